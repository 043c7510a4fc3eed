"""One step of the outer loop: a bounded QP, tried, and kept if it helps.

The paper repeats the QP of Eqs. (10) and (11) with a fixed bound on the step until
lambda_p vanishes. Here the bound is a trust region: it shrinks when the linear model
was wrong, grows when it was right, and a step that makes the fit worse is not taken.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.calibration._problem import CalibrationProblem, Evaluation, evaluate
from softcal_jax.calibration._qp import QPStep, bounded_step
from softcal_jax.fields import ParameterSpace

KKT_TOLERANCE = 1e-6
"""Largest optimality residual with which a vanishing QP step is believed [-]."""


FLAT = 1e-3
"""Largest relative slope of the cost at which a refused step means a minimum [-]."""


class CalibrationSettings(eqx.Module):
    """Settings of the outer loop.

    Attributes:
        tol: Largest entry of lambda_p at which the loop stops [-].
        max_steps: Steps after which it gives up.
        step_bound: First bound on every entry of lambda_p; 1 is a factor e on a log
            scale and the whole range on a linear one [-].
        adapt: Adapt the bound and refuse steps that make the fit worse; without, every
            QP step is taken with the same bound, as in the paper.
    """

    tol: float = eqx.field(static=True, default=1e-6)
    max_steps: int = eqx.field(static=True, default=50)
    step_bound: float = eqx.field(static=True, default=1.0)
    adapt: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not 0.0 < self.tol < 1.0:
            raise ValueError(f"tol must lie in (0, 1), got {self.tol}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        if not self.step_bound > 0.0:
            raise ValueError(f"step_bound must be positive, got {self.step_bound}.")


class CalibrationState(eqx.Module):
    """State of the outer loop; a pytree, so that a batch of starts is one `vmap`.

    Attributes:
        z: Scaled parameters [-].
        evaluation: Equilibria, errors and compliances at `z`.
        step_bound: Bound on the next step [-].
        lambda_p: Last QP step, kept or not [-].
        kkt_residual: Its optimality residual [-].
        accepted: Whether it was kept.
        step: Steps so far.
        converged: Whether lambda_p has vanished, with no bound on the step in its way.
        stalled: Whether steps were refused until the bound itself was below `tol`.
    """

    z: Float[Array, " n_p"]
    evaluation: Evaluation
    step_bound: Float[Array, ""]
    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]
    accepted: Bool[Array, ""]
    step: Int[Array, ""]
    converged: Bool[Array, ""]
    stalled: Bool[Array, ""]


class Proposal(eqx.Module):
    """A step that the QP proposes, and where its equilibria should lie.

    Attributes:
        qp: The step and its check.
        z: Parameters after it [-].
        guess: Displacements after it, to first order [m].
    """

    qp: QPStep
    z: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_nodes 3"]


def initial_state(
    settings: CalibrationSettings, z: Float[Array, " n_p"], evaluation: Evaluation
) -> CalibrationState:
    """State before the first step."""
    return CalibrationState(
        z,
        evaluation,
        jnp.full((), settings.step_bound, z.dtype),
        jnp.full_like(z, jnp.inf),
        jnp.zeros((), z.dtype),
        jnp.ones((), bool),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), bool),
        jnp.zeros((), bool),
    )


def propose(problem: CalibrationProblem, state: CalibrationState) -> Proposal:
    """Solve the QP within the bounds on p and on the step (paper Eqs. 10, 11)."""
    now, bound = state.evaluation, state.step_bound
    low = jnp.maximum(problem.space.lower() - state.z, -bound)
    high = jnp.minimum(problem.space.upper() - state.z, bound)
    qp = bounded_step(now.W_ep, now.error, low, high)
    guess = now.equilibrium.displacement
    if now.tangents is not None:
        guess = guess + jnp.einsum("p,cpni->cni", qp.lambda_p, now.tangents)
    return Proposal(qp, state.z + qp.lambda_p, guess)


def decide(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> CalibrationState:
    """Keep a proposed step if it helps, and adapt the bound on the next."""
    now, lambda_p = state.evaluation, proposal.qp.lambda_p
    bound = state.step_bound
    linear = 0.5 * jnp.sum((now.W_ep @ lambda_p + now.error) ** 2)
    predicted = now.cost - linear
    gain = (now.cost - tried.cost) / jnp.maximum(predicted, 1e-300)
    size = jnp.max(jnp.abs(lambda_p))
    at_bound = size >= 0.99 * bound
    # A step is small because nothing is left to gain, not because it was held short.
    vanished = tried.ok & (size <= settings.tol) & ~at_bound
    vanished = vanished & (proposal.qp.kkt_residual <= KKT_TOLERANCE)
    accepted = tried.ok & ((gain > 1e-4) | vanished | (not settings.adapt))
    if settings.adapt:
        grown = jnp.where((gain > 0.75) & at_bound, 2.0 * bound, bound)
        bound = jnp.where(gain > 0.25, grown, 0.25 * size)
    # Steps were refused until none was left: a minimum only if the slope is gone too.
    collapsed = ~vanished & (bound < settings.tol)
    flat = _slope(now, state.z, problem.space) <= FLAT
    keep = lambda new, old: jnp.where(accepted, new, old)
    return CalibrationState(
        keep(proposal.z, state.z),
        jax.tree.map(keep, tried, now),
        bound,
        lambda_p,
        proposal.qp.kkt_residual,
        accepted,
        state.step + 1,
        vanished | (collapsed & flat),
        collapsed & ~flat,
    )


def _slope(now: Evaluation, z: Float[Array, " n_p"], space: ParameterSpace):
    """Relative fall of the cost per unit of lambda_p, within the bounds on p."""
    gradient = now.W_ep.T @ now.error
    step = z - jnp.clip(z - gradient, space.lower(), space.upper())
    blocked = jnp.where(step == 0.0, 0.0, gradient)
    return jnp.max(jnp.abs(blocked)) / jnp.maximum(2.0 * now.cost, 1e-300)


def calibration_step(
    problem: CalibrationProblem, settings: CalibrationSettings, state: CalibrationState
) -> CalibrationState:
    """One whole step, traceable: propose, evaluate, decide.

    Args:
        problem: The calibration.
        settings: Settings of the outer loop.
        state: State before the step; its evaluation is ok.

    Returns:
        State after it.
    """
    proposal = propose(problem, state)
    tried = evaluate(problem, proposal.z, proposal.guess)
    return decide(problem, settings, state, proposal, tried)
