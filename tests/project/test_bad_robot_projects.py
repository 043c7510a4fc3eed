"""Rigid bodies, actuators and effectors that must be refused, with their keys."""

import pytest
from cable_project import FOLDER

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
        'bodies.plate.group: missing. Expected a group of the mesh: "x_max", or ',
    ),
    "unknown key of a body": (
        (PLATE, f'{PLATE}\nmas = "1 g"'),
        'bodies.plate.mas: unknown key. Did you mean "mass"?',
    ),
    "mass without a unit": (
        ('mass = "10 g"', "mass = 0.01"),
        "bodies.plate.mass: 0.01 has no unit; expected a mass, in quotes and with its",
    ),
    "hinge and axes": (
        (PLATE, f'{PLATE}\nhinge = "z"\naxes = ["x", "y", "z"]'),
        "bodies.plate: got hinge and axes; the hinge is the third of the axes",
    ),
    "axes that are not orthogonal": (
        (PLATE, f'{PLATE}\naxes = ["x", "x", "z"]'),
        "bodies.plate: axes of rigid body 'plate' must be three orthogonal unit",
    ),
    "tied to nothing": (
        (PLATE, f'{PLATE}\ntied_to = "plte"'),
        "bodies: rigid body 'plate' is tied to 'plte', which is not a body. Did you",
    ),
    "a rotation without a unit": (
        (PLATE, f'{PLATE}\nmounting = {{ rotation_vector = "(0, 0, 1)" }}'),
        'bodies.plate.mounting.rotation_vector: "(0, 0, 1)" has no unit; expected three'
        ' numbers with a unit, like "(0, 0, -1) deg".',
    ),
    "unknown type": (
        (CABLE, CABLE.replace('"cable"', '"cabel"')),
        'actuators.cable.type: got "cabel"; expected one of "cable", "chamber", ',
    ),
    "another type's key": (
        (CABLE, f'{CABLE}\nbody = "plate"'),
        'actuators.cable.body: body belongs to type = "motor". This is type = "cable", '
        "which has guides, friction, pulled_from.",
    ),
    "a tag without its photographs": (
        (SLACK, "measured.effectors.sensor.tag = 3"),
        "configurations.slack.measured.effectors.sensor.tag: tag belongs to photos and "
        "tag and base_tag and size. Without these, it has azimuth, elevation, ",
    ),
    "no type": (
        (CABLE, "[actuators.cable]"),
        'actuators.cable.type: missing. Expected one of "cable", "chamber", "surface-p',
    ),
    "no table": (
        (CABLE, f"[actuators]\nwinch = 3\n{CABLE}"),
        "actuators.winch: got 3; expected a table.",
    ),
    "a missing key of a type": (
        (CABLE, '[actuators.turn]\ntype = "motor"\n' + CABLE),
        "actuators.turn.body: missing. Expected the rigid body that it turns, with a ",
    ),
    "a guide outside": (
        ('"(50, 10, 20) mm",', '"(50, 10, 20) cm",'),
        "actuators.cable: cable 'cable', guide 1: the point [0.5, 0.1, 0.2] m lies ",
    ),
    "a guide on an unknown body": (
        ('on = "plate"', 'on = "plat"'),
        "actuators.cable: cable 'cable', guide 2 is on 'plat', expected 'mesh',",
    ),
    "a guide that is no point": (
        ('"(50, 10, 20) mm",', '{ pont = "(50, 10, 20) mm" },'),
        'actuators.cable.guides[2].pont: unknown key. Did you mean "point"?',
    ),
    "an open chamber": (
        (CABLE, f'[actuators.air]\ntype = "chamber"\nsurface = "z_max"\n{CABLE}'),
        "actuators.air: chamber 'air': surface 'z_max' is not closed, it has ",
    ),
    "no direction": (
        (
            CABLE,
            '[actuators.push]\ntype = "surface-force"\nsurface = "z_max"\n'
            f'direction = "w"\n{CABLE}',
        ),
        'actuators.push.direction: got "w"; expected "-z" or [0, 0, -1].',
    ),
    "an actuator that is not there": (
        (PULLED, 'actuation = { cabel = "1.5 N" }'),
        'configurations.pulled.actuation.cabel: there is no actuator "cabel". Did you '
        'mean "cable"? Known: cable.',
    ),
    "a pressure for a cable": (
        (PULLED, 'actuation = { cable = "1.5 kPa" }'),
        'configurations.pulled.actuation.cable: got "1.5 kPa"; expected of a cable, its'
        ' tension, like "2 N", or its shortening, like "5 mm".',
    ),
    "no unit": (
        (PULLED, "actuation = { cable = 1.5 }"),
        "configurations.pulled.actuation.cable: got 1.5; expected of a cable, its ",
    ),
    "a cable that pushes": (
        (PULLED, 'actuation = { cable = "-1 N" }'),
        "configurations.pulled.actuation.cable: configuration 'pulled': cable 'cable' "
        "has the force -1 N: it only pulls, so the force must not be negative.",
    ),
    "a motor beyond half a turn": (
        (
            (PLATE, f'{PLATE}\nhinge = "z"'),
            (CABLE, f'[actuators.turn]\ntype = "motor"\nbody = "plate"\n{CABLE}'),
            (PULLED, 'actuation = { turn = "270 deg" }'),
        ),
        'configurations.pulled.actuation.turn: got "270 deg"; a motor turns by half a ',
    ),
    "a body that is not there": (
        (PULLED, 'bodies = { plte = "held" }'),
        'configurations.pulled.bodies.plte: there is no rigid body "plte". Did you ',
    ),
    "an unknown state": (
        (PULLED, 'bodies = { plate = "hold" }'),
        'configurations.pulled.bodies.plate: got "hold"; expected one of "held", ',
    ),
    "a free body with a pose": (
        (
            PULLED,
            'bodies = { plate = { state = "free", translation = "(1, 0, 0) mm" } }',
        ),
        'configurations.pulled.bodies.plate: state = "free" has no pose; to hold ',
    ),
    "a hinge that is turned": (
        (
            PULLED,
            'bodies = { plate = { state = "hinged", rotation_vector = "(1, 0, 0) deg" '
            "} }",
        ),
        'configurations.pulled.bodies.plate: state = "hinged" turns as the balance ',
    ),
    "an effector of no body": (
        (SENSOR, SENSOR.replace("plate", "plat")),
        'effectors.sensor: there is no rigid body "plat". Did you mean "plate"?',
    ),
    "std of another dimension": (
        ('std = "0.1 mm"\nstd_angle', 'std = "0.1 N"\nstd_angle'),
        'effectors.sensor.std: "0.1 N": "N" is not a length; expected a length, like',
    ),
    "std of nothing": (
        ('actuator = "cable"\nstd = "0.1 mm"', 'actuator = "cable"'),
        "effectors.wound.std: missing. Expected standard deviation, with the unit of ",
    ),
    "a zero std": (
        ('std = "0.1 mm"\nstd_angle', 'std = "0 mm"\nstd_angle'),
        'effectors.sensor.std: got "0 mm"; expected a finite value above zero.',
    ),
    "a choice of an unknown effector": (
        (PULLED, f'{PULLED}\neffectors = ["senser"]'),
        'configurations.pulled.effectors: there is no effector "senser". Did you mean',
    ),
    "a measurement of an unknown effector": (
        ('wound = "1.96 mm"', 'wuond = "1.96 mm"'),
        'configurations.pulled.measured.effectors.wuond: there is no effector "wuond".',
    ),
    "a measurement of an effector that is not chosen": (
        (SLACK, f'effectors = ["wound"]\n{SLACK}'),
        'configurations.slack.measured.effectors.sensor: there is no effector "sensor',
    ),
    "a length for a pose": (
        (SLACK, 'measured.effectors.sensor = "3 mm"'),
        'configurations.slack.measured.effectors.sensor: got "3 mm"; expected a pose,',
    ),
    "a force for a length": (
        ('wound = "1.96 mm"', 'wound = "1.96 N"'),
        'configurations.pulled.measured.effectors.wound: "1.96 N": "N" is not a length',
    ),
    "a pose for a length": (
        ('wound = "1.96 mm"', 'wound = { position = "(1, 2, 3) mm" }'),
        "configurations.pulled.measured.effectors.wound: got a table; expected a length"
        ', since type = "actuator-displacement".',
    ),
    "no such file": (
        ('file = "tracker.csv"', 'file = "trackr.csv"'),
        "configurations.slack.measured.effectors.sensor: sensor file ",
    ),
    "no such reading": (
        (SLACK, SLACK.replace('"slack"', '"slak"')),
        "configurations.slack.measured.effectors.sensor: ",
    ),
    "pose and file": (
        (SLACK, 'measured.effectors.sensor.position = "(1, 2, 3) mm"'),
        "configurations.slack.measured.effectors.sensor: got a pose and a file; give ",
    ),
    "neither pose nor file": (
        ('file = "tracker.csv"', 'sensor = "tip"'),
        "configurations.slack.measured.effectors.sensor: expected the pose, ",
    ),
    "two forms of an orientation": (
        (
            'orientation = { azimuth = "0 deg" }',
            'orientation = { azimuth = "0 deg", quaternion = [1, 0, 0, 0] }',
        ),
        "effectors.sensor.orientation: got azimuth and quaternion; give the ",
    ),
    "a quaternion of another length": (
        ('azimuth = "90 deg" }\nstd', "quaternion = [1, 0, 0, 1] }\nstd"),
        "configurations.slack.measured.effectors.sensor: quaternion has the length "
        "1.41421, not 1: write four digits or more, the scalar part first.",
    ),
    "keys of the other format": (
        ('file = "tracker.csv"', 'file = "tracker.csv"\nstation = 1'),
        "configurations.slack.measured.effectors.sensor: station does not go with "
        'format = "table": a table has a header',
    ),
    "no length unit of a tracker": (
        (
            ('file = "tracker.csv"', ""),
            (
                SLACK,
                'measured.effectors.sensor = { file = "a", format = "polhemus" }',
            ),
        ),
        'configurations.slack.measured.effectors.sensor: format = "polhemus" needs ',
    ),
    "a selection of markers without their file": (
        (SLACK, f'{SLACK}\nmeasured.select = {{ pose = "slack" }}'),
        "configurations.slack.measured: select is for the file of the markers; ",
    ),
    "a setup without a motor": (
        (WOUND, f'[[setup]]\nmotor_zero = "cable"\nlimit = "3 deg"\n{WOUND}'),
        'setup[1].motor_zero: there is no motor "cable"; the project has none: add ',
    ),
    "a setup of another dimension": (
        (WOUND, f'[[setup]]\nmounting = "plate"\nlimit = "3 deg"\n{WOUND}'),
        'setup[1].limit: "3 deg": "deg" is not a length; expected a length, like ',
    ),
    "an empty setup": (
        (WOUND, f'[[setup]]\nlimit = "3 mm"\n{WOUND}'),
        "setup[1]: expected exactly one of motor_zero, mounting, gravity_tilt, "
        "recording_offset, load_factor, actuator_factor, clamp_stiffness, friction; "
        "got none.",
    ),
    "an absolute prior on a log scale": (
        ("# prior_std = 0.3", 'prior_std = "50 kPa"'),
        'parameters.E.prior_std: got "50 kPa"; on a log scale it is relative: expected '
        "a number, like 0.3 for 30 %.",
    ),
    "a body that is held at its nodes": (
        ('supports = [{ group = "x_min" }]', 'supports = [{ group = "x_max" }]'),
        "configurations: configuration 'slack': its supports hold ",
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
    assert said.startswith(message) or f"\n- {message}" in said, said


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    text = (FOLDER / "project.toml").read_text()
    text = text.replace('type = "frame"\nbody = "plate"', 'type = "frame"\nbdy = "a"')
    text = text.replace('type = "cable"\n', 'type = "motor"\n')
    path = tmp_path / "project.toml"
    path.write_text(text)
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    for message in (
        'effectors.sensor.bdy: unknown key. Did you mean "body"?',
        "effectors.sensor.body: missing. Expected name of a rigid body",
        'actuators.cable.guides: guides belongs to type = "cable". This is type = "moto'
        'r", which has body.',
        "actuators.cable.body: missing. Expected the rigid body that it turns",
    ):
        assert f"\n- {message}" in str(caught.value)
