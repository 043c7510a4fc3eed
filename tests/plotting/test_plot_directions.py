"""Pictures of directions of fibres: what is drawn, and which face hides which."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from softcal_jax.materials import Fibre
from softcal_jax.mesh import beam, boundary_faces, boundary_tets
from softcal_jax.plotting import choose_view, plot_directions
from softcal_jax.plotting._fibres import _drawn
from softcal_jax.plotting._figure import SERIES
from softcal_jax.plotting._view import visible_faces

SIZE = (0.02, 0.03, 0.1)
HELIX = 0.6


@pytest.fixture(scope="module")
def mesh():
    return beam(*SIZE, (2, 3, 6))


@pytest.fixture(scope="module")
def helices(mesh):
    """Unit vectors of the tets, wound both ways."""
    middle = (0.5 * SIZE[0], 0.5 * SIZE[1], 0.0)
    made = Fibre.helix(HELIX, mesh.centroids, (0.0, 0.0, 1.0), middle)
    return [np.asarray(fibre.direction()).T for fibre in (made, made.mirrored())]


@pytest.fixture(scope="module")
def view(mesh):
    return choose_view(mesh.points)


def test_boundary_tets_have_the_nodes_of_their_faces(mesh):
    faces, tets = boundary_faces(mesh), mesh.tets[boundary_tets(mesh)]
    assert np.all(np.any(faces[:, :, None] == tets[:, None, :], axis=2))


def test_three_sides_are_seen_the_farthest_first(mesh, view):
    """A box shows three of its six sides."""
    faces = visible_faces(mesh, view)
    a, b, c = np.moveaxis(faces.corners, 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sides = np.unique(np.round(normals, 9), axis=0)
    assert len(sides) == 3
    assert np.all(sides @ view.towards > 0.0)
    depth = faces.corners.mean(axis=1) @ view.towards
    assert np.all(np.diff(depth) >= 0.0)


def test_lines_lie_along_the_projected_fibre(mesh, helices, view):
    """On every second tet, upon the face that it bounds, with its own colour."""
    faces = visible_faces(mesh, view)
    where = np.arange(mesh.n_tets) % 2 == 0
    shapes, colours = _drawn(faces, view, dict(zip("ab", helices, strict=True)), where)
    wound = np.flatnonzero(where[faces.tet])
    assert len(shapes) == len(colours) == len(faces.tet) + 2 * len(wound)
    lines = np.array([shape for shape in shapes if len(shape) == 4])
    assert {len(shape) for shape in shapes} == {3, 4}
    sides = np.stack([lines[:, 0] - lines[:, 3], lines[:, 0] - lines[:, 1]])
    long, short = np.linalg.norm(sides, axis=-1)
    assert np.all(long > short)
    expected = np.stack(helices, axis=1)[faces.tet[wound]].reshape(-1, 3)
    expected = expected @ np.stack([view.right, view.up], axis=1)
    cross = sides[0, :, 0] * expected[:, 1] - sides[0, :, 1] * expected[:, 0]
    np.testing.assert_allclose(cross, 0.0, atol=1e-12)
    middles = view.project(faces.corners[wound].mean(axis=1))
    np.testing.assert_allclose(lines.mean(axis=1), np.repeat(middles, 2, axis=0))


def test_a_fibre_out_of_the_picture_has_no_length(mesh, view):
    """Seen from its end, it is a point."""
    faces = visible_faces(mesh, view)
    out = np.broadcast_to(view.towards, (mesh.n_tets, 3))
    shapes, _ = _drawn(faces, view, {"a": out}, np.ones(mesh.n_tets, bool))
    lines = np.array([shape for shape in shapes if len(shape) == 4]).reshape(-1, 4, 2)
    np.testing.assert_allclose(lines[:, 0] - lines[:, 3], 0.0, atol=1e-15)


def test_picture(mesh, helices, tmp_path):
    path = tmp_path / "directions.png"
    families = dict(zip(("one way", "the other"), helices, strict=True))
    plot_directions(mesh, families, path, title="wound")
    pixels = imread(path)[..., :3]
    assert pixels.shape[0] > pixels.shape[1]  # as the body is
    for colour in SERIES[:2]:
        near = np.abs(pixels - to_rgb(colour)).max(axis=2) < 0.01
        assert near.sum() > 1000  # more than the legend has


def test_wrong_calls(mesh, helices, tmp_path, unchecked):
    with pytest.raises(ValueError, match="families is empty"):
        plot_directions(mesh, {}, tmp_path / "d.png")
    with pytest.raises(ValueError, match=r"'thread' .* 216 .*\(3, 216\)"):
        plot_directions(mesh, {"thread": helices[0].T}, tmp_path / "d.png")
