"""Families of random bounded QPs that all have a solution, and an exact solver.

Goldfarb and Idnani's dual method (quadprog) ends in the optimum after finitely many
steps from the unconstrained minimum, so it shares nothing with the package's methods.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import quadprog

from softcal_jax.calibration import bounded_step

DAMPING = 1e-6
"""Relative to columns of unit length; an exact solver needs a definite matrix."""


RELAXED = 1e-12
"""By how much the exact solver may violate rows of unit length, for unit data [-]."""


class Problem(NamedTuple):
    """min ||W l + error||^2 / 2 for low <= l <= high and A l <= b."""

    W: np.ndarray
    error: np.ndarray
    low: np.ndarray
    high: np.ndarray
    A: np.ndarray
    b: np.ndarray


def conditioned(random, n, *, decades=1.0, rank=None):
    """W of unit norm, singular values over some decades, and an error in its range."""
    m, rank = 3 * n + 4, rank or n
    U, V = (np.linalg.qr(random.normal(size=(k, rank)))[0] for k in (m, n))
    W = U * np.logspace(0.0, -decades, rank) @ V.T
    return W, W @ random.normal(size=n) + 0.1 * random.normal(size=m)


def box(random, n):
    """Bounds around no step, some of them active at the optimum."""
    low, high = np.array([[-1.0], [1.0]]) * np.abs(random.normal(size=(2, n)))
    return low, high


def dense(random, n, inside):
    """Rows of any direction, half of them active at a step within the bounds."""
    A = random.normal(size=(2 * n, n))
    return A, A @ inside + np.abs(random.normal(size=2 * n)) * random.integers(
        0, 2, 2 * n
    )


def order(random, n):
    """Rows a_i l_i <= a_j l_j, as E_l <= E_t; not all can hold with equality."""
    A = np.zeros((2 * n, n))
    for row in A:
        row[random.choice(n, 2, replace=False)] = np.exp(random.normal(size=2)) * [
            1,
            -1,
        ]
    return A


def plain(random, n=6, **shape):
    """Bounds and rows that exclude no step."""
    low, high = box(random, n)
    A, b = dense(random, n, np.zeros(n))
    return Problem(*conditioned(random, n, **shape), low, high, A, b)


def without_effect(random):
    """Half of the parameters change nothing that is measured."""
    problem = plain(random)
    return problem._replace(W=problem.W * (np.arange(6) % 2))


def nothing_measured(random):
    """The shortest step that satisfies the rows."""
    problem = away(random)
    return problem._replace(W=0.0 * problem.W, error=0.0 * problem.error)


def ordered(random, n=6):
    problem = plain(random, n)
    return problem._replace(A=order(random, n), b=np.zeros(2 * n))


def repeated(random):
    """Every row comes twice, in other units, and all meet in no step."""
    problem = ordered(random)
    A = problem.A[:6]
    return problem._replace(A=np.concatenate([A, 2.0 * A]))


def redundant(random):
    """Half of the rows are sums of two others, and are met only where these are."""
    problem = away(random)
    A, b = problem.A[:6], problem.b[:6]
    A, b = (np.concatenate([part, part + np.roll(part, 1, 0)]) for part in (A, b))
    return problem._replace(A=A, b=b)


def equal_bounds(random):
    """A third of the parameters cannot move from a value of their own."""
    problem = plain(random)
    held = np.arange(6) % 3 == 0
    low = np.where(held, 0.5 * problem.high, problem.low)
    high = np.where(held, low, problem.high)
    A, b = dense(random, 6, random.uniform(low, high))
    return problem._replace(low=low, high=high, A=A, b=b)


def half_open(random):
    """Every parameter has one bound."""
    problem = away(random)
    side = random.integers(0, 2, 6) == 0
    low = np.where(side, problem.low, -np.inf)
    return problem._replace(low=low, high=np.where(side, np.inf, problem.high))


def outside(random):
    """The bounds exclude no step."""
    problem = plain(random)
    low, high = problem.low + 2.0, problem.high + 2.0
    A, b = dense(random, 6, random.uniform(low, high))
    return problem._replace(low=low, high=high, A=A, b=b)


def away(random, n=6, **shape):
    """The rows exclude no step, but not another one within the bounds."""
    problem = plain(random, n, **shape)
    A, b = dense(random, n, random.uniform(problem.low, problem.high))
    return problem._replace(A=A, b=b)


def whole_numbers(random):
    """Coefficients -1, 0 and 1, and every row active at one corner of the bounds."""
    low = np.ones(6)
    high, corner = 2.0 * low, random.integers(1, 3, 6)
    A = random.integers(-1, 2, (12, 6)).astype(float)
    b = A @ corner + 0.1 * random.integers(0, 3, 12)
    error = np.concatenate([-random.integers(-1, 4, 6), np.zeros(16)]).astype(float)
    return Problem(np.eye(22, 6), error, low, high, A, b)


def one_point(random):
    """Nothing but one corner of the bounds satisfies the rows."""
    problem = plain(random)
    A = np.concatenate(
        [np.diag(random.uniform(0.5, 2.0, 6)), random.normal(size=(6, 6))]
    )
    A[6:] = -np.abs(A[6:])
    A[:6] *= -1.0
    return problem._replace(A=A, b=A @ problem.high)


def thin(random):
    """Pairs of opposite rows, a millionth apart, away from no step."""
    problem = plain(random)
    A = random.normal(size=(3, 6))
    middle = A @ random.uniform(problem.low, problem.high)
    A = np.concatenate([A, -A, np.zeros((6, 6))])
    return problem._replace(A=A, b=np.concatenate([middle, 1e-6 - middle, np.ones(6)]))


def any_units(random):
    """Parameters, rows and errors in units from 1e-6 to 1e6."""
    problem = away(random)
    unit, of_row = (10.0 ** random.uniform(-6, 6, k) for k in (6, 12))
    of_error = 10.0 ** random.uniform(-6, 6)
    return Problem(
        of_error * problem.W / unit,
        of_error * problem.error,
        problem.low * unit,
        problem.high * unit,
        problem.A / unit * of_row[:, None],
        problem.b * of_row,
    )


def far_bounds(random):
    """Bounds a thousand times the step that the errors ask for."""
    problem = away(random)
    low, high = 1e3 * problem.low, 1e3 * problem.high
    return problem._replace(low=low, high=high)


FAMILIES: dict[str, Callable[[np.random.Generator], Problem]] = {
    "one parameter": lambda random: away(random, 1),
    "three parameters": lambda random: away(random, 3),
    "twelve parameters": lambda random: away(random, 12),
    "well conditioned": lambda random: plain(random, decades=0.5),
    "condition 1e4": lambda random: away(random, decades=4.0),
    "condition 1e8": lambda random: plain(random, decades=8.0),
    "rank one half": lambda random: away(random, rank=3),
    "without effect": without_effect,
    "nothing measured": nothing_measured,
    "ordered moduli": ordered,
    "repeated rows": repeated,
    "redundant rows": redundant,
    "equal bounds": equal_bounds,
    "half-open bounds": half_open,
    "bounds exclude no step": outside,
    "rows exclude no step": away,
    "whole numbers": whole_numbers,
    "one point": one_point,
    "thin": thin,
    "any units": any_units,
    "far bounds": far_bounds,
}


def problems(family: str, count: int) -> list[Problem]:
    random = np.random.default_rng(list(family.encode()))
    return [FAMILIES[family](random) for _ in range(count)]


def steps(drawn: list[Problem]):
    """The steps of all problems, as `bounded_step` returns them."""
    results = []
    for problem in drawn:
        *box, A, b = (jnp.asarray(part) for part in problem)
        results.append(bounded_step(*box, A=A, b=b, damping=DAMPING))
    return tuple(np.stack(part) for part in zip(*results, strict=True))


def exact_step(problem: Problem) -> np.ndarray:
    """The optimum by quadprog.

    Where many rows meet in a point, rounding may leave it none: then `RELAXED` does.
    """
    W, error, low, high, A, b = problem
    n, size = len(low), np.linalg.norm(W, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    level = np.linalg.norm(error) or 1.0
    V, held = W / size, low == high
    G = np.concatenate([np.eye(n), -np.eye(n), -A / size])
    least = np.concatenate([low * size, -high * size, -b]) / level
    length = np.linalg.norm(G, axis=1)
    # Equations come first, once; rows without coefficients say nothing.
    used = np.isfinite(least) & (length > 0.0)
    used[n : 2 * n] &= ~held
    order = np.argsort(~np.append(held, np.zeros(len(G) - n, bool)), kind="stable")
    order = order[used[order]]
    G, least = G[order] / length[order, None], least[order] / length[order]
    Q, c, n_held = V.T @ V + DAMPING * np.eye(n), V.T @ error / level, int(held.sum())
    exact = lambda relaxed: quadprog.solve_qp(
        Q, -c, G.T, least - relaxed * (np.arange(len(least)) >= n_held), n_held
    )[0]
    try:
        y = exact(0.0)
    except ValueError:
        y = exact(RELAXED)
    return y * level / size


def cost(problem: Problem, step: np.ndarray) -> float:
    size = np.linalg.norm(problem.W, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    misfit = np.sum((problem.W @ step + problem.error) ** 2)
    return 0.5 * float(misfit + DAMPING * np.sum((size * step) ** 2))


def violation(problem: Problem, step: np.ndarray) -> float:
    """Largest violation of a row, relative to its terms; bounds must hold exactly."""
    low, high, A, b = problem[2:]
    if not np.all((low <= step) & (step <= high)):
        return np.inf
    width = high - low
    reach = np.abs(step) + np.where(np.isfinite(width), width, 0.0)
    terms = np.abs(A) @ reach + np.abs(b)
    return float(np.max((A @ step - b)[terms > 0.0] / terms[terms > 0.0]))
