"""The QP of one step of inverse control, level by level (paper Eq. 6)."""

from typing import NamedTuple

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.calibration import bounded_step

NULL = 1e-10
"""Share of the largest squared singular value below which a level sees nothing [-]."""


class InputRows(NamedTuple):
    """Where inputs may go: lower <= y <= upper and A y <= b, all scaled [-].

    Attributes:
        lower: Lowest step of each input.
        upper: Highest one.
        A: Change of what follows the inputs, as rows.
        b: Their room.
    """

    lower: Float[Array, " n_a"]
    upper: Float[Array, " n_a"]
    A: Float[Array, "n_rows n_a"]
    b: Float[Array, " n_rows"]


class LevelsStep(NamedTuple):
    """The step that serves all levels, the first one first.

    Attributes:
        y: Scaled step of the inputs [-].
        kkt_residual: Largest optimality residual of the QPs of all levels [-].
    """

    y: Float[Array, " n_a"]
    kkt_residual: Float[Array, ""]


def step_in_levels(
    levels: tuple[tuple[Float[Array, "_ n_a"], Float[Array, " _"]], ...],
    rows: InputRows,
    radius: Float[Array, ""],
) -> LevelsStep:
    """Minimise ||W y + error|| of the first level, then of the next among its minima.

    The minimum of a level has one W y only, so that the next one is free in the null
    space of W: strict priorities, whatever the weights. Each level is one bounded QP.

    Args:
        levels: W and errors of each level, in units of std.
        rows: Limits of the inputs and of what follows them.
        radius: Bound on every input that moves, the trust region [-].

    Returns:
        The step.
    """
    moves = rows.upper > rows.lower
    lower = jnp.maximum(rows.lower, -radius)
    upper = jnp.minimum(rows.upper, radius)
    A = jnp.where(moves[None], rows.A, 0.0)
    # A row that is violated is brought back by what the trust region allows.
    reach = 0.9 * radius * jnp.sum(jnp.abs(A), axis=1)
    b = jnp.maximum(rows.b, -reach)
    y = jnp.zeros_like(lower)
    P, kkt = jnp.eye(y.size, dtype=y.dtype), jnp.zeros((), y.dtype)
    for number, (W, error) in enumerate(levels):
        W = jnp.where(moves[None], W, 0.0)
        if number == 0:
            qp = bounded_step(W, error, lower, upper, A=A, b=b)
            y = qp.lambda_p
        else:
            P = _rows_within_null_space(P, levels[number - 1][0], moves)
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
    return LevelsStep(y, kkt)


def _rows_within_null_space(P, W, moves):
    """The projector P cut down to where W sees nothing."""
    W = jnp.where(moves[None], W, 0.0) @ P
    values, vectors = jnp.linalg.eigh(W.T @ W)
    blind = values <= NULL * jnp.max(values)
    N = jnp.where(blind[None], vectors, 0.0)
    P = P @ (N @ N.T) @ P
    # Only inputs that may move.
    return jnp.where(moves[:, None] & moves[None], P, 0.0)
