import numpy as np
import pytest

from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    check_mesh,
    oriented,
    to_quadratic,
    volumes,
)

BEAM = beam(0.1, 0.02, 0.02, (3, 2, 2))
ONE = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]])


@pytest.mark.parametrize("order", [1, 2])
def test_a_sound_mesh_passes(order):
    check_mesh(beam(0.1, 0.02, 0.02, (3, 1, 2), order=order))


@pytest.mark.parametrize("mesh", [BEAM, to_quadratic(BEAM)])
def test_inverted(mesh):
    tets = mesh.tets.copy()
    # Exchanging corners 1 and 2 exchanges their mid nodes as well.
    swap = [0, 2, 1, 3, 6, 5, 4, 7, 9, 8][: tets.shape[1]]
    tets[[4, 9]] = tets[[4, 9]][:, swap]
    message = r"2 of 72 .*inverted .*: 4 at \(.*\), 9 at \(.*Swap"
    with pytest.raises(ValueError, match=message):
        check_mesh(TetMesh(mesh.points, tets))


def test_curved_tet_folded_by_its_mid_node():
    mesh = to_quadratic(ONE)
    points = mesh.points.copy()
    points[mesh.tets[0, 4]] = [0.76, 0.0, 0.0]  # Beyond 3/4: folds at corner 1.
    with pytest.raises(ValueError, match=r"1 of 1 curved .*inverted .*mid nodes"):
        check_mesh(TetMesh(points, mesh.tets))
    points[mesh.tets[0, 4]] = [0.6, 0.05, 0.0]
    check_mesh(TetMesh(points, mesh.tets))


def test_degenerate():
    points = BEAM.points.copy()
    a, b, c, d = BEAM.tets[0]
    points[d] = points[[a, b, c]].mean(axis=0)
    with pytest.raises(ValueError, match=r"of 72 .*degenerate .*: 0 at .*Remesh"):
        check_mesh(TetMesh(points, BEAM.tets))
    # A tet that repeats a node is flat whatever its size.
    with pytest.raises(ValueError, match=r"1 of 1 .*degenerate"):
        check_mesh(TetMesh(ONE.points[:3], [[0, 1, 2, 2]]))


def test_small_is_not_degenerate():
    check_mesh(TetMesh(1e-9 * ONE.points, ONE.tets))


def test_unused_nodes():
    points = np.vstack([BEAM.points, np.full((7, 3), 0.5)])
    with pytest.raises(ValueError, match=r"7 of 43 .*unused .*\[36, 37.*, \.\.\."):
        check_mesh(TetMesh(points, BEAM.tets))


def test_repeated_and_overlapping():
    twice = np.vstack([BEAM.tets, BEAM.tets[3][[1, 2, 0, 3]]])
    with pytest.raises(ValueError, match=r"1 tets repeat .*: 72 at"):
        check_mesh(TetMesh(BEAM.points, twice))
    points = np.vstack([ONE.points, [[1, 1, 1], [2, 2, 2]]])
    fan = [[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 5]]
    with pytest.raises(ValueError, match="3 tets overlap"):
        check_mesh(TetMesh(points, fan))


@pytest.mark.parametrize("order", [1, 2])
def test_tangled(order):
    """A node beyond the opposite faces, and the tets turned over that it inverts.

    Their volumes are positive, and sum to more than the surface encloses.
    """
    mesh = beam(0.1, 0.02, 0.02, (2, 2, 2), pattern="centred")
    inner = np.setdiff1d(np.arange(mesh.n_nodes), boundary_faces(mesh))[0]
    points = mesh.points.copy()
    points[inner] += [0.06, 0.0, 0.0]
    tangled = TetMesh(points, oriented(mesh.tets, points[mesh.tets]))
    assert volumes(tangled).sum() > 1.05 * volumes(mesh).sum()
    tangled = to_quadratic(tangled) if order == 2 else tangled
    with pytest.raises(ValueError, match=r"tets overlap .*same side"):
        check_mesh(tangled)


def test_disconnected():
    points = np.vstack([BEAM.points, 0.5 + np.vstack([np.zeros(3), np.eye(3)])])
    apart = TetMesh(points, np.vstack([BEAM.tets, [[36, 37, 38, 39]]]))
    with pytest.raises(ValueError, match=r"2 parts .* 72, 1 tets .*Join"):
        check_mesh(apart)


def test_parts_that_only_touch():
    """Nodes that coincide but are not shared, and a shared node alone."""
    half = beam(0.1, 0.02, 0.02, (1, 1, 1))
    other = half.points + np.array([0.1, 0.0, 0.0])
    twins = TetMesh(
        np.vstack([half.points, other]), np.vstack([half.tets, 8 + half.tets])
    )
    with pytest.raises(ValueError, match=r"2 parts .* 6, 6 tets.* 4 pairs .*merge"):
        check_mesh(twins)
    hinge = TetMesh(np.vstack([ONE.points, -np.eye(3)]), [[0, 1, 2, 3], [0, 5, 4, 6]])
    with pytest.raises(ValueError, match=r"2 parts .* 1, 1 tets .*Join"):
        check_mesh(hinge)


def test_all_problems_are_named_at_once():
    tets = BEAM.tets.copy()
    tets[0] = tets[0, [1, 0, 2, 3]]
    points = np.vstack([BEAM.points, [[1, 1, 1]]])
    with pytest.raises(ValueError, match=r"1 of 37 nodes .*\n- 1 of 72 .*inverted"):
        check_mesh(TetMesh(points, tets))
