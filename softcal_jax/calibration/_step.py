"""One step of the outer loop: what the bounded QP proposes is accepted or refused.

The paper repeats the QP of Eqs. (10) and (11) with a fixed bound on the step until
lambda_p vanishes. Here the bound is a trust region, which shrinks when a step is
refused and grows when the model was right. The model is linear in the errors
(Gauss-Newton), or includes their curvature where that predicts the cost better.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int, numpy_of
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._qp import (
    KKT_TOLERANCE,
    QPLimits,
    QPStep,
    ScaledQP,
    convex_model,
    scaled_qp,
    solved_qp,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import Whitened

MEMORY = 5
"""Number of steps over which the cost must fall; at a single one it may rise.

The data often leave a narrow, curved valley. A Gauss-Newton step along it climbs its
wall a little, and the next one returns to its floor further down; if every step had to
lower the cost, the loop would creep (Grippo, Lampariello and Lucidi, SIAM J. Numer.
Anal. 23, 1986).
"""

SLOW = 1e-2
"""Predicted relative fall of the cost below which gradients must be exact [-].

The errors nearly cancel in the gradient there, and errors of W_ep do not.
"""

OUTSIDE = 1e-6
"""How far readings may exceed their limits, in steps to them [-]."""

FLAT = 1e-3
"""Largest relative slope of the cost at which a refused step means a minimum [-]."""

QUICK = 0.2  # relative fall of the cost from which plain Gauss-Newton is used [-]

BOUNDED = 1e-4
"""Smallest cosine between step and residual of the update: keeps it bounded [-]."""


class Curvature(Module):
    """What Gauss-Newton leaves out of the Hessian, and whether a step uses it.

    The Hessian of ||error||^2 / 2 is W^T W + sum_i error_i H_i, with H_i the Hessian of
    each error. The second term vanishes with the errors. Where errors remain, from
    noise or an imperfect model, it dominates along directions that the data hardly see,
    and Gauss-Newton steps converge slowly there, if at all. It is estimated at no extra
    cost from the gradients at both ends of each step (Dennis, Gay and Welsch, ACM
    Trans. Math. Softw. 7, 1981), by the symmetric rank-one update, which can become
    indefinite, as the true term can (Conn, Gould and Toint, Math. Prog. 50, 1991). It
    is used while the cost falls slowly (Fletcher and Xu, IMA J. Numer. Anal. 7, 1987)
    and only if it predicted the last step better than Gauss-Newton.
    """

    matrix: Float[Array, "n_p n_p"]
    used: Bool[Array, ""]


def learned(
    curvature: Curvature,
    step: Float[Array, " n_p"],
    change: Float[Array, " n_p"],
    before: Float[Array, ""],
    after: Float[Array, ""],
    predicted: Float[Array, "2"],
) -> Curvature:
    """Update the estimate after a step, accepted or refused.

    `change` is the change of W along the step, transposed, times the errors. The cost
    `after` is infinite if there is no equilibrium; `predicted` are the costs by the
    linear model of the errors, without and with the curvature.
    """
    left = change - curvature.matrix @ step
    along = jnp.sum(left * step)
    norm = jnp.linalg.norm
    bounded = jnp.abs(along) > BOUNDED * norm(left) * norm(step)
    update = jnp.outer(left, left) / jnp.where(bounded, along, 1.0)
    sound = bounded & jnp.all(jnp.isfinite(update)) & jnp.isfinite(after)
    matrix = curvature.matrix + jnp.where(sound, update, 0.0)
    miss = jnp.abs(after - predicted)
    slow = jnp.isfinite(after) & (before - after < QUICK * before)
    return Curvature(matrix, slow & (miss[1] < miss[0]))


class CalibrationState(Module):
    """State of the outer loop, with the evaluation at z and the bound on the next step.

    `recent_costs` are those of the last accepted steps, the latest first, and
    `recent_excess` how far readings exceeded their limits there, which weighs `penalty`
    beside the cost. `lambda_p` is the last QP step, with its residual, whether the
    polish had to end it, whether it was accepted, whether it was `lost`, without an
    equilibrium, and the iterations that this took. It has `converged` where lambda_p
    has vanished, not shortened by the step bound, where `MEMORY` steps gained nothing,
    or steps were refused at a minimum, and has `stalled` where they were refused until
    the bound was below `tol`, away from a minimum. `least_fall` is the relative fall of
    the cost that is worth a step.
    """

    evaluation: Evaluation
    curvature: Curvature
    recent_costs: Float[Array, " memory"]
    recent_excess: Float[Array, " memory"]
    penalty: Float[Array, ""]
    step_bound: Float[Array, ""]
    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]
    by_polish: Bool[Array, ""]
    accepted: Bool[Array, ""]
    lost: Bool[Array, ""]
    newton_steps: Int[Array, " n_c"]
    step: Int[Array, ""]
    converged: Bool[Array, ""]
    stalled: Bool[Array, ""]
    least_fall: Float[Array, ""]

    @property
    def z(self) -> Float[Array, " n_p"]:
        """The scaled parameters [-]."""
        return self.evaluation.z

    @property
    def ended(self) -> bool:
        """Whether no step leads on."""
        return bool(self.converged or self.stalled or not self.evaluation.ok)


def initial_state(
    settings: CalibrationSettings, evaluation: Evaluation
) -> CalibrationState:
    """Return the state before the first step."""
    n, no, xp = len(evaluation.z), np.array(False), numpy_of(evaluation.cost)
    costs = xp.append(xp.asarray(evaluation.cost), np.full(MEMORY - 1, -np.inf))
    excess = xp.append(_excess(evaluation, evaluation), np.zeros(MEMORY - 1))
    # From the host, since each of these would be a program.
    state: Any = {
        "curvature": Curvature(*jax.device_put((np.zeros((n, n)), no))),
        "recent_costs": costs,
        "recent_excess": excess,
        "penalty": np.ones(()),
        "step_bound": np.array(settings.step_bound, float),
        "lambda_p": np.full(n, np.inf),
        "kkt_residual": np.zeros(()),
        "by_polish": no,
        "accepted": ~no,
        "lost": no,
        "newton_steps": evaluation.equilibrium.steps,
        "step": np.zeros((), np.int32),
        "converged": no,
        "stalled": no,
        "least_fall": np.array(settings.least_fall, float),
    }
    return CalibrationState(evaluation=evaluation, **jax.device_put(state))


def _lengths(now: Evaluation) -> Float[Array | HostArray, " n"]:
    """Return the change of each limited reading per unit of the step."""
    assert now.excess is not None
    xp = numpy_of(now.excess.W)
    size = xp.linalg.norm(xp.asarray(now.excess.W), axis=1)
    return xp.where(size > 0.0, size, 1.0)


def _excess(now: Evaluation, of: Evaluation) -> Float[Array | HostArray, ""]:
    """Add up by how many steps, as linear `now`, readings exceed their limits [-]."""
    if now.excess is None or of.excess is None:
        return numpy_of(of.cost).zeros(())
    xp = numpy_of(of.excess.error)
    beyond = xp.maximum(xp.asarray(of.excess.error), 0.0)
    return xp.asarray(xp.sum(beyond / _lengths(now)))


class Proposal(Module):
    """A step that the QP proposes: parameters after it, and a guess of the equilibria.

    `cost` is predicted by the model of the QP, `costs` by the linear model of the
    errors, without and with curvature, and `excess` by that of limited readings.
    `precise` asks for exact compliances. A step that `vanishes` is too small to be
    worth an evaluation.
    """

    qp: QPStep
    z: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_nodes 3"]
    cost: Float[Array, ""]
    costs: Float[Array, "2"]
    excess: Float[Array, ""]
    precise: Bool[Array, ""]
    vanishes: Bool[Array, ""]


def propose(
    space: ParameterSpace, settings: CalibrationSettings, state: CalibrationState
) -> Proposal:
    """Solve the QP within the bounds on p and on the step (paper Eqs. 10, 11).

    In three programs: that of the QP takes longest to compile, and as its size depends
    on the parameters alone, it serves calibrations with any number of errors.
    """
    models = _models(space, settings, state)
    both = _solved_each(models.qps, state.curvature.used)
    return _proposal(space, settings, state, models, both)


class _Models(NamedTuple):
    """Rows of a step, the change J of z per step coordinate, and both QPs stacked."""

    rows: Whitened
    J: Float[Array, "n_p n_p"]
    qps: ScaledQP


@eqx.filter_jit
def _models(
    space: ParameterSpace, settings: CalibrationSettings, state: CalibrationState
) -> _Models:
    J = _step_coordinates(space, state.z)
    error, W = map(jnp.asarray, state.evaluation.rows)
    W = W @ J
    limits = _limits(space, settings, state, J)
    models = (W, error), convex_model(W, error, state.curvature.matrix)
    scaled = [scaled_qp(*model, limits) for model in models]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *scaled)
    return _Models(Whitened(error, W), J, stacked)


@jax.jit
def _solved_each(qps: ScaledQP, curved: Bool[Array, ""]) -> QPStep:
    """Solve both QPs in one loop, so that a QP is compiled only once.

    The step of the one with curvature is zero unless it is used.
    """

    def one(each: tuple[ScaledQP, Bool[Array, ""]]) -> QPStep:
        qp, wanted = each
        none = jnp.zeros((), qp.c.dtype)
        nothing = QPStep(jnp.zeros_like(qp.c), none, jnp.zeros((), bool))
        return jax.lax.cond(wanted, solved_qp, lambda _: nothing, qp)

    return jax.lax.map(one, (qps, jnp.stack([jnp.array(True), curved])))


@eqx.filter_jit
def _proposal(
    space: ParameterSpace,
    settings: CalibrationSettings,
    state: CalibrationState,
    models: _Models,
    both: QPStep,
) -> Proposal:
    """Return the step of the model that is used, and what it predicts."""
    now = state.evaluation
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
    small = partial(_small, space, settings, state)
    vanishes = small(qp, cost) & small(linear, costs(linear.lambda_p)[0]) & now.ok
    after = jnp.zeros(())
    if now.excess is not None:
        beyond = now.excess.error + now.excess.W @ (J @ qp.lambda_p)
        after = jnp.sum(jnp.maximum(beyond, 0.0) / _lengths(now))
    guess = before = now.equilibrium.displacement
    if now.response.displacement is not None:
        dz = J @ qp.lambda_p
        guess = before + jnp.einsum("p,cpni->cni", dz, now.response.displacement)
    chart = space.chart
    if chart is None:
        moved = space.wrap(state.z + qp.lambda_p)
    else:
        tensors = chart.to_tensor(state.z) + qp.lambda_p
        moved = space.admissible(chart.from_tensor(tensors))
    stay = lambda new, old: jnp.where(vanishes, old, new)
    return Proposal(
        qp=qp,
        z=stay(moved, state.z),
        guess=stay(guess, before),
        cost=cost,
        costs=predicted,
        excess=after,
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


def _limits(
    space: ParameterSpace,
    settings: CalibrationSettings,
    state: CalibrationState,
    J: Float[Array, "n_p n_p"],
) -> QPLimits:
    """Return the constraints of a step, and its damping."""
    chart = space.chart
    limit = jnp.minimum(state.step_bound, space.max_step())
    down, up = space.room(state.z)
    low, high = jnp.maximum(down, -limit), jnp.minimum(up, limit)
    A, b = space.rows()
    b = b - A @ state.z
    if chart is not None:
        # The QP steps tensors, so the bounds of the moduli become rows.
        moduli = np.concatenate([chart.small, chart.large])
        free = np.concatenate([moduli, chart.angle])
        low = low.at[free].set(-state.step_bound)
        high = high.at[free].set(state.step_bound)
        A = jnp.concatenate([A @ J, J[moduli], -J[moduli]])
        b = jnp.concatenate([b, up[moduli], -down[moduli]])
    excess = state.evaluation.excess
    if excess is not None:
        lengths, limited = _lengths(state.evaluation), jnp.isfinite(excess.error)
        rows = jnp.where(limited[:, None], excess.W @ J / lengths[:, None], 0.0)
        room = jnp.where(limited, -excess.error / lengths, 1.0)
        # What is exceeded is reduced only as far as the trust region allows.
        reach = 0.9 * state.step_bound * jnp.sum(jnp.abs(rows), axis=1)
        A = jnp.concatenate([A, rows])
        b = jnp.concatenate([b, jnp.maximum(room, -reach)])
    return QPLimits(low, high, A, b, settings.damping)


def _small(
    space: ParameterSpace,
    settings: CalibrationSettings,
    state: CalibrationState,
    qp: QPStep,
    cost: Float[Array, ""],
) -> Bool[Array, ""]:
    """Return whether a step is small because nothing is left to gain."""
    size = jnp.max(jnp.abs(qp.lambda_p))
    fall = state.evaluation.cost - cost
    size_of_cost = jnp.maximum(state.evaluation.cost, settings.least_cost)
    no_gain = settings.adapt & (fall <= state.least_fall * size_of_cost)
    free = ~_is_at_bound(space, state, qp) & (qp.kkt_residual <= KKT_TOLERANCE)
    return ((size <= settings.tol) | no_gain) & free & _keeps(state.recent_excess[0])


def _keeps(excess: Float[Array, ""]) -> Bool[Array, ""]:
    """Return whether readings are within their limits, up to rounding."""
    return excess <= OUTSIDE


def _is_at_bound(
    space: ParameterSpace, state: CalibrationState, qp: QPStep
) -> Bool[Array, ""]:
    """Return whether a step is as long as the trust region allows."""
    limit = jnp.minimum(state.step_bound, space.max_step())
    return jnp.any(jnp.abs(qp.lambda_p) >= 0.99 * limit)


@eqx.filter_jit
def decide(
    space: ParameterSpace,
    settings: CalibrationSettings,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> CalibrationState:
    """Accept a proposed step if it helps, and adapt the bound on the next.

    Where readings have limits, the cost counts with what exceeds them, as an exact
    penalty function: its weight is raised until the sum is expected to fall along the
    step that the QP found (Nocedal and Wright, Numerical Optimization, 2006, Eq.
    18.36).
    """
    now, lambda_p = state.evaluation, proposal.qp.lambda_p
    curvature, longest = state.curvature, settings.step_bound
    penalty = state.penalty
    if now.excess is not None:
        inwards = state.recent_excess[0] - proposal.excess
        needed = 2.0 * (proposal.cost - now.cost) / inwards
        penalty = jnp.where(inwards > OUTSIDE, jnp.maximum(penalty, needed), penalty)
    # What is exceeded by rounding is not worth a higher cost.
    merit = lambda cost, excess: cost + penalty * jnp.maximum(excess - OUTSIDE, 0.0)
    recent_merits = merit(state.recent_costs, state.recent_excess)
    predicted = recent_merits[0] - merit(proposal.cost, proposal.excess)
    reached = merit(tried.cost, _excess(now, tried))
    gain = (recent_merits[0] - reached) / jnp.maximum(predicted, 1e-300)
    lowered = reached <= jnp.max(recent_merits) - 1e-4 * predicted
    size = jnp.max(jnp.abs(lambda_p))
    at_bound = _is_at_bound(space, state, proposal.qp)
    worth = settings.least_fall * jnp.maximum(now.cost, settings.least_cost)
    no_harm = tried.cost <= now.cost + worth
    vanished = proposal.vanishes & tried.ok & ((size <= settings.tol) | no_harm)
    accepted = tried.ok & (lowered | vanished | (not settings.adapt))
    if settings.adapt:
        bound = state.step_bound
        longest = jnp.minimum(2.0 * bound, jnp.maximum(bound, settings.max_step_bound))
        longest = jnp.where((gain > 0.75) & at_bound, longest, bound)
        curvature = _after(space, state, proposal, tried)
    bound = jnp.where(accepted, longest, 0.25 * size)
    latest = lambda old, new: jnp.roll(old, 1).at[0].set(new)
    recent = latest(state.recent_costs, tried.cost)
    excess = latest(state.recent_excess, _excess(tried, tried))
    # A bound that shrank to nothing means a minimum only where the slope vanishes too.
    collapsed = ~vanished & (bound < settings.tol)
    # Steps that go on, and together gain less than one is worth.
    gained = jnp.max(recent) - jnp.min(recent)
    idle = accepted & settings.adapt & (gained <= worth) & _keeps(excess[0])
    # The slope is the relative fall of the cost per unit of lambda_p, predicted within
    # all constraints for a step so short that the model is linear.
    flat = predicted <= FLAT * size * 2.0 * now.cost
    flat &= _keeps(state.recent_excess[0])
    keep = lambda new, old: jnp.where(accepted, new, old)
    return CalibrationState(
        evaluation=jax.tree.map(keep, tried, now),
        curvature=curvature,
        recent_costs=keep(recent, state.recent_costs),
        recent_excess=keep(excess, state.recent_excess),
        penalty=penalty,
        step_bound=bound,
        lambda_p=lambda_p,
        kkt_residual=proposal.qp.kkt_residual,
        by_polish=proposal.qp.by_polish,
        accepted=accepted,
        lost=~tried.ok,
        newton_steps=tried.equilibrium.steps,
        step=state.step + 1,
        converged=vanished | idle | (collapsed & flat),
        stalled=collapsed & ~flat,
        least_fall=state.least_fall,
    )


def _after(
    space: ParameterSpace,
    state: CalibrationState,
    proposal: Proposal,
    tried: Evaluation,
) -> Curvature:
    """Update the curvature from the compliances at both ends of a step."""
    now = state.evaluation
    W_now = now.rows.W @ _step_coordinates(space, state.z)
    W_tried = tried.rows.W @ _step_coordinates(space, tried.z)
    error = jnp.where(tried.cost <= now.cost, tried.rows.error, now.rows.error)
    step = proposal.qp.lambda_p
    if now.excess is not None and space.chart is None:
        step = space.shorter(tried.z - now.z)  # it may have been wound up on the way
    new = learned(
        state.curvature,
        step=step,
        change=jnp.asarray(W_tried - W_now).T @ error,
        before=now.cost,
        after=tried.cost,
        predicted=proposal.costs,
    )
    # A vanishing step is not taken, so both of its ends are the same.
    keep = lambda old, new: jnp.where(proposal.vanishes, old, new)
    return jax.tree.map(keep, state.curvature, new)
