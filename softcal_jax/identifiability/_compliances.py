"""W_ep of Eq. (9) and W_pp of Sec. V-C, at one equilibrium."""

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model, factor_solve, residual, solved_forces
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity import (
    effector_compliance,
    parameter_forces,
    setup_columns,
    setup_displacements,
)


class EnergyCompliance(eqx.Module):
    """W_ep and W_pp of configurations, one lane each; nothing measured is needed.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p [m].
        W_pp: H_p K^-1 H_p^T, symmetric and positive semidefinite in a stable state [J].
        ok: Whether there is an equilibrium with a regular tangent.
    """

    W_ep: Float[Array, "*batch n_e n_p"]
    W_pp: Float[Array, "*batch n_p n_p"]
    ok: Bool[Array, "*batch"]


def energy_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> EnergyCompliance:
    """W_ep and W_pp = H_p K^-1 H_p^T at an equilibrium, by one factorization.

    Paper Eq. (9) and Sec. V-C. Row i of u' = K^-1 H_p^T is how the nodes move per unit
    of lambda_p,i and H_p^T are the forces that move them (sign as in
    `parameter_forces`), so W_pp,ij = h_i . u'_j = u'_i . K u'_j is positive where K is.
    With m(z) = min_u Pi(u; z) it is what the relaxation of the nodes takes off the
    curvature of the energy: W_pp = d2 Pi/dz2 at fixed u minus d2 m/dz2.

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration with its effectors.
        u: Equilibrium displacement [m].
        space: The parameters.
        z: Their scaled values [-].

    Returns:
        Both compliances, effector coordinates in the order effector, axis.
    """
    forces = parameter_forces(model, configuration, u, space, z)
    solved = factor_solve(model, configuration, u, forces)
    x, setup = solved.x, setup_columns(space)
    W = jnp.sum(forces[:, None] * x[None], axis=(2, 3))
    if setup:  # u'_i . K u'_j, with what is held moving too
        at = jnp.asarray(setup)
        moved = setup_displacements(model, configuration, u, space, z)
        x = x.at[at].set(moved)
        lambda_a = solved_forces(model, configuration, u)
        force = lambda u: residual(model, configuration, u, lambda_a)
        stiff = jax.vmap(lambda du: jax.jvp(force, (u,), (du,))[1])(moved)
        by_setup = jnp.sum(x[:, None] * stiff[None], axis=(2, 3))
        W = W.at[:, at].set(by_setup).at[at].set(by_setup.T)
    W_ep = effector_compliance(model, configuration, u, x, space, z)
    ok = solved.ok & jnp.all(jnp.isfinite(W)) & jnp.all(jnp.isfinite(W_ep))
    # Symmetric but for the rounding of the factorization.
    return EnergyCompliance(W_ep, 0.5 * (W + W.T), ok)
