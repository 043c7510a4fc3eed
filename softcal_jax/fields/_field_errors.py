"""Standard errors of the fields that parameters set, propagated to every tet."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields._model_fields import find_field
from softcal_jax.fields._space import ParameterSpace


def field_standard_errors(
    model: Any,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    covariance: Float[HostArray, "n_p n_p"],
) -> dict[str, Float[HostArray, " n_tets"]]:
    """Compute the standard error of each field that parameters set, in each tet.

    To first order, the square root of the diagonal of J Sigma J^T, where J = df/dz is
    the derivative of the field by the scaled parameters. Where a parameter without a
    standard error acts, with nan in the covariance Sigma of z, the error is nan too.
    Errors are in the unit of their field, by its name in the space.
    """
    known = np.isfinite(np.diag(covariance))
    size, directions = np.linalg.eigh(covariance[np.ix_(known, known)])
    # Rounding may leave a variance slightly below zero.
    root = directions * np.sqrt(np.maximum(size, 0.0))
    errors = {}
    for name, J in zip(space.field_names, _slopes(model, space, z), strict=True):
        J = np.asarray(J)
        error = np.linalg.norm(J[:, known] @ root, axis=1)
        errors[name] = np.where(np.any(J[:, ~known] != 0.0, axis=1), np.nan, error)
    return errors


@eqx.filter_jit
def _slopes(
    model: Any, space: ParameterSpace, z: Float[Array, " n_p"]
) -> list[Float[Array, "n_tets n_p"]]:
    """Differentiate the fields, one value per tet, by the scaled parameters."""

    def fields(z: Float[Array, " n_p"]) -> list[Float[Array, " n_tets"]]:
        changed = space.model_at(model, z)
        values = [find_field(model, name)(changed) for name in space.field_names]
        return [jnp.broadcast_to(value, (model.mesh.n_tets,)) for value in values]

    return jax.jacfwd(fields)(z)
