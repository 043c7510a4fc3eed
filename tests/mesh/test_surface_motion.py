"""Motions of a surface: the volumes of the shapes that they make are known."""

from dataclasses import replace

import numpy as np
import pytest
from problems import irregular_cube

from softcal_jax.mesh import (
    Box,
    TetMesh,
    beam,
    boundary_faces,
    select_faces,
    surface_motion,
    to_quadratic,
    volumes,
)

SIDE, THICK, HOLE, BY = 0.06, 0.01, 0.02, 1e-3


def holed(order):
    """A square plate with a square hole in the middle."""
    box = beam(SIDE, SIDE, THICK, (6, 6, 2))
    off = np.abs(box.centroids[:, :2] - SIDE / 2).max(axis=1)
    kept = box.tets[off > HOLE / 2]
    nodes, tets = np.unique(kept, return_inverse=True)
    mesh = TetMesh(box.points[nodes], tets.reshape(kept.shape))
    wall = Box((HOLE, HOLE, 0.0), (2 * HOLE, 2 * HOLE, THICK), tolerance=1e-6)
    mesh = mesh.with_surface_group("hole", select_faces(mesh, wall))
    return mesh if order == 1 else to_quadratic(mesh)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("direction", "removed"), [(None, HOLE**2 - (HOLE - 2 * BY) ** 2), ((2, 1, 0), 0.0)]
)
def test_a_hole_is_narrower_or_elsewhere(order, direction, removed):
    """In its corners, both walls move by the offset."""
    mesh = holed(order)
    motion = surface_motion(mesh, "hole", direction)
    moved = replace(mesh, points=mesh.points + BY * motion)
    assert volumes(moved).min() > 0.0
    before, after = volumes(mesh).sum(), volumes(moved).sum()
    np.testing.assert_allclose(after - before, removed * THICK, atol=1e-10 * before)
    outer = np.isclose(np.abs(mesh.points[:, :2] / SIDE - 0.5), 0.5).any(axis=1)
    np.testing.assert_allclose(motion[outer][:, 2], 0.0, atol=1e-12)
    for axis in (0, 1):
        side = np.isclose(np.abs(mesh.points[:, axis] / SIDE - 0.5), 0.5)
        assert not motion[side, axis].any()
    if order == 2:
        np.testing.assert_array_equal(
            motion[mesh.tets[:, 4]], motion[mesh.tets[:, :2]].mean(axis=1)
        )


def test_a_side_of_an_irregular_block_stretches_it():
    """The inside follows linearly, as Laplace's equation has it, on any mesh."""
    mesh = irregular_cube(3, 2)
    faces = boundary_faces(mesh)
    top = faces[(mesh.points[faces][:, :, 2] > 1.0 - 1e-9).all(axis=1)]
    motion = surface_motion(mesh.with_surface_group("top", top), "top")
    linear = np.stack([0.0 * mesh.points[:, 2]] * 2 + [mesh.points[:, 2]], axis=1)
    np.testing.assert_allclose(motion, linear, atol=1e-10)


def test_bad_motions():
    mesh = holed(1)
    with pytest.raises(ValueError, match=r"'whole'.* mean 'hole'"):
        surface_motion(mesh, "whole")
    for direction in ((0.0, 0.0, 0.0), (1.0, 0.0), (np.nan, 0.0, 0.0)):
        with pytest.raises(ValueError, match="direction must be a vector"):
            surface_motion(mesh, "hole", direction)
    inside = mesh.with_surface_group("cut", mesh.tets[:4, :3])
    with pytest.raises(ValueError, match=r"'cut' has \d faces inside"):
        surface_motion(inside, "cut")
