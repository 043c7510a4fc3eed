from dataclasses import replace

import jax
import jax.numpy as jnp
import meshio
import numpy as np
import pytest
import pyvista
from export.handmade import sag, small_model, two_elasticities
from obstacle_results import beside_obstacles, pressed

from softcal_jax.equilibrium import build_model, energy_and_force
from softcal_jax.materials import (
    Corotational,
    Fibre,
    FibreReinforced,
    NeoHookean,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import beam, volumes
from softcal_jax.results import (
    read_displacement,
    write_pvd,
    write_robot_vtu,
    write_vtu,
)


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


def cells_of(path):
    """Arrays of the tets, as VTK reads them."""
    return pyvista.read(path).cell_data


ANGLE = 0.7
TURN = np.array(
    [[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1.0]]
)
ORDER = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""XX, YY, ZZ, XY, YZ, XZ of VTK."""


def test_stress_and_stretches_in_simple_shear(model, tmp_path):
    """sigma = mu (b - I) for J = 1 (Bonet and Wood, Eq. 6.29), b = F F^T.

    The stretches of a shear g are a, 1 and 1 / a with a - 1 / a = g.
    """
    g = 0.4
    F = np.array([[1.0, g, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    write_vtu(tmp_path / "a.vtu", model, model.mesh.points @ (F - np.eye(3)).T)
    cells = cells_of(tmp_path / "a.vtu")
    mu = np.asarray(model.law.E) / (2 * 1.4)
    expected = np.array([g * g, 0.0, 0.0, g, 0.0, 0.0])
    np.testing.assert_allclose(
        cells["cauchy_stress"], mu[:, None] * expected, rtol=1e-10, atol=1e-6
    )
    a = 0.5 * g + np.sqrt(1.0 + 0.25 * g * g)
    np.testing.assert_allclose(
        cells["principal_stretches"], np.tile([a, 1.0, 1.0 / a], (model.n_tets, 1))
    )


def test_stress_of_a_turned_stretch_with_change_of_volume(model, tmp_path):
    """sigma = (mu (b - I) + lambda ln J I) / J, in the axes of the deformed body."""
    stretch = np.diag([1.3, 0.9, 1.05])
    F = TURN @ stretch
    write_vtu(tmp_path / "a.vtu", model, model.mesh.points @ (F - np.eye(3)).T)
    grid = pyvista.read(tmp_path / "a.vtu")
    E, nu = np.asarray(model.law.E), 0.4
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    J = np.linalg.det(F)
    b = F @ F.T
    sigma = np.einsum("e,ij->eij", mu / J, b - np.eye(3))
    sigma += np.einsum("e,ij->eij", lam * np.log(J) / J, np.eye(3))
    expected = np.stack([sigma[:, i, j] for i, j in ORDER], axis=1)
    np.testing.assert_allclose(
        grid.cell_data["cauchy_stress"], expected, rtol=1e-9, atol=1e-6
    )
    np.testing.assert_allclose(
        grid.cell_data["principal_stretches"],
        np.tile([1.3, 1.05, 0.9], (model.n_tets, 1)),
    )
    array = grid.GetCellData().GetArray("cauchy_stress")
    names = [array.GetComponentName(k) for k in range(6)]
    assert names == ["XX", "YY", "ZZ", "XY", "YZ", "XZ"]


def test_mean_stress_of_bent_tets_is_that_of_their_nodal_forces(tmp_path):
    """Sum over nodes of x f^T = integral of sigma over the body, without loads inside.

    The forces are the gradient of the energy, by autodiff; in the mixed formulation
    the stress has a part that the law alone has not.
    """
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    model = build_model(
        mesh, NeoHookean(2e5, 0.4), density=1e3, formulation="mean-dilatation"
    )
    u = sag(mesh)
    write_vtu(tmp_path / "a.vtu", model, u)
    grid = pyvista.read(tmp_path / "a.vtu").warp_by_vector("displacement")
    energy = lambda u: energy_and_force(model, u)[0]
    force = np.asarray(jax.jit(jax.grad(energy))(jnp.asarray(u)))
    virial = (mesh.points + u).T @ force
    # VTK integrates the deformed quadratic tets coarsely; sum over their sub-tets.
    J = np.asarray([np.linalg.det(F) for F in bent_gradients(mesh, u)])
    deformed = J * volumes(mesh)
    total = np.einsum("e,ek->k", deformed, grid.cell_data["cauchy_stress"])
    expected = [virial[i, j] for i, j in ORDER]
    size = np.abs(expected).max()
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-9 * size)


def bent_gradients(mesh, u):
    """A matrix per tet whose determinant is its volume over that at rest."""
    from softcal_jax.elements import shape_gradients, tet_rule

    # Degree 4 is exact for the cubic determinant.
    rule = tet_rule(4)
    dN = shape_gradients(rule.barycentric, 10)
    x, X = (mesh.points + u)[mesh.tets], mesh.points[mesh.tets]
    now, rest = (np.linalg.det(np.einsum("eai,qaj->eqij", y, dN)) for y in (x, X))
    ratio = (now @ rule.weights) / (rest @ rule.weights)
    return ratio[:, None, None] ** (1.0 / 3.0) * np.eye(3)


def test_fibre_directions_of_each_tet(tmp_path):
    """u = cos(theta) x + sin(theta) z; a second family at -theta."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    theta = np.linspace(-1.0, 1.0, mesh.n_tets)
    law = Corotational(ReducedTransverseIsotropic(5e5, 2e5, 0.3, Fibre(theta)))
    along = lambda t: np.stack([np.cos(t), 0.0 * t, np.sin(t)], axis=1)
    model = build_model(mesh, law, density=1e3)
    write_vtu(tmp_path / "a.vtu", model, sag(mesh))
    cells = cells_of(tmp_path / "a.vtu")
    np.testing.assert_allclose(cells["fibre_direction"], along(theta), atol=1e-12)
    np.testing.assert_array_equal(cells["theta"], theta)

    wound = FibreReinforced(NeoHookean(2e5, 0.4), 1e6, Fibre(theta), families=2)
    write_vtu(tmp_path / "b.vtu", build_model(mesh, wound, density=1e3), sag(mesh))
    cells = cells_of(tmp_path / "b.vtu")
    np.testing.assert_allclose(cells["fibre_direction_2"], along(-theta), atol=1e-12)


def test_standard_errors_stand_beside_their_fields(tmp_path):
    model = small_model()
    errors = {"E": np.linspace(1e3, 2e3, model.n_tets), "density": np.full(30, np.nan)}
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh), standard_errors=errors)
    cells = cells_of(tmp_path / "a.vtu")
    np.testing.assert_array_equal(cells["E_standard_error"], errors["E"])
    assert np.isnan(cells["density_standard_error"]).all()
    assert "nu_standard_error" not in cells


def test_collection_of_configurations(tmp_path):
    """VTK's reader finds a time for each configuration, with all of its files."""
    model = small_model()
    for k, name in enumerate(("a & b", "c", "c_robot")):
        write_vtu(tmp_path / f"{name}.vtu", model, (k + 1) * sag(model.mesh))
    write_pvd(tmp_path / "all.pvd", [["a & b.vtu"], ["c.vtu", "c_robot.vtu"]])
    reader = pyvista.PVDReader(tmp_path / "all.pvd")
    listed = [(dataset.time, dataset.part) for dataset in reader.datasets]
    assert listed == [(0.0, 0), (1.0, 0), (1.0, 1)]
    reader.set_active_time_value(1.0)
    blocks = reader.read()
    assert len(blocks) == 2
    np.testing.assert_array_equal(blocks[1]["displacement"], 3 * sag(model.mesh))


def test_fields_of_one_name_keep_their_path(tmp_path):
    model = two_elasticities()
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh))
    read = meshio.read(tmp_path / "a.vtu").cell_data
    assert set(read) == {
        "cauchy_stress",
        "principal_stretches",
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
    with pytest.raises(ValueError, match=r"shape \(24, 3\), .*got \(5, 3\)"):
        write_vtu(tmp_path / "a.vtu", model, jnp.zeros((5, 3)))
    assert list(tmp_path.iterdir()) == []


def test_a_state_is_read_back(model, tmp_path):
    """To the last bit, to begin a solve there."""
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh))
    np.testing.assert_array_equal(
        read_displacement(tmp_path / "a.vtu", model), sag(model.mesh)
    )


def test_rigid_bodies_are_read_back(tmp_path):
    model = beside_obstacles()
    fit = pressed(model)
    write_vtu(tmp_path / "a.vtu", model, fit.displacement)
    write_robot_vtu(tmp_path / "a_robot.vtu", model, fit.robot)
    read = read_displacement(tmp_path / "a.vtu", model)
    np.testing.assert_allclose(read, fit.robot.displacement, atol=1e-15)


def test_the_state_of_another_mesh_is_refused(model, tmp_path):
    """Also of one with as many nodes."""
    write_vtu(tmp_path / "a.vtu", model, sag(model.mesh))
    longer = model.mesh.points * [1.1, 1.0, 1.0]
    mesh = replace(model.mesh, points=longer)
    other = build_model(mesh, NeoHookean(2e5, 0.4), density=1000.0)
    with pytest.raises(ValueError, match=r"a\.vtu is of another mesh"):
        read_displacement(tmp_path / "a.vtu", other)


def test_a_damaged_state_is_named(model, tmp_path):
    (tmp_path / "a.vtu").write_text("no xml")
    with pytest.raises(ValueError, match=r"a\.vtu cannot be read"):
        read_displacement(tmp_path / "a.vtu", model)
