import numpy as np
import pytest

from benchmarks._parallel_robot_geometry import merge
from softcal_jax.mesh import beam, check_mesh, volumes

BOX = (0.1, 0.02, 0.03)


@pytest.fixture(params=[1, 2])
def parts(request):
    order = request.param
    a = beam(*BOX, (2, 1, 1), order=order).with_tet_group("first two", [0, 1])
    # The second part shares a side with the first.
    return {"a": a, "b": beam(*BOX, (3, 1, 2), origin=(0.1, 0.0, 0.0), order=order)}


def test_keeps_every_part_as_it_was(parts):
    mesh = merge(parts)
    assert mesh.n_nodes == sum(part.n_nodes for part in parts.values())
    np.testing.assert_allclose(volumes(mesh).sum(), 2 * np.prod(BOX), rtol=1e-12)
    for name, part in parts.items():
        tets = mesh.tets[mesh.tets_of(name)]
        np.testing.assert_array_equal(mesh.points[tets], part.points[part.tets])
    assert not np.intersect1d(mesh.nodes("a"), mesh.nodes("b")).size


def test_groups_are_prefixed_and_renumbered(parts):
    mesh = merge(parts)
    for name, part in parts.items():
        for group, nodes in part.node_groups.items():
            there = mesh.node_groups[f"{name}/{group}"]
            np.testing.assert_array_equal(mesh.points[there], part.points[nodes])
        for group, faces in part.surface_groups.items():
            there = mesh.faces(f"{name}/{group}")
            np.testing.assert_array_equal(mesh.points[there], part.points[faces])
    assert set(mesh.tet_groups) == {"a", "b", "a/first two"}
    np.testing.assert_array_equal(mesh.tets_of("a/first two"), [0, 1])
    again = merge({"b": parts["b"], "a": parts["a"]})
    offset = parts["b"].n_tets
    np.testing.assert_array_equal(again.tets_of("a/first two"), [offset, offset + 1])


def test_check_mesh_names_the_parts_as_disconnected(parts):
    with pytest.raises(ValueError, match="disconnected: 2 parts of 36, 12 tets"):
        check_mesh(merge(parts))


def test_refuses(parts):
    with pytest.raises(ValueError, match=r"merge .*one part"):
        merge({})
    with pytest.raises(ValueError, match="the name 'a/b'"):
        merge({"a/b": parts["a"]})
    with pytest.raises(ValueError, match="the name ''"):
        merge({"": parts["a"]})


def test_refuses_mixed_orders():
    linear, quadratic = (beam(*BOX, (1, 1, 1), order=order) for order in (1, 2))
    with pytest.raises(ValueError, match=r"'l' 1, 'q' 2; .*to_quad"):
        merge({"l": linear, "q": quadratic})
