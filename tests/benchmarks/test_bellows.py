"""The mesh of the bellows: its volume, and the surfaces that it names."""

import numpy as np
import pytest

from benchmarks._bellows import (
    HEIGHT,
    PITCH,
    SIDE,
    STRIP,
    WALL,
    WIDTH,
    Cells,
    bellows,
)
from softcal_jax.mesh import face_areas, volumes

GAP = 1e-3


@pytest.mark.parametrize("cells", [Cells(), Cells(3, 1, 2, wall=2)])
@pytest.mark.parametrize("ends", [True, False])
def test_folds_of_the_stated_size(cells, ends):
    n = 3
    mesh = bellows(n, GAP, cells, ends=ends, order=1)
    fold, gaps = PITCH - GAP, n if ends else n - 1
    inner = np.array([fold - 2.0 * WALL, WIDTH - SIDE, HEIGHT - STRIP - SIDE])
    solid = n * (fold * WIDTH * HEIGHT - inner.prod()) + gaps * GAP * WIDTH * STRIP
    np.testing.assert_allclose(volumes(mesh).sum(), solid)
    np.testing.assert_allclose(np.ptp(mesh.points[:, 0]), n * fold + gaps * GAP)

    a, b, c = inner
    wall = {"front": WIDTH * (HEIGHT - STRIP), "back": WIDTH * (HEIGHT - STRIP)}
    wall["cavity"] = a * b * 2.0 + b * c * 2.0 + a * c  # open at the mirror
    for name, area in wall.items():
        areas, _ = face_areas(mesh, mesh.surface_groups[name])
        np.testing.assert_allclose(areas.sum(), n * area)


def test_one_fold_is_the_mirror_of_the_next():
    one, three = (bellows(n, GAP, order=1) for n in (1, 3))
    centroids = lambda mesh: np.round(1e9 * mesh.centroids).astype(int)
    of_three = {tuple(row) for row in centroids(three)}
    for k in range(3):
        along = [int(k * PITCH * 1e9), 0, 0]
        assert {tuple(row) for row in centroids(one) + along} <= of_three
    turned = centroids(one) * [-1, 1, 1] + [int(PITCH * 1e9), 0, 0]
    off = {tuple(row) for row in turned} ^ {tuple(row) for row in centroids(one)}
    assert off == set()
