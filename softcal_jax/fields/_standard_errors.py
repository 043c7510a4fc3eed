"""Standard errors: those that are asked for, and those of the fields of a model.

For a precision p, 0.1 by default, the asked standard error is

    moduli and other constants of a law, densities,
    factors, stiffnesses                             p times the value
    angles of axes                                   p rad, 5.7 degrees
    Poisson's ratios                                 p / 2
    friction                                         p, a tenth of a pull per radian
    all else of `KINDS`, an angle or a length        10 p times the default `Uncertain`

so that an error of the setup counts as known once its standard error is as small as
after careful work. Bounds do not enter: they are typed, not measured.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields._kinds import KINDS, Uncertain
from softcal_jax.fields._parameters import AbstractEntry, Parameter, find_field, kind_of
from softcal_jax.fields._setup import SetupParameter
from softcal_jax.fields._space import ParameterSpace
from softcal_jax.materials import ANGLE, UNREMARKABLE

PRECISION = 0.1
"""Standard error that is asked for by default, relative to the value [-]."""

WEAK_UP_TO = 3.0
"""Standard error, over the asked one, up to which a value is weakly identifiable [-].

With the default precision that is 30 % of a value, or 17 degrees of an axis: an order
of magnitude, which no part can be designed with.
"""

_LEAST = 1e-9
"""Smallest scaled standard error that is asked for: a value of zero would ask for 0."""


def asked_errors(
    space: ParameterSpace,
    z: Float[Array | HostArray, " n_p"],
    precision: float = PRECISION,
    *,
    model: Any = None,
) -> Float[HostArray, " n_p"]:
    """Return the standard errors of the scaled parameters that are asked for [-].

    They follow from the scaled values z and the precision p by the table above. The law
    of the model declares what its constants are; where none does, angles have a unit.

    Raises:
        ValueError: If the precision is not positive and finite, or the model lacks a
            field.
    """
    check_precision(precision)
    values = np.asarray(space.from_scaled(jax.device_put(z)))
    pairs = [(entry, q) for entry in space.entries for q in entry.parameters]
    asked = []
    for (entry, parameter), value in zip(pairs, values, strict=True):
        in_si = precision * _unit(entry, parameter, abs(float(value)), model)
        log = parameter.scale == "log"
        asked.append(in_si / (float(value) if log else float(parameter.unit_step)))
    return np.maximum(asked, _LEAST)


def check_precision(precision: float) -> None:
    """Raise ValueError unless a precision is positive and finite."""
    if not 0.0 < precision < np.inf:
        raise ValueError(f"precision must be positive, like 0.1, got {precision:g}.")


def _unit(entry: AbstractEntry, q: Parameter, size: float, model: Any) -> float:
    """Return the standard error asked for by a precision of 1, in SI units."""
    if isinstance(entry, SetupParameter):
        kind = KINDS[entry.kind]
        if kind.relative:
            return size
        usual = kind.uncertain
        return getattr(Uncertain(), usual) / PRECISION if usual else 1.0
    known = model is not None and q.field in entry.fields
    kind = kind_of(model, q.field) if known else UNREMARKABLE
    if kind == UNREMARKABLE and q.unit == "rad":
        kind = ANGLE
    return size if kind.asked is None else kind.asked


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
