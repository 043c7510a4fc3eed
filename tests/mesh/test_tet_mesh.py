import numpy as np
import pytest

from softcal_jax.mesh import TetMesh, beam, boundary_faces

POINTS = np.vstack([np.zeros(3), np.eye(3)])
TET = np.array([[0, 1, 2, 3]])


def test_sizes_of_one_tet():
    mesh = TetMesh(POINTS, TET)
    assert (mesh.n_nodes, mesh.n_tets, mesh.order) == (4, 1, 1)
    np.testing.assert_allclose(mesh.size, np.sqrt(3.0), rtol=1e-15)
    assert mesh.tets.dtype == np.int32
    assert mesh.points.dtype == np.float64


def test_unknown_group_suggests_the_near_one():
    mesh = beam(0.1, 0.02, 0.02, (2, 2, 2))
    with pytest.raises(ValueError, match=r"group 'x_mim'.* 'x_min'\?.*'z_max'"):
        mesh.nodes("x_mim")
    with pytest.raises(ValueError, match=r"group 'X_MIN'.* 'x_min'\?"):
        mesh.nodes("X_MIN")
    with pytest.raises(ValueError, match=r"surface group 'tip'\. Known: 'x_max'"):
        mesh.faces("tip")
    with pytest.raises(ValueError, match=r"tet group 'all'.* none.*select_nodes"):
        mesh.tets_of("all")


def test_groups_with_numbers_are_listed_in_their_order():
    """Faces of a CAD model have numbers, and there may be many."""
    mesh = TetMesh(POINTS, TET)
    for number in (10, 2, 1):
        mesh = mesh.with_surface_group(f"face {number}", [[0, 2, 1]])
    with pytest.raises(ValueError, match="'face 1', 'face 2', 'face 10'"):
        mesh.faces("base")


def test_nodes_of_a_name_fall_back_on_faces_and_tets():
    mesh = TetMesh(POINTS, TET)
    mesh = mesh.with_surface_group("base", [[0, 2, 1]]).with_tet_group("body", [0])
    np.testing.assert_array_equal(mesh.nodes("base"), [0, 1, 2])
    np.testing.assert_array_equal(mesh.nodes("body"), [0, 1, 2, 3])
    np.testing.assert_array_equal(mesh.tets_of("body"), [0])
    # A node group of the same name goes first.
    mesh = mesh.with_node_group("base", [2, 2, 1])
    np.testing.assert_array_equal(mesh.nodes("base"), [1, 2])
    np.testing.assert_array_equal(mesh.faces("base"), [[0, 2, 1]])


def test_a_group_makes_a_new_mesh():
    mesh = TetMesh(POINTS, TET)
    mesh.with_node_group("tip", [3])
    assert mesh.node_groups == {}


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (lambda m: m.with_node_group("x_min", [0]), "node group 'x_min' already"),
        (lambda m: m.with_surface_group("x_min", boundary_faces(m)), "face .*'x_min'"),
        (lambda m: m.with_node_group("a", [27]), "node group 'a': index 27 .* 26"),
        (lambda m: m.with_node_group("a", [-1]), "index -1 .* 0 to 26"),
        (lambda m: m.with_node_group("a", np.array([], int)), "group 'a' is empty"),
        (lambda m: m.with_node_group("a", np.ones(27, bool)), "np.flatnonzero turns"),
        (lambda m: m.with_node_group("a", [1.0]), "integer indices, got float64"),
        (lambda m: m.with_tet_group("a", [48]), "tet group 'a': index 48 .* 47"),
        (
            lambda m: m.with_surface_group("a", [[0, 1, 2, 3]]),
            r"surface group 'a' .*\(n_faces, 3\) .*\(1, 4\)",
        ),
    ],
)
def test_bad_groups(add, message):
    mesh = beam(0.1, 0.02, 0.02, (2, 2, 2))
    with pytest.raises(ValueError, match=message):
        add(mesh)


@pytest.mark.parametrize(
    ("points", "tets", "message"),
    [
        (POINTS[:, :2], TET, r"\(n_nodes, 3\), got \(4, 2\)"),
        (POINTS, TET[:, :3], r"\(n_tets, 4\) or \(n_tets, 10\), got \(1, 3\)"),
        (POINTS, np.empty((0, 4), int), "tets is empty"),
        (POINTS, [[0, 1, 2, 4]], "tets: index 4 .* 0 to 3"),
        (np.vstack([POINTS[:3], [[0, np.nan, 1]]]), TET, r"node 3 .*\[0\.0, nan, 1\.0"),
        (1e200 * POINTS, TET, r"node 1 .*\[1e\+200, "),
    ],
)
def test_bad_arrays(points, tets, message):
    with pytest.raises(ValueError, match=message):
        TetMesh(points, tets)
