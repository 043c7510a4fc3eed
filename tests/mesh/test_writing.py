"""Meshes that are written are read again as they were."""

import meshio
import numpy as np
import pytest

from softcal_jax.mesh import beam, read_mesh, to_quadratic, write_mesh


@pytest.mark.parametrize("order", [1, 2])
def test_what_is_read_again_is_the_same(tmp_path, order):
    """Points, tets and groups, through the parser of another project."""
    mesh = beam(0.04, 0.02, 0.01, (4, 2, 1), order=order)
    mesh = mesh.with_tet_group("left", np.flatnonzero(mesh.centroids[:, 0] < 0.02))
    mesh = mesh.with_node_group("corner", [0])
    write_mesh(mesh, tmp_path / "beam.msh", length_unit="mm")
    again = read_mesh(tmp_path / "beam.msh", length_unit="mm", order=order)
    rows = lambda cells: {tuple(row) for row in cells.tolist()}
    assert again.order == order
    np.testing.assert_allclose(again.points, mesh.points, rtol=0, atol=1e-16)
    assert rows(again.tets) == rows(mesh.tets)
    assert again.surface_groups.keys() == mesh.surface_groups.keys()
    for name, faces in mesh.surface_groups.items():
        assert rows(np.sort(again.faces(name))) == rows(np.sort(faces))
        np.testing.assert_array_equal(again.nodes(name), mesh.nodes(name))
    left = again.tets[again.tets_of("left")]
    assert rows(left) == rows(mesh.tets[mesh.tets_of("left")])
    assert again.nodes("corner").tolist() == [0]


def test_the_file_is_of_gmsh_2_in_the_unit(tmp_path):
    write_mesh(beam(0.066, 0.02, 0.01, (4, 2, 1)), tmp_path / "t.msh", length_unit="cm")
    text = (tmp_path / "t.msh").read_text()
    assert text.startswith("$MeshFormat\n2.2 0 8\n")
    raw = meshio.read(tmp_path / "t.msh")
    assert np.abs(raw.points).max() == pytest.approx(6.6)


def test_what_a_file_cannot_hold(tmp_path):
    mesh = beam(0.04, 0.02, 0.01, (4, 2, 1))
    every = mesh.with_tet_group("a", [0, 1]).with_tet_group("b", [1, 2])
    with pytest.raises(ValueError, match=r"1 tets .*several .*'a', 'b'"):
        write_mesh(every, tmp_path / "a.msh")
    with pytest.raises(ValueError, match=r"'\.vtk'.* \.msh"):
        write_mesh(mesh, tmp_path / "a.vtk")
    with pytest.raises(ValueError, match="length unit 'mn'"):
        write_mesh(mesh, tmp_path / "a.msh", length_unit="mn")
    twice = mesh.with_tet_group("x_min", [0])
    with pytest.raises(ValueError, match=r"different kinds .*'x_min'"):
        write_mesh(twice, tmp_path / "a.msh")
    assert not (tmp_path / "a.msh").exists()


def test_quadratic_mesh_is_written_with_straight_edges(tmp_path):
    mesh = to_quadratic(beam(0.04, 0.02, 0.01, (4, 2, 1)))
    write_mesh(mesh, tmp_path / "q.msh")
    assert read_mesh(tmp_path / "q.msh", length_unit="mm").order == 1
