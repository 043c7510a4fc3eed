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
        converged: Whether lambda_p has vanished.
    """

    z: Float[Array, " n_p"]
    evaluation: Evaluation
    step_bound: Float[Array, ""]
    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]
    accepted: Bool[Array, ""]
    step: Int[Array, ""]
    converged: Bool[Array, ""]


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
    settings: CalibrationSettings,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> CalibrationState:
    """Keep a proposed step if it helps, and adapt the bound on the next."""
    now, lambda_p = state.evaluation, proposal.qp.lambda_p
    linear = 0.5 * jnp.sum((now.W_ep @ lambda_p + now.error) ** 2)
    gain = (now.cost - tried.cost) / jnp.maximum(now.cost - linear, 1e-300)
    size = jnp.max(jnp.abs(lambda_p))
    # A vanishing step changes the cost by rounding only; it is taken, and is the last.
    vanished = (size <= settings.tol) & tried.ok
    accepted = tried.ok & ((gain > 1e-4) | vanished | (not settings.adapt))
    bound = state.step_bound
    if settings.adapt:
        at_bound = size >= 0.99 * bound
        grown = jnp.where((gain > 0.75) & at_bound, 2.0 * bound, bound)
        bound = jnp.where(gain > 0.25, grown, 0.25 * size)
        bound = jnp.where(vanished, state.step_bound, bound)
    keep = lambda new, old: jnp.where(accepted, new, old)
    return CalibrationState(
        keep(proposal.z, state.z),
        jax.tree.map(keep, tried, now),
        bound,
        lambda_p,
        proposal.qp.kkt_residual,
        accepted,
        state.step + 1,
        vanished,
    )


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
    return decide(settings, state, proposal, tried)
