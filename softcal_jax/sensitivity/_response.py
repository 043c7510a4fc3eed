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
"""Number of parameters up to which the direct method is always used.

It also yields dx/dp, from which the next equilibria start, and a dozen right-hand sides
cost only about as much as one factorization.
"""


class Response(NamedTuple):
    """Equilibrium of one configuration, with its effectors and their compliance.

    Attributes:
        equilibrium: The equilibrium.
        effectors: Effector coordinates there.
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        displacement: dx/dz by rows [m]; None if adjoint.
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

    Combines `solve_equilibrium` and `parameter_compliance` and saves a factorization:
    W_ep reuses the factor of the last Newton step.

    Args:
        model: The model.
        configuration: One configuration with its effectors; `vmap` runs configurations
            sequentially, each to its own convergence.
        guess: Displacement close to the equilibrium [m].
        space: The parameters.
        z: Their scaled values [-].
        newton: Settings of Newton's method, for a poor guess.
        before: Equilibrium displacement from which the guess was extrapolated to first
            order; the guess itself by default [m].
        precise: Whether to make W_ep exact by one more Newton step; otherwise its error
            is of the order of the last step.

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
