"""Obstacles in project files: shapes, states, contact forces, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from wording import says

import softcal_jax as sc
from softcal_jax.bodies import BodyState
from softcal_jax.configurations import ContactForce, ContactMoment
from softcal_jax.contact import (
    Ball,
    Capsule,
    DistanceGrid,
    HalfSpace,
    RoundedBox,
    RoundedCylinder,
)
from softcal_jax.project import ProjectError, load_project

PAD = """\
name = "pad"

[mesh]
beam = { size = "(20, 20, 10) mm", cells = [2, 2, 1] }
element = "linear"

[material]
law = "corotational"
E = "100 kPa"
nu = 0.4
density = "1 g/cm^3"
contact_scale = "50 um"

[bodies.table]
shape = { type = "plane" }
friction = 0.5
mounting = { translation = "(0, 0, -0.5) mm" }

[bodies.wall]
shape = { type = "plane" }
origin = "(-5, 0, 0) mm"
axes = ["y", "z", "x"]

[bodies.probe]
shape = { type = "sphere", radius = "4 mm" }
origin = "(10, 10, 14.1) mm"
mass = "20 g"

[[parameters]]
field = "E"
lower = "50 kPa"
upper = "1 MPa"

[[setup]]
mounting = "table"
limit = "1 mm"
prior_std = "0.5 mm"

[effectors.cell]
type = "contact-force"
body = "probe"
axis = "z"
std = "1 mN"

[effectors.forces]
type = "contact-force"
body = "table"

[effectors.moments]
type = "contact-moment"
body = "table"
std = "1 N*mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"

[[configurations]]
name = "pressed"
[configurations.bodies]
probe = { translation = "(3, 0, -1) mm", start = { translation = "(3, 0, 1) mm" } }
wall = "absent"
[configurations.measured.effectors]
cell = "0.3 N"
forces = "(0, 0, -0.4) N"
moments = "(0, 1, 0) N*mm"

[[configurations]]
name = "loaded"
bodies = { probe = "sliding" }
"""

SHAPES = {
    'type = "plane"': HalfSpace(),
    'type = "sphere", radius = "4 mm"': Ball(4e-3),
    'type = "cylinder", radius = "4 mm", length = "1 cm", rounding = "1 mm"': (
        RoundedCylinder(4e-3, 1e-2, 1e-3)
    ),
    'type = "capsule", radius = "4 mm", length = "1 cm"': Capsule(4e-3, 1e-2),
    'type = "box", size = "(8, 6, 4) mm", rounding = "1 mm"': (
        RoundedBox((8e-3, 6e-3, 4e-3), 1e-3)
    ),
}

AWAY = (
    (
        'probe = { translation = "(3, 0, -1) mm", start = { translation = "(3, 0, 1) '
        'mm" } }',
        'probe = "absent"',
    ),
    ('probe = "sliding"', 'probe = "absent"'),
)
"""Shapes of any size then have no place inside the pad."""

SPHERE = 'type = "sphere", radius = "4 mm"'


def write(folder, *changes):
    text = PAD
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times"
        text = text.replace(old, new)
    (folder / "project.toml").write_text(text)
    return folder / "project.toml"


def write_ball(path, *, open_at_top=False):
    """A ball of 4 mm, in mm."""
    import pyvista as pv

    pv.Sphere(radius=4.0, start_phi=30 if open_at_top else 0).save(path)


def test_obstacles_are_those_of_the_python_api(tmp_path):
    model = load_project(write(tmp_path), solve=False).model
    contacts, bodies = model.mechanism.contacts, model.mechanism.bodies
    assert contacts.names == ("table", "wall", "probe")
    np.testing.assert_allclose(contacts.friction, [0.5, 0.0, 0.0])
    np.testing.assert_allclose(contacts.scale, 50e-6)
    np.testing.assert_allclose(bodies.mounting_translation[0], [0, 0, -0.5e-3])
    np.testing.assert_allclose(bodies.axes[1, 2], [1, 0, 0])
    np.testing.assert_allclose(
        bodies.origin[1:], 1e-3 * np.array([[-5, 0, 0], [10, 10, 14.1]])
    )
    np.testing.assert_allclose(bodies.mass, [0, 0, 0.02])
    assert not bodies.has_nodes.any()


def test_states_and_readings(tmp_path):
    project = load_project(write(tmp_path), solve=False)
    pressed, loaded = project.calibration
    state = pressed.bodies["probe"]
    assert isinstance(state, BodyState)
    assert state.kind == "held"
    np.testing.assert_allclose(state.pose.translation, [3e-3, 0, -1e-3])
    np.testing.assert_allclose(state.start.translation, [3e-3, 0, 1e-3])
    assert pressed.bodies["wall"] == "absent"
    assert loaded.bodies == {"probe": "sliding"}
    cell, forces, moments = pressed.effectors
    assert isinstance(cell, ContactForce)
    assert (cell.body, cell.measured, cell.std) == ("probe", 0.3, 1e-3)
    assert cell.axis is not None
    np.testing.assert_allclose(cell.axis, [0, 0, 1])
    assert isinstance(forces, ContactForce)
    assert forces.measured is not None
    np.testing.assert_allclose(forces.measured, [0, 0, -0.4])
    assert isinstance(moments, ContactMoment)
    assert moments.measured is not None
    np.testing.assert_allclose(moments.measured, [0, 1e-3, 0])
    assert project.space is not None
    assert project.space.names[1:] == [f"mounting {a} of table" for a in "xyz"]


def test_the_scale_of_contact_is_uncertain_by_itself(tmp_path):
    assert load_project(write(tmp_path), solve=False).uncertain.contact == 1.0
    stated = ("[effectors.cell]", "[uncertain]\ncontact = 0.5\n\n[effectors.cell]")
    assert load_project(write(tmp_path, stated), solve=False).uncertain.contact == 0.5
    left_out = ('contact_scale = "50 um"\n', "")
    model = load_project(write(tmp_path, left_out), solve=False).model
    bodies = [sc.RigidBody("table", shape=HalfSpace())]
    plain = sc.build_model(model.mesh, model.law, density=1e3, bodies=bodies)
    scale, usual = (m.mechanism.contacts.scale for m in (model, plain))
    np.testing.assert_allclose(scale, usual)


@pytest.mark.parametrize(("keys", "shape"), SHAPES.items(), ids=[*map(repr, SHAPES)])
def test_every_shape(tmp_path, keys, shape):
    project = load_project(write(tmp_path, (SPHERE, keys), *AWAY), solve=False)
    read = project.model.mechanism.contacts.shapes[2]
    assert type(read) is type(shape)
    for key, value in vars(shape).items():
        np.testing.assert_allclose(getattr(read, key), value)


def test_a_surface_is_read_and_belongs_to_the_project(tmp_path):
    write_ball(tmp_path / "ball.stl")
    surface = 'type = "surface", file = "ball.stl", length_unit = "mm"'
    project = load_project(write(tmp_path, (SPHERE, surface)), solve=False)
    shape = project.model.mechanism.contacts.shapes[2]
    assert isinstance(shape, DistanceGrid)
    places = jnp.array([[0, 0, 4e-3], [6e-3, 0, 0], [0, -3e-3, 0]])
    distances = [float(shape.distance(place)) for place in places]
    # The facets of the file lie inside of the ball.
    np.testing.assert_allclose(distances, [0, 2e-3, -1e-3], atol=0.05e-3)
    assert tmp_path / "ball.stl" in project.files


REFUSED = {
    "neither nodes nor a shape": (
        ('shape = { type = "sphere", radius = "4 mm" }\n', ""),
        'bodies.probe.group: missing ... "x_max" ... shape ... "plane"',
    ),
    "no such shape": (
        ('"sphere"', '"ball"'),
        'bodies.probe.shape.type: got "ball" ... "plane", "sphere", "cylinder", '
        '"capsule", "box", "surface"',
    ),
    "no size": (
        (SPHERE, 'type = "sphere"'),
        'bodies.probe.shape.radius: missing ... "5',
    ),
    "no radius": (
        ('radius = "4 mm"', 'radius = "0 mm"'),
        'bodies.probe.shape.radius: got "0 mm" ... above zero',
    ),
    "a key of another shape": (
        (SPHERE, f'{SPHERE}, length = "1 cm"'),
        "bodies.probe.shape.length: unknown key ... type, radius",
    ),
    "edges rounder than the box": (
        (SPHERE, 'type = "box", size = "(8, 6, 4) mm", rounding = "3 mm"'),
        "bodies.probe.shape: rounding of a box ... at most half",
    ),
    "no file": (
        (SPHERE, 'type = "surface", file = "bal.stl", length_unit = "mm"'),
        "bodies.probe.shape: surface file ... bal.stl ... does not exist ... "
        "'ball.stl'",
    ),
    "an open surface": (
        (SPHERE, 'type = "surface", file = "open.stl", length_unit = "mm"'),
        "bodies.probe.shape: ... open.stl ... open edges ... closed surface",
    ),
    "no surface": (
        (SPHERE, 'type = "surface", file = "project.toml", length_unit = "mm"'),
        "bodies.probe.shape: ... extension '.toml' ... .stl, .ply",
    ),
    "a broken surface": (
        (SPHERE, 'type = "surface", file = "broken.stl", length_unit = "mm"'),
        "bodies.probe.shape: ... broken.stl ... closed surface",
    ),
    "friction without a shape": (
        ('shape = { type = "plane" }\nfriction', 'group = "x_min"\nfriction'),
        "bodies.table: friction ... needs a shape",
    ),
    "two third axes": (
        ('axes = ["y"', 'hinge = "x"\naxes = ["y"'),
        "bodies.wall: got hinge and axes ... give one",
    ),
    "an unknown state": (
        ('"sliding"', '"slidng"'),
        'configurations.loaded.bodies.probe: got "slidng" ... "sliding"',
    ),
    "a turn of what slides": (
        (
            'probe = "sliding"',
            'probe = { state = "sliding", rotation_vector = "(0, 1, 0) deg" }',
        ),
        "configurations.loaded.bodies.probe: a body that is sliding ignores",
    ),
    "a start inside": (
        ('translation = "(3, 0, 1) mm"', 'translation = "(3, 0, -1) mm"'),
        "configurations: ... inside the obstacle 'probe' ... start",
    ),
    "no obstacle": (
        ('body = "probe"', 'body = "prob"'),
        "effectors.cell: ... obstacle ... 'probe'",
    ),
    "a force along an axis": (
        ('cell = "0.3 N"', 'cell = "(0, 0, 0.3) N"'),
        "configurations.pressed.measured.effectors.cell: ... a force",
    ),
    "one number of three": (
        ('forces = "(0, 0, -0.4) N"', 'forces = "0.4 N"'),
        "configurations.pressed.measured.effectors.forces: ... three numbers",
    ),
    "a scale of nothing": (
        ('"50 um"', '"0 um"'),
        'material.contact_scale: got "0 um" ... above zero',
    ),
}


@pytest.mark.parametrize(("change", "message"), REFUSED.values(), ids=REFUSED)
def test_refused_with_its_key(tmp_path, change, message):
    write_ball(tmp_path / "ball.stl")
    write_ball(tmp_path / "open.stl", open_at_top=True)
    (tmp_path / "broken.stl").write_text("solid nothing\nendsolid\n")
    path = write(tmp_path, change)
    with pytest.raises(ProjectError) as caught:
        load_project(path, solve=False)
    assert says(str(caught.value).removeprefix(f"{path}: "), message)


def test_a_force_pushes_a_probe(tmp_path):
    """It acts on the frame of the body, not on the pad below it."""
    push = (
        "[effectors.cell]\n",
        '[actuators.push]\ntype = "point-force"\npoint = "(10, 10, 20) mm"\n'
        'direction = "-z"\nbody = "probe"\n\n[effectors.cell]\n',
    )
    loaded = (
        'bodies = { probe = "sliding" }',
        'bodies = { probe = "sliding" }\nactuation = { push = "2 N" }',
    )
    project = load_project(write(tmp_path, push, loaded))
    mechanism = project.model.mechanism
    assert project.configurations[1].actuation["push"].value == 2.0
    rows = np.asarray(mechanism.actuators.rows(jnp.asarray(mechanism.points)))[0]
    np.testing.assert_allclose(rows.sum(axis=0), (0.0, 0.0, -1.0), atol=1e-12)
    acted = np.flatnonzero(np.abs(rows).any(axis=1))
    probe = mechanism.bodies.names.index("probe")
    assert set(acted) <= set(project.model.mesh.n_nodes + 4 * probe + np.arange(4))
    unknown = (push[0], push[1].replace('body = "probe"', 'body = "prob"'))
    (tmp_path / "bad").mkdir()
    with pytest.raises(ProjectError, match=r"(?s)push.*'prob'.*'probe'"):
        load_project(write(tmp_path / "bad", unknown, loaded))
