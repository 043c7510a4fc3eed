"""The cantilever of Sec. V of the paper."""

import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import gravity_load
from softcal_jax.fields import check_parameters
from softcal_jax.mesh import volumes
from softcal_jax.robots import anisotropic_beam

CELLS = (2, 1, 1)
NAMES = [f"{field} of CP {i}" for field in ("E_t", "E_l", "theta") for i in (1, 2)]


@pytest.fixture(scope="module")
def beam():
    return anisotropic_beam(cells=CELLS, poses=range(1, 7))


def test_size_and_mass(beam):
    points = beam.model.mesh.points
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.15, 0.015, 0.015])
    mass = float(beam.model.density) * volumes(beam.model.mesh).sum()
    np.testing.assert_allclose(mass, 0.032, rtol=1e-12)
    weight = gravity_load(beam.model, jnp.array([0.0, 0.0, -9.81])).sum(axis=0)
    np.testing.assert_allclose(weight, [0.0, 0.0, -0.31392], atol=1e-12)


def test_poses_turn_gravity_about_the_long_axis(beam):
    """0, 45 and 90 degrees, held at one end and then at the other."""
    root = 9.81 / np.sqrt(2.0)
    expected = [(0.0, -9.81, 0.0), (0.0, -root, root), (0.0, 0.0, 9.81)] * 2
    gravity = [configuration.gravity for configuration in beam.configurations]
    np.testing.assert_allclose(gravity, expected, atol=1e-12)
    names = [configuration.name for configuration in beam.configurations]
    assert names == [f"pose {i}" for i in range(1, 7)]


def test_effector_is_the_centre_of_the_free_end(beam):
    arrays = configuration_arrays(beam.model.mesh, beam.configurations)
    held = np.asarray(arrays.fixed).all(axis=2)
    x = beam.model.mesh.points[:, 0]
    for i, configuration in enumerate(beam.configurations):
        held_x, free_x = (0.0, 0.15) if i < 3 else (0.15, 0.0)
        np.testing.assert_array_equal(held[i], np.isclose(x, held_x))
        np.testing.assert_allclose(
            configuration.markers.positions, [[free_x, 0.0075, 0.0075]], atol=1e-15
        )
        assert configuration.measured is None


def test_four_effectors_stand_on_the_bottom_midline():
    beam = anisotropic_beam(cells=CELLS, poses=[1], n_effectors=4, std=2e-3)
    markers = beam.configurations[0].markers
    expected = [(x, 0.0, 0.0075) for x in (0.0525, 0.0675, 0.0825, 0.0975)]
    np.testing.assert_allclose(markers.positions, expected, atol=1e-15)
    assert markers.names[0] == "x 52.5 mm"
    np.testing.assert_array_equal(markers.std, 2e-3)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"tensor_steps": False},
        {"tensor_steps": False, "ordered": False, "scaling": "linear"},
        {"tensor_steps": False, "scaling": "paper", "interpolation": "linear"},
        {"plane": "xy", "order": 1},
    ],
)
def test_parameters_fit_the_model(options):
    beam = anisotropic_beam(cells=CELLS, **options)
    check_parameters(beam.model, beam.space)
    assert beam.space.names == NAMES
    assert set(beam.target) == set(NAMES)
    start = beam.space.from_scaled(beam.space.start())
    np.testing.assert_allclose(start, [7e5, 7e5, 4e5, 4e5, 0, 0], rtol=1e-13)
    target = beam.space.to_scaled(jnp.array([beam.target[name] for name in NAMES]))
    assert np.all(target >= beam.space.lower())
    assert np.all(target <= beam.space.upper())
    A, b = beam.space.order_rows()
    assert len(b) == (2 if options.get("ordered", True) and not beam.space.axes else 0)
    assert np.all(A @ target <= b)


def test_control_points_are_the_centres_of_the_end_faces(beam):
    for entry in beam.space.entries:
        np.testing.assert_allclose(
            entry.control_points.positions,
            [[0.0, 0.0075, 0.0075], [0.15, 0.0075, 0.0075]],
        )


def test_scaling_and_step_limits_of_the_published_scene():
    """S = (1 MPa, 1 MPa, 1 rad); one step moves 10 kPa or 0.005 rad at most."""
    beam = anisotropic_beam(
        cells=CELLS, scaling="paper", interpolation="linear", tensor_steps=False
    )
    unit = [float(q.unit_step) for q in beam.space.parameters]
    np.testing.assert_allclose(unit, [1e6, 1e6, 1e6, 1e6, 1.0, 1.0])
    moves = np.array(unit) * np.asarray(beam.space.max_step())
    np.testing.assert_allclose(moves, [1e4, 1e4, 1e4, 1e4, 0.005, 0.005])


def test_print_plane_and_start_are_those_asked_for():
    start = {"E_t": 5e5, "E_l": 1e5, "theta": 0.3}
    beam = anisotropic_beam(cells=CELLS, plane="xy", start=start)
    assert beam.model.law.elasticity.fibre.plane == "xy"
    begun = beam.space.from_scaled(beam.space.start())
    np.testing.assert_allclose(begun, [5e5, 5e5, 1e5, 1e5, 0.3, 0.3], rtol=1e-13)


def test_bad_pose_and_number_of_effectors(unchecked):
    with pytest.raises(ValueError, match=r"pose .* 1, 2, 3, 4, 5, 6, got 7\."):
        anisotropic_beam(cells=CELLS, poses=[1, 7])
    with pytest.raises(ValueError, match=r"n_effectors .* 1 or 4, got 3\."):
        anisotropic_beam(cells=CELLS, n_effectors=3)
