"""The bounded QP step on the stacked errors (paper Eqs. 10 and 11)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxopt import BoxOSQP

from softcal_jax._typing import Array, Float

DAMPING = 1e-10
"""Damping of the step, for columns of W of unit length [-].

Along a direction that the data do not see, rounding in the errors would move the
parameters anywhere; this leaves them where they are. The minimum is not shifted: the
error itself, not the parameters, is what a step still reduces.
"""


class QPStep(NamedTuple):
    """Solution of the QP and its check.

    Attributes:
        lambda_p: The step, in scaled units [-].
        kkt_residual: Largest violation of the optimality conditions, for columns of W
            and an error of unit length [-].
    """

    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]


def bounded_step(
    W: Float[Array, "n_e n_p"],
    error: Float[Array, " n_e"],
    lower: Float[Array, " n_p"],
    upper: Float[Array, " n_p"],
) -> QPStep:
    """Minimise ||W lambda_p + error||^2 / 2 for lower <= lambda_p <= upper.

    By `jaxopt.BoxOSQP` on a problem scaled to unit columns and unit error, started at
    the unbounded step and polished: the bounds that it found active are
    taken as equalities, and the rest is solved exactly (Stellato et al., OSQP, Math.
    Prog. Comp. 12, 2020, Sec. 5.2). Its default inner solver, conjugate gradients, can
    end far from optimal on a flat valley; hence the direct one.

    Args:
        W: Stacked compliances in noise units [-].
        error: Stacked errors before the step, Delta_e0, in noise units [-].
        lower: Lower bounds of the step [-].
        upper: Upper bounds of the step [-].

    Returns:
        The step, clipped into its bounds, with its KKT residual.
    """
    size = jnp.linalg.norm(W, axis=0)
    # A parameter without any effect keeps its scale, and does not move.
    size = jnp.where(size > 0.0, size, 1.0)
    V = W / size[None, :]
    level = jnp.maximum(jnp.linalg.norm(error), jnp.finfo(error.dtype).tiny)
    c = V.T @ (error / level)
    Q = V.T @ V + DAMPING * jnp.eye(W.shape[1])
    low, high = lower * size / level, upper * size / level
    A = jnp.eye(W.shape[1])
    solver = BoxOSQP(
        eq_qp_solve="lu", tol=1e-10, maxiter=4000, check_primal_dual_infeasability=False
    )
    start = jnp.clip(jnp.linalg.solve(Q, -c), low, high)
    params, _ = solver.run(
        solver.init_params(start, (Q, c), A, (low, high)), (Q, c), A, (low, high)
    )
    rough = jnp.clip(params.primal[0], low, high)
    polished = _polish(Q, c, low, high, rough)
    kkt_rough = _kkt_residual(Q, c, low, high, rough)
    kkt_polished = _kkt_residual(Q, c, low, high, polished)
    better = kkt_polished < kkt_rough
    y = jnp.where(better, polished, rough)
    # Clipped once more, since scaling back rounds.
    return QPStep(
        jnp.clip(y * level / size, lower, upper),
        jnp.where(better, kkt_polished, kkt_rough),
    )


def _kkt_residual(Q, c, low, high, y):
    """Largest entry of the projected gradient: zero at the optimum and only there."""
    return jnp.max(jnp.abs(y - jnp.clip(y - (Q @ y + c), low, high)))


def _polish(Q, c, low, high, y):
    """Solve exactly for the entries that are not held by a bound at `y`."""
    gradient = Q @ y + c
    near = lambda bound: jnp.abs(y - bound) <= 1e-6 * (1.0 + jnp.abs(bound))
    at_low, at_high = near(low) & (gradient > 0.0), near(high) & (gradient < 0.0)
    held = at_low | at_high
    bound = jnp.where(at_low, low, jnp.where(at_high, high, 0.0))
    either = held[:, None] | held[None, :]
    reduced = jnp.where(either, jnp.eye(y.shape[0]), Q)
    exact = jnp.linalg.solve(reduced, jnp.where(held, bound, -c - Q @ bound))
    # A singular reduced matrix keeps what the iteration found.
    return jnp.where(jnp.all(jnp.isfinite(exact)), jnp.clip(exact, low, high), y)
