"""Decide whether a step of inverse control helped: limits first, then the levels."""

from typing import NamedTuple

import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration import KKT_TOLERANCE

ROUNDING = 1e-6
"""Violation of a limit that is ignored, relative to the size of the robot [-]."""

FLAT_COSINE = 1e-2
"""Cosine between error and step below which a refused step means a minimum [-]."""


class Parts(NamedTuple):
    """Quantities that a step should lower: violated limits, then each level's cost [-].

    Attributes:
        now: Before the step.
        expected: After the step, by the linear model.
        tried: After the step, at the true equilibrium.
    """

    now: Float[Array, " n_parts"]
    expected: Float[Array, " n_parts"]
    tried: Float[Array, " n_parts"]

    def above(self, tol: float | Float[Array, ""]) -> "Parts":
        """Raise all parts to what is good enough, so that noise below it is ignored."""
        floor = jnp.full_like(self.now, 0.5 * tol**2).at[0].set(ROUNDING).at[-1].set(0)
        return Parts(*(jnp.maximum(part, floor) for part in self))


class Decision(NamedTuple):
    """Consequences of a step that was tried.

    Attributes:
        accepted: Whether the step is kept.
        step_bound: Bound on the next step [-].
        penalty: Weights of the parts [-].
        vanished: Whether no step helps any more.
        stalled: Whether even the smallest step was refused, away from a minimum.
    """

    accepted: Bool[Array, ""]
    step_bound: Float[Array, ""]
    penalty: Float[Array, " n_parts"]
    vanished: Bool[Array, ""]
    stalled: Bool[Array, ""]


class Trial(NamedTuple):
    """A step that was tried.

    Attributes:
        parts: Limits and costs before and after the step.
        size: Its largest entry [-].
        kkt_residual: Optimality residual of its QPs [-].
        cosine: Cosine between the errors and their expected reduction [-].
        converged: Whether it ended at an equilibrium.
    """

    parts: Parts
    size: Float[Array, ""]
    kkt_residual: Float[Array, ""]
    cosine: Float[Array, ""]
    converged: Bool[Array, ""]


def decide(
    trial: Trial,
    step_bound: Float[Array, ""],
    penalty: Float[Array, " n_parts"],
    *,
    tol: float | Float[Array, ""],
    step_tol: float | Float[Array, ""],
    max_step_bound: float | Float[Array, ""],
) -> Decision:
    """Accept a step that lowers the weighted sum of the parts, and adapt the bound.

    The sum is an exact penalty function: the weight of an earlier part is raised until
    the sum is expected to fall along the step that the QPs of all levels found (Nocedal
    and Wright, Numerical Optimization, 2006, Eq. 18.36).

    Args:
        trial: The step that was tried.
        step_bound: Bound on the step [-].
        penalty: Weights before the step [-].
        tol: Error in units of std that is good enough [-].
        step_tol: Size of a step at which the search ends [-].
        max_step_bound: Largest bound [-].

    Returns:
        The decision.
    """
    parts = trial.parts.above(tol)
    penalty = _raised(penalty, parts.now - parts.expected)
    expected = jnp.sum(penalty * (parts.now - parts.expected))
    drop = jnp.sum(penalty * (parts.now - parts.tried))
    at_bound = trial.size >= 0.99 * step_bound
    kept_limits = trial.parts.now[0] <= 10.0 * ROUNDING
    vanished = trial.converged & (trial.size <= step_tol) & ~at_bound & kept_limits
    vanished = vanished & (trial.kkt_residual <= KKT_TOLERANCE)
    # A vanished step ends the search even if it is refused: its expected gain may lie
    # below the residual of the equilibria.
    lowered = (drop >= 1e-4 * expected) & (expected > 0.0)
    accepted = trial.converged & lowered
    good = (drop > 0.75 * expected) & at_bound
    grown = jnp.where(good, jnp.minimum(2.0 * step_bound, max_step_bound), step_bound)
    bound = jnp.where(accepted, grown, 0.25 * trial.size)
    collapsed = ~accepted & (bound < step_tol)
    flat = trial.converged & (trial.cosine <= FLAT_COSINE) & kept_limits
    return Decision(
        accepted=accepted,
        step_bound=bound,
        penalty=penalty,
        vanished=vanished | (collapsed & flat),
        stalled=collapsed & ~flat,
    )


def _raised(penalty: Float[Array, " n_parts"], drops: Float[Array, " n_parts"]):
    """Raise weights of earlier parts until the weighted drops have a positive sum."""
    for part in range(penalty.shape[0] - 2, -1, -1):
        later = jnp.sum(penalty[part + 1 :] * drops[part + 1 :])
        falls = drops[part] > jnp.finfo(drops.dtype).tiny
        needed = jnp.where(falls, -2.0 * later / jnp.where(falls, drops[part], 1.0), 0)
        penalty = penalty.at[part].max(needed)
    return penalty
