"""The model of MuJoCo: what its XML holds, what is refused, and MuJoCo's own forces."""

from xml.etree import ElementTree

import numpy as np
import pytest

import softcal_jax as sc
from benchmarks._sofa_scenes import densities
from softcal_jax.actuators import ForceActuator, SurfaceForceActuator, SurfacePressure
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    PointForce,
)
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.exchange._formats import exported_poses
from softcal_jax.exchange.mujoco import (
    _surroundings,
    check_poses,
    check_robot,
    law_for_mujoco,
    mjcf,
)
from softcal_jax.materials import (
    ClassicalCorotational,
    MooneyRivlin,
    StVenantKirchhoff,
    TransverseIsotropic,
)
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 1, 1))
LAW = StVenantKirchhoff(sc.Isotropic(2e5, 0.3))
SPACE = densities()
CABLE = sc.Cable(
    "cable",
    [sc.Guide((-0.02, 0.0, 0.03), "ground"), (0.05, 0.0, 0.02), (0.1, 0.0, 0.02)],
)
PUSH = ForceActuator("push", (0.07, 0.01, 0.02), (0.0, 1.0, 0.0))
HELD = ForceActuator("held", (0.1, 0.01, 0.02), (0.0, 1.0, 0.0))
PRESS = SurfaceForceActuator("press", "x_max", (0.0, 0.0, -1.0))


def robot(actuators=(CABLE, HELD, PUSH, PRESS), law=LAW, density=1000.0):
    return build_model(MESH, law, density=density, actuators=actuators)


def configuration(name="posed", gravity=(0.0, 0.0, -9.8), **more):
    supports = [sc.Support("x_min"), sc.Support("x_max", "y"), SOFT]
    loads = [PointForce((0.08, 0.01, 0.02), (0.01, 0.0, -0.02))]
    return Configuration(name, supports, gravity, loads, **more)


SOFT = sc.Support("z_min", "z", stiffness=4e5)
PULLED = {"cable": 0.4, "push": 0.02, "press": 0.05}


def posed(model, *configurations):
    """Poses at the equilibria of the model."""
    check_robot(model)
    poses = exported_poses(model, SPACE, SPACE.start(), configurations)
    check_poses(poses)
    solved = [solve_equilibrium(model, pose.lane).displacement for pose in poses]
    return [
        p._replace(displacement=np.asarray(u))
        for p, u in zip(poses, solved, strict=True)
    ]


@pytest.fixture(scope="module")
def written():
    """A robot with a cable through nodes, forces, loads and all kinds of supports.

    What acts on held nodes alone moves nothing, and has no motor.
    """
    model = robot()
    forces = {name: ImposedForce(value) for name, value in PULLED.items()}
    poses = posed(model, configuration(actuation=forces), configuration("slack"))
    return model, poses, mjcf("test", model, poses, ["E -- 1 Pa"])


def test_the_body_is_a_flex_between_points_that_slide(written):
    text = written[2]
    assert "E - - 1 Pa" in text  # a comment must not hold two hyphens
    root = ElementTree.fromstring(text)
    assert root.find("option").get("gravity") == "0.0 0.0 -9.8"
    bodies = {body.get("name"): body for body in root.find("worldbody").iter("body")}
    clamped = np.flatnonzero(MESH.points[:, 0] == 0.0)
    slid = np.flatnonzero(MESH.points[:, 0] == 0.1)
    assert set(bodies) == {f"node{i}" for i in range(MESH.n_nodes)} - {
        f"node{i}" for i in clamped
    }
    for i in slid:
        joints = [joint.get("name") for joint in bodies[f"node{i}"].iter("joint")]
        assert joints == [f"node{i}.0", f"node{i}.2"]
    sprung = [j for j in root.iter("joint") if float(j.get("stiffness", 0.0)) > 0.0]
    assert {j.get("axis") for j in sprung} == {"0.0 0.0 1.0"}
    masses = [float(inertia.get("mass")) for inertia in root.iter("inertial")]
    # The beam weighs 40 g; the clamped face holds an eighth of its four cells or less.
    assert 0.034 < sum(masses) < 0.04
    (flex,) = root.iter("flex")
    assert flex.get("body").split().count("world") == clamped.size
    tets = np.array(flex.get("element").split(), int).reshape(-1, 4)
    np.testing.assert_array_equal(tets, MESH.tets)
    elasticity = flex.find("elasticity")
    assert (elasticity.get("young"), elasticity.get("poisson")) == ("200000.0", "0.3")


def test_actuators_and_loads_are_controls_and_poses_keyframes(written):
    root = ElementTree.fromstring(written[2])
    motors = [motor.get("name") for motor in root.iter("motor")]
    assert motors == ["cable", "push", "press", "loads of posed", "loads of slack"]
    keys = {key.get("name"): key.get("ctrl") for key in root.iter("key")}
    assert keys == {
        "posed": "0.4 0.02 0.05 1.0 0.0",
        "slack": "0.0 0.0 0.0 0.0 1.0",
    }
    spatial = root.find("tendon").find("spatial")
    assert len(spatial) == 3
    assert [len(site) for site in root.find("worldbody").findall("site")] == [0]


def test_tets_of_equal_constants_share_a_flex():
    E = np.where(MESH.centroids[:, 0] < 0.05, 1e5, 3e5)
    model = robot((), StVenantKirchhoff(sc.Isotropic(E, 0.3)))
    root = ElementTree.fromstring(mjcf("two", model, posed(model, configuration()), []))
    young = {flex.find("elasticity").get("young"): flex for flex in root.iter("flex")}
    assert set(young) == {"100000.0", "300000.0"}
    counts = [len(flex.get("element").split()) for flex in young.values()]
    assert counts == [2 * MESH.n_tets] * 2


def test_other_surroundings_take_another_file():
    poses = posed(robot(()), configuration(), configuration("b", (0.0, 0.0, 9.8)))
    assert len({_surroundings(pose) for pose in poses}) == 2


@pytest.mark.parametrize(
    "law",
    [
        sc.NeoHookean(2e5, 0.3),
        sc.Corotational(sc.Isotropic(2e5, 0.3)),
        ClassicalCorotational(sc.Isotropic(2e5, 0.3)),
        LAW,
    ],
)
def test_isotropic_laws_have_a_counterpart(law):
    assert type(law_for_mujoco(law)) is StVenantKirchhoff
    assert float(law_for_mujoco(law).elasticity.E) == 2e5


def test_other_laws_are_refused():
    fibre = TransverseIsotropic(7e5, 4e5, 0.3, 0.35, 2e5, sc.Fibre(0.3))
    for law in (MooneyRivlin(1e4, 1e4, 0.49), StVenantKirchhoff(fibre)):
        with pytest.raises(ValueError, match=r"no counterpart in MuJoCo.* calibrate"):
            law_for_mujoco(law)
    with pytest.raises(ValueError, match="with TransverseIsotropic has no"):
        law_for_mujoco(sc.Corotational(fibre))


def test_what_is_attached_and_mujoco_lacks_is_refused():
    rough = sc.Cable("rough", CABLE.guides, friction=0.1, pulled_from="first")
    with pytest.raises(ValueError, match="cable with friction 'rough' has no counterp"):
        posed(robot([rough]), configuration())
    pressed = SurfacePressure("pressed", "z_max")
    with pytest.raises(ValueError, match=r"'pressed' has no counterpart in MuJoCo"):
        posed(robot([pressed]), configuration())
    plate = build_model(MESH, LAW, density=1e3, bodies=[sc.RigidBody("plate", "x_max")])
    with pytest.raises(ValueError, match=r"rigid bodies \(plate\).* model of MuJoCo"):
        posed(plate, configuration())
    with pytest.raises(ValueError, match="give `density`"):
        posed(robot(density=0.0), configuration())
    moved = Configuration("moved", sc.Support("x_min", "xyz", (0.001, 0.0, 0.0)))
    with pytest.raises(ValueError, match="'moved': a support that is moved"):
        posed(robot(), moved)
    wound = configuration("wound", actuation={"cable": ImposedDisplacement(1e-3)})
    with pytest.raises(ValueError, match=r"'wound': the displacement of .*'cable'"):
        posed(robot(), wound)


def loaded(text, folder, monkeypatch):
    """The model and its data in MuJoCo, which writes a log where it runs."""
    mujoco = pytest.importorskip("mujoco")
    monkeypatch.chdir(folder)
    model = mujoco.MjModel.from_xml_string(text)
    return mujoco, model, mujoco.MjData(model)


def forces(mujoco, model, data, pose):
    """Force on each free coordinate, and the largest of the elastic ones."""
    mujoco.mj_resetDataKeyframe(model, data, model.key(pose).id)
    mujoco.mj_forward(model, data)
    total = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
    return total, np.abs(data.qfrc_passive).max()


def test_keyframes_are_at_rest_in_mujoco(written, tmp_path, monkeypatch):
    """Elasticity, weight, loads, tension, forces and springs balance at each node."""
    simulation = loaded(written[2], tmp_path, monkeypatch)
    for pose in written[1]:
        assert np.abs(pose.displacement).max() > 1e-4
        total, largest = forces(*simulation, pose.name)
        assert largest > 1e-2
        np.testing.assert_allclose(total, 0.0, atol=1e-6 * largest)


def test_the_flex_of_mujoco_is_our_law(tmp_path, monkeypatch):
    """Its forces at random displacements are those of St. Venant-Kirchhoff's tets."""
    E = 1e5 * (1.0 + (MESH.centroids[:, 0] > 0.05))
    model = robot((), StVenantKirchhoff(sc.Isotropic(E, 0.45)))
    pose = Configuration("free", gravity=(0.0, 0.0, 0.0), supports="x_min")
    (pose,) = posed(model, pose)
    u = 2e-3 * np.random.default_rng(0).normal(size=MESH.points.shape)
    u[MESH.points[:, 0] == 0.0] = 0.0
    text = mjcf("random", model, [pose._replace(displacement=u)], [])
    mujoco, simulated, data = loaded(text, tmp_path, monkeypatch)
    _, largest = forces(mujoco, simulated, data, "free")
    expected = np.zeros_like(u)
    for tet, modulus in zip(MESH.tets, E, strict=True):
        X, x = MESH.points[tet], (MESH.points + u)[tet]
        rest = (X[1:] - X[0]).T
        F = (x[1:] - x[0]).T @ np.linalg.inv(rest)
        strain = 0.5 * (F.T @ F - np.eye(3))
        mu = modulus / (2 * 1.45)
        lam = modulus * 0.45 / (1.45 * 0.1)
        P = F @ (lam * np.trace(strain) * np.eye(3) + 2 * mu * strain)
        H = -np.linalg.det(rest) / 6 * P @ np.linalg.inv(rest).T
        expected[tet[1:]] += H.T
        expected[tet[0]] -= H.sum(axis=1)
    free = MESH.points[:, 0] > 0.0
    np.testing.assert_allclose(
        data.qfrc_passive, expected[free].ravel(), rtol=0, atol=1e-9 * largest
    )


def test_a_guide_between_nodes_is_carried_by_them(tmp_path, monkeypatch):
    """What pulls at it, passed on by its weights, balances the nodes."""
    guides = [sc.Guide((-0.02, 0.0, 0.03), "ground"), (0.04, 0.004, 0.015), (0.1, 0, 0)]
    model = robot([sc.Cable("inner", guides)])
    pulled = configuration(actuation={"inner": ImposedForce(0.4)})
    poses = posed(model, pulled)
    text = mjcf("inner", model, poses, [])
    root = ElementTree.fromstring(text)
    (point,) = (b for b in root.iter("body") if "guide" in b.get("name"))
    assert point.get("gravcomp") == "1.0"
    ties = [t for t in root.find("tendon").findall("fixed") if "guide" in t.get("name")]
    for axis, tie in enumerate(ties):
        *shares, own = [float(joint.get("coef")) for joint in tie]
        assert own == -1.0
        np.testing.assert_allclose(sum(shares), 1.0, rtol=1e-12)
        assert tie[-1].get("joint") == f"inner, guide 1.{axis}"
    mujoco, simulated, data = loaded(text, tmp_path, monkeypatch)
    total, largest = forces(mujoco, simulated, data, "posed")
    at = lambda joint: simulated.joint(joint.get("joint")).qposadr[0]
    for tie in ties:
        np.testing.assert_allclose(data.tendon(tie.get("name")).length, 0.0, atol=1e-15)
        pull = total[at(tie[-1])]
        total[at(tie[-1])] = 0.0
        for joint in tie[:-1]:
            total[at(joint)] += float(joint.get("coef")) * pull
    assert np.abs(data.qfrc_actuator).max() > 0.1
    np.testing.assert_allclose(total, 0.0, atol=1e-6 * largest)
