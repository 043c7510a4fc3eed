"""Measurements that the model makes of itself."""

from dataclasses import replace

import numpy as np
import pytest

from softcal_jax import lanes
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import synthetic_measurements

N_MARKERS = 300
VALUES = {"rho": 800.0, "E": 2e5}  # not in the order of the space
SPACE = ParameterSpace(
    (
        Parameter("E", "E", 1e5, 3e4, 1e6),
        Parameter("rho", "density", 1e3, 100.0, 1e4),
    )
)
INSIDE = np.random.default_rng(7).uniform(0.05, 0.95, (N_MARKERS, 3))
POSITIONS = INSIDE * [0.1, 0.02, 0.02]
EVERY = tuple(f"m{i}" for i in range(N_MARKERS))


def pose(name, std, gravity=(0.0, 0.0, -9.81), n=N_MARKERS):
    markers = Markers(EVERY[:n], POSITIONS[:n], std)
    return Configuration(name, "x_min", gravity, markers=markers)


@pytest.fixture(scope="module")
def model():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1))
    return build_model(mesh, NeoHookean(1e5, 0.3), density=1000.0)


@pytest.fixture(scope="module")
def poses():
    return (pose("down", 1e-3), pose("side", 1e-3, (0.0, 3.0, 0.0), n=2))


@pytest.fixture(scope="module")
def exact(model, poses):
    return synthetic_measurements(model, SPACE, poses, VALUES)


def test_positions_are_those_of_the_equilibrium(model, poses, exact):
    """A body built with the values themselves, one pose at a time."""
    body = build_model(model.mesh, NeoHookean(2e5, 0.3), density=800.0)

    def positions(pose):
        lane = lanes(body, [pose])[0]
        moved = model.mesh.points + solve_equilibrium(body, lane).displacement
        carriers = np.asarray(moved)[lane.effectors.nodes]
        return np.einsum("ij,ijk->ik", lane.effectors.weights, carriers)

    assert [c.name for c in exact] == ["down", "side"]
    for before, after in zip(poses, exact, strict=True):
        expected = positions(before)
        assert after.measured.shape == before.markers.positions.shape
        # The equilibrium is that of Newton's default tolerance.
        np.testing.assert_allclose(after.measured, expected, rtol=0, atol=1e-9)
        assert np.abs(after.measured - before.markers.positions).max() > 1e-4
        assert before.measured is None


def errors(model, exact, poses, seed):
    noisy = synthetic_measurements(model, SPACE, poses, VALUES, noise=True, seed=seed)
    return [a.measured - b.measured for a, b in zip(noisy, exact, strict=True)]


def test_noise_has_the_standard_deviation_of_each_marker_and_axis(model, exact):
    """Normal errors: 100 to 900 draws of each kind, within five standard errors."""
    per_marker = np.repeat([1e-3, 2e-3, 4e-3], N_MARKERS // 3)
    per_axis = np.tile([1e-3, 2e-3, 4e-3], (N_MARKERS, 1))
    for std in (np.array(2e-3), per_marker, per_axis):
        poses = (pose("down", std), pose("side", 1e-3, (0.0, 3.0, 0.0), n=2))
        noise = errors(model, exact, poses, seed=3)[0]
        unit = noise / (std[:, None] if std.ndim == 1 else std)
        for part in (unit, *unit.T, *np.split(unit, 3)):
            n = part.size
            assert abs(np.std(part) - 1.0) < 5.0 / np.sqrt(2.0 * n)
            assert abs(np.mean(part)) < 5.0 / np.sqrt(n)


def test_noise_is_that_of_its_seed(model, exact, poses):
    first, again, other = (errors(model, exact, poses, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[0], again[0])
    assert np.all(first[0] != other[0])
    # The poses do not share their errors either.
    assert np.all(first[0][:2] != first[1])


def test_measured_positions_are_replaced_and_all_else_is_kept(exact):
    moved = replace(exact[0], measured=exact[0].measured + 1.0)
    np.testing.assert_array_equal(moved.measured, exact[0].measured + 1.0)
    for name in ("name", "supports", "gravity", "loads"):
        assert getattr(moved, name) == getattr(exact[0], name)
    assert moved.markers is exact[0].markers


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"E": 2e5}, "'rho'.*not given.* E, rho"),
        (VALUES | {"nu": 0.3}, "'nu'.*no parameter.* E, rho"),
        ({}, "'E'.*not given"),
    ],
)
def test_values_must_name_every_parameter(model, poses, values, message):
    with pytest.raises(ValueError, match=message):
        synthetic_measurements(model, SPACE, poses, values)


def test_configuration_without_markers_is_named(model, poses):
    blind = Configuration("blind", "x_min")
    with pytest.raises(ValueError, match=r"'blind'.*no markers"):
        synthetic_measurements(model, SPACE, [*poses, blind], VALUES)


def test_configuration_without_equilibrium_is_named(model, poses):
    """Fifty thousand times its weight, head down."""
    crushed = pose("crushed", 1e-3, (-5e5, 0.0, 0.0), n=2)
    with pytest.raises(RuntimeError, match="configuration 'crushed'") as error:
        synthetic_measurements(model, SPACE, [poses[0], crushed], VALUES)
    assert "down" not in str(error.value)
