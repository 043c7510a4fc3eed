import jax.numpy as jnp
import meshio
import numpy as np
import pytest
import pyvista
from export.handmade import sag, small_model, two_elasticities

from softcal_jax.export import write_vtu
from softcal_jax.mesh import volumes


@pytest.fixture(scope="module", params=[1, 2])
def model(request):
    return small_model(request.param)


def test_read_back_by_meshio(model, tmp_path):
    """Points, cells and values are what was written, to the last bit."""
    u = sag(model.mesh)
    write_vtu(tmp_path / "a.vtu", model, u)
    read = meshio.read(tmp_path / "a.vtu")
    assert [block.type for block in read.cells] == [
        "tetra" if model.mesh.order == 1 else "tetra10"
    ]
    np.testing.assert_array_equal(read.cells[0].data, model.mesh.tets)
    np.testing.assert_array_equal(read.points, model.mesh.points)
    np.testing.assert_array_equal(read.point_data["displacement"], u)
    np.testing.assert_array_equal(read.cell_data["E"][0], model.law.E)
    np.testing.assert_array_equal(read.cell_data["nu"][0], np.full(model.n_tets, 0.4))
    np.testing.assert_array_equal(
        read.cell_data["density"][0], np.full(model.n_tets, 1000.0)
    )


def test_vtk_sees_the_same_body(model, tmp_path):
    """VTK's own volumes: a wrong node order would change or invert them."""
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh))
    grid = pyvista.read(tmp_path / "a.vtu")
    kind = pyvista.CellType.TETRA
    if model.mesh.order == 2:
        kind = pyvista.CellType.QUADRATIC_TETRA
    assert set(grid.celltypes) == {kind}
    sizes = grid.compute_cell_sizes(length=False, area=False)["Volume"]
    np.testing.assert_allclose(sizes, volumes(model.mesh), rtol=1e-9)
    np.testing.assert_array_equal(grid["displacement"], sag(model.mesh))


def test_energy_density_of_a_uniform_stretch(model, tmp_path):
    """Every tet has psi(F), for its own modulus."""
    F = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 1.05]])
    write_vtu(tmp_path / "a.vtu", model, model.mesh.points @ (F - np.eye(3)).T)
    density = meshio.read(tmp_path / "a.vtu").cell_data["strain_energy_density"][0]
    E, nu = np.asarray(model.law.E), 0.4
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    log_J = np.log(np.linalg.det(F))
    psi = mu * (0.5 * (np.sum(F * F) - 3) - log_J) + 0.5 * lam * log_J**2
    np.testing.assert_allclose(density, psi, rtol=1e-10)


def test_fields_of_one_name_keep_their_path(tmp_path):
    model = two_elasticities()
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh))
    read = meshio.read(tmp_path / "a.vtu").cell_data
    assert set(read) == {
        "strain_energy_density",
        "density",
        "first.E",
        "first.nu",
        "second.E",
        "second.nu",
    }
    np.testing.assert_array_equal(read["second.E"][0], np.full(model.n_tets, 2e5))


@pytest.mark.usefixtures("unchecked")
def test_wrong_calls(tmp_path):
    model = small_model()
    u = sag(model.mesh)
    with pytest.raises(ValueError, match=r"must end in \.vtu, got 'a\.vtk'"):
        write_vtu(tmp_path / "a.vtk", model, u)
    with pytest.raises(ValueError, match=r"shape \(24, 3\), one row per node, got"):
        write_vtu(tmp_path / "a.vtu", model, jnp.zeros((5, 3)))
    assert list(tmp_path.iterdir()) == []
