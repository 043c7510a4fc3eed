"""One step of the outer loop: what the bounded QP proposes is accepted or refused.

The paper repeats the QP of Eqs. (10) and (11) with a fixed bound on the step until
lambda_p vanishes. Here the bound is a trust region: it shrinks when a step is refused
and grows when the model was right. A step is refused if its cost is no lower than the
highest of the last few (`MEMORY`). The model is linear in the errors (Gauss-Newton), or
includes their curvature from past steps where that predicts the cost better.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration._curvature import Curvature, convex_model, learned
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._qp import (
    QPLimits,
    QPStep,
    ScaledQP,
    scaled_qp,
    solved_qp,
)
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import Whitened

KKT_TOLERANCE = 1e-6
"""Largest optimality residual with which a vanishing QP step is trusted [-]."""

SMALLEST_FALL = 1e-8
"""Relative fall of the cost that is not worth a step [-].

Where the fit leaves an error, Gauss-Newton converges linearly, and many small steps
would follow that hardly change the fit.
"""

SLOW = 1e-2
"""Predicted relative fall of the cost below which gradients must be exact [-].

The errors nearly cancel in the gradient there, and errors of W_ep do not.
"""

FLAT = 1e-3
"""Largest relative slope of the cost at which a refused step means a minimum [-]."""


class Proposal(Module):
    """A step that the QP proposes: parameters after it, and a guess of the equilibria.

    `cost` is that after it by the model that the QP used, `costs` by the linear model
    of the errors, and with curvature. `precise` asks for exact compliances after it.
    A step that `vanishes` is too small to be worth an evaluation: the loop ends, and
    `z` and `guess` are those before the step.
    """

    qp: QPStep
    z: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_nodes 3"]
    cost: Float[Array, ""]
    costs: Float[Array, "2"]
    precise: Bool[Array, ""]
    vanishes: Bool[Array, ""]


def propose(
    problem: CalibrationProblem, settings: CalibrationSettings, state: CalibrationState
) -> Proposal:
    """Solve the QP within the bounds on p and on the step (paper Eqs. 10, 11).

    In three programs: that of the QP is the longest to compile, and as its size is that
    of the parameters alone, it serves calibrations with any number of errors.
    """
    models = _models(problem, settings, state)
    both = _solved_each(models.qps, models.needed)
    return _proposal(problem, settings, state, models, both)


class _Models(NamedTuple):
    """The rows of a step, and two QPs stacked: of them, and with curvature.

    `J` is the change of z per step coordinate; `needed` tells which of the QPs have to
    be solved.
    """

    rows: Whitened
    J: Float[Array, "n_p n_p"]
    qps: ScaledQP
    needed: Bool[Array, "2"]


@eqx.filter_jit
def _models(
    problem: CalibrationProblem, settings: CalibrationSettings, state: CalibrationState
) -> _Models:
    J = _step_coordinates(problem.space, state.z)
    rows = _along(state.evaluation.rows, J)
    error, W = map(jnp.asarray, rows)
    limits = _limits(problem, settings, state, J)
    models = (W, error), convex_model(W, error, state.curvature.matrix)
    scaled = [scaled_qp(*model, limits) for model in models]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *scaled)
    needed = jnp.stack([jnp.array(True), state.curvature.used])
    return _Models(rows, J, stacked, needed)


@jax.jit
def _solved_each(qps: ScaledQP, needed: Bool[Array, "2"]) -> QPStep:
    """Solve those QPs that are needed, and stack the steps; the others' are zero.

    In one loop, so that the QP is compiled only once here.
    """

    def one(each: tuple[ScaledQP, Bool[Array, ""]]) -> QPStep:
        qp, wanted = each
        shape = jax.eval_shape(solved_qp, qp)
        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shape)
        return jax.lax.cond(wanted, solved_qp, lambda _: nothing, qp)

    return jax.lax.map(one, (qps, needed))


@eqx.filter_jit
def _proposal(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    models: _Models,
    both: QPStep,
) -> Proposal:
    """Return the step of the model that is used, and what it predicts."""
    now, space = state.evaluation, problem.space
    (error, W), J, S = models.rows, models.J, state.curvature.matrix
    used = state.curvature.used.astype(jnp.int32)
    qp = jax.tree.map(lambda steps: steps[used], both)

    def costs(step):
        cost = 0.5 * jnp.sum((W @ step + error) ** 2)
        return jnp.stack([cost, cost + 0.5 * jnp.sum(step * (S @ step))])

    predicted = costs(qp.lambda_p)
    cost = predicted[used]
    # A wrong curvature may shorten a step: both models must find it small.
    linear = jax.tree.map(lambda steps: steps[0], both)
    vanishes = _small(problem, settings, state, qp, cost) & now.ok
    vanishes &= _small(problem, settings, state, linear, costs(linear.lambda_p)[0])
    guess = before = now.equilibrium.displacement
    if now.response.displacement is not None:
        dz = J @ qp.lambda_p
        guess = before + jnp.einsum("p,cpni->cni", dz, now.response.displacement)
    stay = lambda new, old: jnp.where(vanishes, old, new)
    return Proposal(
        qp=qp,
        z=stay(_moved(space, state.z, qp.lambda_p), state.z),
        guess=stay(guess, before),
        cost=cost,
        costs=predicted,
        precise=now.cost - cost <= SLOW * now.cost,
        vanishes=vanishes,
    )


def _step_coordinates(
    space: ParameterSpace, z: Float[Array, " n_p"]
) -> Float[Array, "n_p n_p"]:
    """Return the change of z per step coordinate: tensors where axes have a chart."""
    if space.chart is None:
        return jnp.eye(z.shape[0])
    return jax.jacfwd(space.chart.from_tensor)(space.chart.to_tensor(z))


def _along(rows: Whitened, J: Float[Array, "n_p n_p"]) -> Whitened:
    """Return rows by step coordinates."""
    return Whitened(rows.error, rows.W @ J)


def _moved(
    space: ParameterSpace, z: Float[Array, " n_p"], step: Float[Array, " n_p"]
) -> Float[Array, " n_p"]:
    """Return parameters after a step, which moves tensors where axes have a chart."""
    if space.chart is None:
        return space.wrap(z + step)
    chart = space.chart
    return space.admissible(chart.from_tensor(chart.to_tensor(z) + step))


def _limits(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    J: Float[Array, "n_p n_p"],
) -> QPLimits:
    """Return the constraints of a step, and its damping."""
    space, chart = problem.space, problem.space.chart
    limit = jnp.minimum(state.step_bound, space.max_step())
    down, up = space.room(state.z)
    low, high = jnp.maximum(down, -limit), jnp.minimum(up, limit)
    A, b = space.order_rows()
    b = b - A @ state.z
    if chart is not None:
        # The QP steps tensors, so the bounds of the moduli become rows.
        moduli = np.concatenate([chart.small, chart.large])
        free = np.concatenate([moduli, chart.angle])
        low = low.at[free].set(-state.step_bound)
        high = high.at[free].set(state.step_bound)
        A = jnp.concatenate([A @ J, J[moduli], -J[moduli]])
        b = jnp.concatenate([b, up[moduli], -down[moduli]])
    return QPLimits(low, high, A, b, settings.damping)


def _small(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    qp: QPStep,
    cost: Float[Array, ""],
) -> Bool[Array, ""]:
    """Return whether a step is small because nothing is left to gain."""
    size = jnp.max(jnp.abs(qp.lambda_p))
    fall = state.evaluation.cost - cost
    no_gain = settings.adapt & (fall <= SMALLEST_FALL * state.evaluation.cost)
    free = ~_is_at_bound(problem, state, qp) & (qp.kkt_residual <= KKT_TOLERANCE)
    return ((size <= settings.tol) | no_gain) & free


def _is_at_bound(
    problem: CalibrationProblem, state: CalibrationState, qp: QPStep
) -> Bool[Array, ""]:
    """Return whether a step is as long as the trust region allows."""
    limit = jnp.minimum(state.step_bound, problem.space.max_step())
    return jnp.any(jnp.abs(qp.lambda_p) >= 0.99 * limit)


def decide(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> CalibrationState:
    """Accept a proposed step if it helps, and adapt the bound on the next."""
    now, lambda_p = state.evaluation, proposal.qp.lambda_p
    bound, curvature = state.step_bound, state.curvature
    predicted = now.cost - proposal.cost
    gain = (now.cost - tried.cost) / jnp.maximum(predicted, 1e-300)
    reference = jnp.max(state.recent_costs)
    lowered = tried.cost <= reference - 1e-4 * predicted
    size = jnp.max(jnp.abs(lambda_p))
    at_bound = _is_at_bound(problem, state, proposal.qp)
    no_harm = tried.cost <= now.cost + SMALLEST_FALL * now.cost
    vanished = proposal.vanishes & tried.ok & ((size <= settings.tol) | no_harm)
    accepted = tried.ok & (lowered | vanished | (not settings.adapt))
    if settings.adapt:
        most = jnp.maximum(bound, settings.max_step_bound)
        grown = jnp.minimum(2.0 * bound, most)
        grown = jnp.where((gain > 0.75) & at_bound, grown, bound)
        bound = jnp.where(accepted, grown, 0.25 * size)
        curvature = _after(problem, state, proposal, tried)
    # A bound that shrank to nothing means a minimum only where the slope vanishes too.
    collapsed = ~vanished & (bound < settings.tol)
    # The slope is the relative fall of the cost per unit of lambda_p, predicted within
    # all constraints for a step so short that the model is linear.
    flat = predicted <= FLAT * size * 2.0 * now.cost
    keep = lambda new, old: jnp.where(accepted, new, old)
    recent = jnp.roll(state.recent_costs, 1).at[0].set(tried.cost)
    return CalibrationState(
        z=keep(proposal.z, state.z),
        evaluation=jax.tree.map(keep, tried, now),
        curvature=curvature,
        recent_costs=keep(recent, state.recent_costs),
        step_bound=bound,
        lambda_p=lambda_p,
        kkt_residual=proposal.qp.kkt_residual,
        accepted=accepted,
        step=state.step + 1,
        converged=vanished | (collapsed & flat),
        stalled=collapsed & ~flat,
    )


def _after(
    problem: CalibrationProblem,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> Curvature:
    """Update the curvature from the compliances at both ends of a step."""
    now = state.evaluation
    J = partial(_step_coordinates, problem.space)
    here = _along(now.rows, J(state.z))
    there = _along(tried.rows, J(proposal.z))
    error = jnp.where(tried.cost <= now.cost, there.error, here.error)
    new = learned(
        state.curvature,
        step=proposal.qp.lambda_p,
        change=jnp.asarray(there.W - here.W).T @ error,
        before=now.cost,
        after=tried.cost,
        predicted=proposal.costs,
    )
    # A vanishing step is not taken, so both of its ends are the same.
    keep = lambda old, new: jnp.where(proposal.vanishes, old, new)
    return jax.tree.map(keep, state.curvature, new)
