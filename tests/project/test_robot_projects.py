"""Project files with rigid bodies, actuators and effectors, against the Python API."""

from pathlib import Path

import equinox as eqx
import jax
import meshio
import numpy as np
import pytest
from all_kinds_project import ALL_KINDS
from cable_project import ASKED, FOLDER, POINT, cable_beam, poses
from scipy.spatial.transform import Rotation

import softcal_jax as sc
from benchmarks._hollow import hollow_cube
from softcal_jax.actuators import ForceActuator, SurfaceForceActuator, SurfacePressure
from softcal_jax.bodies import hinge_axes
from softcal_jax.configurations import (
    ActuatorForce,
    BodyAngle,
    Centroid,
    SupportReaction,
    configuration_arrays,
)
from softcal_jax.fields import motor_zero, mounting
from softcal_jax.project import load_project


def write(folder: Path, text: str) -> Path:
    path = folder / "project.toml"
    path.write_text(text)
    return path


def by_hand():
    """The same model, space and configurations by the Python API."""
    mm, deg = 1e-3, np.pi / 180
    mesh = sc.beam(0.06, 0.02, 0.02, (6, 1, 1))
    middle = sc.select_nodes(mesh, lambda X: np.abs(X[:, 0] - 0.03) < 1e-9)
    model = sc.build_model(
        mesh,
        sc.Corotational(sc.Isotropic(300e3, 0.3)),
        density=1000.0,
        bodies=[
            sc.RigidBody(
                "arm",
                "x_min",
                origin=[-0.005, 0.01, 0.01],
                axes=hinge_axes([0, -1, 0]),
                mounting=sc.Pose([0, 0, 2 * mm]),
            ),
            sc.RigidBody(
                "tip",
                "x_max",
                mass=0.01,
                centre_of_mass=[0.065, 0.01, 0.01],
                axes=np.eye(3)[[1, 2, 0]],
            ),
            sc.RigidBody(
                "collar",
                middle,
                tied_to="tip",
                mounting=sc.Pose(rotation_vector=[0, 10 * deg, 0]),
            ),
        ],
        actuators=[
            sc.Motor("arm", "arm"),
            sc.Cable(
                "left", [sc.Guide((0, 0.01, 0.02), "ground"), (0.045, 0.01, 0.02)]
            ),
            ForceActuator("push", (0.045, 0.01, 0.02), (0, 0, -1)),
            SurfaceForceActuator("spread", "z_max", (0, 0, 1)),
            SurfacePressure("blow", "z_max"),
        ],
    )
    sensor = sc.BodyFrame(
        "sensor",
        "tip",
        # From rest, at the middle of the end face.
        sc.Pose.from_matrix(
            Rotation.from_euler("ZYX", [10, 0, -20], degrees=True).as_matrix(),
            np.array([1.0, 2.0, 3.0]) * mm - [0.06, 0.01, 0.01],
        ),
        std=0.3 * mm,
        std_angle=0.3 * deg,
    )
    length = sc.ActuatorDisplacement("length", "left", std=0.1 * mm)
    others = [
        BodyAngle("bend", "tip", "arm", (0, 1, 0), 5 * deg, std=deg),
        Centroid("middle", "z_max", [0.03, 0.01, 0.025]),
        eqx.tree_at(lambda e: e.measured, length, -1 * mm, is_leaf=lambda x: x is None),
        ActuatorForce("torque", "arm", 0.02, std=1e-3),
        SupportReaction("clamp", "x_min", [0, 0, 1.0], std=0.01),
    ]
    gravity = (0.0, 0.0, -9.81)
    configurations = [
        sc.Configuration(
            "imposed forces",
            gravity=gravity,
            effectors=[sensor, *others],
            actuation={
                "arm": sc.ImposedDisplacement(20 * deg),
                "left": sc.ImposedForce(1.0),
                "push": sc.ImposedDisplacement(2 * mm),
                "spread": sc.ImposedForce(0.5),
                "blow": sc.ImposedForce(1e3),
            },
        ),
        sc.Configuration(
            "held",
            gravity=gravity,
            effectors=[length],
            bodies={"tip": sc.Pose([0, 0, 5 * mm], [0, 5 * deg, 0])},
            actuation={
                "arm": sc.ImposedForce(0.005),
                "left": sc.ImposedDisplacement(1 * mm),
            },
        ),
    ]
    space = sc.ParameterSpace(
        [
            sc.Parameter("E", "E", 300e3, 100e3, 1e6, unit="Pa", prior_std=0.3),
            sc.Parameter("nu", "nu", 0.3, 0.2, 0.4, scale="linear", prior_std=0.05),
            motor_zero("arm", limit=3 * deg, prior_std=0.5 * deg),
            *mounting("arm", (0, 0, 2 * mm), limit=2 * mm, prior_std=None),
            *mounting("collar", (0, 0, 0), limit=2 * mm, prior_std=None),
        ]
    )
    return model, space, configurations


def assert_same(read, wanted):
    """Equal up to the rounding of units."""
    host = lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf
    read, wanted = (jax.tree.map(host, tree) for tree in (read, wanted))
    assert eqx.tree_equal(read, wanted, rtol=1e-12, atol=1e-15), (read, wanted)


def test_every_table_is_what_the_python_api_makes(tmp_path):
    project = load_project(write(tmp_path, ALL_KINDS))
    model, space, configurations = by_hand()
    assert_same(project.model.mechanism, model.mechanism)
    assert project.model.conservative == model.conservative is False
    assert_same(project.space, space)
    arrays = lambda m, c: configuration_arrays(m.mesh, c, m.mechanism)
    assert_same(
        arrays(project.model, project.calibration), arrays(model, configurations)
    )
    assert [c.name for c in project.candidates] == ["hinged"]
    assert project.candidates[0].bodies == {"tip": "hinged"}
    # Candidates take over what is asked in [shared], and see all effectors.
    assert project.candidates[0].actuation["left"] == sc.ImposedForce(1.0)
    assert len(project.candidates[0].effectors) == 6


def test_the_cable_beam_is_the_one_of_the_python_api():
    """The project of docs/guide/robots.md; its measurements are the tracker's."""
    project, model = load_project(FOLDER / "project.toml"), cable_beam()
    assert_same(project.model.mechanism, model.mechanism)
    arrays = lambda m, c: configuration_arrays(m.mesh, c, m.mechanism)
    loaded = arrays(project.model, project.configurations)
    wanted = arrays(model, poses())
    assert_same(loaded.actuation, wanted.actuation)
    assert_same(loaded.fixed, wanted.fixed)
    assert [c.name for c in project.configurations] == list(ASKED)
    pulled = project.calibration[1]
    assert pulled.effectors[1].measured == pytest.approx(1.96e-3)
    assert project.calibration[0].effectors[1].measured is None


def sensor_of(folder, measured, frame="", configurations=1):
    """The measured motion of a sensor on the plate, from another measurement."""
    text = (FOLDER / "project.toml").read_text()
    text = text[: text.index("[[configurations]]")]
    start = text.index("[effectors.sensor]")
    text = text[:start] + (
        '[effectors.sensor]\ntype = "frame"\nbody = "plate"\n'
        f'point = "(105, 10, 10) mm"\n{frame}\n'
        '[shared]\ngravity = "(0, 0, -9.81) m/s^2"\n'
        'supports = [{ group = "x_min" }]\n'
        f'[[configurations]]\nname = "a"\nmeasured.effectors.sensor = {measured}\n'
    )
    calibration = load_project(write(folder, text)).calibration
    assert len(calibration) == configurations
    (effector,) = calibration[0].effectors
    np.testing.assert_array_equal(effector.point, POINT)
    return effector.measured


def assert_motion(pose, translation, rotation_vector):
    np.testing.assert_allclose(pose.translation, translation, atol=1e-12)
    np.testing.assert_allclose(pose.rotation_vector, rotation_vector, atol=1e-12)


def test_a_pose_is_seen_through_base_and_mounting_of_the_sensor(tmp_path):
    """The base is turned by 90 degrees, the sensor by 90 about its x; worked by hand.

    The base's x is the robot's y: 115 mm along the base's -y are 115 mm along x. In the
    robot's frame the sensor shows Rz(90) times what the base saw.
    """
    frame = (
        'base = { position = "(0, 20, 0) mm", azimuth = "90 deg" }\n'
        'orientation = { roll = "90 deg" }'
    )
    # At rest the base sees Rz(-90) Rx(90); the plate has turned by 30 degrees about z.
    pose = '{ position = "(-10, -115, 10) mm", azimuth = "-60 deg", roll = "90 deg" }'
    motion = sensor_of(tmp_path, pose, frame)
    assert_motion(motion, [0.01, 0.0, 0.0], [0.0, 0.0, np.pi / 6])


@pytest.mark.parametrize(
    "form",
    [
        'azimuth = "90 deg"',
        'rotation_vector = "(0, 0, 90) deg"',
        "quaternion = [0.70711, 0, 0, 0.70711]",
    ],
)
def test_forms_of_an_orientation(tmp_path, form):
    pose = f'{{ position = "(105, 10, 10) mm", {form} }}'
    motion = sensor_of(tmp_path, pose)
    # Of unit length to five digits.
    np.testing.assert_allclose(motion.rotation_vector, [0, 0, np.pi / 2], atol=1e-5)


READINGS = """\
pose,sensor,x_mm,y_mm,z_mm,azimuth_deg,elevation_deg,roll_deg
rest,a,0,0,0,10,0,0
now,a,1,0,0,40,0,0
now,a,3,0,0,40,0,0
now,b,9,9,9,0,0,0
"""


def test_the_motion_between_two_readings_needs_no_place_of_the_sensor(tmp_path):
    """The mean of two readings, less the one at rest, in the turned base."""
    (tmp_path / "readings.csv").write_text(READINGS)
    motion = sensor_of(
        tmp_path,
        '{ file = "readings.csv", sensor = "a", select = { pose = "now" }, '
        'displacement_from = { pose = "rest" } }',
        'base = { azimuth = "90 deg" }\norientation = { roll = "33 deg" }',
    )
    assert_motion(motion, [0.0, 0.002, 0.0], [0.0, 0.0, np.pi / 6])


def test_a_sensor_may_refer_to_a_simulated_pose(tmp_path):
    """A name is that of a configuration, with or without a file of markers."""
    pose = '{ position = "(105, 10, 10) mm", azimuth = "0 deg" }'
    text = f"""{pose}
[[configurations]]
name = "b"
measured = {{ displacement_from = "a", effectors = {{ sensor = {pose} }} }}
"""
    sensor_of(tmp_path, text, configurations=2)
    first, second = load_project(tmp_path / "project.toml").calibration
    assert (first.displacement_from, second.displacement_from) == (None, "a")


def test_the_bare_text_of_a_tracker(tmp_path):
    (tmp_path / "tracker.txt").write_text("1 4.2 0.4 0.4 0 0 0\n2 0 0 0 90 0 0\n")
    motion = sensor_of(
        tmp_path,
        '{ file = "tracker.txt", format = "polhemus", length_unit = "inch", '
        "station = 1 }",
    )
    assert_motion(motion, np.array([4.2, 0.4, 0.4]) * 0.0254 - POINT, np.zeros(3))


def test_a_chamber_of_a_mesh_file(tmp_path):
    """Volume or pressure, by the unit; the wall is picked by where it is."""
    mesh = hollow_cube()
    meshio.Mesh(mesh.points, [("tetra", mesh.tets)]).write(tmp_path / "cube.vtu")
    low, high = np.quantile(mesh.points[:, 0], [0.0, 1.0])
    third = (high - low) / 3
    corner = lambda v: f'"({v}, {v}, {v}) m"'
    text = f"""\
name = "balloon"
[mesh]
file = "cube.vtu"
length_unit = "m"
element = "linear"
[groups.wall]
of = "faces"
box = {{ lower = {corner(low + third)}, upper = {corner(high - third)} }}
tolerance = "{0.1 * third} m"
[groups.bottom]
plane = {{ point = {corner(low)}, normal = [0, 0, 1] }}
[material]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
density = "1 g/cm^3"
[actuators.air]
type = "chamber"
surface = "wall"
[effectors.volume]
type = "actuator-displacement"
actuator = "air"
std = "1 ml"
[shared]
gravity = "(0, 0, 0) m/s^2"
supports = [{{ group = "bottom" }}]
[[configurations]]
name = "blown"
actuation = {{ air = "2 kPa" }}
measured.effectors = {{ volume = "3 ml" }}
[[configurations]]
name = "filled"
actuation = {{ air = "5 ml" }}
"""
    project = load_project(write(tmp_path, text))
    blown, filled = project.calibration
    assert blown.actuation == {"air": sc.ImposedForce(2e3)}
    assert isinstance(filled.actuation["air"], sc.ImposedDisplacement)
    assert filled.actuation["air"].value == pytest.approx(5e-6)
    assert blown.effectors[0].measured == pytest.approx(3e-6)
    assert blown.effectors[0].std == pytest.approx(1e-6)
    faces = project.model.mesh.faces("wall")
    assert project.model.mechanism.actuators.kinds[0].noun == "chamber"
    assert len(faces) == 12
