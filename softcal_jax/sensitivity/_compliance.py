"""Sensitivities of the effectors to the parameters, W_ep = H_e K^-1 H_p^T (Eq. 9).

Sign: Eqs. (1) and (7) of the paper give K dx = ... - (df/dp) S lambda_p, Eq. (8) writes
+ H_p^T lambda_p. Hence H_p^T = -(dR/dp) S, with R = f - f_ext; it is defined here, in
`parameter_forces`, and nowhere else.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model, factor_solve, residual
from softcal_jax.fields import ParameterSpace

Derivative = Literal["autodiff", "finite-difference"]

FINITE_DIFFERENCE_STEP = 6e-6
"""Cube root of the float64 rounding unit: the best step of a central difference."""


def parameter_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_nodes 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    derivative: Derivative = "autodiff",
    step: float | Float[Array, ""] = FINITE_DIFFERENCE_STEP,
) -> Float[Array, "n_p n_nodes 3"]:
    """H_p^T by rows: the force that a unit step of each parameter puts on the nodes.

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

    def force(z):
        return -residual(space.apply(model, z), configuration, u)

    directions = jnp.eye(z.shape[0])
    if derivative == "autodiff":
        return jax.vmap(lambda d: jax.jvp(force, (z,), (d,))[1])(directions)
    difference = lambda d: (force(z + step * d) - force(z - step * d)) / (2.0 * step)
    return jax.lax.map(difference, directions)


class Compliance(NamedTuple):
    """W_ep of one configuration, and what it was made of.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p [m].
        displacement: dx/dz by rows, for warm starts [m]; None from the adjoint side.
        ok: False if the tangent could not be factorized; W_ep is then zero.
    """

    W_ep: Float[Array, "n_e n_p"]
    displacement: Float[Array, "n_p n_nodes 3"] | None
    ok: Bool[Array, ""]


def parameter_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_nodes 3"],
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
        W_ep with effector coordinates in the order marker, axis.
    """
    effectors = configuration.effectors
    n_e = effectors.measured.size
    forces = parameter_forces(model, configuration, u, space, z, derivative=derivative)
    if method == "direct" or (method == "auto" and z.shape[0] <= n_e):
        solved = factor_solve(model, configuration, u, forces)
        W = jax.vmap(effectors.positions)(solved.x)
        return Compliance(W.reshape(z.shape[0], n_e).T, solved.x, solved.ok)
    _, pull_back = jax.vjp(effectors.positions, u)
    unit = jnp.eye(n_e).reshape(n_e, *effectors.measured.shape)
    (rows,) = jax.vmap(pull_back)(unit)
    solved = factor_solve(model, configuration, u, rows, transpose=True)
    W = jnp.sum(solved.x[:, None] * forces[None], axis=(2, 3))
    return Compliance(jnp.asarray(W), None, solved.ok)
