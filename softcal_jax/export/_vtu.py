"""Deformed bodies as VTK files for ParaView."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, tet_states
from softcal_jax.export._tet_fields import (
    fibre_directions,
    principal_stretches,
    symmetric_part,
    tet_fields,
)
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
    cauchy = symmetric_part(states.cauchy)
    stress = np.stack([cauchy[:, i, j] for i, j in _SYMMETRIC.values()], axis=1)
    _add(grid, "cauchy_stress", stress, tuple(_SYMMETRIC))
    _add(grid, "principal_stretches", principal_stretches(states), ("1", "2", "3"))
    grid.cell_data["strain_energy_density"] = states.energy / volumes(mesh)
    for name, values in tet_fields(model, standard_errors or {}).items():
        grid.cell_data[name] = values
    for name, values in fibre_directions(model).items():
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
