"""Project files with a CAD model, surfaces from points, and sealed chambers."""

import numpy as np
import pytest
from mesh.test_surfaces import open_block
from wording import says

from softcal_jax.mesh import write_mesh
from softcal_jax.project import ProjectError, load_mesh, load_project

BLOCK = """\
name = "block"

[mesh]
file = "block.msh"
length_unit = "mm"
element = "linear"

[groups.base]
face = { points = ["(0, -400, -400) mm"] }

[groups.wall]
inside = { point = "(300, 0, 0) mm", stop_at = "base" }

[groups.around]
reachable = { point = "(500, 500, 10) mm", stop_at = ["base"], angle = "100 deg" }

[groups.core]
of = "tets"
cylinder = { start = "(600, 0, 0) mm", end = "(1, 0, 0) m", radius = "200 mm" }

[groups.ring.annulus]
start = "(990, 0, 0) mm"
end = "(1, 0, 0) m"
inner = "0.4 m"
outer = "0.8 m"

[material]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
density = "1 g/cm^3"

[actuators.air]
type = "chamber"
surface = "wall"
seal = true

[shared]
gravity = "(0, 0, 0) m/s^2"
supports = [{ group = "base" }]

[[configurations]]
name = "blown"
actuation = { air = "2 kPa" }
"""


@pytest.fixture
def path(tmp_path):
    """The project, beside a cube of side 1 m whose cavity opens at x = 0."""
    write_mesh(open_block(), tmp_path / "block.msh", length_unit="mm")
    (tmp_path / "project.toml").write_text(BLOCK)
    return tmp_path / "project.toml"


def changed(path, *changes):
    text = BLOCK
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    return path


def refusal(path, *changes, of=load_project):
    with pytest.raises(ProjectError) as caught:
        of(changed(path, *changes))
    return str(caught.value)


def test_groups_by_place(path):
    mesh = load_mesh(path)
    block = open_block()
    n = {name: len(faces) for name, faces in mesh.surface_groups.items()}
    assert n["base"] == len(block.faces("inlet side"))
    assert n["wall"] == len(block.faces("cavity"))
    assert n["around"] == len(block.faces("outer")) - n["base"]
    assert len(mesh.tets_of("core")) > 0
    assert np.all(mesh.centroids[mesh.tets_of("core"), 0] > 0.6)
    ring = mesh.points[mesh.nodes("ring")]
    assert np.all(ring[:, 0] > 0.989)
    assert np.hypot(*ring[:, 1:].T).min() > 0.399


def test_a_mesh_and_groups_alone_are_enough_to_look_at(path):
    text = BLOCK[: BLOCK.index("[material]")].replace('name = "block"', "")
    path.write_text(text)
    assert set(load_mesh(path).surface_groups) >= {"base", "wall", "around"}
    text = refusal(path, ("[groups.wall]", "[grups.wall]"), of=load_mesh)
    assert says(text, 'grups: ... mean "groups"')


def test_a_sealed_chamber(path):
    arrays = load_project(path).model.mechanism.actuators
    np.testing.assert_allclose(arrays.rest, [2 / 27], rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("seal = true", ""),
            "actuators.air: ... 'wall' is not closed",
        ),
        (
            ("seal = true", "seal = 1"),
            "actuators.air.seal: got 1 ... true or false",
        ),
        (
            ('stop_at = "base" }', 'stop_at = "bose" }'),
            "groups.wall: ... 'bose' ... mean 'base'",
        ),
        (
            (
                'face = { points = ["(0, -400, -400) mm"] }',
                'plane = { point = "(0, 0, 0) mm", normal = "-x" }',
            ),
            "groups.wall: 'base' is a group of nodes ... of =",
        ),
        (
            (', stop_at = "base" }', " }"),
            "groups.wall: no cavity ... (300, 0, 0) mm",
        ),
        (
            ('["(0, -400, -400) mm"]', "[]"),
            "groups.base.face.points: got [] ... 1",
        ),
        (
            ('["(0, -400, -400) mm"]', '["(0, -400, -400) cm"]'),
            "groups.base: ... (0, -4, -4) m",
        ),
        (
            ("face = {", 'of = "nodes"\nface = {'),
            "groups.base: face ... of out",
        ),
        (
            ('file = "block.msh"', 'file = "block.step"'),
            "mesh.size: missing ... length",
        ),
        (
            ('length_unit = "mm"', 'length_unit = "mm"\nsize = "3 mm"'),
            "mesh.size: unknown key ... file, length_unit",
        ),
        (
            ('file = "block.msh"', 'file = "block.stl"\nsize = "3 mm"'),
            "mesh: CAD model ",
        ),
        (
            ('file = "block.msh"', 'file = "block.step"\nsize = "3 mm"'),
            "Leave it out",
        ),
        (
            ('inner = "0.4 m"', 'inner = "0.9 m"'),
            "groups.ring: ... inner one",
        ),
    ],
)
def test_what_is_refused(path, change, message):
    assert says(refusal(path, change), message)
