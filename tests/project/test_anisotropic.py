"""What a project file with laws, control points and candidates becomes."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from anisotropic_project import write_anisotropic_project
from small_project import write_small_project
from wording import says

from softcal_jax.fields import ControlPointParameters
from softcal_jax.materials import (
    ClassicalCorotational,
    Corotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    ReducedTransverseIsotropic,
    StVenantKirchhoff,
    TransverseHyperelastic,
    TransverseIsotropic,
)
from softcal_jax.project import Project, ProjectError, load_project
from softcal_jax.robots import anisotropic_beam, synthetic_measurements

DEGREE = np.pi / 180.0
FIBRE = 'theta = "20 deg"\nphi = "0.1 rad"\nprint_plane = "xy"\n'
FULL = f'nu_t = 0.2\nnu_tl = 0.3\nmu_l = "150 kPa"\n{FIBRE}'
SOFT = (700e3, 400e3)


def law_of(folder, law, constants):
    """The law of a file, from its name and constants, at one point."""
    path = write_small_project(
        folder,
        ('law = "neo-hookean"\nE = "200 kPa"\nnu = 0.3\n', f"{law}\n{constants}"),
        (
            'field = "E"\nlower = "100 kPa"\nupper = "1 MPa"',
            'field = "density"\nlower = "500 kg/m^3"\nupper = "2 g/cm^3"',
        ),
    )
    return load_project(path).model.law


def fibre():
    return Fibre(20.0 * DEGREE, 0.1, "xy")


LAWS = {
    "isotropic by name": (
        'law = "corotational"\nelasticity = "isotropic"',
        'E = "200 kPa"\nnu = 0.3\n',
        lambda: Corotational(Isotropic(200e3, 0.3)),
    ),
    "full": (
        'law = "corotational"\nelasticity = "transverse-isotropic"',
        f'E_t = "700 kPa"\nE_l = "400 kPa"\n{FULL}',
        lambda: Corotational(TransverseIsotropic(*SOFT, 0.2, 0.3, 150e3, fibre())),
    ),
    "reduced": (
        'law = "st-venant-kirchhoff"\nelasticity = "reduced-transverse-isotropic"',
        f'E_t = "700 kPa"\nE_l = "400 kPa"\nnu = 0.3\n{FIBRE}',
        lambda: StVenantKirchhoff(ReducedTransverseIsotropic(*SOFT, 0.3, fibre())),
    ),
    "classical": (
        'law = "classical-corotational"\nelasticity = "reduced-transverse-isotropic"',
        f'E_t = "700 kPa"\nE_l = "400 kPa"\nnu = 0.3\n{FIBRE}',
        lambda: ClassicalCorotational(ReducedTransverseIsotropic(*SOFT, 0.3, fibre())),
    ),
    "transverse hyperelastic": (
        'law = "transverse-hyperelastic"',
        f'E_t = "700 kPa"\nE_l = "400 kPa"\nnu = 0.3\nmu_l = "150 kPa"\n{FIBRE}',
        lambda: TransverseHyperelastic(*SOFT, 0.3, 150e3, fibre()),
    ),
    "angle out of the plane left out": (
        'law = "transverse-hyperelastic"',
        'E_t = "700 kPa"\nE_l = "400 kPa"\nnu = 0.3\nmu_l = "150 kPa"\n'
        'theta = "20 deg"\n',
        lambda: TransverseHyperelastic(*SOFT, 0.3, 150e3, Fibre(20.0 * DEGREE)),
    ),
    "fibre-reinforced": (
        'law = "fibre-reinforced"',
        f'E = "264 kPa"\nnu = 0.499\nE_f = "20 MPa"\n{FIBRE}',
        lambda: FibreReinforced(NeoHookean(264e3, 0.499), 20e6, fibre()),
    ),
    "fibre-reinforced with another matrix": (
        'law = "fibre-reinforced"\nmatrix = "corotational"',
        'E = "264 kPa"\nnu = 0.3\nE_f = "20 MPa"\nfamilies = 2\ntension_only = true\n'
        + FIBRE,
        lambda: FibreReinforced(
            Corotational(Isotropic(264e3, 0.3)),
            20e6,
            fibre(),
            families=2,
            tension_only=True,
        ),
    ),
    "along an axis": (
        'law = "fibre-reinforced"',
        'E = "264 kPa"\nnu = 0.3\nE_f = "20 MPa"\ndirections = { type = "along", axis '
        '= "x" }\n',
        lambda: FibreReinforced(NeoHookean(264e3, 0.3), 20e6, Fibre(0.0)),
    ),
}


@pytest.mark.parametrize("case", LAWS)
def test_laws(tmp_path, case):
    """The same stress as the law made in Python, under a strain of all components."""
    law, constants, expected = LAWS[case]
    got, wanted = law_of(tmp_path, law, constants), expected()
    F = jnp.asarray([[1.1, 0.05, 0.02], [-0.03, 0.95, 0.04], [0.01, 0.06, 1.03]])
    assert type(got) is type(wanted)
    # One tet, where the directions of fibres are given for each.
    one = lambda leaf: leaf if np.ndim(leaf) == 0 else jnp.asarray(np.asarray(leaf)[0])
    got = jax.tree.map(one, got)
    np.testing.assert_allclose(got.stress(F), wanted.stress(F), rtol=1e-12)


def test_the_example_is_the_beam_of_the_paper():
    """Model, parameters and poses of the explained file are those of the robot."""
    project = load_project(Path(__file__).with_name("anisotropic_beam.toml"))
    beam = anisotropic_beam(poses=(1, 2, 3, 4))
    assert project.space is not None
    assert project.space.names == beam.space.names
    assert project.space.axes == beam.space.axes == (("E_l", "E_t", "theta"),)
    for mine, theirs in zip(project.parameters, beam.space.parameters, strict=True):
        for key in ("start", "lower", "upper", "unit_step"):
            np.testing.assert_allclose(
                getattr(mine, key), getattr(theirs, key), rtol=1e-14, err_msg=key
            )
        assert (mine.scale, mine.unit) == (theirs.scale, theirs.unit)
        assert mine.periodic == theirs.periodic
    z = beam.space.to_scaled(jnp.asarray([beam.target[n] for n in beam.space.names]))
    mine, theirs = (
        p.model_at(m, z)
        for p, m in ((project.space, project.model), (beam.space, beam.model))
    )
    for name in ("E_t", "E_l"):
        np.testing.assert_allclose(
            getattr(mine.law.elasticity, name), getattr(theirs.law.elasticity, name)
        )
    np.testing.assert_allclose(
        mine.law.elasticity.fibre.theta, theirs.law.elasticity.fibre.theta
    )
    np.testing.assert_allclose(mine.density, theirs.density, rtol=1e-6)
    poses = project.configurations + project.candidates
    for posed, pose in zip(poses, beam.configurations, strict=True):
        np.testing.assert_allclose(posed.gravity, pose.gravity, atol=1e-12)
        assert posed.markers is not None
        np.testing.assert_allclose(posed.markers.positions, pose.markers.positions)


def test_options_of_control_points(tmp_path):
    path = write_anisotropic_project(
        tmp_path,
        (
            'positions = { "CP 1" = "(0, 7.5, 7.5) mm", "CP 2" = "(150, 7.5, 7.5) mm" }'
            "\npower = 2",
            'positions = ["(0, 0, 0) mm", "(75, 0, 0) mm", "(150, 0, 0) mm"]\n'
            'names = ["foot", "middle", "tip"]\npower = 4\nnearest = 2\naxes = "x"\n'
            'max_distance = "1 cm"',
        ),
        (
            'start = { "CP 2" = "0.6 MPa" }\nlower = "50 kPa"\nupper = "1 MPa"',
            'lower = { foot = "50 kPa", middle = "60 kPa" }\nupper = "1 MPa"\n'
            'fixed = { tip = "0.9 MPa" }\nsampling = "centroids"\n'
            'interpolation = "log"\nmax_step = 0.01',
        ),
        (
            'field = "E_l"\n',
            'field = "E_l"\ntied = { tip = "E_l of foot" }\nscale = "linear"\n'
            'S = "1 MPa"\n',
        ),
        ("axes = [[", 'order = [["E_l of foot", "E_l of middle"]]\n# [['),
    )
    space = load_project(path).space
    assert space is not None
    E_t, E_l, theta = space.entries
    assert isinstance(E_t, ControlPointParameters)
    points = E_t.control_points
    assert points.names == ("foot", "middle", "tip")
    assert (points.power, points.nearest, points.axes) == (4.0, 2, "x")
    assert points.max_distance == 0.01
    assert [float(q.lower) for q in E_t.parameters] == [50e3, 60e3]
    assert E_t.interpolation == "log"
    assert {k: float(v) for k, v in E_t.fixed.items()} == {"tip": 900e3}
    assert [float(q.max_step) for q in E_t.parameters] == [0.01, 0.01]
    assert isinstance(E_l, ControlPointParameters)
    assert E_l.tied == (("tip", "E_l of foot"),)
    assert [q.name for q in E_l.parameters] == ["E_l of foot", "E_l of middle"]
    assert (E_l.scale, float(E_l.parameters[0].unit_step)) == ("linear", 1e6)
    assert E_l.interpolation == "linear"
    assert isinstance(theta, ControlPointParameters)
    assert theta.interpolation == "director"
    assert theta.scale == "linear"
    assert space.order == (("E_l of foot", "E_l of middle"),)


CORE = ('S = "1 rad"\n', 'S = "1 rad"\ncore = 0.1\n')


def test_core_of_the_angle(tmp_path):
    space = load_project(write_anisotropic_project(tmp_path, CORE)).space
    assert space is not None
    cores = {e.field: e.core for e in space.entries if hasattr(e, "core")}
    assert cores == {"E_t": 0.0, "E_l": 0.0, "theta": 0.1}


def test_a_core_without_axes_is_refused(tmp_path):
    path = write_anisotropic_project(tmp_path, CORE, ("axes = [[", "# [["))
    with pytest.raises(ProjectError, match=r"theta .*core.* in axes"):
        load_project(path)


def test_angles_are_in_radians(tmp_path):
    """The start of an angle is that of the material; a file has degrees."""
    project = load_project(write_anisotropic_project(tmp_path))
    theta = project.parameters[-1]
    assert (theta.name, theta.unit) == ("theta of CP 2", "rad")
    np.testing.assert_allclose(
        [theta.start, theta.lower, theta.upper],
        np.array([10.0, -90.0, 90.0]) * DEGREE,
        rtol=1e-15,
    )
    assert float(theta.unit_step) == 1.0


def test_one_angle_for_the_body_turns_freely(tmp_path):
    """Bounds of half a turn are none, with control points or without."""
    path = write_anisotropic_project(
        tmp_path,
        ('field = "theta"\ncontrol_points = "ends"', 'field = "theta"'),
        ("axes = [[", "# [["),
    )
    assert load_project(path).parameters[-1].periodic


def test_a_single_parameter_has_no_table_of_bounds(tmp_path):
    """Not an empty one, either."""
    path = write_anisotropic_project(
        tmp_path,
        ('field = "theta"\ncontrol_points = "ends"', 'field = "theta"'),
        ('upper = "90 deg"', "upper = {}"),
        ("axes = [[", "# [["),
    )
    with pytest.raises(ProjectError) as refused:
        load_project(path)
    assert says(refused.value, "upper = {}", "control_points")


def test_regions_have_constants_of_their_own(tmp_path):
    path = write_anisotropic_project(
        tmp_path,
        (
            "[control_points.ends]",
            '[groups.half]\nof = "tets"\n'
            'box = { lower = "(75, 0, 0) mm", upper = "(150, 15, 15) mm" }\n\n'
            '[material.regions.half]\nE_t = "500 kPa"\ntheta = "-30 deg"\n\n'
            "[control_points.ends]",
        ),
        (
            'field = "E_t"\ncontrol_points = "ends"\nstart = { "CP 2" = "0.6 MPa" }',
            'field = "E_t"\nregion = "half"',
        ),
        (
            'field = "theta"\ncontrol_points = "ends"',
            'field = "theta"\nregion = "half"\ncontrol_points = "ends"',
        ),
        ("axes = [[", "# [["),
        ('"CP 1" = "(0, 7.5', '"CP 1" = "(76, 7.5'),
    )
    project = load_project(path)
    law, half = project.model.law, project.model.mesh.tets_of("half")
    E_t, theta = law.elasticity.E_t, law.elasticity.fibre.theta
    other = np.setdiff1d(np.arange(project.model.n_tets), half)
    np.testing.assert_allclose(E_t[half], 500e3, rtol=1e-12)
    np.testing.assert_allclose(E_t[other], 700e3, rtol=1e-12)
    np.testing.assert_allclose(theta[half], -30.0 * DEGREE, rtol=1e-12)
    np.testing.assert_allclose(theta[other], 10.0 * DEGREE, rtol=1e-12)
    assert project.parameters[0].name == "E_t_half"
    assert float(project.parameters[0].start) == 500e3
    assert project.parameters[-1].name == "theta of CP 2"
    assert float(project.parameters[-1].start) == pytest.approx(-30.0 * DEGREE)


def test_candidates_share_what_is_not_measured(tmp_path):
    """Gravity, supports and markers of [shared]; its measurement is of others."""
    path = write_small_project(
        tmp_path,
        (
            '[[configurations]]\nname = "pulled"',
            '[[candidates]]\nname = "upside down"\ngravity = "(0, 0, 9.81) m/s^2"\n\n'
            '[[configurations]]\nname = "pulled"',
        ),
    )
    (candidate,) = load_project(path).candidates
    assert candidate.name == "upside down"
    assert candidate.gravity == (0.0, 0.0, 9.81)
    assert candidate.markers is not None
    assert candidate.markers.names == ("tip", "side")
    assert candidate.measured is None


def test_only_a_calibration_needs_measurements(tmp_path):
    """Poses to be measured are read, solved and judged; calibrating names them."""
    project = load_project(write_anisotropic_project(tmp_path))
    assert [c.measured for c in project.configurations] == [None, None]
    with pytest.raises(ProjectError) as caught:
        project.calibrate()
    number, *problems = str(caught.value).splitlines()
    assert number == f"{project.path}: 2 problems."
    for name, problem in zip(("pose 1", "pose 3"), problems, strict=True):
        assert says(problem, f"configurations.{name}: ... no `measured`")


def test_candidates_alone(tmp_path):
    """A file without any configuration: nothing to simulate, something to rank."""
    path = write_anisotropic_project(tmp_path)
    text = path.read_text()
    start, end = text.index("[[configurations]]"), text.index("[[candidates]]")
    path.write_text(text[:start] + text[end:])
    project = load_project(path)
    project.check_identify()
    with pytest.raises(ProjectError, match=r"configurations: .*add \[\[config"):
        project.simulate()
    with pytest.raises(ProjectError, match=r'configurations: none .*"calibration"'):
        project.calibrate()


def test_nothing_to_identify(tmp_path):
    path = write_anisotropic_project(tmp_path, ('markers = ["tip"]\n', ""))
    text = path.read_text()
    cut = text.index("[markers]"), text.index("[shared]")
    last = text.index("[[candidates]]")
    path.write_text(text[: cut[0]] + text[cut[1] : last])
    for ask in (Project.identify, Project.rank_candidates):
        with pytest.raises(ProjectError, match=r"markers: .*add \[markers\]"):
            ask(load_project(path))


def test_ranking_needs_candidates(tmp_path):
    project = load_project(write_small_project(tmp_path))
    with pytest.raises(ProjectError, match=r"candidates: .*add \[\[candidates"):
        project.rank_candidates()


@pytest.mark.slow
def test_known_fields_come_back(tmp_path):
    """A calibration of fields at control points, from poses that the model made."""
    changes = (
        ("cells = [4, 1, 1] }", 'cells = [3, 1, 1] }\nelement = "linear"'),
        (
            'field = "theta"\ncontrol_points = "ends"\nlower = "-90 deg"\n'
            'upper = "90 deg"\nS = "1 rad"',
            'field = "nu"\nlower = 0.1\nupper = 0.4',
        ),
        ("axes = [[", 'order = [["E_l", "E_t"]]\n# [['),
        ('[[candidates]]\nname = "pose 4"', '[[configurations]]\nname = "pose 4"'),
    )
    project = load_project(write_anisotropic_project(tmp_path, *changes))
    assert project.space is not None
    target = [900e3, 600e3, 300e3, 200e3, 0.35]
    measured = synthetic_measurements(
        project.model,
        project.space,
        project.calibration,
        dict(zip(project.space.names, target, strict=True)),
    )
    known = dataclasses.replace(project, calibration=measured, starts=1, intervals=None)
    result = known.calibrate()
    assert result.converged
    np.testing.assert_allclose([p.value for p in result.parameters], target, rtol=1e-5)
