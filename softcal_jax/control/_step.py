"""One step of inverse control: try inputs, and decide whether they helped."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import KKT_TOLERANCE
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.control._compliance import (
    ActuatorCompliance,
    ActuatorReadings,
    actuator_compliance,
    actuator_readings,
    with_inputs,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    solve_equilibrium,
)

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
        if self.other_starts < 0:
            raise ValueError(
                f"other_starts must not be negative, got {self.other_starts}."
            )
        if not self.epsilon >= 0.0:
            raise ValueError(f"epsilon must not be negative, got {self.epsilon}.")


class Reached(NamedTuple):
    """The equilibrium at some inputs, slack cables wound up, and the readings there."""

    value: Float[Array | HostArray, " n_a"]
    solution: EquilibriumSolution
    state: ActuatorReadings


class Arrival(NamedTuple):
    """An equilibrium with its derivatives, which are nan where there is none."""

    value: Float[Array | HostArray, " n_a"]
    solution: EquilibriumSolution
    compliance: ActuatorCompliance

    @property
    def stands(self) -> bool:
        """Whether there is an equilibrium with derivatives."""
        return bool(np.isfinite(self.compliance.W_ea).all())


@eqx.filter_jit
def reach(
    model: Model,
    configuration: ConfigurationArrays,
    box: Float[Array, "2 n_a"],
    value: Float[Array, " n_a"],
    guess: Float[Array, "n_points 3"],
    newton: NewtonSettings,
) -> Reached:
    """Solve for the equilibrium and wind up slack cables.

    Winding them up until they are just taut does not change the equilibrium, but a
    slack cable has no effect on the robot and so no derivative, whereas a taut one has.
    """
    configuration = with_inputs(configuration, value)
    solution = solve_equilibrium(model, configuration, guess=guess, settings=newton)
    state = actuator_readings(model, configuration, solution)
    cable = jnp.asarray(model.mechanism.actuators.unilateral)
    cable = cable & jnp.asarray(configuration.actuation.by_displacement)
    lower, upper = box
    wound = jnp.maximum(value, jnp.minimum(state.displacements, upper))
    value = jnp.where(cable & (upper > lower), wound, value)
    return Reached(value, solution, state)


@eqx.filter_jit
def differentiate(
    model: Model, configuration: ConfigurationArrays, there: Reached
) -> Arrival:
    """Differentiate an equilibrium by its inputs.

    This takes another factorization, so it is not done for steps that are refused.
    """
    configuration = with_inputs(configuration, jnp.asarray(there.value))
    compliance = actuator_compliance(model, configuration, there.solution)
    return Arrival(there.value, there.solution, compliance)


class TriedStep(NamedTuple):
    """A step that was tried; its parts are violated limits, then each level's cost [-].

    Attributes:
        now: Parts before the step.
        expected: Parts after the step, by the linear model.
        tried: Parts after the step, at the true equilibrium; inf without one.
        size: Largest entry of the step.
        kkt_residual: Optimality residual of its QPs.
        cosine: Cosine between the errors and their expected reduction.
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
