"""Deformed bodies as VTK files for ParaView."""

from collections import Counter
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import meshio
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, strain_energy
from softcal_jax.materials import is_point_values
from softcal_jax.mesh import volumes

_strain_energy = eqx.filter_jit(strain_energy)


def write_vtu(
    path: str | Path,
    model: Model,
    displacement: Float[ArrayLike, "n_nodes 3"],
) -> None:
    """Write a deformed body for ParaView; quadratic tets stay quadratic.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the deformed
    shape. Per tet: `strain_energy_density` [J/m3], `density` [kg/m3] and every field of
    the law under its own name, in SI. Per point `rigid_body`, if there are any: the
    index of its rigid body plus 1, 0 for soft points.

    Args:
        path: The file, ending in .vtu.
        model: The model.
        displacement: Nodal displacement [m].

    Raises:
        ValueError: If the name does not end in .vtu, or the shape is wrong.
    """
    path = vtu_path(path)
    mesh = model.mesh
    u = np.asarray(displacement, float)
    if u.shape != mesh.points.shape:
        raise ValueError(
            f"displacement must have the shape {mesh.points.shape}, one row per node, "
            f"got {u.shape}."
        )
    energy = np.asarray(_strain_energy(model, jnp.asarray(u))).ravel()[: mesh.n_tets]
    cells = {"strain_energy_density": energy / volumes(mesh), **_material(model)}
    bodies = model.mechanism.bodies
    of_bodies = {}
    if bodies.n_bodies:
        owner = np.zeros(mesh.n_nodes)
        owner[bodies.attached] = bodies.body + 1.0
        of_bodies["rigid_body"] = owner
    kind = "tetra" if mesh.order == 1 else "tetra10"
    meshio.Mesh(
        mesh.points,
        [(kind, mesh.tets)],
        point_data={"displacement": u, **of_bodies},
        cell_data={name: [values] for name, values in cells.items()},
    ).write(path)


def vtu_path(path: str | Path) -> Path:
    """Check the ending of a file's name."""
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"the file name must end in .vtu, got {path.name!r}.")
    return path


def _material(model: Model) -> dict[str, HostArray]:
    """Return density and fields of the law, one value or vector per tet."""
    leaves: list[tuple[str, ArrayLike]] = [("density", model.density)]
    law = jax.tree_util.tree_leaves_with_path(model.law, is_leaf=is_point_values)
    for path, leaf in law:
        if is_point_values(leaf):  # a cell of VTK holds one value
            leaf = jnp.mean(leaf.values, axis=1)
        leaves.append((jax.tree_util.keystr(path).strip("."), leaf))
    last = lambda path: path.rpartition(".")[2]
    names = Counter(last(path) for path, _ in leaves)
    cells = {}
    for path, leaf in leaves:
        # A law with two elasticities has two E: use the whole path as the name then.
        name = last(path) if names[last(path)] == 1 else path
        values = np.asarray(leaf, float)
        if values.ndim == 0:
            values = np.full(model.n_tets, values)
        # VTK knows no tensors per tet.
        cells[name] = values if values.ndim == 1 else values.reshape(len(values), -1)
    return cells
