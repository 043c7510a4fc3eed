"""Fields of the law in each tet, directions of its fibres, and what it bears."""

import dataclasses
import operator
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.equilibrium import Model, TetStates
from softcal_jax.fields import find_field
from softcal_jax.materials import Fibre, is_point_values

STANDARD_ERROR = "_standard_error"
"""What follows the name of a field in that of its standard error."""


def tet_fields(
    model: Model, standard_errors: Mapping[str, Float[HostArray, " n_tets"]]
) -> dict[str, HostArray]:
    """Return density and fields of the law, one value or vector per tet, in SI.

    Values at quadrature points are averaged. Fields that have standard errors in each
    tet, see `field_standard_errors`, are followed by these, as `E_standard_error`.
    """
    errors = {find_field(model, name).path: e for name, e in standard_errors.items()}
    cells = {}
    for name, path, leaf in _named(model):
        if is_point_values(leaf):  # a cell of VTK holds one value
            leaf = jnp.mean(leaf.values, axis=1)
        values = np.asarray(leaf, float)
        if values.ndim == 0:
            values = np.full(model.n_tets, values)
        # VTK knows no tensors per tet.
        cells[name] = values if values.ndim == 1 else values.reshape(len(values), -1)
        if path in errors:
            cells[name + STANDARD_ERROR] = errors[path]
    return cells


def field_units(model: Model) -> dict[str, str]:
    """Return the SI units of `tet_fields` by name, where the law declares one."""
    units = {"density": "kg/m3"}
    for name, path, _ in _named(model):
        owner, _, own = path.rpartition(".")
        module = operator.attrgetter(owner)(model) if owner else model
        metadata = {f.name: f.metadata for f in dataclasses.fields(module)}[own]
        if "unit" in metadata:
            units[name] = metadata["unit"]
    return units


def _named(model: Model) -> Iterator[tuple[str, str, Any]]:
    """Yield name, path in the model and values of the density and the law's fields."""
    law = jax.tree_util.tree_leaves_with_path(model.law, is_leaf=is_point_values)
    leaves: list[tuple[str, Any]] = [("density", model.density)]
    leaves += [("law" + jax.tree_util.keystr(path), leaf) for path, leaf in law]
    # Entries of a tuple, the local axes of a fibre, are no fields: see its direction.
    leaves = [(path, leaf) for path, leaf in leaves if "[" not in path]
    shorts = [path.rpartition(".")[2] for path, _ in leaves]
    for short, (path, leaf) in zip(shorts, leaves, strict=True):
        # A law with two elasticities has two E: use the whole path as the name then.
        alone = shorts.count(short) == 1
        yield short if alone else path.removeprefix("law."), path, leaf


def principal_stretches(states: TetStates) -> Float[HostArray, "n_tets 3"]:
    """Compute the principal stretches, the singular values of F, largest first [-]."""
    return np.linalg.svd(states.F, compute_uv=False).mean(axis=1)


def symmetric_part(stress: Float[HostArray, "n_tets 3 3"]) -> HostArray:
    """Return the symmetric part of a stress, of a law whose moments do not balance."""
    return 0.5 * (stress + np.swapaxes(stress, 1, 2))


def von_mises_stress(states: TetStates) -> Float[HostArray, " n_tets"]:
    """Compute the von Mises stress of the mean Cauchy stress of each tet [Pa].

    It is sqrt(3/2 s : s) with the deviatoric part s, so without the pressure, which
    tets of a nearly incompressible law bear unevenly.
    """
    cauchy = symmetric_part(states.cauchy)
    s = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0
    return np.sqrt(1.5 * np.sum(s * s, axis=(1, 2)))


def fibre_directions(model: Model) -> dict[str, Float[HostArray, "n_tets 3"]]:
    """Return the directions of the fibres at rest, by family [-]."""
    return {
        f"fibre_direction{f'_{k}' if k > 1 else ''}": _axes(fibre, model.n_tets)
        for k, fibre in enumerate(model.law.fibres(), start=1)
    }


def _axes(fibre: Fibre, n_tets: int) -> Float[HostArray, "n_tets 3"]:
    """Compute one direction per tet: the mean axis of those at quadrature points.

    As u and -u are one axis, it is the first principal axis of the mean of u u^T.
    """
    leaves, tree = jax.tree.flatten(fibre, is_leaf=is_point_values)
    tables = [
        np.asarray(leaf.values if is_point_values(leaf) else jnp.reshape(leaf, (-1, 1)))
        for leaf in leaves
    ]
    n_qp = max(values.shape[1] for values in tables)
    flat = [np.broadcast_to(values, (n_tets, n_qp)).ravel() for values in tables]
    at_points = jax.tree.unflatten(tree, map(jnp.asarray, flat))
    u = np.asarray(jax.vmap(Fibre.direction)(at_points)).reshape(n_tets, n_qp, 3)
    if n_qp == 1:
        return u[:, 0]
    mean = np.linalg.eigh(np.einsum("eqi,eqj->eij", u, u))[1][:, :, -1]
    return mean * np.where(np.sum(mean * u[:, 0], axis=1) < 0.0, -1.0, 1.0)[:, None]
