"""Rigid bodies, actuators and effectors that must be refused, with their keys."""

from typing import ClassVar

import equinox as eqx
import pytest
from cable_project import FOLDER
from robot_project import PROJECT
from wording import says

from softcal_jax._module import key
from softcal_jax.actuators import ACTUATORS, AbstractActuator, Kind, Motor
from softcal_jax.configurations import ImposedForce
from softcal_jax.project import ProjectError, load_project

PLATE = '[bodies.plate]\ngroup = "x_max"'
CABLE = '[actuators.cable]\ntype = "cable"'
SENSOR = '[effectors.sensor]\ntype = "frame"\nbody = "plate"'
WOUND = "[effectors.wound]"
PULLED = 'actuation = { cable = "1.5 N" }'
SLACK = 'measured.effectors.sensor.select = { pose = "slack" }'

CASES = {
    "unknown group of a body": (
        ('group = "x_max"', 'group = "x_maxx"'),
        "bodies.plate: rigid body 'plate'",
    ),
    "no group": (
        (PLATE, "[bodies.plate]"),
        'bodies.plate.group: missing ... "x_max"',
    ),
    "unknown key of a body": (
        (PLATE, f'{PLATE}\nmas = "1 g"'),
        'bodies.plate.mas: unknown key ... mean "mass"',
    ),
    "mass without a unit": (
        ('mass = "10 g"', "mass = 0.01"),
        "bodies.plate.mass: 0.01 has no unit",
    ),
    "hinge and axes": (
        (PLATE, f'{PLATE}\nhinge = "z"\naxes = ["x", "y", "z"]'),
        "bodies.plate: got hinge and axes",
    ),
    "axes that are not orthogonal": (
        (PLATE, f'{PLATE}\naxes = ["x", "x", "z"]'),
        "bodies.plate: axes ... 'plate' ... orthogonal",
    ),
    "tied to nothing": (
        (PLATE, f'{PLATE}\ntied_to = "plte"'),
        "bodies: ... unknown ... 'plate' ... 'plte'",
    ),
    "a rotation without a unit": (
        (PLATE, f'{PLATE}\nmounting = {{ rotation_vector = "(0, 0, 1)" }}'),
        'bodies.plate.mounting.rotation_vector: "(0, 0, 1)" has no unit ... "(0, 0, '
        '-1) deg"',
    ),
    "unknown type": (
        (CABLE, CABLE.replace('"cable"', '"cabel"')),
        'actuators.cable.type: got "cabel" ... "cable", "chamber"',
    ),
    "another type's key": (
        (CABLE, f'{CABLE}\nbody = "plate"'),
        "actuators.cable.body: unknown key ... guides, friction, pulled_from",
    ),
    "a tag without its photographs": (
        (SLACK, "measured.effectors.sensor.tag = 3"),
        "configurations.slack.measured.effectors.sensor.tag: unknown key ... file",
    ),
    "no type": (
        (CABLE, "[actuators.cable]"),
        'actuators.cable.type: missing ... "cable", "chamber"',
    ),
    "no table": (
        (CABLE, f"[actuators]\nwinch = 3\n{CABLE}"),
        "actuators.winch: got 3 ... table",
    ),
    "a missing key of a type": (
        (CABLE, '[actuators.turn]\ntype = "motor"\n' + CABLE),
        "actuators.turn.body: missing ... rigid body",
    ),
    "a guide outside": (
        ('"(50, 10, 20) mm",', '"(50, 10, 20) cm",'),
        "actuators.cable: ... guide 1 ... (500, 100, 200) mm",
    ),
    "all that is wrong of actuators at once": (
        (
            CABLE,
            '[actuators.air]\ntype = "chamber"\nsurface = "z_max"\n'
            '[actuators.far]\ntype = "cable"\nmax_distance = "1 mm"\n'
            f'guides = ["(50, 10, 22) mm", "(80, 10, 23) mm"]\n{CABLE}',
        ),
        "actuators.far: ... guide 1 ... 3 mm ... 1 mm ... guide 0 ... max_distance",
    ),
    "a guide on an unknown body": (
        ('on = "plate"', 'on = "plat"'),
        "actuators.cable: ... guide 2 ... 'plat' ... 'mesh'",
    ),
    "a guide that is no point": (
        ('"(50, 10, 20) mm",', '{ pont = "(50, 10, 20) mm" },'),
        'actuators.cable.guides[2].pont: unknown key ... mean "point"',
    ),
    "an open chamber": (
        (CABLE, f'[actuators.air]\ntype = "chamber"\nsurface = "z_max"\n{CABLE}'),
        "actuators.air: ... 'z_max' is not closed",
    ),
    "no direction": (
        (
            CABLE,
            '[actuators.push]\ntype = "surface-force"\nsurface = "z_max"\n'
            f'direction = "w"\n{CABLE}',
        ),
        'actuators.push.direction: got "w" ... "-z" or [0, 0, -1]',
    ),
    "an actuator that is not there": (
        (PULLED, 'actuation = { cabel = "1.5 N" }'),
        'configurations.pulled.actuation.cabel: ... "cabel" ... mean "cable" ... '
        "Known: cable",
    ),
    "a pressure for a cable": (
        (PULLED, 'actuation = { cable = "1.5 kPa" }'),
        'configurations.pulled.actuation.cable: got "1.5 kPa" ... tension ... "2 N" '
        '... shortening ... "5 mm"',
    ),
    "no unit": (
        (PULLED, "actuation = { cable = 1.5 }"),
        "configurations.pulled.actuation.cable: got 1.5 ... cable",
    ),
    "a cable that pushes": (
        (PULLED, 'actuation = { cable = "-1 N" }'),
        "configurations.pulled.actuation.cable: ... -1 N ... only pulls",
    ),
    "a motor beyond half a turn": (
        (
            (PLATE, f'{PLATE}\nhinge = "z"'),
            (CABLE, f'[actuators.turn]\ntype = "motor"\nbody = "plate"\n{CABLE}'),
            (PULLED, 'actuation = { turn = "270 deg" }'),
        ),
        "configurations.pulled.actuation.turn: ... 4.71239 rad ... pi",
    ),
    "a body that is not there": (
        (PULLED, 'bodies = { plte = "held" }'),
        'configurations.pulled.bodies.plte: ... "plte" ... mean "plate"',
    ),
    "an unknown state": (
        (PULLED, 'bodies = { plate = "hold" }'),
        'configurations.pulled.bodies.plate: got "hold" ... "held"',
    ),
    "a free body with a pose": (
        (
            PULLED,
            'bodies = { plate = { state = "free", translation = "(1, 0, 0) mm" } }',
        ),
        "configurations.pulled ... plate ... free ... pose",
    ),
    "a hinge that is turned": (
        (
            PULLED,
            'bodies = { plate = { state = "hinged", rotation_vector = "(1, 0, 0) deg" '
            "} }",
        ),
        "configurations.pulled ... plate ... hinged ... turn",
    ),
    "an effector of no body": (
        (SENSOR, SENSOR.replace("plate", "plat")),
        "effectors.sensor: ... 'plat' ... mean 'plate'",
    ),
    "std of another dimension": (
        ('std = "0.1 mm"\nstd_angle', 'std = "0.1 N"\nstd_angle'),
        'effectors.sensor.std: "0.1 N": "N" is not a length',
    ),
    "std of nothing": (
        ('actuator = "cable"\nstd = "0.1 mm"', 'actuator = "cable"'),
        "effectors.wound.std: missing ... standard deviation",
    ),
    "a zero std": (
        ('std = "0.1 mm"\nstd_angle', 'std = "0 mm"\nstd_angle'),
        'effectors.sensor.std: got "0 mm" ... above zero',
    ),
    "a choice of an unknown effector": (
        (PULLED, f'{PULLED}\neffectors = ["senser"]'),
        'configurations.pulled.effectors: ... "senser" ... mean "sensor"',
    ),
    "a measurement of an unknown effector": (
        ('wound = "1.96 mm"', 'wuond = "1.96 mm"'),
        'configurations.pulled.measured.effectors.wuond: ... "wuond"',
    ),
    "a measurement of an effector that is not chosen": (
        (SLACK, f'effectors = ["wound"]\n{SLACK}'),
        'configurations.slack.measured.effectors.sensor: ... "sensor"',
    ),
    "a length for a pose": (
        (SLACK, 'measured.effectors.sensor = "3 mm"'),
        'configurations.slack.measured.effectors.sensor: got "3 mm" ... pose',
    ),
    "a force for a length": (
        ('wound = "1.96 mm"', 'wound = "1.96 N"'),
        'configurations.pulled.measured.effectors.wound: "1.96 N": "N" is not a length',
    ),
    "a pose for a length": (
        ('wound = "1.96 mm"', 'wound = { position = "(1, 2, 3) mm" }'),
        "configurations.pulled.measured.effectors.wound: expected a length",
    ),
    "no such file": (
        ('file = "tracker.csv"', 'file = "trackr.csv"'),
        "configurations.slack.measured.effectors.sensor: sensor file ",
    ),
    "no such reading": (
        (SLACK, SLACK.replace('"slack"', '"slak"')),
        "configurations.slack.measured.effectors.sensor: ... pose = slak",
    ),
    "pose and file": (
        (SLACK, 'measured.effectors.sensor.position = "(1, 2, 3) mm"'),
        "configurations.slack.measured.effectors.sensor.position: unknown key",
    ),
    "neither pose nor file": (
        ('file = "tracker.csv"', 'sensor = "tip"'),
        "configurations.slack.measured.effectors.sensor.position: missing. Expected ",
    ),
    "two forms of an orientation": (
        (
            'orientation = { azimuth = "0 deg" }',
            'orientation = { azimuth = "0 deg", quaternion = [1, 0, 0, 0] }',
        ),
        "effectors.sensor.orientation: got azimuth and quaternion",
    ),
    "a quaternion of another length": (
        ('azimuth = "90 deg" }\nstd', "quaternion = [1, 0, 0, 1] }\nstd"),
        "configurations.slack.measured.effectors.sensor: ... quaternion ... 1.41421, "
        "not 1 ... four digits",
    ),
    "keys of the other format": (
        ('file = "tracker.csv"', 'file = "tracker.csv"\nstation = 1'),
        "shared.measured.effectors.sensor.station: unknown key ... format, sensor",
    ),
    "no length unit of a tracker": (
        (
            ('file = "tracker.csv"', ""),
            (
                SLACK,
                'measured.effectors.sensor = { file = "a", format = "polhemus" }',
            ),
        ),
        "configurations.slack.measured.effectors.sensor.length_unit: missing. Expected",
    ),
    "a selection of markers without their file": (
        (SLACK, f'{SLACK}\nmeasured.select = {{ pose = "slack" }}'),
        "configurations.slack.measured: select ... file of the markers",
    ),
    "a setup without a motor": (
        (WOUND, f'[[setup]]\nmotor_zero = "cable"\nlimit = "3 deg"\n{WOUND}'),
        'setup[1].motor_zero: ... "cable" ... none',
    ),
    "a setup of another dimension": (
        (WOUND, f'[[setup]]\nmounting = "plate"\nlimit = "3 deg"\n{WOUND}'),
        'setup[1].limit: "3 deg": "deg" is not a length',
    ),
    "an empty setup": (
        (WOUND, f'[[setup]]\nlimit = "3 mm"\n{WOUND}'),
        "setup[1]: ... one of motor_zero, mounting, friction, marker_offset, "
        "gravity_tilt, recording_offset, load_factor, load_offset, "
        "actuator_factor, clamp_stiffness, shape_offset; got none",
    ),
    "a text where only true has a meaning": (
        (WOUND, f'[[setup]]\ngravity_tilt = "both"\nlimit = "3 deg"\n{WOUND}'),
        'setup[1].gravity_tilt: got "both"; expected true.',
    ),
    "an absolute prior on a log scale": (
        ("# prior_std = 0.3", 'prior_std = "50 kPa"'),
        'parameters.E.prior_std: got "50 kPa" ... relative ... 0.3',
    ),
    "a body that is held at its nodes": (
        ('supports = [{ group = "x_min" }]', 'supports = [{ group = "x_max" }]'),
        "configurations: ... 'slack': its supports hold",
    ),
}


@pytest.mark.parametrize(("changes", "message"), CASES.values(), ids=CASES)
def test_refused_with_its_key(tmp_path, changes, message):
    text = (FOLDER / "project.toml").read_text()
    for old, new in changes if isinstance(changes[0], tuple) else (changes,):
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times"
        text = text.replace(old, new)
    path = tmp_path / "project.toml"
    path.write_text(text)
    (tmp_path / "tracker.csv").write_bytes((FOLDER / "tracker.csv").read_bytes())
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    said = str(caught.value).removeprefix(f"{path}: ")
    # What is shared is wrong in each configuration.
    assert says(said.split("\n- "), message)


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    text = (FOLDER / "project.toml").read_text()
    text = text.replace('type = "frame"\nbody = "plate"', 'type = "frame"\nbdy = "a"')
    text = text.replace('type = "cable"\n', 'type = "motor"\n')
    path = tmp_path / "project.toml"
    path.write_text(text)
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    for message in (
        'effectors.sensor.bdy: unknown key ... mean "body"',
        "effectors.sensor.body: missing ... rigid body",
        "actuators.cable.guides: unknown key ... body",
        "actuators.cable.body: missing ... rigid body",
    ):
        assert says(str(caught.value).split("\n- "), message)


class Drum(AbstractActuator):
    """A motor with a drum, which no project file knows."""

    body: str = eqx.field(metadata=key(words='the body that it turns: "arm"'))
    radius: float = eqx.field(metadata=key("m", 'its radius: "5 mm"', "positive"))
    teeth: int | None = None
    kind: ClassVar[Kind] = Kind("drum", "N m", "rad", imposed='like "1 N*mm"')

    def cliques(self, rest, owner):
        return Motor(self.label, self.body).cliques(rest, owner)


@pytest.fixture
def with_drum(tmp_path, monkeypatch):
    """Reads a project with a drum, whose table has some keys."""
    monkeypatch.setitem(ACTUATORS, "drum", Drum)

    def read(keys):
        text = PROJECT.replace("[effectors.sensor]", f"{keys}\n\n[effectors.sensor]")
        text = text.replace('arm = "20 deg"', 'arm = "20 deg", drum = "2 N*mm"')
        path = tmp_path / "project.toml"
        path.write_text(text)
        return load_project(path, solve=False)

    return read


DRUM = '[actuators.drum]\ntype = "drum"\n'


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('body = "arm"', 'radius: missing ... its radius: "5 mm"'),
        ('body = "arm"\nradius = "5 kPa"', 'radius: "5 kPa" ... a length'),
        ('body = "arm"\nradius = "0 mm"', "radius: ... above zero"),
        ('radius = "5 mm"', "body: missing ... turns"),
        ('body = "arm"\nradius = "5 mm"\nteeth = 2.5', "teeth: got 2.5 ... whole"),
        ('body = "arm"\nteeth = 2', "radius: missing"),
        ('radius = "5 mm"\ntooth = 2', "tooth: ... Known ... body, radius, teeth"),
    ],
)
def test_an_actuator_needs_its_class_only(with_drum, keys, message):
    """Its table, with keys, units and messages, is made from its fields."""
    with pytest.raises(ProjectError) as caught:
        with_drum(DRUM + keys)
    assert says(str(caught.value).split("\n- "), f"actuators.drum.{message}")


def test_an_actuator_is_made_from_its_table(with_drum):
    project = with_drum(f'{DRUM}body = "arm"\nradius = "5 mm"')
    assert project.model.mechanism.actuators.names[-1] == "drum"
    assert project.configurations[0].actuation["drum"] == ImposedForce(2e-3)
