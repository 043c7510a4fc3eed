"""Rows of the parameters at a fixed state, from which Eq. (9) is built.

Sign: Eqs. (1) and (7) of the paper give K dx = ... - (df/dp) S lambda_p, Eq. (8) writes
+ H_p^T lambda_p. Hence H_p^T = -(dR/dp) S, with R = f - f_ext; it is defined here, in
`parameter_forces`, and nowhere else.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    InputRows,
    Linearisation,
    Model,
    add_weighted,
    effector_values,
    field_forces,
    gravity_load,
    input_rows,
    residual,
    solved_forces,
)
from softcal_jax.fields import ParameterSpace, find_field
from softcal_jax.materials import is_point_values

Derivative = Literal["autodiff", "finite-difference"]

FINITE_DIFFERENCE_STEP = 6e-6
"""Optimal step of a central difference: cube root of the float64 rounding unit."""


def parameter_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    derivative: Derivative = "autodiff",
    step: float | Float[Array, ""] = FINITE_DIFFERENCE_STEP,
) -> Float[Array, "n_p n_points 3"]:
    """Compute H_p^T by rows: the force on the nodes per unit step of each parameter.

    H_p^T = -(d R / d p) S at fixed displacement, by autodiff or by the paper's finite
    differences of the internal force (Sec. III; central here, hence of second order).
    Parameters that only move held nodes or bodies, such as the zero of a motor, exert
    no force on a fixed state.

    Args:
        model: The model.
        configuration: One configuration.
        u: Displacement [m].
        space: The parameters.
        z: Their scaled values [-].
        derivative: "autodiff" or "finite-difference".
        step: Step of the finite difference, in scaled units [-].

    Returns:
        Forces per unit of lambda_p [N].
    """
    lambda_a = solved_forces(*space.apply(model, configuration, z), u)
    force = lambda model, configuration: -residual(model, configuration, u, lambda_a)
    if derivative == "finite-difference":
        at = lambda z: force(*space.apply(model, configuration, z))
        return jax.lax.map(
            lambda d: (at(z + step * d) - at(z - step * d)) / (2.0 * step),
            jnp.eye(z.shape[0]),
        )
    forces = field_rows(*space.apply(model, configuration, z), u, space, z)
    others = _others(space)
    if others.size == 0:
        return forces
    along = _along(model, configuration, space, z)
    return forces.at[others].set(jax.vmap(lambda d: along(d, force))(_unit(others)))


def parameter_rows(
    linearisation: Linearisation,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    derivative: Derivative = "autodiff",
) -> InputRows:
    """Compute the rows of all parameters at an equilibrium, per unit of lambda_p.

    Whatever the kind of parameter, they follow from `space.apply`. Parameters that set
    fields of the law need one pass over the tets per field and move nothing held.

    Args:
        linearisation: The equilibrium, with the parameters applied.
        space: The parameters.
        z: Their scaled values [-].
        derivative: How the forces of fields are computed, see `parameter_forces`.

    Returns:
        Rows for `sensitivity`, with the effectors as readings.
    """
    lin = linearisation
    model, configuration, u = lin.model, lin.configuration, lin.u
    if derivative == "autodiff":
        forces = field_rows(model, configuration, u, space, z)
    else:
        forces = parameter_forces(
            model, configuration, u, space, z, derivative=derivative
        )
    n_p, n_m = z.shape[0], lin.system.active.size
    rows = InputRows(
        force=jax.vmap(lin.free)(forces),
        held=jnp.zeros_like(forces),
        gap=jnp.zeros((n_p, n_m)),
        reading=_readings_of_fields(lin, forces),
    )
    others = _others(space)
    if others.size == 0:
        return rows
    along = _along(model, configuration, space, z)
    found = jax.vmap(
        lambda d: input_rows(
            model,
            configuration,
            u,
            lin.lambda_a,
            lambda function: along(d, function),
            effector_values,
        )
    )(_unit(others))
    return jax.tree.map(lambda all_, own: all_.at[others].set(own), rows, found)


def _others(space: ParameterSpace) -> Int[HostArray, " n_other"]:
    """Return the indices of the parameters that set more than fields of the law."""
    return np.flatnonzero(~np.asarray(space.sets_fields))


def _unit(columns: Int[HostArray, " n"]) -> Float[Array, "n n"]:
    return jnp.eye(columns.size)


def _along(
    model: Model,
    configuration: ConfigurationArrays,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
):
    """Return a differentiator of functions of (model, configuration).

    Only parameters that set no fields vary, so autodiff does not pass through fields.
    """
    others = _others(space)

    def derivative(direction: Float[Array, " n_other"], function: Callable):
        at = lambda w: function(*space.apply(model, configuration, z, others, w))
        return jax.jvp(at, (z[others],), (direction,))[1]

    return derivative


def _readings_of_fields(
    lin: Linearisation, forces: Float[Array, "n_p n_points 3"]
) -> Float[Array, "n_p n_e"]:
    """Compute the direct change of readings by fields; only force readings change."""
    effectors = lin.configuration.effectors
    if not effectors.has_forces:
        return jnp.zeros((forces.shape[0], effectors.measured.size))
    state = (lin.model, lin.configuration, lin.u, lin.lambda_a)
    read = lambda unbalanced: effector_values(*state, unbalanced).ravel()
    unbalanced = residual(*state)
    return jax.vmap(lambda f: jax.jvp(read, (unbalanced,), (-f,))[1])(forces)


def field_rows(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Float[Array, "n_p n_points 3"]:
    """Compute the forces of parameters that set fields of the law, or the density [N].

    Autodiff in two factors: force by the field in each tet, and field by z, so that all
    control points of one field share one pass over the tets. Rows of other parameters
    are zero.

    Args:
        model: The model with the parameters of `z` applied.
        configuration: One configuration, likewise.
        u: Displacement [m].
        space: The parameters.
        z: Their scaled values [-].
    """
    wheres = {name: find_field(model, name) for name in space.field_names}
    fields = lambda z: {
        name: _one_per_tet(model, where(space.model_at(model, z)))
        for name, where in wheres.items()
    }
    directions = jnp.eye(z.shape[0])
    slopes = jax.vmap(lambda d: jax.jvp(fields, (z,), (d,))[1])(directions)
    total = jnp.zeros((z.shape[0], *u.shape))
    if "density" in wheres:
        # The load is linear in the density once the bodies' extra mass is set to zero.
        bare = eqx.tree_at(
            lambda m: m.mechanism.bodies.mass, model, replace_fn=jnp.zeros_like
        )
        weight = lambda slope: gravity_load(
            eqx.tree_at(wheres["density"], bare, slope[:, 0]),
            configuration.acceleration,
        )
        total = total + jax.vmap(weight)(slopes["density"])
    in_law = {
        name: _InLaw(where) for name, where in wheres.items() if name != "density"
    }
    if in_law:
        forces = field_forces(model, u, in_law)
        total = total - add_weighted(model, forces, slopes)
    return total


def adjoint_of_tets(
    linearisation: Linearisation,
    fields: tuple[str, ...],
    adjoint: Float[Array, "n_e n_dof"],
) -> Float[Array, "n_fields n_e n_tets"]:
    """Compute the derivatives of readings by the values of fields in each tet.

    Args:
        linearisation: The equilibrium.
        fields: Names of fields of the law, or "density".
        adjoint: Rows K^-T H_e^T of the readings, see `adjoint_rows`.

    Returns:
        Change of each reading per SI unit of each field in each tet.
    """
    model, configuration = linearisation.model, linearisation.configuration
    u = linearisation.u
    moved = linearisation.scatter(adjoint)
    law = {f: _InLaw(find_field(model, f)) for f in fields if f != "density"}
    forces = field_forces(model, u, law) if law else {}

    def of_law(field: str, row: Float[Array, "n_points 3"]) -> Float[Array, " n_tets"]:
        at = jnp.moveaxis(row[model.nodes], -1, 2)
        work = jnp.sum(forces[field] * at[:, None], axis=(1, 2, 3))
        return -work.ravel()[: model.n_tets]

    def of_density(row: Float[Array, "n_points 3"]) -> Float[Array, " n_tets"]:
        fall = jnp.sum(row * configuration.acceleration[None], axis=1)
        return jnp.sum(model.node_volumes * fall[model.mesh.tets], axis=1)

    one = lambda row: jnp.stack(
        [of_density(row) if f == "density" else of_law(f, row) for f in fields]
    )
    return jnp.swapaxes(jax.lax.map(one, moved), 0, 1)


@dataclass(frozen=True)
class _InLaw:
    """A model's field accessor applied to its law; equal if the accessors are."""

    where: Callable[[Any], Any]

    def __call__(self, law: Any) -> Any:
        return self.where(_Holder(law))


class _Holder(NamedTuple):
    """A stand-in for a model that only holds the law."""

    law: Any


def _one_per_tet(model: Model, value: Any) -> Float[Array, "n_tets m"]:
    """Expand a field to tets and quadrature points; m is 1 for one value per tet."""
    if is_point_values(value):
        return value.values
    return jnp.broadcast_to(value, (model.n_tets,))[:, None]
