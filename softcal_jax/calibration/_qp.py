"""The constrained QP step on the stacked errors (paper Eqs. 10 and 11)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import lu_factor, lu_solve
from jaxopt import BoxOSQP
from jaxopt.base import KKTSolution

from softcal_jax._typing import Array, Bool, Float, Int, is_traced

DAMPING = 1e-10
"""Damping of the step, for columns of W of unit length [-].

Along a direction that the data do not see, rounding in the errors would move the
parameters anywhere; this leaves them where they are. The minimum is not shifted: the
error itself, not the parameters, is what a step still reduces.
"""

ROW_REGULARISATION = 1e-12
"""Regularises dependent active rows, for rows of unit length; refined away [-]."""

EXCHANGES = 10
"""Solutions with an exchanged active set before it is taken to cycle."""

TRIFLE = 1e-8
"""How far a row is moved to part it from others, in extents of the row [-]."""

ROUNDING = 1e-14
"""Sign errors of this size do not change the active set, for data of unit size [-]."""


class QPStep(NamedTuple):
    """Solution of the QP and its check.

    Attributes:
        lambda_p: The step, in scaled units [-].
        kkt_residual: Largest violation of the optimality conditions, for columns of W,
            rows of A and an error of unit length [-].
    """

    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]


class _Scaled(NamedTuple):
    """min y.Q.y / 2 + c.y for low <= y <= high and R y <= r, all of unit size [-]."""

    Q: Float[Array, "n_p n_p"]
    c: Float[Array, " n_p"]
    low: Float[Array, " n_p"]
    high: Float[Array, " n_p"]
    R: Float[Array, "n_rows n_p"]
    r: Float[Array, " n_rows"]


class _Point(NamedTuple):
    """A point within the bounds, multipliers of its rows, and how optimal they are."""

    y: Float[Array, " n_p"]
    mu: Float[Array, " n_rows"]
    kkt: Float[Array, ""]


class _Descent(NamedTuple):
    """Loop of the downhill method: -1 at a lower, 1 at an upper limit, 0 free."""

    side: Int[Array, " n_p"]
    row: Int[Array, " n_rows"]
    y: Float[Array, " n_p"]
    step: Int[Array, ""]
    settled: Bool[Array, ""]


class _Exchange(NamedTuple):
    """Loop of the exchanges: the active set as in `_Descent`."""

    side: Int[Array, " n_p"]
    row: Int[Array, " n_rows"]
    best: _Point
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

    To this, `damping` adds damping / 2 times ||D l||^2, with D the lengths of the
    columns of W. By `jaxopt.BoxOSQP` on a problem scaled to unit columns, rows and
    error, started where an active-set method ends and polished by the same: bounds and
    rows that it found active are taken as equalities, the rest is solved exactly, and
    the set is corrected (Stellato et al., OSQP, Math. Prog. Comp. 12, 2020, Sec. 5.2).
    Its default inner solver, conjugate gradients, can end far from optimal on a flat
    valley; hence the direct one.

    Args:
        W: Stacked compliances in noise units [-].
        error: Stacked errors before the step, Delta_e0, in noise units [-].
        lower: Lower bounds of the step [-].
        upper: Upper bounds of the step [-].
        A: Rows of linear inequalities on the step, as E_l <= E_t; none by default [-].
        b: Their right-hand sides, given with `A` [-].
        damping: Damping of the step, positive, for columns of W of unit length [-].

    Returns:
        The step with its KKT residual. It is clipped into its bounds; active rows are
        solved as equalities and hold to rounding, or the residual says by how much
        not. Bounds or rows that exclude each other give a finite step and a large
        residual; data that are not finite an infinite one.

    Raises:
        ValueError: If only one of `A` and `b` is given, or `damping` is not positive.
    """
    if (A is None) != (b is None):
        raise ValueError("A and b describe the rows together: give both or neither.")
    if not is_traced(damping) and not damping > 0.0:
        raise ValueError(f"damping must be positive, got {damping}.")
    if A is None or b is None:
        A, b = jnp.zeros((0, W.shape[1]), W.dtype), jnp.zeros(0, W.dtype)
    qp, unit = _scaled(W, error, lower, upper, A, b, damping)
    best = _solve(qp)
    # Clipped once more, since scaling back rounds.
    return QPStep(jnp.clip(best.y * unit, lower, upper), best.kkt)


def _scaled(W, error, lower, upper, A, b, damping) -> tuple[_Scaled, Array]:
    """The problem in unit columns, rows and error, and the step of its unit."""
    size = jnp.linalg.norm(W, axis=0)
    # A parameter without any effect keeps its scale, and does not move.
    size = jnp.where(size > 0.0, size, 1.0)
    R = A / size[None, :]
    length = jnp.linalg.norm(R, axis=1)
    length = jnp.where(length > 0.0, length, 1.0)
    # The error sets the scale; where no step is no choice, so does the way to go.
    way = jnp.concatenate(
        [size * jnp.clip(0.0, lower, upper), jnp.minimum(b, 0.0) / length]
    )
    level = jnp.maximum(jnp.linalg.norm(error), jnp.max(jnp.abs(way)))
    level = jnp.where(level > jnp.finfo(W.dtype).tiny, level, 1.0)
    V = W / size[None, :]
    qp = _Scaled(
        V.T @ V + damping * jnp.eye(W.shape[1], dtype=W.dtype),
        V.T @ (error / level),
        lower * size / level,
        upper * size / level,
        R / length[:, None],
        b / length / level,
    )
    return qp, level / size


def _solve(qp: _Scaled) -> _Point:
    """Active set, then BoxOSQP from there, then active set from where that ends."""
    n = qp.c.shape[0]
    zero, none = jnp.zeros_like(qp.c), jnp.zeros_like(qp.r)
    nothing = _best(qp, _Point(zero, none, jnp.full((), jnp.inf)), zero, none)
    start = _exchange(qp, *_descend(qp), nothing)

    G = jnp.concatenate([jnp.eye(n, dtype=qp.c.dtype), qp.R])
    limits = (
        jnp.concatenate([qp.low, jnp.full_like(qp.r, -jnp.inf)]),
        jnp.concatenate([qp.high, qp.r]),
    )
    dual = jnp.concatenate([-_gradient(qp, start.y, start.mu), start.mu])
    solver = BoxOSQP(
        eq_qp_solve="lu", tol=1e-10, maxiter=4000, check_primal_dual_infeasability=False
    )
    first = KKTSolution((start.y, jnp.clip(G @ start.y, *limits)), dual, (dual, dual))
    params, _ = solver.run(first, (qp.Q, qp.c), G, limits)

    (y, z), dual = params.primal, params.dual_eq
    best = _best(qp, start, y, dual[n:])
    # BoxOSQP projects z, so what it holds active lies on its limit exactly.
    at_low, at_high = (z == limits[0]) & (dual < 0.0), (z == limits[1]) & (dual > 0.0)
    side = jnp.where(at_high, 1, jnp.where(at_low, -1, 0)).astype(jnp.int32)
    return _exchange(qp, side[:n], side[n:], best)


def _gradient(qp: _Scaled, y, mu):
    """Gradient of the Lagrangian without the bounds."""
    return qp.Q @ y + qp.c + qp.R.T @ mu


def _extent(qp: _Scaled):
    """How far each row varies over the box, at most one; the scale of its slack."""
    width = jnp.abs(qp.high - qp.low)[None, :]
    # Not `R @ width`: a zero times an infinite width is not a number.
    part = jnp.where(qp.R == 0.0, 0.0, jnp.abs(qp.R) * width)
    return jnp.clip(jnp.sum(part, axis=1), jnp.finfo(width.dtype).eps, 1.0)


def _best(qp: _Scaled, best: _Point, y, mu) -> _Point:
    """The better of two points by KKT residual; one that is not finite never wins."""
    y, mu = jnp.clip(y, qp.low, qp.high), jnp.maximum(mu, 0.0)
    new = _Point(y, mu, _kkt_residual(qp, y, mu))
    better = (new.kkt < best.kkt) & jnp.isfinite(new.kkt)
    return jax.tree.map(lambda a, b: jnp.where(better, a, b), new, best)


def _kkt_residual(qp: _Scaled, y, mu):
    """Largest violation of the KKT conditions: zero at the optimum and only there.

    A gradient must vanish or push against a bound where y lies: the smaller of push
    and distance counts. Likewise for a multiplier and the slack of its row. In a tight
    box every distance is short; there it counts as a part of the box.
    """
    eps = jnp.finfo(y.dtype).eps
    gradient, slack = _gradient(qp, y, mu), qp.r - qp.R @ y
    width = jnp.clip(jnp.abs(qp.high - qp.low), eps, 1.0)
    extent = _extent(qp)
    to_low, to_high = (y - qp.low) / width, (qp.high - y) / width
    # What rounding leaves of an equality is no violation.
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


def _wrong_multipliers(qp: _Scaled, side, row, y, mu):
    """How far the multipliers of active bounds and rows are below zero."""
    gradient = _gradient(qp, y, mu)
    bounds = jnp.where(side > 0, gradient, jnp.where(side < 0, -gradient, 0.0))
    return bounds, jnp.where(row != 0, -mu, 0.0)


def _descend(qp: _Scaled) -> tuple[Int[Array, " n_p"], Int[Array, " n_rows"]]:
    """Active bounds and rows, found by changes of one entry at a time, downhill.

    The primal active-set method (Nocedal and Wright, Numerical Optimization, 2006, Alg.
    16.3) from the point nearest to no step. A row that this point violates is relaxed
    to it; what then remains is left to BoxOSQP. Each row is moved outwards by a trifle
    of its own: where more rows meet than there are parameters, changes could cycle.
    """
    n, n_rows = qp.c.shape[0], qp.r.shape[0]
    start = jnp.clip(0.0, qp.low, qp.high)
    trifle = TRIFLE * (1.0 + jnp.arange(n_rows, dtype=qp.r.dtype) * 0.618 % 1.0)
    rows = jnp.maximum(qp.r, qp.R @ start) + trifle * _extent(qp)
    relaxed = qp._replace(r=rows)

    def change(state: _Descent) -> _Descent:
        side, row = state.side, state.row
        target, mu = _equality_solution(relaxed, side, row, passes=1)
        move = target - state.y
        room = jnp.where(move > 0.0, qp.high - state.y, state.y - qp.low)
        along, slack = qp.R @ move, relaxed.r - qp.R @ state.y
        # Only a free bound or row ahead can stop the move.
        ahead = jnp.concatenate(
            [(side == 0) & (move != 0.0), (row == 0) & (along > 0.0)]
        )
        speed = jnp.where(ahead, jnp.concatenate([jnp.abs(move), along]), 1.0)
        room = jnp.maximum(jnp.concatenate([room, slack]), 0.0)
        ratio = jnp.where(ahead, room / speed, jnp.inf)
        stopped = jnp.min(ratio) < 1.0
        y = jnp.clip(state.y + jnp.minimum(jnp.min(ratio), 1.0) * move, qp.low, qp.high)
        wrong = jnp.concatenate(_wrong_multipliers(relaxed, side, row, target, mu))
        stop, drop = (jnp.arange(n + n_rows) == jnp.argmax(v) for v in (-ratio, wrong))
        end = jnp.concatenate([jnp.where(move > 0.0, 1, -1), jnp.ones(n_rows, int)])
        old = jnp.concatenate([side, row])
        added = jnp.where(stop, end.astype(old.dtype), old)
        dropped = jnp.where(drop & (wrong > ROUNDING), 0, old)
        new = jnp.where(stopped, added, dropped)
        settled = ~stopped & ~jnp.any(wrong > ROUNDING)
        return _Descent(new[:n], new[n:], y, state.step + 1, settled)

    max_steps = 4 * (n + n_rows)
    going = lambda state: ~state.settled & (state.step < max_steps)
    free, none = jnp.zeros(n, jnp.int32), jnp.zeros(n_rows, jnp.int32)
    count, false = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
    state = _Descent(free, none, start, count, false)
    state = jax.lax.while_loop(going, change, state)
    return state.side, state.row


def _exchange(qp: _Scaled, side, row, best: _Point) -> _Point:
    """Solve with an active set, correct it by all signs at once, till it stands.

    A primal-dual active-set method (Hintermueller, Ito and Kunisch, SIAM J. Optim. 13,
    2002): few steps where it works, a cycle where it does not; hence the cap.
    """

    def correct(state: _Exchange) -> _Exchange:
        side, row = state.side, state.row
        y, mu = _equality_solution(qp, side, row, passes=3)
        tol = ROUNDING * (1.0 + jnp.max(jnp.abs(y)))
        wrong_side, wrong_row = _wrong_multipliers(qp, side, row, y, mu)
        above, below = y > qp.high + tol, y < qp.low - tol
        outside = jnp.where(above, 1, jnp.where(below, -1, 0)).astype(side.dtype)
        over = (qp.R @ y > qp.r + tol).astype(row.dtype)
        new_side = jnp.where(wrong_side > ROUNDING, 0, jnp.where(side, side, outside))
        new_row = jnp.where(wrong_row > ROUNDING, 0, jnp.where(row, row, over))
        settled = jnp.all(new_side == side) & jnp.all(new_row == row)
        best = _best(qp, state.best, y, mu)
        return _Exchange(new_side, new_row, best, state.step + 1, settled)

    going = lambda state: ~state.settled & (state.step < EXCHANGES)
    false, none = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    state = _Exchange(side, row, best, none, false)
    return jax.lax.while_loop(going, correct, state).best


def _equality_solution(qp: _Scaled, side, row, passes: int):
    """Point and row multipliers with the active bounds and rows as equalities.

    Dependent rows would make the system singular: they are regularised, and further
    passes with the true matrix take the effect of that back.
    """
    n, held, active = side.shape[0], side != 0, row != 0
    bound = jnp.where(side > 0, qp.high, qp.low)
    eye = lambda size: jnp.eye(size, dtype=qp.c.dtype)
    K = jnp.block(
        [
            [
                jnp.where(held[:, None], eye(n), qp.Q),
                jnp.where(held[:, None], 0.0, qp.R.T),
            ],
            [
                jnp.where(active[:, None], qp.R, 0.0),
                jnp.where(active[:, None], 0.0, eye(row.shape[0])),
            ],
        ]
    )
    right = jnp.concatenate(
        [jnp.where(held, bound, -qp.c), jnp.where(active, qp.r, 0.0)]
    )
    shift = jnp.concatenate([jnp.zeros(n), jnp.where(active, ROW_REGULARISATION, 0.0)])
    factors = lu_factor(K - jnp.diag(shift))
    improve = lambda _, x: x + lu_solve(factors, right - K @ x)
    solution = jax.lax.fori_loop(0, passes, improve, jnp.zeros_like(right))
    return solution[:n], solution[n:]
