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
        step_bound: First bound on the step of every input, measured as `step_tol` [-].
        max_step_bound: Largest value of that bound [-].
        epsilon: Weight of the energy of the actuators, Eq. (6), relative to the effect
            of the inputs on the effectors [-]. It determines inputs that the goals
            leave open, such as co-contraction, at the price of missing the goals by
            about as much. With 0 the search ends as soon as the goals are met.
        other_starts: Number of other starts to try, and after them a continuation of
            the goals, before the search says that a goal cannot be met. With 0 the
            first local optimum counts.
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

    A y is the change of the quantities that are not imposed: first with a minus sign,
    for their lower limits, actuator by actuator, then for their upper limits.
    """

    lower: Float[Array | HostArray, " n_a"]
    upper: Float[Array | HostArray, " n_a"]
    A: Float[Array | HostArray, "n_rows n_a"]
    b: Float[Array | HostArray, " n_rows"]


@jax.jit
def limited_step(
    W: Float[Array, "n_all n_a"],
    error: Float[Array, " n_all"],
    limits: StepLimits,
    radius: Float[Array, ""],
) -> QPStep:
    """Minimise ||W y + error|| within the limits; `radius` bounds every entry of y."""
    moves = limits.upper > limits.lower
    A = jnp.where(moves[None], limits.A, 0.0)
    # A violated row is reduced only as far as the trust region allows.
    reach = 0.9 * radius * jnp.sum(jnp.abs(A), axis=1)
    return bounded_step(
        jnp.where(moves[None], W, 0.0),
        error,
        jnp.maximum(limits.lower, -radius),
        jnp.minimum(limits.upper, radius),
        A=A,
        b=jnp.maximum(limits.b, -reach),
    )


class TriedStep(NamedTuple):
    """A step that was tried; its parts are violated limits, then the cost [-].

    `now` are the parts before the step, `expected` those after it by the linear model,
    `tried` at the true equilibrium, inf without one. `size` is the largest entry of the
    step, `cosine` that between the errors and their expected reduction.
    """

    now: Float[HostArray, "2"]
    expected: Float[HostArray, "2"]
    tried: Float[HostArray, "2"]
    size: float
    kkt_residual: float
    cosine: float


class Decision(NamedTuple):
    """Consequences of a step that was tried.

    Attributes:
        accepted: Whether the step is kept.
        step_bound: Bound on the next step [-].
        penalty: Weight of violated limits beside the cost [-].
        vanished: Whether no step helps any more.
        stalled: Whether even the smallest step was refused, away from a minimum.
    """

    accepted: bool
    step_bound: float
    penalty: float
    vanished: bool = False
    stalled: bool = False


def decide(trial: TriedStep, before: Decision, settings: ControlSettings) -> Decision:
    """Accept a step that lowers the weighted sum of the parts, and adapt the bound.

    The sum is an exact penalty function: the weight of violated limits is raised until
    the sum is expected to fall along the step that the QP found (Nocedal and Wright,
    Numerical Optimization, 2006, Eq. 18.36).
    """
    floor = ROUNDING, 0.0
    now, expected, tried = (
        np.maximum(parts, floor) for parts in (trial.now, trial.expected, trial.tried)
    )
    penalty, (closer, cheaper) = before.penalty, now - expected
    if closer > np.finfo(float).tiny:
        penalty = max(penalty, -2.0 * float(cheaper / closer))
    weights = np.array([penalty, 1.0])
    hoped, drop = weights @ (now - expected), weights @ (now - tried)
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
