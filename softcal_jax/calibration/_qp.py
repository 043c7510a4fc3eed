"""The bounded QP step on the stacked errors (paper Eqs. 10 and 11)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxopt import BoxOSQP

from softcal_jax._typing import Array, Float


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

    By `jaxopt.BoxOSQP` at a tolerance of 1e-10 on a problem scaled to unit columns:
    at its default tolerance it errs by 1e-2 where W has a condition of 1e5.

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
    V = W / size
    level = jnp.maximum(jnp.linalg.norm(error), jnp.finfo(error.dtype).tiny)
    Q, c = V.T @ V, V.T @ (error / level)
    low, high = lower * size / level, upper * size / level
    n = W.shape[1]
    solver = BoxOSQP(
        matvec_Q=lambda Q, x: Q @ x,
        matvec_A=lambda _, x: x,
        tol=1e-10,
        maxiter=4000,
        check_primal_dual_infeasability=False,
    )
    start = solver.init_params(
        jnp.zeros(n), (Q, c), None, (low, high)
    )
    params, _ = solver.run(start, (Q, c), None, (low, high))
    y = jnp.clip(params.primal[0], low, high)
    gradient = Q @ y + c
    kkt_residual = jnp.max(jnp.abs(y - jnp.clip(y - gradient, low, high)))
    return QPStep(y * level / size, kkt_residual)
