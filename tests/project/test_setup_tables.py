"""What is only roughly known of setup, loads and recordings, as [[setup]]."""

import numpy as np
import pytest

from softcal_jax.fields import SetupParameter
from softcal_jax.project import ProjectError, load_project

BEAM = """\
name = "roughly known"

[mesh]
beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }
element = "linear"

[material]
law = "corotational"
E = "300 kPa"
nu = 0.3
density = "1 g/cm^3"

[actuators.tendon]
type = "cable"
guides = ["(10, 10, 20) mm", "(30, 10, 20) mm", "(50, 10, 15) mm"]
friction = 0.2
pulled_from = "first"

[[parameters]]
field = "E"
lower = "100 kPa"
upper = "1 MPa"

[effectors.shortening]
type = "actuator-displacement"
actuator = "tendon"
std = "0.1 mm"

[markers.positions]
tip = "(60, 5, 5) mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"
supports = [{ group = "x_min", stiffness = "1 GPa/m" }]
loads = [
    { surface = "x_max", force = "(0, 0, -0.1) N" },
    { surface = "z_max", force = "(0, 0, -0.2) N", name = "payload" },
]

[[configurations]]
name = "a"
recording = "monday"
actuation = { tendon = "1 N" }
measured = { effectors = { shortening = "1 mm" } }

[[configurations]]
name = "b"
recording = "monday"
actuation = { tendon = { value = "2 N", releasing = true } }
measured = { effectors = { shortening = "2 mm" } }

[[configurations]]
name = "c"
actuation = { tendon = "3 N" }
measured = { effectors = { shortening = "3 mm" } }
"""

KINDS = """
[[setup]]
gravity_tilt = true
limit = "5 deg"
prior_std = "1 deg"

[[setup]]
load_factor = true
prior_std = 0.05
each = "configuration"

[[setup]]
load_factor = "payload"
prior_std = 0.02

[[setup]]
load_offset = "payload"
limit = "20 mN"
prior_std = "5 mN"

[[setup]]
actuator_factor = "tendon"
limit = 1.5

[[setup]]
recording_offset = true
limit = "2 mm"
turn_limit = "3 deg"
each = "recording"

[[setup]]
clamp_stiffness = "x_min"
prior_std = 0.5

[[setup]]
friction = "tendon"
limit = 0.1

[[setup]]
marker_offset = "tip"
limit = "2 mm"
prior_std = "0.5 mm"
"""


def load(tmp_path, text):
    path = tmp_path / "project.toml"
    path.write_text(text)
    return load_project(path)


def test_every_kind_becomes_parameters(tmp_path):
    project = load(tmp_path, BEAM + KINDS)
    entries = [e for e in project.space.entries if isinstance(e, SetupParameter)]
    assert [q.name for e in entries for q in e.parameters] == [
        "first tilt of gravity",
        "second tilt of gravity",
        *(f"factor of loads in {c}" for c in "abc"),
        "factor of payload",
        *(f"{axis} offset of payload" for axis in "xyz"),
        "factor of tendon",
        *(f"offset {axis} in {r}" for axis in "xyz" for r in ("monday", "c")),
        *(f"turn {axis} in {r}" for axis in "xyz" for r in ("monday", "c")),
        "stiffness of x_min",
        "friction of tendon",
        *(f"offset {axis} of tip" for axis in "xyz"),
    ]
    by_name = {q.name: q for e in entries for q in e.parameters}
    np.testing.assert_allclose(by_name["first tilt of gravity"].prior_std, np.pi / 180)
    np.testing.assert_allclose(by_name["turn z in c"].upper, 3 * np.pi / 180)
    np.testing.assert_allclose(by_name["z offset of payload"].lower, -0.02)
    np.testing.assert_allclose(by_name["factor of tendon"].upper, 1.5)
    np.testing.assert_allclose(by_name["stiffness of x_min"].start, 1e9)
    np.testing.assert_allclose(by_name["friction of tendon"].lower, 0.1)
    b = project.configurations[1]
    assert b.recording == "monday"
    assert b.actuation["tendon"].releasing
    assert b.supports[0].stiffness == 1e9


def test_a_recording_may_be_turned_alone(tmp_path):
    """As where motions are compared, in which an offset cancels."""
    table = '[[setup]]\nrecording_offset = true\nturn_limit = "3 deg"\n'
    project = load(tmp_path, BEAM + table)
    entries = [e for e in project.space.entries if isinstance(e, SetupParameter)]
    names = [q.name for e in entries for q in e.parameters]
    assert names == ["turn x", "turn y", "turn z"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('load_factor = true\neach = ["tuesday"]', "no recording .tuesday."),
        ('load_factor = "weight"', "no load .weight."),
        ("load_factor = true\nprior_std = true", "expected a number"),
        ('clamp_stiffness = "x_max"', "support .* .x_max."),
        ('friction = "rope"\nlimit = 0.1', "actuator with friction .rope."),
        ('actuator_factor = "rope"', "no actuator .rope."),
        ("recording_offset = true", "needs limit.* turn_limit"),
        ('marker_offset = "top"\nlimit = "1 mm"', "no marker or 6-D sensor .top.* tip"),
    ],
)
def test_what_the_project_does_not_have(tmp_path, table, message):
    with pytest.raises(ProjectError, match=message):
        load(tmp_path, f"{BEAM}\n[[setup]]\n{table}\n")


def test_a_cable_is_asked_for_in_known_words(tmp_path):
    wrong = BEAM.replace("releasing = true", "relasing = true")
    with pytest.raises(ProjectError, match=r"tendon: .*relasing.*\{ value "):
        load(tmp_path, wrong)


SHAPES = """
[shapes.wall]
surface = "z_max"

[shapes.side]
surface = "y_max"
direction = "x"

[[setup]]
shape_offset = ["wall", "side"]
limit = "2 mm"
prior_std = "0.2 mm"

[uncertain]
shapes = "0.3 mm"
"""


def test_offsets_of_shapes(tmp_path):
    project = load(tmp_path, BEAM + SHAPES)
    *_, wall, side = project.parameters
    assert (wall.name, side.name) == ("offset of wall", "offset of side")
    assert float(wall.upper) == 2e-3
    assert project.uncertain.shapes == 3e-4
    motion = project.model.shapes.motion
    top = project.model.mesh.nodes("z_max")
    np.testing.assert_allclose(motion[0, top], np.tile([0.0, 0.0, 1.0], (8, 1)))
    sides = project.model.mesh.nodes("y_max")
    np.testing.assert_allclose(motion[1, sides], np.tile([1.0, 0.0, 0.0], (8, 1)))
    for wrong, message in (
        (
            SHAPES.replace('"z_max"', '"top"'),
            "shapes.wall: unknown surface group 'top'",
        ),
        (SHAPES.replace('["wall", "side"]', '"lid"'), "no shape .lid.*side"),
        (SHAPES.replace('"2 mm"', '"30 mm"'), "bound: .*'wall' by -0.03 m.*inside out"),
    ):
        with pytest.raises(ProjectError, match=message):
            load(tmp_path, BEAM + wrong)
