from itertools import product

import jax
import jax.numpy as jnp
import jaxopt
import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear, nnls

from softcal_jax.calibration import _qp, bounded_step

ROUNDING = 1e-12
"""What solving equalities in float64 leaves, for data of unit size."""


def n_errors(n):
    return 3 * n + 4


def step(W, error, low, high, A=None, b=None, damping=_qp.DAMPING):
    """`bounded_step`, padded to six parameters and twelve rows: a shared program.

    What pads is measured to stay at zero, and rows without coefficients say nothing.
    """
    n, more = len(low), max(6 - len(low), 0)
    W, error = block_diag(W, np.eye(more)), np.append(error, np.zeros(more))
    missing = n_errors(n + more) - len(error)
    W, error = np.pad(W, ((0, missing), (0, 0))), np.pad(error, (0, missing))
    low, high = np.append(low, -np.ones(more)), np.append(high, np.ones(more))
    if A is not None:
        idle = 12 - len(A)
        A = jnp.asarray(np.pad(A, ((0, idle), (0, more))))
        b = jnp.asarray(np.append(b, np.ones(idle)))
    box = (jnp.asarray(part) for part in (W, error, low, high))
    y, kkt, by_polish = map(np.asarray, bounded_step(*box, A=A, b=b, damping=damping))
    return _qp.QPStep(y[:n], kkt, by_polish)


def random_qp(n, condition, seed):
    rng = np.random.default_rng(seed)
    m = n_errors(n)
    U, _ = np.linalg.qr(rng.normal(size=(m, n)))
    V, _ = np.linalg.qr(rng.normal(size=(n, n)))
    W = U * np.logspace(0, -np.log10(condition), n) @ V.T
    bound = np.abs(rng.normal(size=(2, n)))
    return W, rng.normal(size=m), -bound[0], bound[1]


@pytest.mark.parametrize(("n", "condition"), [(1, 1), (3, 10), (6, 1e3), (12, 1e5)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_step_is_that_of_an_exact_bounded_solver(n, condition, scale):
    """Against SciPy's bounded least squares; the errors may be in any unit."""
    W, error, low, high = random_qp(n, condition, seed=n)
    W, error = scale * W, scale * error
    ours = step(W, error, low, high)
    exact = lsq_linear(W / scale, -error / scale, (low, high), tol=1e-14)
    cost = 0.5 * np.sum(((W @ ours.lambda_p + error) / scale) ** 2)
    # Both are minima; along a flat valley only the cost compares.
    np.testing.assert_allclose(cost, exact.cost, rtol=1e-8)
    assert ours.kkt_residual < 1e-12  # polished: the iteration alone ends at 1e-10
    assert np.all((ours.lambda_p >= low) & (ours.lambda_p <= high))


def test_step_stops_at_an_active_bound():
    lambda_p, kkt, _ = step(np.eye(2), np.array([-3.0, 0.5]), -np.ones(2), np.ones(2))
    np.testing.assert_allclose(lambda_p, [1.0, -0.5], atol=1e-9)
    assert kkt < 1e-9


def test_rank_deficient_compliance_gives_a_finite_bounded_step():
    W = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]])
    one = np.ones(3)
    lambda_p, *_ = step(W, np.array([-1.0, -2.0]), -one, one)
    np.testing.assert_allclose(W @ lambda_p, [1.0, 2.0], atol=1e-8)
    assert lambda_p[2] == 0.0  # a parameter without effect does not move
    assert np.all(np.abs(lambda_p) <= 1.0)


def test_no_error_means_no_step():
    lambda_p, *_ = step(np.eye(2), np.zeros(2), -np.ones(2), np.ones(2))
    np.testing.assert_array_equal(lambda_p, 0.0)


def ordered_qp(n, n_rows, condition, seed):
    """Rows a_i l_i - a_j l_j <= b of any size, half of them active at no step."""
    W, error, low, high = random_qp(n, condition, seed)
    rng = np.random.default_rng(seed + 1000)
    A = np.zeros((n_rows, n))
    for row in A:
        row[rng.choice(n, 2, replace=False)] = np.exp(2.0 * rng.normal(size=2)) * [
            1,
            -1,
        ]
    b = np.abs(rng.normal(size=n_rows)) * rng.integers(0, 2, n_rows)
    return W, error, low, high, A, b


def enumerated_minimum(Q, c, low, high, A, b):
    """Least y.Q.y / 2 + c.y: the optimum solves the equalities of some active set."""
    n, best = len(c), np.inf
    G, limit = np.vstack([np.eye(n), -np.eye(n), A]), np.concatenate([high, -low, b])
    for sides in product([(), (0,), (1,)], repeat=n):
        held = [i + n * s for i, side in enumerate(sides) for s in side]
        for rows in product([False, True], repeat=len(b)):
            active = held + [2 * n + j for j, row in enumerate(rows) if row]
            N = G[active]
            K = np.block([[Q, N.T], [N, np.zeros((len(N), len(N)))]])
            right = np.concatenate([-c, limit[active]])
            y = np.linalg.lstsq(K, right, rcond=1e-13)[0][:n]
            if np.all(G @ y <= limit + 1e-10):
                best = min(best, 0.5 * y @ Q @ y + c @ y)
    return best


def stationarity_defect(W, error, low, high, A, b, y):
    """Part of the gradient that no push of active limits explains, by SciPy's NNLS."""
    size = np.linalg.norm(W, axis=0)
    gradient = W.T @ (W @ y + error) / size + 1e-10 * size * y
    G = np.vstack([np.diag(size), -np.diag(size), A]) / size
    limit = np.concatenate([high, -low, b])
    rounding = 1e-11 * (1.0 + np.abs(limit))
    active = np.abs(np.vstack([np.eye(len(y)), -np.eye(len(y)), A]) @ y - limit)
    normals = G[active <= rounding].T
    return nnls(normals, -gradient)[1] if normals.size else np.linalg.norm(gradient)


def factored(Q, c):
    """W and error with ||W y + error||^2 / 2 = y.Q.y / 2 + c.y + constant."""
    W = np.linalg.cholesky(Q).T
    return W, np.linalg.solve(W.T, c)


HOCK_SCHITTKOWSKI = {
    # Q, c, constant, low, high, A, b, minimiser, minimum
    "HS21": (
        np.diag([0.02, 2.0]),
        [0.0, 0.0],
        -100.0,
        ([2.0, -50.0], [50.0, 50.0]),
        ([[-10.0, 1.0]], [-10.0]),
        [2.0, 0.0],
        -99.96,
    ),
    "HS35": (
        [[4.0, 2.0, 2.0], [2.0, 4.0, 0.0], [2.0, 0.0, 2.0]],
        [-8.0, -6.0, -4.0],
        9.0,
        (np.zeros(3), np.full(3, np.inf)),
        ([[1.0, 1.0, 2.0]], [3.0]),
        [4 / 3, 7 / 9, 4 / 9],
        1 / 9,
    ),
    "HS76": (
        [[2.0, 0, -1, 0], [0, 1.0, 0, 0], [-1, 0, 2.0, 1], [0, 0, 1, 1.0]],
        [-1.0, -3.0, 1.0, -1.0],
        0.0,
        (np.zeros(4), np.full(4, np.inf)),
        (
            [[1.0, 2, 1, 1], [3.0, 1, 2, -1], [0.0, -1, -4, 0]],
            [5.0, 4.0, -1.5],
        ),
        [3 / 11, 23 / 11, 0.0, 6 / 11],
        -4.681818,
    ),
}


@pytest.mark.parametrize("name", HOCK_SCHITTKOWSKI)
def test_step_is_the_published_minimum(name):
    """Hock and Schittkowski, Test Examples for Nonlinear Programming Codes, 1981."""
    Q, c, constant, bounds, rows, minimiser, minimum = HOCK_SCHITTKOWSKI[name]
    Q, c = np.array(Q), np.array(c)
    A, b = (np.array(part) for part in rows)
    W, error = factored(Q, c)
    low, high = (np.array(bound) for bound in bounds)
    y, kkt, _ = step(W, error, low, high, A=A, b=b, damping=1e-15)
    y = np.asarray(y)
    # Seven digits are published; the minimisers are exact fractions.
    np.testing.assert_allclose(y @ Q @ y / 2 + c @ y + constant, minimum, rtol=2e-7)
    np.testing.assert_allclose(y, minimiser, atol=1e-11)
    assert kkt < ROUNDING


@pytest.mark.parametrize("condition", [1.0, 1e3, 1e5])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_step_with_rows_is_the_best_of_all_active_sets(condition, seed, scale):
    W, error, low, high, A, b = ordered_qp(4, 3, condition, seed)
    y, kkt, _ = step(scale * W, scale * error, low, high, A=A, b=b)
    y, size = np.asarray(y), np.linalg.norm(W, axis=0)
    Q = W.T @ W + 1e-10 * np.diag(size**2)
    cost = 0.5 * y @ Q @ y + (W.T @ error) @ y
    exact = enumerated_minimum(Q, W.T @ error, low, high, A, b)
    # The minimum of a quadratic is found to the square of the point's error.
    np.testing.assert_allclose(cost, exact, rtol=1e-10, atol=1e-13)
    assert kkt < ROUNDING
    assert np.all((y >= low) & (y <= high))
    assert np.all(A @ y <= b + ROUNDING * (1.0 + np.abs(A).sum(axis=1)))


@pytest.mark.parametrize(("n", "n_rows"), [(5, 12), (6, 2), (36, 12)])
@pytest.mark.parametrize("condition", [10.0, 1e3, 1e5])
@pytest.mark.parametrize("seed", range(5))
def test_gradient_is_a_push_of_active_limits(n, n_rows, condition, seed):
    """Necessary and, the problem being convex, enough for the minimum at any size."""
    W, error, low, high, A, b = ordered_qp(n, n_rows, condition, seed)
    y, kkt, _ = step(W, error, low, high, A=A, b=b)
    assert stationarity_defect(W, error, low, high, A, b, np.asarray(y)) < 1e-11
    assert kkt < ROUNDING
    assert np.all((y >= low) & (y <= high))
    assert np.all(A @ y <= b + ROUNDING * (1.0 + np.abs(A).sum(axis=1)))


def test_no_rows_is_the_same_step():
    W, error, low, high = random_qp(6, 1e3, seed=6)
    without = step(W, error, low, high)
    arrays = (jnp.asarray(part) for part in (W, error, low, high))
    empty = bounded_step(*arrays, A=jnp.zeros((0, 6)), b=jnp.zeros(0))
    idle = step(W, error, low, high, A=np.eye(6)[:2], b=np.full(2, np.inf))
    np.testing.assert_array_equal(without.lambda_p, empty.lambda_p)
    np.testing.assert_allclose(without.lambda_p, idle.lambda_p, rtol=1e-9)


def test_size_of_a_row_does_not_matter():
    """Rows of any unit describe one half-space, met and judged alike."""
    W, error, low, high, A, b = ordered_qp(4, 3, 10.0, seed=3)
    y, kkt, _ = step(W, error, low, high, A=A, b=b)
    unit = np.array([1e-9, 1.0, 1e9])
    other, kkt_other, _ = step(W, error, low, high, A=A * unit[:, None], b=b * unit)
    np.testing.assert_allclose(other, y, atol=ROUNDING)
    assert max(kkt, kkt_other) < ROUNDING


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_degenerate_active_sets_have_the_one_minimum(push):
    """At a corner more limits meet than there are parameters, and a row comes twice."""
    A = np.array([[1.0, -1.0], [1.0, -1.0], [2.0, -2.0], [1.0, 1.0]])
    b = np.array([0.0, 0.0, 0.0, 2.0])
    error = push * np.array([-3.0, -2.0])
    one = np.ones(2)
    y, kkt, _ = step(np.eye(2), error, -one, one, A=A, b=b)
    exact = one if push > 0 else -one
    np.testing.assert_allclose(y, exact, atol=ROUNDING)
    assert kkt < ROUNDING


def test_opposite_rows_are_an_equality():
    A = np.array([[1.0, -1.0], [-1.0, 1.0], [2.0, -2.0], [-2.0, 2.0]])
    y, kkt, _ = step(
        np.eye(2), np.array([-0.6, 0.2]), -np.ones(2), np.ones(2), A=A, b=np.zeros(4)
    )
    np.testing.assert_allclose(y, [0.2, 0.2], atol=1e-9)  # damped by 1e-10
    assert kkt < ROUNDING


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_rank_deficient_compliance_with_rows(rank):
    """The smallest damped step; rows also move a parameter without effect."""
    rng = np.random.default_rng(rank)
    W = rng.normal(size=(22, rank)) @ rng.normal(size=(rank, 5))
    W = np.hstack([W, np.zeros((22, 1))])
    A = np.array([[1.0, 0, 0, 0, 0, 1], [0, 1, -1, 0, 0, 0]])
    low, high = -np.ones(6), np.ones(6)
    y, kkt, _ = step(W, rng.normal(size=22), low, high, A=A, b=np.array([-0.9, 0.0]))
    y = np.asarray(y)
    assert kkt < ROUNDING
    assert np.all(np.abs(y) <= 1.0)
    assert np.all(A @ y <= np.array([-0.9, 0.0]) + ROUNDING)
    if rank == 0:
        np.testing.assert_allclose(y, [-0.45, 0, 0, 0, 0, -0.45], atol=ROUNDING)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_what_cannot_be_met_shows_in_the_residual(size):
    """Whatever the error's size beside that of the bounds, and never as NaN."""
    W, error, low, high = random_qp(3, 10.0, seed=1)
    error = size * error
    A = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]])
    contradiction = step(W, error, low, high, A=A, b=np.full(2, -0.1))
    outside = step(W, error, low, high, A=A, b=np.array([-100.0, 0.0]))
    nothing = step(W, error, low, high, A=0.0 * A, b=np.array([-1.0, 0.0]))
    crossed = step(W, error, low, np.where(np.arange(3) == 1, low - 0.1, high))
    for y, kkt, _ in (contradiction, outside, nothing, crossed):
        assert kkt > 1e-2
        assert np.all(np.isfinite(y))
        assert np.isfinite(kkt)


def test_step_is_optimal_where_neither_bounds_nor_rows_allow_no_step():
    A = [[-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-1.0, 1.0, 0.0], [1.0, -1.0, -1.0]]
    b = [-3.7, -1.8, -0.8, -1.0]
    error, one = np.array([0.0, 0.0, -1.0]), np.ones(3)
    y, kkt, _ = step(np.eye(3), error, one, 2.0 * one, A=np.array(A), b=np.array(b))
    np.testing.assert_allclose(y, [1.8, 1.0, 1.9], atol=1e-9)  # damped by 1e-10
    assert kkt < ROUNDING


def test_bounds_that_exclude_no_step_are_met_without_any_error():
    low, high = np.array([0.5, -1.0]), np.ones(2)
    y, kkt, _ = step(np.eye(2), np.zeros(2), low, high)
    np.testing.assert_allclose(y, [0.5, 0.0], atol=ROUNDING)
    assert kkt < ROUNDING


def test_batch_of_starts_is_one_by_one():
    problems = [ordered_qp(6, 2, 10.0**k, seed=k) for k in range(5)]
    rows = lambda W, e, low, high, A, b: bounded_step(W, e, low, high, A=A, b=b)
    batch = jax.jit(jax.vmap(rows))(
        *(np.stack(part) for part in zip(*problems, strict=True))
    )
    for k, problem in enumerate(problems):
        *box, A, b = problem
        y, kkt, _ = step(*box, A=A, b=b)
        np.testing.assert_allclose(batch.lambda_p[k], y, atol=1e-10)
        assert max(kkt, batch.kkt_residual[k]) < ROUNDING


def test_damping_shortens_a_step_and_moves_no_minimum():
    W, error = np.eye(2), np.array([-0.5, 0.2])
    y, *_ = step(W, error, -np.ones(2), np.ones(2), damping=1.0)
    np.testing.assert_allclose(y, [0.25, -0.1], rtol=1e-12)  # half the way
    again, *_ = step(W, np.zeros(2), -np.ones(2), np.ones(2), damping=1.0)
    np.testing.assert_array_equal(again, 0.0)


def test_wrong_calls_say_so():
    one = jnp.ones(1)
    with pytest.raises(ValueError, match=r"A and b.*together"):
        bounded_step(jnp.eye(1), one, -one, one, A=jnp.eye(1))
    with pytest.raises(ValueError, match=r"damping.*got 0\.0"):
        bounded_step(jnp.eye(1), one, -one, one, damping=0.0)


@pytest.mark.parametrize("iterates", [True, False])
def test_step_says_which_of_both_solvers_ended_it(monkeypatch, iterates):
    """The first goes to its upper, the second to its lower bound, others to a row."""

    class Idle(jaxopt.BoxOSQP):
        def run(self, first, *_):
            return first, None

    if not iterates:
        monkeypatch.setattr(jaxopt, "BoxOSQP", Idle)
    error = jnp.array([-3.0, 3.0, -0.8, -0.9])
    A, b = jnp.array([[0.0, 0.0, 1.0, 1.0]]), jnp.array([1.0])
    limits = _qp.QPLimits(-jnp.ones(4), jnp.ones(4), A, b, _qp.DAMPING)
    ours = jax.jit(lambda: _qp.solved_qp(_qp.scaled_qp(jnp.eye(4), error, limits)))()
    np.testing.assert_allclose(ours.lambda_p, [1.0, -1.0, 0.45, 0.55], atol=ROUNDING)
    assert ours.kkt_residual < ROUNDING
    assert bool(ours.by_polish) == (not iterates)


def test_a_row_that_pushes_without_being_met_is_a_violation():
    """y = 0 is stationary with a multiplier of 0.5, but the row has a slack of 1."""
    one = jnp.ones(1)
    box = one, -one, one  # unit, lower, upper
    qp = _qp.ScaledQP(jnp.eye(1), -0.5 * one, -one, one, jnp.eye(1), one, *box)
    residual = jax.jit(_qp._kkt_residual)
    np.testing.assert_allclose(residual(qp, 0.0 * one, 0.5 * one), 0.5, rtol=ROUNDING)
    np.testing.assert_allclose(residual(qp, 0.5 * one, 0.0 * one), 0.0)
