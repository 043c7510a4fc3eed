"""Deformed bodies as VTK files for ParaView."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, TetStates, tet_states
from softcal_jax.fields import find_field
from softcal_jax.materials import Fibre, is_point_values
from softcal_jax.mesh import volumes

if TYPE_CHECKING:
    import pyvista

_SYMMETRIC = {"XX": (0, 0), "YY": (1, 1), "ZZ": (2, 2)}
_SYMMETRIC |= {"XY": (0, 1), "YZ": (1, 2), "XZ": (0, 2)}
"""Entries of a symmetric tensor in the order of VTK."""


def write_vtu(
    path: str | Path,
    model: Model,
    displacement: Float[ArrayLike, "n_nodes 3"],
    *,
    standard_errors: Mapping[str, Float[HostArray, " n_tets"]] | None = None,
) -> None:
    """Write a deformed body for ParaView; quadratic tets stay quadratic.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the deformed
    shape. Per tet: `cauchy_stress`, the mean over the tet, in the order XX, YY, ZZ, XY,
    YZ, XZ, of a law whose moments do not balance its symmetric part [Pa];
    `principal_stretches`, the largest first, mean over the quadrature points [-];
    `strain_energy_density` [J/m3], `density` [kg/m3] and every field of the law under
    its own name, in SI; `fibre_direction` at rest, and `fibre_direction_2` of a second
    family [-]; `E_standard_error` and so on of fields that were calibrated. Per point
    `rigid_body`, if there are any: the index of its rigid body plus 1, 0 for soft
    points.

    Args:
        path: The file, ending in .vtu.
        model: The model.
        displacement: Nodal displacement [m].
        standard_errors: Standard errors of fields in each tet, by the name of the
            field, see `field_standard_errors`.

    Raises:
        ValueError: If the name does not end in .vtu, or the shape is wrong.
    """
    import pyvista

    path = vtu_path(path)
    mesh = model.mesh
    u = np.asarray(displacement, float)
    if u.shape != mesh.points.shape:
        raise ValueError(
            f"displacement must have the shape {mesh.points.shape}, one row per node, "
            f"got {u.shape}."
        )
    states = tet_states(model, jnp.asarray(u))
    kinds = pyvista.CellType.TETRA, pyvista.CellType.QUADRATIC_TETRA
    grid = pyvista.UnstructuredGrid({kinds[mesh.order - 1]: mesh.tets}, mesh.points)
    grid.point_data["displacement"] = u
    bodies = model.mechanism.bodies
    if bodies.n_bodies:
        owner = np.zeros(mesh.n_nodes)
        owner[bodies.attached] = bodies.body + 1.0
        grid.point_data["rigid_body"] = owner
    stress = np.stack([_part(states.cauchy, *ij) for ij in _SYMMETRIC.values()], axis=1)
    _add(grid, "cauchy_stress", stress, tuple(_SYMMETRIC))
    _add(grid, "principal_stretches", _stretches(states), ("1", "2", "3"))
    grid.cell_data["strain_energy_density"] = states.energy / volumes(mesh)
    for name, values in _material(model, standard_errors or {}).items():
        grid.cell_data[name] = values
    for name, values in _fibres(model).items():
        grid.cell_data[name] = values
    save_vtu(path, grid)


def save_vtu(path: Path, grid: "pyvista.UnstructuredGrid") -> None:
    """Write a grid.

    Raises:
        OSError: If it could not be written.
    """
    grid.save(path)
    if not path.exists():  # VTK removes what it could not finish, and only prints it
        raise OSError(f"{path} could not be written: is the disk full?")


def vtu_path(path: str | Path) -> Path:
    """Check the ending of a file's name."""
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"the file name must end in .vtu, got {path.name!r}.")
    return path


def _add(
    grid: "pyvista.UnstructuredGrid",
    name: str,
    values: Float[HostArray, "n_tets k"],
    components: tuple[str, ...],
) -> None:
    """Add values per tet whose components have names."""
    grid.cell_data[name] = values
    array = grid.GetCellData().GetArray(name)
    for k, component in enumerate(components):
        array.SetComponentName(k, component)


def _part(
    stress: Float[HostArray, "n_tets 3 3"], i: int, j: int
) -> Float[HostArray, " n_tets"]:
    return 0.5 * (stress[:, i, j] + stress[:, j, i])


def _stretches(states: TetStates) -> Float[HostArray, "n_tets 3"]:
    """Compute the principal stretches, the singular values of F [-]."""
    return np.linalg.svd(states.F, compute_uv=False).mean(axis=1)


def _material(
    model: Model, errors: Mapping[str, Float[HostArray, " n_tets"]]
) -> dict[str, HostArray]:
    """Return density and fields of the law, one value or vector per tet.

    Those that have standard errors are followed by these.
    """
    leaves: list[tuple[str, ArrayLike]] = [("density", model.density)]
    law = jax.tree_util.tree_leaves_with_path(model.law, is_leaf=is_point_values)
    for path, leaf in law:
        if is_point_values(leaf):  # a cell of VTK holds one value
            leaf = jnp.mean(leaf.values, axis=1)
        leaves.append((jax.tree_util.keystr(path).strip("."), leaf))
    # Entries of a tuple, the local axes of a fibre, are no fields: see its direction.
    leaves = [(path, leaf) for path, leaf in leaves if "[" not in path]
    last = lambda path: path.rpartition(".")[2]
    names = Counter(last(path) for path, _ in leaves)
    found = {find_field(model, name).path: own for name, own in errors.items()}
    cells = {}
    for path, leaf in leaves:
        # A law with two elasticities has two E: use the whole path as the name then.
        name = last(path) if names[last(path)] == 1 else path
        values = np.asarray(leaf, float)
        if values.ndim == 0:
            values = np.full(model.n_tets, values)
        # VTK knows no tensors per tet.
        cells[name] = values if values.ndim == 1 else values.reshape(len(values), -1)
        error = found.get(path if path == "density" else f"law.{path}")
        if error is not None:
            cells[f"{name}_standard_error"] = error
    return cells


def _fibres(model: Model) -> dict[str, Float[HostArray, "n_tets 3"]]:
    """Return the directions of the fibres at rest, by family [-]."""
    names = (f"fibre_direction{f'_{k}' if k > 1 else ''}" for k in range(1, 100))
    fibres = model.law.fibres()
    return {n: _axes(f, model.n_tets) for n, f in zip(names, fibres, strict=False)}


def _axes(fibre: Fibre, n_tets: int) -> Float[HostArray, "n_tets 3"]:
    """Compute one direction per tet: the mean axis of those at quadrature points.

    As u and -u are one axis, it is the first principal axis of the mean of u u^T.
    """
    leaves, tree = jax.tree.flatten(fibre, is_leaf=is_point_values)
    own = [
        np.asarray(leaf.values if is_point_values(leaf) else jnp.reshape(leaf, (-1, 1)))
        for leaf in leaves
    ]
    n_qp = max(values.shape[1] for values in own)
    flat = [np.broadcast_to(values, (n_tets, n_qp)).ravel() for values in own]
    at_points = jax.tree.unflatten(tree, map(jnp.asarray, flat))
    u = np.asarray(jax.vmap(Fibre.direction)(at_points)).reshape(n_tets, n_qp, 3)
    if n_qp == 1:
        return u[:, 0]
    mean = np.linalg.eigh(np.einsum("eqi,eqj->eij", u, u))[1][:, :, -1]
    return mean * np.where(np.sum(mean * u[:, 0], axis=1) < 0.0, -1.0, 1.0)[:, None]
