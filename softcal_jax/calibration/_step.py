"""One step of the outer loop: accept or refuse what the bounded QP proposes.

The paper repeats the QP of Eqs. (10) and (11) with a fixed bound on the step until
lambda_p vanishes. Here the bound is a trust region: it shrinks when a step is refused
and grows when the model was right. A step is refused if its cost is no lower than the
highest of the last few (`MEMORY`). The model is linear in the errors (Gauss-Newton), or
includes their curvature from past steps where that predicts the cost better.
"""

import jax
import jax.numpy as jnp

from softcal_jax.calibration._curvature import Curvature, learned
from softcal_jax.calibration._problem import CalibrationProblem, Evaluation
from softcal_jax.calibration._proposal import (
    SMALLEST_FALL,
    Proposal,
    is_at_bound,
    linear_model,
)
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState
from softcal_jax.fields import ParameterSpace

FLAT = 1e-3
"""Largest relative slope of the cost at which a refused step means a minimum [-]."""


def decide(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> CalibrationState:
    """Accept a proposed step if it helps, and adapt the bound on the next."""
    now, lambda_p = state.evaluation, proposal.qp.lambda_p
    bound = state.step_bound
    predicted = now.cost - proposal.cost
    gain = (now.cost - tried.cost) / jnp.maximum(predicted, 1e-300)
    reference = jnp.max(state.recent_costs)
    lowered = tried.cost <= reference - 1e-4 * predicted
    size = jnp.max(jnp.abs(lambda_p))
    at_bound = is_at_bound(problem, state, proposal.qp)
    no_harm = tried.cost <= now.cost + SMALLEST_FALL * now.cost
    vanished = proposal.vanishes & tried.ok & ((size <= settings.tol) | no_harm)
    accepted = tried.ok & (lowered | vanished | (not settings.adapt))
    if settings.adapt:
        most = jnp.maximum(bound, settings.max_step_bound)
        grown = jnp.minimum(2.0 * bound, most)
        grown = jnp.where((gain > 0.75) & at_bound, grown, bound)
        bound = jnp.where(accepted, grown, 0.25 * size)
    # A bound that shrank to nothing means a minimum only where the slope vanishes too.
    collapsed = ~vanished & (bound < settings.tol)
    # The slope is the relative fall of the cost per unit of lambda_p, predicted within
    # all constraints for a step so short that the model is linear.
    flat = predicted <= FLAT * size * 2.0 * now.cost
    keep = lambda new, old: jnp.where(accepted, new, old)
    curvature = state.curvature
    if settings.adapt:
        curvature = _after(problem.space, state, proposal, tried)
    return CalibrationState(
        keep(proposal.z, state.z),
        jax.tree.map(keep, tried, now),
        curvature,
        keep(jnp.roll(state.recent_costs, 1).at[0].set(tried.cost), state.recent_costs),
        bound,
        lambda_p,
        proposal.qp.kkt_residual,
        accepted,
        state.step + 1,
        vanished | (collapsed & flat),
        collapsed & ~flat,
    )


def _after(
    space: ParameterSpace,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> Curvature:
    """Update the curvature from the compliances at both ends of a step."""
    now = state.evaluation
    here = linear_model(space, state.z, now)
    there = linear_model(space, proposal.z, tried)
    error = jnp.where(tried.cost <= now.cost, there.error, here.error)
    new = learned(
        state.curvature,
        proposal.qp.lambda_p,
        (there.W - here.W).T @ error,
        now.cost,
        tried.cost,
        proposal.costs,
    )
    # A vanishing step is not taken, so both of its ends are the same.
    keep = lambda old, new: jnp.where(proposal.vanishes, old, new)
    return jax.tree.map(keep, state.curvature, new)
