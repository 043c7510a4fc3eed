"""What a project file becomes."""

import numpy as np
import pytest
from small_project import E_TRUE, write_small_project
from watching import only
from wording import says

from softcal_jax.calibration import HistoryEntry
from softcal_jax.calibration._configuration_result import displaced
from softcal_jax.configurations import configuration_lanes
from softcal_jax.materials import Corotational, NeoHookean, StVenantKirchhoff
from softcal_jax.mesh import beam
from softcal_jax.project import ProjectError, load_project


def test_all_that_it_holds(tmp_path):
    project = load_project(write_small_project(tmp_path))
    assert project.name == "small"
    assert [c.name for c in project.configurations] == ["weight", "pulled"]
    assert [c.name for c in project.validation] == ["pulled"]
    (E,) = project.parameters
    assert (E.name, E.field, E.scale, E.unit) == ("E", "E", "log", "Pa")
    assert [float(v) for v in (E.start, E.lower, E.upper)] == [200e3, 100e3, 1e6]
    assert float(project.model.density) == pytest.approx(1000.0)
    assert isinstance(project.model.law, NeoHookean)
    np.testing.assert_array_equal(
        project.model.mesh.points, beam(0.06, 0.02, 0.02, (3, 1, 1)).points
    )
    np.testing.assert_array_equal(
        project.model.mesh.nodes("tip"), project.model.mesh.nodes("x_max")
    )
    assert project.noise == "estimated"
    markers = project.calibration[0].markers
    assert markers is not None
    np.testing.assert_allclose(markers.std, [1e-4, 2e-4])


def test_measured_displacements(tmp_path):
    """The glue offset of the tip and the frame of the camera are gone."""
    project = load_project(write_small_project(tmp_path))
    for name, registration in project.registrations.items():
        assert registration.rms < 1e-11, name
    weight = project.calibration[0]
    # Down by half a millimetre; registered, but not turned about another axis.
    np.testing.assert_allclose(
        weight.measured - weight.markers.positions,
        [[-8.2e-6, 1.04e-4, -5.61e-4], [-1.33e-4, 1.07e-4, -5.59e-4]],
        atol=1e-6,
    )


def test_measured_positions(tmp_path):
    """Without `displacement_from`, the glue offset of 1 mm stays in."""
    line = 'displacement_from = { phase = "rest" }\n'
    positions = load_project(write_small_project(tmp_path / "a", (line, "")))
    displaced = load_project(write_small_project(tmp_path / "b"))
    offset = positions.calibration[0].measured - displaced.calibration[0].measured
    np.testing.assert_allclose(offset, [[0, 0, 1e-3], [0, 0, 0]], atol=1e-11)


def test_displacements_from_a_configuration(tmp_path):
    """The glue offset of 1 mm stays in the positions, and out of the fit."""
    line = 'displacement_from = { phase = "rest" }\n'
    changes = [
        (line, 'displacement_from = "weight"\n'),
        ('role = "validation"', 'role = "calibration"'),
        ("[markers]\n", "[settings]\nintervals = 0\n\n[markers]\n"),
    ]
    path = write_small_project(tmp_path, *changes)
    project = load_project(path)
    weight, pulled = project.calibration
    assert weight.displacement_from is None
    assert pulled.displacement_from == "weight"
    np.testing.assert_allclose(
        weight.measured - weight.markers.positions,
        [[-8.2e-6, 1.04e-4, 1e-3 - 5.61e-4], [-1.33e-4, 1.07e-4, -5.59e-4]],
        atol=1e-6,
    )
    result = project.calibrate()
    # Steps end where the cost, of which the offsets of 1 mm leave 1e-6, stands still.
    np.testing.assert_allclose(result.value("E"), E_TRUE, rtol=1e-5)
    predicted, _ = project.simulate({"E": E_TRUE})
    for pose in (*result.configurations, *predicted.configurations):
        assert pose.rms_after < 1e-8


def test_glue_is_told_by_poses_that_have_an_equilibrium(tmp_path):
    """An offset of 1 mm in one of two poses that share it; the other has none."""
    changes = [
        ('displacement_from = { phase = "rest" }\n', 'displacement_from = "weight"\n'),
        ('role = "validation"', 'role = "calibration"'),
    ]
    project = load_project(write_small_project(tmp_path, *changes))
    posed, model = project.configurations, project.model
    lanes = configuration_lanes(model.mesh, posed, model.mechanism)
    errors = np.full(np.shape(lanes.arrays.effectors.measured), np.nan)
    errors[0] = 1e-3
    moved = displaced(posed, lanes, errors).effectors
    for before, after in zip(lanes.effectors, moved, strict=True):
        np.testing.assert_allclose(after[0].measured - before[0].measured, 1e-3)


def test_calibrate_and_simulate(tmp_path):
    """E of the recordings comes back; the history starts where the file says."""
    project = load_project(write_small_project(tmp_path))
    seen = []
    result = project.calibrate(watch=only(HistoryEntry, seen.append))
    assert result.converged
    # The recordings hold a picometre: 1e-12 of a motion of 6e-4 m.
    np.testing.assert_allclose(result.value("E"), E_TRUE, rtol=1e-8)
    assert seen[0].values == {"E": pytest.approx(200e3)}
    assert len(seen) == len(result.history)
    assert says(result.notes[-1], "rms", "weight 0.00 mm", "pulled 0.00 mm")

    start, _ = project.simulate()
    assert start.converged
    # Before calibration the body is softer, so it sags more than was measured.
    assert start.configurations[0].displacement[:, 2].min() < -0.561e-3 * 1.3

    predicted, _ = project.simulate({"E": result.value("E"), "friction": 0.3})
    for fit, again in zip(result.configurations, predicted.configurations, strict=True):
        assert again.role == "prediction"
        np.testing.assert_allclose(again.displacement, fit.displacement, atol=1e-12)
        assert again.rms_after == pytest.approx(fit.rms_after, abs=1e-12)
        assert again.motion == fit.motion
    for fit, before in zip(result.configurations, start.configurations, strict=True):
        assert before.rms_after == pytest.approx(fit.rms_before, rel=1e-9)
    with pytest.raises(ProjectError, match=r"no value of E, only of E_t"):
        project.simulate({"E_t": 1e5})


@pytest.mark.parametrize(
    ("law", "kind"),
    [("corotational", Corotational), ("st-venant-kirchhoff", StVenantKirchhoff)],
)
def test_laws(tmp_path, law, kind):
    path = write_small_project(tmp_path, ('"neo-hookean"', f'"{law}"'))
    assert isinstance(load_project(path).model.law, kind)


def test_quadratic_is_the_default(tmp_path):
    path = write_small_project(tmp_path, ('element = "linear"\n', ""))
    mesh = load_project(path).model.mesh
    assert mesh.order == 2
    # Groups by position hold the mid nodes too.
    assert len(mesh.nodes("tip")) == 9


def test_mesh_file(tmp_path):
    """A linear mesh in millimetres is made quadratic, its groups can be selected."""
    import meshio

    made = beam(60.0, 20.0, 20.0, (3, 1, 1))
    meshio.Mesh(made.points, [("tetra", made.tets)]).write(tmp_path / "robot.vtu")
    path = write_small_project(
        tmp_path,
        (
            'beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }',
            'file = "robot.vtu"\nlength_unit = "mm"',
        ),
        ('element = "linear"', ""),
        ('group = "x_min"', 'group = "foot"'),
        ('surface = "x_max"', 'surface = "end"'),
        (
            "[groups.tip]",
            '[groups.foot]\nbox = { lower = "(0, 0, 0) m", upper = "(0, 2, 2) cm" }\n\n'
            '[groups.end]\nof = "faces"\n'
            'plane = { point = "(60, 0, 0) mm", normal = [2, 0, 0] }\n\n[groups.tip]',
        ),
    )
    project = load_project(path)
    assert project.model.mesh.order == 2
    np.testing.assert_allclose(
        project.model.mesh.points.max(axis=0), [0.06, 0.02, 0.02]
    )
    force = project.validation[0].loads[0].nodal_forces(project.model.mesh).sum(axis=0)
    np.testing.assert_allclose(force, [0.02, 0.0, -0.05], atol=1e-15)


def test_regions(tmp_path):
    """Constants per tet group, and a parameter that starts at its region's value."""
    path = write_small_project(
        tmp_path,
        (
            "[groups.tip]",
            '[groups.half]\nof = "tets"\n'
            'sphere = { centre = "(60, 10, 10) mm", radius = "20 mm" }\n\n[groups.tip]',
        ),
        (
            "[[parameters]]",
            '[material.regions.half]\nE = "500 kPa"\ndensity = "2 g/cm^3"\n\n'
            '[[parameters]]\nregion = "half"',
        ),
    )
    project = load_project(path)
    mesh, law = project.model.mesh, project.model.law
    inside = mesh.tets_of("half")
    assert 0 < len(inside) < mesh.n_tets
    expected = np.full(mesh.n_tets, 200e3)
    expected[inside] = 500e3
    np.testing.assert_allclose(law.E, expected, rtol=1e-12)
    np.testing.assert_allclose(project.model.density, expected / 300 - 2e3 / 3 + 1000)
    assert project.parameters[0].name == "E_half"


def test_gravity_by_direction(tmp_path):
    path = write_small_project(
        tmp_path,
        (
            'gravity = "(0, 0, -9.81) m/s^2"',
            'gravity = { size = "9.81 m/s^2", direction = [0, 3, -4] }',
        ),
    )
    np.testing.assert_allclose(
        load_project(path).calibration[0].gravity, [0.0, 5.886, -7.848]
    )


def test_own_on_top_of_shared(tmp_path):
    """A configuration states its own; the tables it shares are merged key by key."""
    path = write_small_project(
        tmp_path,
        (
            'name = "weight"\n',
            'name = "weight"\ngravity = "(0, 0, 0) m/s^2"\nmarkers = ["side"]\n',
        ),
    )
    weight, pulled = load_project(path).configurations
    assert (weight.gravity, pulled.gravity) == ((0, 0, 0), (0, 0, -9.81))
    assert weight.markers.names == ("side",)
    assert weight.measured.shape == (1, 3)
    assert pulled.markers.names == ("tip", "side")


def test_precision_that_is_asked_for(tmp_path):
    assert load_project(write_small_project(tmp_path)).precision == 0.1
    asked = "[settings]\nprecision = 0.05\n\n[markers]\n"
    path = write_small_project(tmp_path, ("[markers]\n", asked))
    assert load_project(path).precision == 0.05


@pytest.mark.parametrize(
    ("asked", "level"), [("", 0.95), ("intervals = 0.9", 0.9), ("intervals = 0", None)]
)
def test_level_of_the_intervals(tmp_path, asked, level):
    """Several starts are a matter of the parameters unless the file says."""
    asked = f"[settings]\n{asked}\n\n[markers]\n"
    project = load_project(write_small_project(tmp_path, ("[markers]\n", asked)))
    assert project.intervals == level
    assert project.starts is None


def test_settings(tmp_path):
    text = '[settings]\nnoise = "stated"\ntol = 1e-4\nstep_bound = 0.5\n\n[newton]\n'
    path = write_small_project(
        tmp_path,
        ("[markers]\n", text + 'rtol = 1e-9\nsolver = "klu"\n\n[markers]\n'),
    )
    project = load_project(path)
    assert project.noise == "stated"
    assert (project.settings.tol, project.settings.step_bound) == (1e-4, 0.5)
    assert project.settings.max_steps == 50
    assert project.newton.rtol == 1e-9
    assert project.model.solver.name == "KLU (klujax)"


def test_start_of_a_parameter(tmp_path):
    """It overrides the constant of the material, in a simulation too."""
    lower = 'lower = "100 kPa"'
    path = write_small_project(tmp_path, (lower, f'{lower}\nstart = "150 kPa"'))
    project = load_project(path)
    assert float(project.parameters[0].start) == 150e3
    assert float(project.model.law.E) == pytest.approx(150e3)


def test_parameter_without_a_unit(tmp_path):
    """Poisson's ratio is a plain number, on a linear scale."""
    path = write_small_project(
        tmp_path,
        (
            'field = "E"\nlower = "100 kPa"\nupper = "1 MPa"',
            'name = "ratio"\nfield = "nu"\nlower = 0.1\nupper = 0.45\nS = 0.05',
        ),
    )
    (ratio,) = load_project(path).parameters
    assert (ratio.name, ratio.scale, ratio.unit) == ("ratio", "linear", "")
    assert float(ratio.start) == 0.3
    assert float(ratio.unit_step) == 0.05
