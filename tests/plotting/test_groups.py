"""Pictures of a mesh with its groups: what is coloured, what a cut bares, names."""

import numpy as np
import pytest
from matplotlib.image import imread

from benchmarks._hollow import hollow_cube
from softcal_jax.mesh import beam
from softcal_jax.plotting import choose_view, plot_groups
from softcal_jax.plotting._configuration import _CUT, _colours, _faces, _image, _panels
from softcal_jax.plotting._view import fit_panel


def test_a_box_shows_three_sides_with_their_colours():
    """Pixels of each side: its area times the cosine of its angle."""
    mesh, size = beam(0.1, 0.04, 0.02, (5, 2, 1)), np.array([0.1, 0.04, 0.02])
    view, names = choose_view(mesh.points), list(mesh.surface_groups)
    faces, group = _faces(mesh, names, view, np.ones(mesh.n_tets, bool))
    assert np.all(group >= 0)
    panel = fit_panel(view, 800, 1.15)
    image = _image(view, faces, group, panel)
    for k, name in enumerate(names):
        axis, sign = "xyz".index(name[0]), 1.0 if name.endswith("max") else -1.0
        facing = max(sign * view.towards[axis], 0.0)
        expected = facing * size.prod() / size[axis]
        seen = np.sum(image == k) / panel[2] ** 2
        # A row of pixels along its edges is its neighbour's.
        np.testing.assert_allclose(seen, expected, atol=0.02 * size[0] * size[1])


def test_walls_of_a_cavity_are_hidden_until_it_is_cut():
    mesh = hollow_cube()
    names = list(mesh.surface_groups)
    wall, seen = names.index("cavity"), []
    for view, drawn in _panels(mesh).values():
        image = _image(
            view, *_faces(mesh, names, view, drawn), fit_panel(view, 800, 1.15)
        )
        seen.append(np.sum(image == wall))
    assert seen[:2] == [0, 0]
    assert min(seen[2:]) > 1000


def test_a_cut_bares_the_wall_of_a_cavity():
    mesh = hollow_cube()
    view, names = choose_view(mesh.points), list(mesh.surface_groups)
    behind = (mesh.centroids @ view.towards) < 0.0
    faces, group = _faces(mesh, names, view, behind)
    assert np.any(group == _CUT)
    # What looks towards the viewer of the far half of the wall, and of none else.
    wall = faces.corners[group == names.index("cavity")]
    assert len(wall) > 2
    assert np.abs(wall).max() == pytest.approx(1 / 6)


def test_the_last_group_of_a_face_colours_it():
    mesh = beam(0.1, 0.04, 0.02, (5, 2, 1))
    mesh = mesh.with_tet_group("left", np.flatnonzero(mesh.centroids[:, 0] < 0.04))
    names = ["left", *mesh.surface_groups]
    _, group = _faces(mesh, names, choose_view(mesh.points), np.ones(mesh.n_tets, bool))
    assert not np.any(group == 0)  # each face has a surface of its own
    bare = type(mesh)(mesh.points, mesh.tets, {}, {}, mesh.tet_groups)
    faces, group = _faces(
        bare, ["left"], choose_view(mesh.points), np.ones(mesh.n_tets, bool)
    )
    left = faces.corners.mean(axis=1)[:, 0] < 0.04
    np.testing.assert_array_equal(group, np.where(left, 0, -1))


def test_colours_are_apart():
    colours = np.array(_colours(30))
    gaps = np.linalg.norm(colours[:, None] - colours, axis=2) + np.eye(30)
    assert gaps.min() > 0.02


def test_picture(tmp_path):
    """Colours of the groups, those of nodes too, are in it."""
    mesh = beam(0.1, 0.04, 0.02, (5, 2, 1), order=2).with_node_group("tip", [0, 1, 2])
    plot_groups(mesh, tmp_path / "groups.png", title="a beam")
    pixels = imread(tmp_path / "groups.png")[..., :3]
    for colour in _colours(len(mesh.surface_groups) + 1):
        near = np.abs(pixels - colour).max(axis=2) < 0.01
        assert near.sum() > 200, colour
