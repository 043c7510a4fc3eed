"""Equilibria and their compliances together, for the outer loop of a calibration."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    continue_equilibrium,
    effector_values,
    lane_by_lane,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity._rows import parameter_rows

FEW_PARAMETERS = 12
"""Up to here the direct side is taken even where the adjoint one needs fewer solves.

It also tells dx/dp, from which the next equilibria start; on one factor, a dozen
right-hand sides cost about as much as a factorization.
"""


class Response(NamedTuple):
    """Equilibrium of one configuration, and how its effectors follow the parameters.

    Attributes:
        equilibrium: The equilibrium.
        effectors: Effector coordinates there.
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        displacement: dx/dz by rows [m]; None from the adjoint side.
        ok: False if there is no equilibrium or no tangent; W_ep is then zero.
    """

    equilibrium: EquilibriumSolution
    effectors: Float[Array, "*batch n_rows 3"]
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
    """Find the equilibrium near a guess, and W_ep = H_e K^-1 H_p^T there; Eq. (9).

    What `solve_equilibrium` and `parameter_compliance` give one after the other, with
    one factorization less: W_ep is solved for on the factor of the last Newton step.

    Args:
        model: The body.
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
        Equilibrium, effectors and compliance, coordinates in the order effector, axis.
    """

    @lane_by_lane
    def lane(model, configuration, guess, before, precise, space, z):
        model, configuration = space.apply(model, configuration, z)
        equilibrium, linearisation = continue_equilibrium(
            model, configuration, guess, settings=newton, before=before, precise=precise
        )
        rows = parameter_rows(linearisation, space, z)
        most = max(configuration.effectors.measured.size, FEW_PARAMETERS)
        found = sensitivity(
            linearisation, rows, effector_values, adjoint=z.shape[0] > most
        )
        ok = found.ok & equilibrium.converged
        W_ep, displacement = jax.tree.map(
            lambda a: jnp.where(ok, a, 0.0), (found.W_ep, found.displacement)
        )
        effectors = effector_values(
            model, configuration, equilibrium.displacement, equilibrium.multipliers
        )
        return Response(
            equilibrium=equilibrium,
            effectors=effectors,
            W_ep=W_ep,
            displacement=displacement,
            ok=ok,
        )

    before = guess if before is None else before
    precise = jnp.asarray(precise)
    return lane(model, configuration, guess, before, precise, space, z)
