"""One step of inverse control: its settings, its QP, and whether it is kept (Eq. 6)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import KKT_TOLERANCE, QPStep, bounded_step
from softcal_jax.equilibrium import NewtonSettings

NULL = 1e-10
"""Relative squared singular value below which a level does not see a direction [-]."""

ROUNDING = 1e-6
"""Violation of a limit that is ignored, relative to the size of the robot [-]."""

FLAT_COSINE = 1e-2
"""Cosine between error and step below which a refused step means a minimum [-]."""


class ControlSettings(Module):
    """Settings of inverse control.

    Attributes:
        tol: Error of every effector coordinate at which a goal is met, in units of its
            standard deviation [-].
        step_tol: Step of the inputs at which the search ends, as the largest
            displacement of a node, relative to the size of the robot [-].
        max_steps: Number of steps after which the search gives up.
        step_bound: First bound on the step of every input, measured likewise [-].
        max_step_bound: Largest value of that bound [-].
        epsilon: Weight of the energy of the actuators, Eq. (6), relative to the effect
            of the inputs on the effectors [-]. It determines inputs that the goals
            leave open, such as co-contraction, at the price of missing the goals by
            about as much. With 0 the search ends as soon as the goals are met.
        other_starts: Other starts from which the search goes on, and then over a
            continuation of the goals, before it says that a goal cannot be met. With 0
            the first local optimum counts.
        newton: Settings of the equilibria.
    """

    tol: float = 1e-2
    step_tol: float = 1e-6
    max_steps: int = 50
    step_bound: float = 0.1
    max_step_bound: float = 0.5
    epsilon: float = 0.0
    other_starts: int = 24
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)

    def __check_init__(self):
        for name in ("tol", "step_tol", "step_bound", "max_step_bound"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        for name in ("other_starts", "epsilon"):
            if not getattr(self, name) >= 0.0:
                value = getattr(self, name)
                raise ValueError(f"{name} must not be negative, got {value}.")


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


class TriedStep(NamedTuple):
    """A step that was tried; its parts are violated limits, then each level's cost [-].

    They are those before the step, after it by the linear model, and after it at the
    true equilibrium; inf without one. `size` is the largest entry of the step, `cosine`
    that between the errors and their expected reduction.
    """

    now: Float[HostArray, " n_parts"]
    expected: Float[HostArray, " n_parts"]
    tried: Float[HostArray, " n_parts"]
    size: float
    kkt_residual: float
    cosine: float


class Decision(NamedTuple):
    """Consequences of a step that was tried.

    Attributes:
        accepted: Whether the step is kept.
        step_bound: Bound on the next step [-].
        penalty: Weights of the parts [-].
        vanished: Whether no step helps any more.
        stalled: Whether even the smallest step was refused, away from a minimum.
    """

    accepted: bool
    step_bound: float
    penalty: Float[HostArray, " n_parts"]
    vanished: bool = False
    stalled: bool = False


def decide(trial: TriedStep, before: Decision, settings: ControlSettings) -> Decision:
    """Accept a step that lowers the weighted sum of the parts, and adapt the bound.

    The sum is an exact penalty function: the weight of an earlier part is raised until
    the sum is expected to fall along the step that the QPs of all levels found (Nocedal
    and Wright, Numerical Optimization, 2006, Eq. 18.36).
    """
    # Below the tolerance all errors count as equal, so that noise there is ignored.
    floor = np.full_like(trial.now, 0.5 * settings.tol**2)
    floor[0], floor[-1] = ROUNDING, 0.0
    now, expected, tried = (
        np.maximum(each, floor) for each in (trial.now, trial.expected, trial.tried)
    )
    penalty = _raised(before.penalty, now - expected)
    hoped, drop = penalty @ (now - expected), penalty @ (now - tried)
    converged = bool(np.isfinite(trial.tried).all())
    at_bound = trial.size >= 0.99 * before.step_bound
    kept_limits = trial.now[0] <= 10.0 * ROUNDING
    # A vanished step ends the search even if it is refused: its expected gain may lie
    # below the residual of the equilibria.
    vanished = converged and kept_limits and trial.kkt_residual <= KKT_TOLERANCE
    vanished = vanished and trial.size <= settings.step_tol and not at_bound
    accepted = bool(converged and hoped > 0.0 and drop >= 1e-4 * hoped)
    bound = before.step_bound if accepted else 0.25 * trial.size
    if accepted and at_bound and drop > 0.75 * hoped:
        bound = min(2.0 * bound, settings.max_step_bound)
    collapsed = not accepted and bound < settings.step_tol
    flat = converged and kept_limits and trial.cosine <= FLAT_COSINE
    return Decision(
        accepted=accepted,
        step_bound=bound,
        penalty=penalty,
        vanished=bool(vanished or (collapsed and flat)),
        stalled=bool(collapsed and not flat),
    )


def _raised(penalty: HostArray, drops: HostArray) -> Float[HostArray, " n_parts"]:
    """Raise weights of earlier parts until the weighted drops have a positive sum."""
    penalty = penalty.copy()
    for part in range(len(penalty) - 2, -1, -1):
        if drops[part] > np.finfo(float).tiny:
            later = penalty[part + 1 :] @ drops[part + 1 :]
            penalty[part] = max(penalty[part], -2.0 * later / drops[part])
    return penalty
