"""Equilibria and their compliances together, for the outer loop of a calibration."""

from typing import NamedTuple

import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    continue_equilibrium,
    lane_by_lane,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity._compliance import (
    effector_compliance,
    effector_rows,
    parameter_forces,
)
from softcal_jax.sensitivity._setup import (
    setup_columns,
    setup_compliance,
    setup_displacements,
)

FEW_PARAMETERS = 12
"""Up to here the direct side is taken even where the adjoint one needs fewer solves.

It also tells dx/dp, from which the next equilibria start; on one factor, a dozen
right-hand sides cost about as much as a factorization.
"""


class Response(NamedTuple):
    """Equilibrium of one configuration, and how its effectors follow the parameters.

    Attributes:
        equilibrium: The equilibrium.
        W_ep: Change of each effector coordinate per unit of lambda_p [m].
        displacement: dx/dz by rows [m]; None from the adjoint side.
        ok: False if there is no equilibrium or no tangent; W_ep is then zero.
    """

    equilibrium: EquilibriumSolution
    W_ep: Float[Array, "*batch n_e n_p"]
    displacement: Float[Array, "*batch n_p n_points 3"] | None
    ok: Bool[Array, "*batch"]


def equilibrium_response(
    model: Model,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    newton: NewtonSettings,
    before: Float[Array, "n_points 3"] | None = None,
    precise: bool | Bool[Array, ""] = False,
) -> Response:
    """Equilibrium near a guess and W_ep = H_e K^-1 H_p^T there, paper Eq. (9).

    What `solve_equilibrium` and `parameter_compliance` give one after the other, with
    one factorization less: W_ep is solved for on the factor of the last Newton step.

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration with its effectors; `vmap` runs the
            configurations one after the other, each to its own end.
        guess: Displacement close to the equilibrium [m].
        space: The parameters.
        z: Their scaled values [-].
        newton: Settings of Newton's method where the guess is not good.
        before: Displacement of an equilibrium from which the guess was extrapolated, to
            first order; by default the guess [m].
        precise: Whether W_ep is exact, for one more Newton step; otherwise it is off by
            the way of the last.

    Returns:
        Equilibrium and compliance, effector coordinates in the order effector, axis.
    """

    @lane_by_lane
    def lane(model, configuration, guess, before, precise, space, z):
        effectors = configuration.effectors
        setup = setup_columns(space)
        n_e, n_p = effectors.measured.size, z.shape[0]
        if n_p <= max(n_e, FEW_PARAMETERS) or effectors.has_forces:
            forces = lambda u: parameter_forces(model, configuration, u, space, z)
            done = continue_equilibrium(
                model,
                configuration,
                guess,
                forces,
                settings=newton,
                before=before,
                precise=precise,
            )
            ok = done.ok & done.equilibrium.converged
            x = jnp.where(ok, done.x, 0.0)
            u = done.equilibrium.displacement
            if setup:
                moved = setup_displacements(model, configuration, u, space, z)
                x = x.at[jnp.asarray(setup)].set(jnp.where(ok, moved, 0.0))
            W = effector_compliance(model, configuration, u, x, space, z)
            W = jnp.where(ok, W, 0.0)
            return Response(done.equilibrium, W, x, ok)
        rows = lambda u: effector_rows(model, effectors, u)
        done = continue_equilibrium(
            model,
            configuration,
            guess,
            rows,
            settings=newton,
            before=before,
            precise=precise,
            transpose=True,
        )
        u = done.equilibrium.displacement
        H_p = parameter_forces(model, configuration, u, space, z)
        ok = done.ok & done.equilibrium.converged
        W = jnp.sum(done.x[:, None] * H_p[None], axis=(2, 3))
        if setup:
            by_setup = setup_compliance(model, configuration, u, space, z, rows(u))
            W = W.at[:, jnp.asarray(setup)].set(by_setup)
        return Response(done.equilibrium, jnp.where(ok, W, 0.0), None, ok)

    before = guess if before is None else before
    precise = jnp.asarray(precise)
    return lane(model, configuration, guess, before, precise, space, z)
