"""Sensitivities of the effectors to the parameters, W_ep = H_e K^-1 H_p^T (Eq. 9).

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

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays, EffectorArrays
from softcal_jax.equilibrium import (
    Model,
    add_weighted,
    effector_forces,
    effector_positions,
    factor_solve,
    field_forces,
    gravity_load,
    residual,
    solved_forces,
)
from softcal_jax.fields import ParameterSpace, SetupParameter, find_field
from softcal_jax.materials import is_point_values
from softcal_jax.sensitivity._setup import (
    setup_columns,
    setup_compliance,
    setup_displacements,
    setup_readings,
)

Derivative = Literal["autodiff", "finite-difference"]

FINITE_DIFFERENCE_STEP = 6e-6
"""Cube root of the float64 rounding unit: the best step of a central difference."""


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
    """H_p^T by rows: the force that a unit step of each parameter puts on the nodes.

    Parameters of the setup move what is held, see `setup_displacements`: no force here.

    H_p^T = -(d R / d p) S at fixed displacement; autodiff, or the paper's finite
    differences of the internal force (Sec. III; central here, so that the error is of
    second order).

    Args:
        model: The body.
        configuration: One configuration.
        u: Displacement [m].
        space: The parameters.
        z: Their scaled values [-].
        derivative: "autodiff" or "finite-difference".
        step: Step of the finite difference, in scaled units [-].

    Returns:
        Forces per unit of lambda_p [N].
    """
    directions = jnp.eye(z.shape[0])
    if derivative == "autodiff":
        return _by_fields(model, configuration, u, space, z, directions)

    lambda_a = solved_forces(model, configuration, u)

    def force(z):
        return -residual(space.apply(model, z), configuration, u, lambda_a)

    difference = lambda d: (force(z + step * d) - force(z - step * d)) / (2.0 * step)
    return jax.lax.map(difference, directions)


def _by_fields(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    directions: Float[Array, "n_p n_p"],
) -> Float[Array, "n_p n_points 3"]:
    """Autodiff in two factors: by the field in each tet, and of the field by z.

    A dozen control points of one field then cost one pass over the tets.
    """
    of_material = [e for e in space.entries if not isinstance(e, SetupParameter)]
    names = list(dict.fromkeys(entry.field for entry in of_material))
    wheres = {name: find_field(model, name) for name in names}
    fields = lambda z: {
        name: _one_per_tet(model, where(space.apply(model, z)))
        for name, where in wheres.items()
    }
    slopes = jax.vmap(lambda d: jax.jvp(fields, (z,), (d,))[1])(directions)
    applied = space.apply(model, z)
    total = jnp.zeros((z.shape[0], *u.shape))
    if "density" in wheres:
        # Linear in the density alone: what rigid bodies weigh beside is no part of it.
        bare = eqx.tree_at(
            lambda m: m.mechanism.bodies.mass, applied, replace_fn=jnp.zeros_like
        )
        weight = lambda slope: gravity_load(
            eqx.tree_at(wheres["density"], bare, slope[:, 0]),
            jnp.asarray(configuration.gravity),
        )
        total = total + jax.vmap(weight)(slopes["density"])
    in_law = {
        name: _InLaw(where) for name, where in wheres.items() if name != "density"
    }
    if in_law:
        forces = field_forces(applied, u, in_law)
        total = total - add_weighted(applied, forces, slopes)
    return total


@dataclass(frozen=True)
class _InLaw:
    """An accessor of a model's field, for its law; equal if the accessors are."""

    where: Callable[[Any], Any]

    def __call__(self, law: Any) -> Any:
        return self.where(_Holder(law))


class _Holder(NamedTuple):
    """A law in the place where a model has it."""

    law: Any


def _one_per_tet(model: Model, value: Any) -> Float[Array, "n_tets m"]:
    """A field by tets and quadrature points; m is 1 for one value per tet."""
    if is_point_values(value):
        return value.values
    return jnp.broadcast_to(value, (model.n_tets,))[:, None]


def effector_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    displacement: Float[Array, "n_p n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Float[Array, "n_e n_p"]:
    """W_ep = H_e dx/dz, effector coordinates in the order effector, axis [m].

    Forces depend on the parameters beside the positions: with
    e = e(x, z), W_ep = H_e dx/dz + de/dz.

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration with its effectors.
        u: Equilibrium displacement [m].
        displacement: dx/dz by rows [m].
        space: The parameters.
        z: Their scaled values [-].
    """
    effectors = configuration.effectors
    if effectors.only_points:  # linear
        weights = jnp.asarray(effectors.weights)[None, :, :, None]
        moved = jnp.sum(weights * displacement[:, effectors.nodes], axis=2)
        return moved.reshape(displacement.shape[0], -1).T
    where = lambda u: effector_positions(model, effectors, u)
    moved = jax.vmap(lambda du: jax.jvp(where, (u,), (du,))[1])(displacement)
    if setup := setup_columns(space):
        read = setup_readings(model, effectors, u, space, z)
        moved = moved.at[jnp.asarray(setup)].add(read)
    if effectors.has_forces:
        forces = lambda z, u: effector_forces(space.apply(model, z), configuration, u)
        unit = jnp.eye(z.shape[0])
        changed = jax.vmap(lambda dz, du: jax.jvp(forces, (z, u), (dz, du))[1])
        moved = jnp.concatenate([moved, changed(unit, displacement)], axis=1)
    return moved.reshape(displacement.shape[0], -1).T


def effector_rows(
    model: Model, effectors: EffectorArrays, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_e n_points 3"]:
    """H_e by rows: how each effector coordinate follows the nodes [-].

    Args:
        model: The body.
        effectors: Effectors that follow from positions: no forces.
        u: Displacement [m].
    """
    n_e = effectors.measured.size
    where = lambda u: effector_positions(model, effectors, u)
    _, pull_back = jax.vjp(where, u)
    unit = jnp.eye(n_e).reshape(n_e, *effectors.measured.shape)
    return jax.vmap(pull_back)(unit)[0]


class Compliance(NamedTuple):
    """W_ep of one configuration, and what it was made of.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p [m].
        displacement: dx/dz by rows, for warm starts [m]; None from the adjoint side.
        ok: False if the tangent could not be factorized; W_ep is then zero.
    """

    W_ep: Float[Array, "n_e n_p"]
    displacement: Float[Array, "n_p n_points 3"] | None
    ok: Bool[Array, ""]


def parameter_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    method: Literal["auto", "direct", "adjoint"] = "auto",
    derivative: Derivative = "autodiff",
) -> Compliance:
    """W_ep = H_e K^-1 H_p^T at an equilibrium, by one factorization; paper Eq. (9).

    The adjoint rows are K^-T H_e^T, where K^T is not K without a potential.

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration with its effectors.
        u: Equilibrium displacement [m].
        space: The parameters.
        z: Their scaled values [-].
        method: "direct" solves for the n_p columns of H_p^T, "adjoint" for the n_e rows
            of H_e; "auto" takes the fewer right-hand sides.
        derivative: How H_p is made, see `parameter_forces`.

    Returns:
        W_ep with effector coordinates in the order effector, axis.

    Raises:
        ValueError: If the adjoint side is asked for although some effectors are forces.
    """
    effectors = configuration.effectors
    n_e = effectors.measured.size
    setup = setup_columns(space)
    forces = parameter_forces(model, configuration, u, space, z, derivative=derivative)
    if method == "adjoint" and effectors.has_forces:
        raise ValueError(
            'method "adjoint" cannot tell how forces follow the parameters, and '
            'some effectors are forces: take "direct".'
        )
    few = z.shape[0] <= n_e or effectors.has_forces
    if method == "direct" or (method == "auto" and few):
        solved = factor_solve(model, configuration, u, forces)
        x = solved.x
        if setup:
            moved = setup_displacements(model, configuration, u, space, z)
            x = x.at[jnp.asarray(setup)].set(moved)
        W = effector_compliance(model, configuration, u, x, space, z)
        return Compliance(W, x, solved.ok)
    rows = effector_rows(model, effectors, u)
    solved = factor_solve(model, configuration, u, rows, transpose=True)
    W = jnp.sum(solved.x[:, None] * forces[None], axis=(2, 3))
    if setup:
        by_setup = setup_compliance(model, configuration, u, space, z, rows)
        W = W.at[:, jnp.asarray(setup)].set(by_setup)
    return Compliance(jnp.asarray(W), None, solved.ok)
