"""The constrained QP step on the stacked errors (paper Eqs. 10, 11), and curvature."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import lu_factor, lu_solve

from softcal_jax._typing import Array, Bool, Float, Int, is_traced

DAMPING = 1e-10
"""Damping of the step, for columns of W of unit length [-].

Along a direction that the data do not see, rounding in the errors would move the
parameters arbitrarily. The minimum does not shift, since only the step is damped.
"""

ROW_REGULARISATION = 1e-12
"""Regularisation of dependent active rows of unit length; refinement removes it [-]."""

ROW_SHIFT = 1e-8
"""Shift that separates rows that meet in one point, relative to their extent [-]."""

PENALTY = 1e4
"""Cost of violating rows, above the sum of the multipliers of unit data [-]."""

SLIGHT = 1e-7  # violation of a row that BoxOSQP may leave, for unit data [-]

ROUNDING = 1e-14
"""Largest multiplier of the wrong sign that counts as rounding, for unit data [-]."""

KKT_TOLERANCE = 1e-6  # largest optimality residual with which a step is trusted [-]
MOST_LEFT, MOST_ITERATIONS = 1e-8, 1000  # at which BoxOSQP stops
SOLVED = 1e-12  # optimality residual at which a point is not polished any further [-]
FLATTEST = 1e-8  # smallest curvature of the convex model, relative to the largest [-]


class QPStep(NamedTuple):
    """Solution of the QP, in scaled units [-].

    `kkt_residual` is the largest violation of the optimality conditions, for columns of
    W, rows of A and an error of unit length; `by_polish` says whether BoxOSQP alone had
    left more than `KKT_TOLERANCE`.
    """

    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]
    by_polish: Bool[Array, ""]


class QPLimits(NamedTuple):
    """Constraints of a step, lower <= l <= upper and A l <= b, and its damping [-]."""

    lower: Float[Array, " n_p"]
    upper: Float[Array, " n_p"]
    A: Float[Array, "n_rows n_p"]
    b: Float[Array, " n_rows"]
    damping: float | Float[Array, ""]


class ScaledQP(NamedTuple):
    """min y.Q.y / 2 + c.y for low <= y <= high and R y <= r, all of unit size [-].

    The step is `unit` * y, within the limits `lower` and `upper`.
    """

    Q: Float[Array, "n_p n_p"]
    c: Float[Array, " n_p"]
    low: Float[Array, " n_p"]
    high: Float[Array, " n_p"]
    R: Float[Array, "n_rows n_p"]
    r: Float[Array, " n_rows"]
    unit: Float[Array, " n_p"]
    lower: Float[Array, " n_p"]
    upper: Float[Array, " n_p"]


class _Candidate(NamedTuple):
    """A point within the bounds, the multipliers of its rows, and its residual [-]."""

    y: Float[Array, " n_p"]
    mu: Float[Array, " n_rows"]
    kkt: Float[Array, ""]


class _ActiveSet(NamedTuple):
    """State of the active-set method; `active` is -1 at lower limits, 1 at upper."""

    active: Int[Array, " n_p+n_rows"]
    y: Float[Array, " n_p"]
    step: Int[Array, ""]
    settled: Bool[Array, ""]


def bounded_step(
    W: Float[Array, "n_e n_p"],
    error: Float[Array, " n_e"],
    lower: Float[Array, " n_p"],
    upper: Float[Array, " n_p"],
    *,
    A: Float[Array, "n_rows n_p"] | None = None,
    b: Float[Array, " n_rows"] | None = None,
    damping: float | Float[Array, ""] = DAMPING,
) -> QPStep:
    """Minimise ||W l + error||^2 / 2 for lower <= l <= upper and A l <= b.

    `damping` adds damping / 2 times ||D l||^2, with D the lengths of the columns of W.
    `jaxopt.BoxOSQP` solves the problem scaled to unit columns, rows and error. Then an
    active-set method polishes its solution, by solving with the constraints that are
    active at the end as equalities, which is exact (`python -m benchmarks run qp`
    measures which of the two decides).

    Args:
        W: Stacked compliances in noise units [-].
        error: Stacked errors before the step, Delta_e0, in noise units [-].
        lower: Lower bounds of the step [-].
        upper: Upper bounds of the step [-].
        A: Rows of linear inequalities on the step, as E_l <= E_t [-].
        b: Their right-hand sides, given with `A` [-].
        damping: Damping of the step, positive, for columns of W of unit length [-].

    Returns:
        The step, clipped to its bounds. Active rows hold to rounding. Where bounds or
        rows exclude each other the residual is large; for infinite data it is infinite.

    Raises:
        ValueError: If only one of `A` and `b` is given, or `damping` is not positive.
    """
    if (A is None) != (b is None):
        raise ValueError("A and b describe the rows together: give both or neither.")
    if not is_traced(damping) and not damping > 0.0:
        raise ValueError(f"damping must be positive, got {damping}.")
    if A is None or b is None:
        A, b = jnp.zeros((0, W.shape[1]), W.dtype), jnp.zeros(0, W.dtype)
    limits = QPLimits(lower, upper, A, b, jnp.asarray(damping))
    return _bounded_step(W, error, limits)


@jax.jit
def _bounded_step(W, error, limits: QPLimits) -> QPStep:
    return solved_qp(scaled_qp(W, error, limits))


def scaled_qp(
    W: Float[Array, "n_e n_p"], error: Float[Array, " n_e"], limits: QPLimits
) -> ScaledQP:
    """Scale the QP of `bounded_step` to unit columns, rows and error."""
    lower, upper, A, b, damping = limits
    size = jnp.linalg.norm(W, axis=0)
    # A parameter without any effect keeps its scale and does not move.
    size = jnp.where(size > 0.0, size, 1.0)
    R = A / size[None, :]
    length = jnp.linalg.norm(R, axis=1)
    length = jnp.where(length > 0.0, length, 1.0)
    # The error sets the scale, or the constraints that a step of zero violates.
    violation = jnp.concatenate(
        [size * jnp.clip(0.0, lower, upper), jnp.minimum(b, 0.0) / length]
    )
    level = jnp.maximum(jnp.linalg.norm(error), jnp.max(jnp.abs(violation)))
    level = jnp.where(level > jnp.finfo(W.dtype).tiny, level, 1.0)
    V = W / size[None, :]
    return ScaledQP(
        Q=V.T @ V + damping * jnp.eye(W.shape[1], dtype=W.dtype),
        c=V.T @ (error / level),
        low=lower * size / level,
        high=upper * size / level,
        R=R / length[:, None],
        r=b / length / level,
        unit=level / size,
        lower=lower,
        upper=upper,
    )


def solved_qp(qp: ScaledQP) -> QPStep:
    """Run BoxOSQP from no step, and polish its solution."""
    nothing = _no_step(qp)
    iterated = _iterated(qp, nothing)
    best = _polished(qp, iterated, nothing)
    # Scaling back rounds.
    step = jnp.clip(best.y * qp.unit, qp.lower, qp.upper)
    return QPStep(step, best.kkt, iterated.kkt > KKT_TOLERANCE)


def _no_step(qp: ScaledQP) -> _Candidate:
    """Return the point within the bounds that is nearest to zero."""
    zero, none = jnp.zeros_like(qp.c), jnp.zeros_like(qp.r)
    nothing = _Candidate(zero, none, jnp.full((), jnp.inf, qp.c.dtype))
    return _better(qp, nothing, zero, none)


def _iterated(qp: ScaledQP, start: _Candidate) -> _Candidate:
    """Run BoxOSQP from a point, with limits and rows scaled to a range of one."""
    # Here, so that commands which do not need it do not wait for it.
    from jaxopt import BoxOSQP
    from jaxopt.base import KKTSolution

    n = qp.c.shape[0]
    width = jnp.concatenate([_width(qp), _extent(qp)])
    G = jnp.concatenate([jnp.eye(n, dtype=qp.c.dtype), qp.R]) / width[:, None]
    limits = (
        jnp.concatenate([qp.low, jnp.full_like(qp.r, -jnp.inf)]) / width,
        jnp.concatenate([qp.high, qp.r]) / width,
    )
    none = jnp.zeros_like(width)
    # LU: conjugate gradients, the default, can end far off in a flat valley. A new
    # step size takes a while to show whether it is better.
    solver = BoxOSQP(
        eq_qp_solve="lu",
        tol=MOST_LEFT,
        maxiter=MOST_ITERATIONS,
        stepsize_updates_frequency=25,
        check_primal_dual_infeasability=False,
    )
    first = KKTSolution((start.y, jnp.clip(G @ start.y, *limits)), none, (none, none))
    params, _ = solver.run(first, (qp.Q, qp.c), G, limits)
    return _better(qp, start, params.primal[0], (params.dual_eq / width)[n:])


def _gradient(qp: ScaledQP, y, mu):
    """Return the gradient of the Lagrangian without the bounds."""
    return qp.Q @ y + qp.c + qp.R.T @ mu


def _width(qp: ScaledQP):
    """Return the width of the box in each coordinate, at most one."""
    return jnp.clip(jnp.abs(qp.high - qp.low), jnp.finfo(qp.c.dtype).eps, 1.0)


def _extent(qp: ScaledQP):
    """Return the range of each row over the box, at most one, to scale its slack."""
    width = jnp.abs(qp.high - qp.low)[None, :]
    # Not `R @ width`: zero times an infinite width is NaN.
    part = jnp.where(qp.R == 0.0, 0.0, jnp.abs(qp.R) * width)
    return jnp.clip(jnp.sum(part, axis=1), jnp.finfo(width.dtype).eps, 1.0)


def _better(qp: ScaledQP, best: _Candidate, y, mu) -> _Candidate:
    """Return the point of smaller KKT residual; one that is not finite never wins."""
    y, mu = jnp.clip(y, qp.low, qp.high), jnp.maximum(mu, 0.0)
    new = _Candidate(y, mu, _kkt_residual(qp, y, mu))
    better = (new.kkt < best.kkt) & jnp.isfinite(new.kkt)
    return jax.tree.map(lambda a, b: jnp.where(better, a, b), new, best)


def _kkt_residual(qp: ScaledQP, y, mu):
    """Return the largest violation of the KKT conditions: zero only at the optimum.

    A component of the gradient must vanish, or push against a bound that y has reached:
    the smaller of push and distance counts, and likewise of the multiplier of a row and
    its slack. In a tight box all distances are short, so they count relative to it.
    """
    eps = jnp.finfo(y.dtype).eps
    gradient, slack = _gradient(qp, y, mu), qp.r - qp.R @ y
    width, extent = _width(qp), _extent(qp)
    to_low, to_high = (y - qp.low) / width, (qp.high - y) / width
    # The rounding of an active row is no violation.
    rounding = 8.0 * eps * (jnp.abs(qp.R) @ jnp.abs(y) + jnp.abs(qp.r))
    violated = jnp.maximum(-slack - rounding, 0.0) / extent
    violations = [
        jnp.minimum(jnp.maximum(gradient, 0.0), to_low),
        jnp.minimum(jnp.maximum(-gradient, 0.0), to_high),
        -to_low,
        -to_high,
        jnp.minimum(mu, jnp.maximum(slack, 0.0) / extent),
        -mu,
        violated,
    ]
    return jnp.max(jnp.concatenate([jnp.maximum(v, 0.0) for v in violations]))


def _polished(qp: ScaledQP, iterated: _Candidate, nothing: _Candidate) -> _Candidate:
    """Descend from what BoxOSQP found, and from no step where that is a dead end."""

    def descend(state: tuple[Int[Array, ""], _Candidate]):
        tried, best = state
        first = tried == 0
        start = jax.tree.map(lambda a, b: jnp.where(first, a, b), iterated, nothing)
        end = _descended(qp, start)
        return tried + 1, _better(qp, best, end.y, end.mu)

    def unsolved(state: tuple[Int[Array, ""], _Candidate]):
        tried, best = state
        return (tried < 2) & (best.kkt > jnp.where(tried == 0, SOLVED, KKT_TOLERANCE))

    begin = jnp.zeros((), jnp.int32), iterated
    return jax.lax.while_loop(unsolved, descend, begin)[1]


def _descended(qp: ScaledQP, start: _Candidate) -> _Candidate:
    """Descend from a point by an active-set method, and solve with its last active set.

    The primal active-set method (Nocedal and Wright, Numerical Optimization, 2006, Alg.
    16.3) changes one active constraint at a time, so the cost never rises. It needs a
    start that satisfies the rows, see `_elastic`. Until it ends, all rows are shifted
    outwards by different small amounts, since the method could cycle where more rows
    meet than there are parameters.
    """
    n_rows = qp.r.shape[0]
    relaxed, y = _elastic(qp, start.y)
    n = y.shape[0]
    shift = ROW_SHIFT * (1.0 + jnp.arange(n_rows, dtype=qp.r.dtype) * 0.618 % 1.0)
    relaxed = relaxed._replace(r=relaxed.r + shift * _extent(qp))

    def change(state: _ActiveSet) -> _ActiveSet:
        active = state.active
        target, mu = _equality_solution(relaxed, active, passes=1)
        move = target - state.y
        to_bound = jnp.where(move > 0.0, relaxed.high - state.y, state.y - relaxed.low)
        along, slack = relaxed.R @ move, relaxed.r - relaxed.R @ state.y
        # Only inactive constraints that the move approaches can stop it.
        ahead = (active == 0) & jnp.concatenate([move != 0.0, along > 0.0])
        speed = jnp.where(ahead, jnp.concatenate([jnp.abs(move), along]), 1.0)
        room = jnp.maximum(jnp.concatenate([to_bound, slack]), 0.0)
        ratio = jnp.where(ahead, room / speed, jnp.inf)
        length = jnp.minimum(jnp.min(ratio), 1.0)
        stopped = length < 1.0
        # Multipliers of the wrong sign, by size; bounds push against the gradient.
        push = jnp.concatenate([-_gradient(relaxed, target, mu), mu])
        wrong = -active.astype(push.dtype) * push
        place = jnp.arange(n + n_rows)
        side = jnp.concatenate([jnp.where(move > 0.0, 1, -1), jnp.ones(n_rows, int)])
        added = jnp.where(place == jnp.argmin(ratio), side.astype(active.dtype), active)
        drop = (place == jnp.argmax(wrong)) & (wrong > ROUNDING)
        return _ActiveSet(
            active=jnp.where(stopped, added, jnp.where(drop, 0, active)),
            y=jnp.clip(state.y + length * move, relaxed.low, relaxed.high),
            step=state.step + 1,
            settled=~stopped & ~jnp.any(drop),
        )

    going = lambda s: ~s.settled & (s.step < 4 * (n + n_rows))
    feasible = (jnp.arange(n + n_rows) == n - 1) & (y[-1] == 0.0)
    count = jnp.zeros((), jnp.int32)
    state = _ActiveSet(-feasible.astype(jnp.int32), y, count, start.kkt <= SOLVED)
    active = jnp.delete(jax.lax.while_loop(going, change, state).active, n - 1)
    return _better(qp, start, *_equality_solution(qp, active, passes=3))


def _elastic(qp: ScaledQP, y) -> tuple[ScaledQP, Float[Array, " n_p_plus_1"]]:
    """Add a variable that relaxes the rows violated at `y`, and its value there.

    Its cost is so high that it vanishes wherever the rows can be satisfied. Rows that
    are violated by rounding alone are relaxed for good.
    """
    left = qp.R @ y
    far = left > qp.r + SLIGHT
    violation = jnp.where(far, left - qp.r, 0.0)
    worst = jnp.max(violation, initial=0.0)
    share = violation / jnp.where(worst > 0.0, worst, 1.0)
    more = lambda array, value: jnp.append(array, jnp.asarray(value, array.dtype))
    return qp._replace(
        Q=jnp.pad(qp.Q, (0, 1)).at[-1, -1].set(1.0),
        c=more(qp.c, PENALTY),
        low=more(qp.low, 0.0),
        high=more(qp.high, worst),
        R=jnp.column_stack([qp.R, -share]),
        r=jnp.where(far, qp.r, jnp.maximum(qp.r, left)),
    ), more(y, worst)


def _equality_solution(qp: ScaledQP, active, passes: int):
    """Solve for the point and `mu`, with active bounds and rows as equalities.

    Dependent rows would make the system singular: they are regularised, and iterative
    refinement with the true matrix removes the effect.
    """
    n = qp.c.shape[0]
    side, row = active[:n], active[n:] != 0
    held = side != 0
    bound = jnp.where(side > 0, qp.high, qp.low)
    eye = lambda size: jnp.eye(size, dtype=qp.c.dtype)
    free, inactive = ~held[:, None], ~row[:, None]
    K = jnp.block(
        [
            [jnp.where(free, qp.Q, eye(n)), jnp.where(free, qp.R.T, 0.0)],
            [jnp.where(inactive, 0.0, qp.R), jnp.where(inactive, eye(row.size), 0.0)],
        ]
    )
    right = jnp.concatenate([jnp.where(held, bound, -qp.c), jnp.where(row, qp.r, 0.0)])
    shift = jnp.concatenate([jnp.zeros(n), jnp.where(row, ROW_REGULARISATION, 0.0)])
    factors = lu_factor(K - jnp.diag(shift))
    improve = lambda _, x: x + lu_solve(factors, right - K @ x)
    solution = jax.lax.fori_loop(0, passes, improve, jnp.zeros_like(right))
    return solution[:n], solution[n:]


def convex_model(
    W: Float[Array, "n_e n_p"],
    error: Float[Array, " n_e"],
    matrix: Float[Array, "n_p n_p"],
) -> tuple[Float[Array, "n_p n_p"], Float[Array, " n_p"]]:
    """Return W' and error' that have the cost's gradient and, if convex, its Hessian.

    The Hessian is taken apart into eigenvalues, with the columns of W scaled to unit
    length. Negative ones are replaced by their size, so that a step goes downhill.
    """
    size = jnp.linalg.norm(W, axis=0)
    size = jnp.where(size > 0.0, size, 1.0)
    unit = W / size[None, :]
    hessian = unit.T @ unit + matrix / size[:, None] / size[None, :]
    curvatures, axes = jnp.linalg.eigh(hessian)
    curvatures = jnp.abs(curvatures)
    root = jnp.sqrt(jnp.maximum(curvatures, FLATTEST * jnp.max(curvatures)))
    gradient = axes.T @ (unit.T @ error)
    return root[:, None] * axes.T * size[None, :], gradient / root
