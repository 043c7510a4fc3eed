"""One step of the outer loop: a bounded QP, tried, and kept if it helps.

The paper repeats the QP of Eqs. (10) and (11) with a fixed bound on the step until
lambda_p vanishes. Here the bound is a trust region: it shrinks when a step is refused,
grows when the linear model was right, and a step is refused that leaves the fit no
better than the worst of the last few (`MEMORY`).
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.calibration._problem import CalibrationProblem, Evaluation, evaluate
from softcal_jax.calibration._qp import DAMPING, QPStep, bounded_step

KKT_TOLERANCE = 1e-6
"""Largest optimality residual with which a vanishing QP step is believed [-]."""


SMALLEST_FALL = 1e-8
"""Fall of the cost that is not worth a step, relative to the cost [-].

Where the fit leaves an error, a Gauss-Newton step only goes a share of the way, and
many small ones would follow that hardly change the fit.
"""


FLAT = 1e-3
"""Largest relative slope of the cost at which a refused step means a minimum [-]."""


MEMORY = 5
"""Steps over which the cost must have fallen, not at each of them.

The data often leave a narrow, curved valley. A Gauss-Newton step along it climbs its
wall a little, and the next one comes back to its floor further down; a step that must
lower the cost itself can only creep (Grippo, Lampariello and Lucidi, SIAM J. Numer.
Anal. 23, 1986).
"""


class CalibrationSettings(eqx.Module):
    """Settings of the outer loop.

    Attributes:
        tol: Largest entry of lambda_p at which the loop stops, without that step; with
            `adapt` also where it would lower the cost by less than `SMALLEST_FALL` [-].
        max_steps: Steps after which it gives up.
        step_bound: First bound on every entry of lambda_p; 1 is a factor e on a log
            scale and the whole range on a linear one [-].
        max_step_bound: Largest bound that it may grow to; beyond a factor of two the
            linear model says little, and equilibria are far to find [-].
        damping: Levenberg damping of the QP, for columns of W of unit length: it holds
            back directions that the data hardly see. A step that is repeated until it
            vanishes ends at the same minimum, later [-].
        adapt: Adapt the bound and refuse steps that do not help over `MEMORY` steps;
            without, every QP step is taken with the same bound, as in the paper.
    """

    tol: float = eqx.field(static=True, default=1e-6)
    max_steps: int = eqx.field(static=True, default=50)
    step_bound: float = eqx.field(static=True, default=0.3)
    max_step_bound: float = eqx.field(static=True, default=0.5)
    damping: float = eqx.field(static=True, default=DAMPING)
    adapt: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not 0.0 < self.tol < 1.0:
            raise ValueError(f"tol must lie in (0, 1), got {self.tol}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        if not self.step_bound > 0.0:
            raise ValueError(f"step_bound must be positive, got {self.step_bound}.")
        if not self.damping > 0.0:
            raise ValueError(f"damping must be positive, got {self.damping}.")
        if not self.max_step_bound > 0.0:
            raise ValueError(
                f"max_step_bound must be positive, got {self.max_step_bound}."
            )


class CalibrationState(eqx.Module):
    """State of the outer loop; a pytree, so that a batch of starts is one `vmap`.

    Attributes:
        z: Scaled parameters [-].
        evaluation: Equilibria, errors and compliances at `z`.
        recent_costs: Costs of the last steps that were kept, the last one first [-].
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
    recent_costs: Float[Array, " memory"]
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
        before: Those before it [m].
        cost: Cost after it, by the linear model [-].
        vanishes: Whether the step is too small to be worth a trial: the loop is at its
            end, and `z` and `guess` are those before the step.
    """

    qp: QPStep
    z: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_nodes 3"]
    before: Float[Array, "n_c n_nodes 3"]
    cost: Float[Array, ""]
    vanishes: Bool[Array, ""]


def initial_state(
    settings: CalibrationSettings, z: Float[Array, " n_p"], evaluation: Evaluation
) -> CalibrationState:
    """State before the first step."""
    return CalibrationState(
        z,
        evaluation,
        jnp.full((MEMORY,), -jnp.inf, z.dtype).at[0].set(evaluation.cost),
        jnp.full((), settings.step_bound, z.dtype),
        jnp.full_like(z, jnp.inf),
        jnp.zeros((), z.dtype),
        jnp.ones((), bool),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), bool),
        jnp.zeros((), bool),
    )


def propose(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
) -> Proposal:
    """Solve the QP within the bounds on p and on the step (paper Eqs. 10, 11)."""
    now, space = state.evaluation, problem.space
    solve = partial(bounded_step, damping=settings.damping)
    limit = jnp.minimum(state.step_bound, space.max_step())
    down, up = space.room(state.z)
    low, high = jnp.maximum(down, -limit), jnp.minimum(up, limit)
    A, b = space.order_rows()
    b = b - A @ state.z
    chart = space.chart
    W_ep, error = now.W_ep, now.error
    if space.has_prior:
        W_ep = jnp.concatenate([W_ep, jnp.diag(space.prior_weights())])
        error = jnp.concatenate([error, now.prior])
    if chart is None:
        qp = solve(W_ep, error, low, high, A=A, b=b)
        dz, z = qp.lambda_p, space.wrap(state.z + qp.lambda_p)
        linear = W_ep @ qp.lambda_p + error
    else:
        # The QP moves tensors; the bounds of their moduli become rows.
        tensor = chart.to_tensor(state.z)
        J = jax.jacfwd(chart.from_tensor)(tensor)
        moduli = np.concatenate([chart.small, chart.large])
        free = np.concatenate([moduli, chart.angle])
        rows = jnp.concatenate([A @ J, J[moduli], -J[moduli]])
        W = W_ep @ J
        qp = solve(
            W,
            error,
            low.at[free].set(-state.step_bound),
            high.at[free].set(state.step_bound),
            A=rows,
            b=jnp.concatenate([b, up[moduli], -down[moduli]]),
        )
        dz, z = J @ qp.lambda_p, chart.from_tensor(tensor + qp.lambda_p)
        z = space.admissible(z)
        linear = W @ qp.lambda_p + error
    cost = 0.5 * jnp.sum(linear**2)
    guess = before = now.equilibrium.displacement
    if now.tangents is not None:
        guess = before + jnp.einsum("p,cpni->cni", dz, now.tangents)
    vanishes = _small(problem, settings, state, qp, cost) & now.ok
    stay = lambda new, old: jnp.where(vanishes, old, new)
    return Proposal(qp, stay(z, state.z), stay(guess, before), before, cost, vanishes)


def _small(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    qp: QPStep,
    cost: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether a step is small because nothing is left to gain, not held short."""
    size = jnp.max(jnp.abs(qp.lambda_p))
    fall = state.evaluation.cost - cost
    no_gain = settings.adapt & (fall <= SMALLEST_FALL * state.evaluation.cost)
    free = ~_at_bound(problem, state, qp) & (qp.kkt_residual <= KKT_TOLERANCE)
    return ((size <= settings.tol) | no_gain) & free


def _at_bound(problem: CalibrationProblem, state: CalibrationState, qp: QPStep):
    limit = jnp.minimum(state.step_bound, problem.space.max_step())
    return jnp.any(jnp.abs(qp.lambda_p) >= 0.99 * limit)


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
    predicted = now.cost - proposal.cost
    gain = (now.cost - tried.cost) / jnp.maximum(predicted, 1e-300)
    reference = jnp.max(state.recent_costs)
    lowered = tried.cost <= reference - 1e-4 * predicted
    size = jnp.max(jnp.abs(lambda_p))
    at_bound = _at_bound(problem, state, proposal.qp)
    no_harm = tried.cost <= now.cost + SMALLEST_FALL * now.cost
    vanished = _small(problem, settings, state, proposal.qp, proposal.cost)
    vanished = vanished & tried.ok & ((size <= settings.tol) | no_harm)
    accepted = tried.ok & (lowered | vanished | (not settings.adapt))
    if settings.adapt:
        most = jnp.maximum(bound, settings.max_step_bound)
        grown = jnp.minimum(2.0 * bound, most)
        grown = jnp.where((gain > 0.75) & at_bound, grown, bound)
        bound = jnp.where(accepted, grown, 0.25 * size)
    # Steps were refused until none was left: a minimum only if the slope is gone too.
    collapsed = ~vanished & (bound < settings.tol)
    # Relative fall of the cost per unit of lambda_p, within all constraints: the last
    # QP step was so short that its model was linear.
    flat = predicted <= FLAT * size * 2.0 * now.cost
    keep = lambda new, old: jnp.where(accepted, new, old)
    return CalibrationState(
        keep(proposal.z, state.z),
        jax.tree.map(keep, tried, now),
        keep(jnp.roll(state.recent_costs, 1).at[0].set(tried.cost), state.recent_costs),
        bound,
        lambda_p,
        proposal.qp.kkt_residual,
        accepted,
        state.step + 1,
        vanished | (collapsed & flat),
        collapsed & ~flat,
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
    proposal = propose(problem, settings, state)
    tried = evaluate(problem, proposal.z, proposal.guess, proposal.before)
    return decide(problem, settings, state, proposal, tried)
