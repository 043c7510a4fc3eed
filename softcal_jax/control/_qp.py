"""The QP of one step of inverse control, level by level (paper Eq. 6)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import QPStep, bounded_step

NULL = 1e-10
"""Relative squared singular value below which a level does not see a direction [-]."""


class StepLimits(NamedTuple):
    """Limits of the scaled step y: lower <= y <= upper and A y <= b [-].

    A y is the change of the quantities that are not imposed: less that change for their
    lower limits, actuator by actuator, then the change for their upper limits.
    """

    lower: Float[Array | HostArray, " n_a"]
    upper: Float[Array | HostArray, " n_a"]
    A: Float[Array | HostArray, "n_rows n_a"]
    b: Float[Array | HostArray, " n_rows"]


@jax.jit
def step_in_levels(
    levels: tuple[tuple[Float[Array, "_ n_a"], Float[Array, " _"]], ...],
    limits: StepLimits,
    radius: Float[Array, ""],
) -> QPStep:
    """Minimise ||W y + error|| of the first level, then of the next among its minima.

    All minima of a level share W y, so the next level moves only in the null space of
    W, and priorities are strict whatever the weights. Each level is one bounded QP; the
    optimality residual is the largest of all. The radius bounds every entry of y.
    """
    moves = limits.upper > limits.lower
    lower = jnp.maximum(limits.lower, -radius)
    upper = jnp.minimum(limits.upper, radius)
    A = jnp.where(moves[None], limits.A, 0.0)
    # A violated row is reduced only as far as the trust region allows.
    reach = 0.9 * radius * jnp.sum(jnp.abs(A), axis=1)
    b = jnp.maximum(limits.b, -reach)
    y = jnp.zeros_like(lower)
    P, kkt = jnp.eye(y.size, dtype=y.dtype), jnp.zeros((), y.dtype)
    for level, (W, error) in enumerate(levels):
        W = jnp.where(moves[None], W, 0.0)
        if level == 0:
            qp = bounded_step(W, error, lower, upper, A=A, b=b)
            y = qp.lambda_p
        else:
            P = _within_null_space(P, levels[level - 1][0], moves)
            far = jnp.full_like(y, 4.0 * y.size) * radius
            qp = bounded_step(
                W @ P,
                error + W @ y,
                -far,
                far,
                A=jnp.concatenate([P, -P, A @ P]),
                b=jnp.concatenate([upper - y, y - lower, b - A @ y]),
            )
            y = jnp.clip(y + P @ qp.lambda_p, lower, upper)
        kkt = jnp.maximum(kkt, qp.kkt_residual)
    return QPStep(y, kkt)


def _within_null_space(P, W, moves):
    """Restrict the projector P to the null space of W."""
    W = jnp.where(moves[None], W, 0.0) @ P
    values, vectors = jnp.linalg.eigh(W.T @ W)
    blind = values <= NULL * jnp.max(values)
    N = jnp.where(blind[None], vectors, 0.0)
    P = P @ (N @ N.T) @ P
    return jnp.where(moves[:, None] & moves[None], P, 0.0)
