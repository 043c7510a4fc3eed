"""Scenes run by a strict stand-in of SOFA, and their equilibria without the package."""

import csv
import json

import numpy as np
import pytest
from scene_equilibrium import solve
from wording import says

import softcal_jax as sc
from benchmarks._sofa import Node, components, run
from benchmarks._sofa_scenes import (
    CONFIGURATIONS,
    GROUND,
    LAWS,
    MESH,
    TIP,
    actuated,
    densities,
    edge_law,
    hollow_beam,
    posed,
)
from softcal_jax.exchange._formats import exported_poses
from softcal_jax.exchange.sofa._export import check_robot, scene_data
from softcal_jax.materials import SofaCorotational

FACTORS = {"mm-kg-s": 1e3, "SI": 1.0}

FAR = sc.Guide((0.2, 0.01, 0.02), "ground")


@pytest.fixture(scope="module")
def bent_beam():
    return posed(edge_law(), CONFIGURATIONS)


def assert_same_equilibrium(scene, folder, release, units):
    """The stand-in meets the package's effectors and nodes to 1e-6 of the motion."""
    for c, u in zip(scene.configurations, scene.displacement, strict=True):
        root, monitor = run(folder, release, name=c.name)
        x, X = solve(root)
        factor = FACTORS[units]
        np.testing.assert_allclose(X, factor * scene.model.mesh.points, rtol=1e-15)
        motion = np.abs(u).max()
        assert motion > 1e-4
        np.testing.assert_allclose((x - X) / factor, u, rtol=0, atol=1e-6 * motion)
        monitor.state.position.value = x.tolist()
        monitor.onAnimateEndEvent({})
        with monitor.path.open(newline="") as file:
            header, *rows = csv.reader(file)
        assert header[-1] == "distance from predicted"
        assert [row[1] for row in rows] == list(TIP.names)
        off = [float(row[-1]) for row in rows]
        assert max(off) < 1e-6 * factor * motion
        held = TIP.positions[0] * factor
        assert np.linalg.norm(np.array(rows[0][2:5], float) - held) > 0.1 * motion


@pytest.mark.parametrize(
    ("release", "units"),
    [("v25.12", "mm-kg-s"), ("v26.06", "mm-kg-s"), ("v26.06", "SI")],
)
def test_what_sofa_is_given_is_the_model(bent_beam, release, units, tmp_path):
    """Moduli per tet, loads, clamps, sliding, moved and elastic supports, gravity."""
    scene = bent_beam
    scene.write(tmp_path / "scene", release=release, units=units)
    assert_same_equilibrium(scene, tmp_path / "scene", release, units)
    readme = (tmp_path / "scene" / "README.md").read_text()
    assert "runSofa -l SofaPython3 -g batch -n 1 scene.py" in readme
    assert "SoftRobots" not in readme
    data = json.loads((tmp_path / "scene" / "robot.json").read_text())
    first, second = data["configurations"]["bent"]["effectors"]
    assert first["measured"] == [FACTORS[units] * v for v in (0.1, 0.01, 0.0)]
    assert second["measured"][1] == 0.0
    other = data["configurations"]["sprung & moved"]["effectors"]
    assert [effector["measured"] for effector in other] == [None, None]


def test_the_stand_in_is_strict(bent_beam, tmp_path):
    bent_beam.write(tmp_path / "scene")
    script = tmp_path / "scene" / "scene.py"
    text = script.read_text()
    wrong = {
        ("maxNbIterationsNewton=", "newton_iterations="): "has no data newton_iter",
        ('"DiagonalMass"', '"DiagonalMas"'): "has no component DiagonalMas",
        ('    "Sofa.Component.Mass",\n', ""): "needs the plugin Sofa.Component.Mass",
        ('"@loader.position"', '"@load.position"'): "the link @load.position leads",
    }
    for (old, new), message in wrong.items():
        assert old in text
        script.write_text(text.replace(old, new))
        with pytest.raises(ValueError, match=message):
            run(tmp_path / "scene", "v26.06")


def test_unknown_names_are_counted(bent_beam, tmp_path):
    bent_beam.write(tmp_path / "scene")
    script = tmp_path / "scene" / "scene.py"
    text = script.read_text()
    for old, new in (
        ("maxNbIterationsNewton=", "newton_iterations="),
        ('    "Sofa.Component.Mass",\n', '    "Sofa.Component.Masses",\n'),
    ):
        assert old in text
        text = text.replace(old, new)
    script.write_text(text)
    unknown = []
    run(tmp_path / "scene", "v26.06", unknown=unknown)
    needed, unread, unneeded = sorted(unknown)
    assert says(needed, "DiagonalMass needs ... Sofa.Component.Mass")
    assert says(unread, "NewtonRaphsonSolver ... newton_iterations")
    assert says(unneeded, "no component ... Sofa.Component.Masses")


def test_the_stand_in_knows_both_releases():
    new = set(components("v26.06")) - set(components("v25.12"))
    assert new == {"CorotationalFEMForceField"}
    with pytest.raises(ValueError, match="no component GenericConstraintSolver"):
        Node("root", "v26.06").addObject("GenericConstraintSolver")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(LAWS)[1:])
def test_other_laws(name, tmp_path):
    scene = posed(LAWS[name](), CONFIGURATIONS[:1])
    scene.write(tmp_path / "scene")
    assert_same_equilibrium(scene, tmp_path / "scene", "v26.06", "mm-kg-s")


@pytest.mark.slow
def test_cables_and_chambers(tmp_path):
    """Tension through guides, from the ground at either end, and a pressure."""
    mesh, (actuators, configurations) = hollow_beam(), actuated()
    *configurations, _ = configurations
    law = SofaCorotational.of_mesh(mesh, sc.Isotropic(2e5, 0.3), "edge")
    scene = posed(law, configurations, mesh=mesh, actuators=actuators)
    np.testing.assert_allclose(scene.displacement[0], scene.displacement[1], atol=1e-12)
    scene.write(tmp_path / "scene")
    readme = (tmp_path / "scene" / "README.md").read_text()
    assert "-l SoftRobots -g batch -n 100" in readme
    assert_same_equilibrium(scene, tmp_path / "scene", "v26.06", "mm-kg-s")


def written(configuration, *actuators, mesh=None):
    """A configuration of a hollow beam as it is written in mm, not solved."""
    mesh = hollow_beam() if mesh is None else mesh
    law = SofaCorotational.of_mesh(mesh, sc.Isotropic(2e5, 0.3), "edge")
    model = sc.build_model(mesh, law, density=1.0, actuators=actuators)
    space = densities()
    poses = exported_poses(model, space, space.start(), [configuration])
    data = scene_data("test", model, poses, release="v26.06", units="mm-kg-s")
    return data["configurations"][configuration.name]


def test_imposed_lengths_and_volumes():
    cable = sc.Cable("rope", [GROUND, (0.1, 0.01, 0.02)])
    imposed = {
        "rope": sc.ImposedDisplacement(0.002),
        "cavity": sc.ImposedDisplacement(1e-7),
    }
    asked = sc.Configuration("wound", "x_min", actuation=imposed)
    scene = written(asked, cable, sc.Chamber("cavity", "cavity"))
    (rope,), (cavity,) = scene["cables"], scene["chambers"]
    assert (rope["value"], rope["value type"]) == (2.0, "displacement")
    assert rope["pull point"] == [-10.0, 10.0, 20.0]
    np.testing.assert_allclose(rope["points"], [[100.0, 10.0, 20.0]])
    np.testing.assert_allclose(cavity["value"], 100.0)  # mm3
    assert cavity["value type"] == "volumeGrowth"


def test_a_guide_in_a_channel_is_refused():
    """SOFA would tie it to the nearest tet."""
    mesh = hollow_beam()
    middle = mesh.points[mesh.nodes("cavity")].mean(axis=0)
    cable = sc.Cable("rope", [(0.0, 0.01, 0.02), tuple(middle)])
    pulled = {"rope": sc.ImposedForce(1.0)}
    with pytest.raises(ValueError, match=r"'rope' .*channel.*one tet"):
        written(sc.Configuration("pulled", "x_min", actuation=pulled), cable)


def test_a_sealed_chamber_is_its_wall_where_its_rim_is_held():
    mesh = hollow_beam()
    rim, *wall = mesh.surface_groups["cavity"]
    opened = mesh.with_surface_group("wall", np.array(wall))
    opened = opened.with_node_group("rim", rim)
    sealed = sc.Chamber("cavity", "wall", seal=True)
    blown = {"cavity": sc.ImposedForce(1e3)}
    held = sc.Configuration("held", ["x_min", "rim"], actuation=blown)
    (cavity,) = written(held, sealed, mesh=opened)["chambers"]
    assert len(cavity["triangles"]) == len(wall)
    loose = sc.Configuration("loose", "x_min", actuation=blown)
    with pytest.raises(ValueError, match=r"'cavity': .*rim .* 3 nodes .*Hold"):
        written(loose, sealed, mesh=opened)


REFUSED = {
    "two ends on the ground": (
        {"supports": "x_min", "actuation": {"rope": sc.ImposedForce(1.0)}},
        "'rope' .*more than one guide",
    ),
    "volume beside a moved support": (
        {
            "supports": [sc.Support("x_min", displacement=(0.001, 0.0, 0.0))],
            "actuation": {"cavity": sc.ImposedDisplacement(1e-7)},
        },
        "'asked': .*chamber .*imposed .*pressure",
    ),
    "elastic support that moves": (
        {
            "supports": [
                "x_min",
                sc.Support("x_side", "x", (0.001, 0.0, 0.0), stiffness=1e5),
            ]
        },
        "'asked': .*support .*displacement out",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_configurations_that_a_scene_cannot_hold(name):
    asked, message = REFUSED[name]
    rope = sc.Cable("rope", [GROUND, (0.06, 0.01, 0.02), FAR])
    with pytest.raises(ValueError, match=message):
        written(
            sc.Configuration("asked", **asked), rope, sc.Chamber("cavity", "cavity")
        )


def test_robots_that_a_scene_cannot_hold():
    bodies = [sc.RigidBody("plate", "x_max")]
    model = sc.build_model(MESH, edge_law(), density=1.0, bodies=bodies)
    with pytest.raises(ValueError, match=r"bodies \(plate\).*`base_radius`"):
        check_robot(model)
    rope = sc.Cable(
        "rope",
        [(0.02, 0.01, 0.02), (0.06, 0.01, 0.02), (0.1, 0.01, 0.02)],
        friction=0.2,
        pulled_from="first",
    )
    model = sc.build_model(MESH, edge_law(), density=1.0, actuators=[rope])
    with pytest.raises(ValueError, match=r"friction 'rope' .*no counterpart"):
        check_robot(model)
