"""Standard errors of the fields that parameters set, propagated to every tet."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields._model_fields import find_field
from softcal_jax.fields._space import ParameterSpace
from softcal_jax.materials import is_point_values


def field_standard_errors(
    model: Any,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    covariance: Float[HostArray, "n_p n_p"],
) -> dict[str, Float[HostArray, " n_tets"]]:
    """Compute the standard error of each field that parameters set, in each tet.

    To first order, the square root of the diagonal of J Sigma J^T, where J = df/dz is
    the derivative of the field by the scaled parameters. What is given at quadrature
    points is averaged over the tet. Where a parameter without a standard error acts,
    nan in the covariance Sigma of z, the result is nan too. It is in the unit of the
    field, by its name in the space.
    """
    known = np.isfinite(np.diag(covariance))
    size, directions = np.linalg.eigh(covariance[np.ix_(known, known)])
    root = np.zeros((len(known), int(known.sum())))
    # Rounding may leave a variance slightly below zero.
    root[known] = directions * np.sqrt(np.maximum(size, 0.0))
    tangents = np.concatenate([root, np.eye(len(known))[:, ~known]], axis=1)
    counts = np.concatenate([np.ones(root.shape[1]), np.zeros(int((~known).sum()))])
    sums = _propagated(model, space, z, jnp.asarray(tangents.T), jnp.asarray(counts))
    return {
        name: np.where(np.asarray(lost) > 0.0, np.nan, np.sqrt(np.asarray(variance)))
        for name, (variance, lost) in zip(space.field_names, sums, strict=True)
    }


@eqx.filter_jit
def _propagated(
    model: Any,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    tangents: Float[Array, "n n_p"],
    counts: Float[Array, " n"],
) -> list[tuple[Float[Array, " n_tets"], Float[Array, " n_tets"]]]:
    """Sum the squared derivatives along tangents that count, and along the others."""

    def by_tet(value: Any) -> Float[Array, " n_tets"]:
        if is_point_values(value):
            return jnp.mean(value.values, axis=1)
        return jnp.broadcast_to(value, (model.mesh.n_tets,))

    def fields(z: Float[Array, " n_p"]) -> list[Float[Array, " n_tets"]]:
        changed = space.model_at(model, z)
        return [by_tet(find_field(model, f)(changed)) for f in space.field_names]

    values, push = jax.linearize(fields, z)

    def add(sums, tangent_and_count):
        tangent, count = tangent_and_count
        squares = [change**2 for change in push(tangent)]
        return [
            (own + count * square, other + (1.0 - count) * square)
            for (own, other), square in zip(sums, squares, strict=True)
        ], None

    none = [(jnp.zeros_like(value), jnp.zeros_like(value)) for value in values]
    return jax.lax.scan(add, none, (tangents, counts))[0]
