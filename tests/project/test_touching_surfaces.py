"""Surfaces of the body that touch each other, from a project file to its report."""

import numpy as np
import pytest
from wording import says

from softcal_jax.configurations import configuration_arrays
from softcal_jax.fields import KINDS
from softcal_jax.mesh import TetMesh, beam, boundary_faces, write_mesh
from softcal_jax.project import ProjectError, load_project
from softcal_jax.results import write_results

STACK = """\
name = "stack"

[mesh]
file = "stack.msh"
length_unit = "mm"
element = "linear"
parts = "linked"

[material]
law = "corotational"
E = "100 kPa"
nu = 0.3
density = "1 g/cm^3"
touching = [["low", "high"]]

[effectors.squeeze]
type = "contact-force"
body = "low on high"
axis = "z"
std = "10 mN"

[[configurations]]
name = "pressed"
gravity = "(0, 0, 0) m/s^2"
supports = [
    { group = "bottom" },
    { group = "top", displacement = "(0, 0, -2) mm" },
]
"""


def write(folder, *changes):
    """Two blocks, one above the other, 0.5 mm apart."""
    one = beam(0.02, 0.02, 0.02, (2, 2, 2))
    n, lift = one.n_nodes, [0.0, 0.0, 0.0205]
    points = np.concatenate([one.points, one.points + lift])
    mesh = TetMesh(points, np.concatenate([one.tets, one.tets + n]))
    faces = boundary_faces(mesh)
    z = points[faces][..., 2]
    heights = {"bottom": 0.0, "low": 0.02, "high": 0.0205, "top": 0.0405}
    for name, height in heights.items():
        chosen = np.isclose(z, height, atol=1e-9).all(axis=1)
        mesh = mesh.with_surface_group(name, faces[chosen])
    write_mesh(mesh, folder / "stack.msh")
    text = STACK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "project.toml"
    path.write_text(text)
    return path


def test_surfaces_that_touch_are_in_results_and_reports(tmp_path):
    project = load_project(write(tmp_path))
    result, _ = project.simulate()
    (pose,) = result.configurations
    assert pose.converged
    assert pose.self_contact is None
    assert pose.robot is not None
    (contact,) = pose.robot.contacts
    assert contact.name == "low on high"
    # Clamped at both ends, a little more than P = E (l - 1).
    force = 0.02**2 * 1e5 * 1.5e-3 / 0.04
    assert force < contact.force[2] < 1.3 * force
    (read,) = [e for e in pose.effectors if e.name == "squeeze"]
    np.testing.assert_allclose(np.ravel(read.simulated)[0], contact.force[2])
    assert says(str(result), "low on high")
    write_results(result, tmp_path / "report")
    text = (tmp_path / "report" / "report.html").read_text()
    assert says(text, "low on high", "largest depth")


def test_their_cushion_is_uncertain_too(tmp_path):
    project = load_project(write(tmp_path), solve=False)
    model, poses = project.model, project.configurations
    arrays = configuration_arrays(model.mesh, poses, model.mechanism)
    assert KINDS["contact_scale"].occurs(model, arrays, ()) == {"": ("",)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('"high"]]', '"hight"]]'), "material: ... 'hight' ... high"),
        (('[["low", "high"]]', '["low", "high"]'), "material.touching"),
        (('[["low", "high"]]', '[["low", "low"]]'), "material: ... no face of 'low'"),
        (('body = "low on high"', 'body = "high"'), "squeeze ... low on high"),
    ],
)
def test_refused_with_its_key(tmp_path, change, message):
    with pytest.raises(ProjectError) as caught:
        load_project(write(tmp_path, change), solve=False)
    assert says(str(caught.value), *message.split(" ... "))
