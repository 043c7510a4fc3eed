import numpy as np
import pytest

from softcal_jax.mesh import beam, boundary_faces, check_mesh, volumes

BOX = (0.1, 0.02, 0.03)


@pytest.mark.parametrize(
    ("cells", "n_nodes"),
    [((20, 4, 4), 525), ((40, 6, 6), 2009), ((60, 10, 10), 7381), ((3, 1, 2), 24)],
)
def test_counts(cells, n_nodes):
    mesh = beam(*BOX, cells)
    assert mesh.n_nodes == n_nodes
    assert mesh.n_tets == 6 * np.prod(cells)


def test_counts_of_the_centred_pattern():
    """Grid nodes, one node per cell and one per face between or around cells."""
    mesh = beam(*BOX, (3, 1, 2), pattern="centred")
    faces = 4 * 1 * 2 + 3 * 2 * 2 + 3 * 1 * 3
    assert mesh.n_nodes == 24 + 6 + faces
    assert mesh.n_tets == 24 * 6


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pattern", ["mirrored", "centred"])
@pytest.mark.parametrize("cells", [(4, 2, 2), (3, 1, 2), (1, 1, 1)])
def test_fills_the_box_and_conforms(cells, pattern, order):
    mesh = beam(*BOX, cells, origin=(1.0, -2.0, 0.5), order=order, pattern=pattern)
    check_mesh(mesh)
    assert (volumes(mesh) > 0).all()
    np.testing.assert_allclose(volumes(mesh).sum(), np.prod(BOX), rtol=1e-12)
    np.testing.assert_allclose(mesh.points.min(axis=0), [1.0, -2.0, 0.5], rtol=1e-15)
    np.testing.assert_allclose(mesh.points.max(axis=0), [1.1, -1.98, 0.53], rtol=1e-15)
    # Conforming: what is not shared by two tets lies on a side of the box.
    X = mesh.points[boundary_faces(mesh)]
    on_a_side = (np.ptp(X, axis=1) == 0).any(axis=1)
    assert on_a_side.all()


def _tets_as_places(mesh, mirror=None):
    """The tets as a set of sets of places on the lattice of half cells."""
    lattice = np.rint(mesh.points * 1e6).astype(int)
    if mirror is not None:
        lattice[:, mirror] = np.rint(1e6 * BOX[mirror]).astype(int) - lattice[:, mirror]
    return {frozenset(map(tuple, tet)) for tet in lattice[mesh.tets].tolist()}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("cells", "pattern"),
    [((5, 2, 4), "mirrored"), ((4, 4, 2), "mirrored"), ((2, 3, 1), "centred")],
)
def test_is_its_own_mirror_image_across(cells, pattern, order):
    mesh = beam(*BOX, cells, order=order, pattern=pattern)
    tets = _tets_as_places(mesh)
    assert len(tets) == mesh.n_tets
    assert tets == _tets_as_places(mesh, mirror=1)
    assert tets == _tets_as_places(mesh, mirror=2)


def test_odd_count_is_not_its_own_mirror_image():
    """The documented limit of the default pattern, and the test above can fail."""
    mesh = beam(*BOX, (4, 3, 2))
    assert _tets_as_places(mesh) != _tets_as_places(mesh, mirror=1)
    assert _tets_as_places(mesh) == _tets_as_places(mesh, mirror=2)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pattern", ["mirrored", "centred"])
def test_sides_are_groups(order, pattern):
    mesh = beam(*BOX, (4, 2, 3), order=order, pattern=pattern)
    for axis, letter in enumerate("xyz"):
        for side, value in (("min", 0.0), ("max", BOX[axis])):
            name = f"{letter}_{side}"
            there = np.flatnonzero(np.abs(mesh.points[:, axis] - value) < 1e-12)
            np.testing.assert_array_equal(mesh.nodes(name), there)
            np.testing.assert_array_equal(np.unique(mesh.faces(name)), there)
            X = mesh.points[mesh.faces(name)[:, :3]]
            area = np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]).sum(axis=0) / 2.0
            outwards = np.zeros(3)
            outwards[axis] = np.prod(BOX) / BOX[axis] * (1 if side == "max" else -1)
            np.testing.assert_allclose(area, outwards, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: beam(0.1, 0.0, 0.02, (2, 2, 2)), r"positive \[m\], got \[0\.1, 0\.0,"),
        (lambda: beam(0.1, 0.02, np.nan, (2, 2, 2)), "positive .*nan"),
        (lambda: beam(*BOX, (2, 0, 2)), r"positive integers, got \(2, 0, 2\)"),
        (lambda: beam(*BOX, (2, 2.0, 2)), r"positive integers, got \(2, 2.0, 2\)"),
        (lambda: beam(*BOX, (2, 2)), r"three positive integers, got \(2, 2\)"),
        (lambda: beam(*BOX, (2, 2, 2), order=3), "order .* 1 .* 2 .* 3"),
        (lambda: beam(*BOX, (2, 2, 2), origin=(0, 0)), r"origin .*\(0, 0\)"),
        (lambda: beam(*BOX, (2, 2, 2), pattern="mirored"), "'mirored'.* 'mirrored'"),
    ],
)
def test_bad_calls(call, message):
    with pytest.raises(ValueError, match=message):
        call()
