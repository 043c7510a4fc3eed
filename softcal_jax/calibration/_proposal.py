"""The bounded QP step on the stacked errors, proposed (paper Eqs. 10 and 11)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration._curvature import convex_model
from softcal_jax.calibration._problem import CalibrationProblem, Evaluation
from softcal_jax.calibration._qp import QPStep, bounded_step
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState
from softcal_jax.fields import ParameterSpace

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


class Proposal(eqx.Module):
    """A step that the QP proposes, with a guess of its equilibria.

    Attributes:
        qp: The step and its check.
        z: Parameters after it [-].
        guess: Displacements after it, to first order [m].
        before: Displacements before it [m].
        cost: Cost after it, by the model that the QP used [-].
        costs: Cost after it by the linear model of the errors, and with curvature [-].
        precise: Whether compliances after it must be exact.
        vanishes: Whether the step is too small to be worth an evaluation: the loop
            ends, and `z` and `guess` are those before the step.
    """

    qp: QPStep
    z: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_nodes 3"]
    before: Float[Array, "n_c n_nodes 3"]
    cost: Float[Array, ""]
    costs: Float[Array, "2"]
    precise: Bool[Array, ""]
    vanishes: Bool[Array, ""]


def propose(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    state: CalibrationState,
) -> Proposal:
    """Solve the QP within the bounds on p and on the step (paper Eqs. 10, 11)."""
    now, space = state.evaluation, problem.space
    linear = linear_model(space, state.z, now)
    W, error = linear.W, linear.error
    limits = _limits(problem, state, linear.J)
    solve = lambda W, error: limits.solve(W, error, settings.damping)
    gauss_newton = lambda: solve(W, error)
    S = state.curvature.matrix
    curved = lambda: solve(*convex_model(W, error, S))
    qp = jax.lax.cond(state.curvature.used, curved, gauss_newton)

    def costs(step):
        cost = 0.5 * jnp.sum((W @ step + error) ** 2)
        return jnp.stack([cost, cost + 0.5 * jnp.sum(step * (S @ step))])

    predicted = costs(qp.lambda_p)
    cost = predicted[state.curvature.used.astype(jnp.int32)]
    # A wrong curvature may shorten a step: both models must find it small.
    vanishes = _small(problem, settings, state, qp, cost) & now.ok

    def linearly():
        step = gauss_newton()
        return _small(problem, settings, state, step, costs(step.lambda_p)[0])

    vanishes = jax.lax.cond(vanishes & state.curvature.used, linearly, lambda: vanishes)
    z = _moved(space, state.z, qp.lambda_p)
    guess = before = now.equilibrium.displacement
    if now.tangents is not None:
        dz = linear.J @ qp.lambda_p
        guess = before + jnp.einsum("p,cpni->cni", dz, now.tangents)
    stay = lambda new, old: jnp.where(vanishes, old, new)
    return Proposal(
        qp,
        stay(z, state.z),
        stay(guess, before),
        before,
        cost,
        predicted,
        now.cost - cost <= SLOW * now.cost,
        vanishes,
    )


class LinearModel(NamedTuple):
    """Errors to first order in step coordinates, those of the prior included.

    `J` is the change of z per coordinate.
    """

    W: Float[Array, "n_rows n_p"]
    error: Float[Array, " n_rows"]
    J: Float[Array, "n_p n_p"]


def linear_model(
    space: ParameterSpace, z: Float[Array, " n_p"], evaluation: Evaluation
) -> LinearModel:
    """Linearise the errors of an evaluation in step coordinates."""
    W_ep, error = evaluation.W_ep, evaluation.error
    if space.has_prior:
        W_ep = jnp.concatenate([W_ep, jnp.diag(space.prior_weights())])
        error = jnp.concatenate([error, evaluation.prior])
    if space.chart is None:
        return LinearModel(W_ep, error, jnp.eye(z.shape[0]))
    J = jax.jacfwd(space.chart.from_tensor)(space.chart.to_tensor(z))
    return LinearModel(W_ep @ J, error, J)


def _moved(
    space: ParameterSpace, z: Float[Array, " n_p"], step: Float[Array, " n_p"]
) -> Float[Array, " n_p"]:
    """Return parameters after a step, which moves tensors where axes have a chart."""
    if space.chart is None:
        return space.wrap(z + step)
    chart = space.chart
    return space.admissible(chart.from_tensor(chart.to_tensor(z) + step))


class _Limits(NamedTuple):
    """Constraints of a step: bounds of its entries, and rows A step <= b."""

    low: Float[Array, " n_p"]
    high: Float[Array, " n_p"]
    A: Float[Array, "n_rows n_p"]
    b: Float[Array, " n_rows"]

    def solve(self, W, error, damping: float) -> QPStep:
        """Return the QP step within them."""
        return bounded_step(
            W, error, self.low, self.high, A=self.A, b=self.b, damping=damping
        )


def _limits(problem: CalibrationProblem, state: CalibrationState, J) -> _Limits:
    space, chart = problem.space, problem.space.chart
    limit = jnp.minimum(state.step_bound, space.max_step())
    down, up = space.room(state.z)
    low, high = jnp.maximum(down, -limit), jnp.minimum(up, limit)
    A, b = space.order_rows()
    b = b - A @ state.z
    if chart is None:
        return _Limits(low, high, A, b)
    # The QP steps tensors, so the bounds of the moduli become rows.
    moduli = np.concatenate([chart.small, chart.large])
    free = np.concatenate([moduli, chart.angle])
    return _Limits(
        low.at[free].set(-state.step_bound),
        high.at[free].set(state.step_bound),
        jnp.concatenate([A @ J, J[moduli], -J[moduli]]),
        jnp.concatenate([b, up[moduli], -down[moduli]]),
    )


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
    free = ~is_at_bound(problem, state, qp) & (qp.kkt_residual <= KKT_TOLERANCE)
    return ((size <= settings.tol) | no_gain) & free


def is_at_bound(
    problem: CalibrationProblem, state: CalibrationState, qp: QPStep
) -> Bool[Array, ""]:
    """Return whether a step is as long as the trust region allows."""
    limit = jnp.minimum(state.step_bound, problem.space.max_step())
    return jnp.any(jnp.abs(qp.lambda_p) >= 0.99 * limit)
