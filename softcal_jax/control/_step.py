"""One step of inverse control: solve the QPs, try the step, keep it if it helps."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.control._compliance import (
    ActuatorCompliance,
    ActuatorState,
    actuator_compliance,
    actuator_state,
    with_inputs,
)
from softcal_jax.control._decision import ROUNDING, Parts, Trial, decide
from softcal_jax.control._problem import (
    ControlProblem,
    Linear,
    follow_room,
    level_errors,
    linearise,
)
from softcal_jax.control._qp import step_in_levels
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    NewtonSettings,
    solve_equilibrium,
)


class ControlSettings(eqx.Module):
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
        newton: Settings of the equilibria.
    """

    tol: float | Float[Array, ""] = 1e-2
    step_tol: float | Float[Array, ""] = 1e-6
    max_steps: int = eqx.field(static=True, default=50)
    step_bound: float | Float[Array, ""] = 0.1
    max_step_bound: float | Float[Array, ""] = 0.5
    epsilon: float = eqx.field(static=True, default=0.0)
    newton: NewtonSettings = eqx.field(static=True, default_factory=NewtonSettings)

    def __check_init__(self):
        for name in ("tol", "step_tol", "step_bound", "max_step_bound"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        if not self.epsilon >= 0.0:
            raise ValueError(f"epsilon must not be negative, got {self.epsilon}.")


class ControlState(eqx.Module):
    """State of the search, as a pytree.

    Attributes:
        value: Inputs of all actuators, in their units.
        solution: Equilibrium there.
        compliance: Derivatives there.
        step_bound: Bound on the next step [-].
        penalty: Weights of limits and levels in the sum that a step must lower [-].
        cost: Half the squared errors of all levels, energy included [-].
        violation: Sum of the violated limits of what is not imposed [-].
        error: Largest error of an effector coordinate, in units of std [-].
        last_step: Largest entry of the last step, kept or not [-].
        kkt_residual: Optimality residual of its QPs [-].
        newton_steps: Newton iterations of the last trial.
        accepted: Whether it was kept.
        step: Steps so far.
        met: Whether all goals are met within the limits.
        vanished: Whether no step lowers the error any more.
        stalled: Whether even the smallest step was refused, away from a minimum.
    """

    value: Float[Array, " n_a"]
    solution: EquilibriumSolution
    compliance: ActuatorCompliance
    step_bound: Float[Array, ""]
    penalty: Float[Array, " n_parts"]
    cost: Float[Array, ""]
    violation: Float[Array, ""]
    error: Float[Array, ""]
    last_step: Float[Array, ""]
    kkt_residual: Float[Array, ""]
    newton_steps: Int[Array, ""]
    accepted: Bool[Array, ""]
    step: Int[Array, ""]
    met: Bool[Array, ""]
    vanished: Bool[Array, ""]
    stalled: Bool[Array, ""]


def _respond(problem: ControlProblem, value, solution: EquilibriumSolution):
    """Wind up slack cables until they are just taut, and differentiate there.

    This does not change the equilibrium, but a slack cable has no effect on the robot
    and so no derivative, whereas a taut one has.
    """
    configuration = with_inputs(problem.configuration, value)
    delta_a = actuator_state(problem.model, configuration, solution).displacements
    cable = jnp.asarray(problem.model.mechanism.actuators.unilateral)
    cable = cable & jnp.asarray(configuration.actuation.by_displacement)
    lower, upper = problem.box()
    wound = jnp.where(cable, jnp.maximum(value, jnp.minimum(delta_a, upper)), value)
    value = jnp.where(upper > lower, wound, value)
    configuration = with_inputs(problem.configuration, value)
    return value, actuator_compliance(problem.model, configuration, solution)


def start_control(
    problem: ControlProblem,
    guess: Float[Array, "n_points 3"],
    settings: ControlSettings,
) -> ControlState:
    """Build the state before the first step (traceable).

    Args:
        problem: The command.
        guess: Displacement close to the equilibrium at the start; zero for rest [m].
        settings: Settings.
    """
    solution = solve_equilibrium(
        problem.model,
        with_inputs(problem.configuration, problem.start),
        guess=guess,
        settings=settings.newton,
    )
    value, compliance = _respond(problem, problem.start, solution)
    zero, no = jnp.zeros(()), jnp.zeros((), bool)
    state = ControlState(
        value=value,
        solution=solution,
        compliance=compliance,
        step_bound=zero + settings.step_bound,
        penalty=jnp.ones(problem.levels.shape[0] + 1),
        cost=zero,
        violation=zero,
        error=zero,
        last_step=zero + jnp.inf,
        kkt_residual=zero,
        newton_steps=solution.steps,
        accepted=~no,
        step=jnp.zeros((), jnp.int32),
        met=no,
        vanished=no,
        stalled=no,
    )
    return _judged(problem, settings, state)


def _judged(problem: ControlProblem, settings: ControlSettings, state: ControlState):
    """Update the errors of a state and whether its goals are met."""
    linear = linearise(problem, state.value, state.compliance)
    parts = _parts(problem, linear, state.compliance.state)
    error = jnp.max(jnp.abs(problem.residuals(state.compliance.state)))
    met = (error <= settings.tol) & (parts[0] <= ROUNDING)
    return eqx.tree_at(
        lambda s: (s.cost, s.violation, s.error, s.met),
        state,
        (jnp.sum(parts[1:]), parts[0], error, met),
    )


def _parts(problem: ControlProblem, linear: Linear, state: ActuatorState):
    """Compute the violated limits, then the cost of each level [-]."""
    room = follow_room(problem, state, linear.length)
    violation = jnp.sum(jnp.maximum(-room, 0.0))
    off = level_errors(problem, state, linear.energy)
    return jnp.concatenate([violation[None], 0.5 * jnp.sum(off**2, axis=1)])


def control_step(
    problem: ControlProblem, settings: ControlSettings, state: ControlState
) -> ControlState:
    """Take one step: linearise, solve the QPs, try, decide (traceable).

    Args:
        problem: The command.
        settings: Settings.
        state: State before the step, whose equilibrium has converged.

    Returns:
        State after it.
    """
    linear = linearise(problem, state.value, state.compliance)
    levels = tuple(zip(linear.W, linear.error, strict=True))
    qp = step_in_levels(levels, linear.rows, state.step_bound)
    change = qp.y * linear.scale
    value = jnp.clip(state.value + change, *problem.box())
    guess = jnp.tensordot(change, state.compliance.displacement, axes=1)
    guess = state.solution.displacement + guess
    configuration = with_inputs(problem.configuration, value)
    solution = solve_equilibrium(
        problem.model, configuration, guess=guess, settings=settings.newton
    )
    tried = actuator_state(problem.model, configuration, solution)
    trial = Trial(
        parts=Parts(
            now=_parts(problem, linear, state.compliance.state),
            expected=_expected_parts(linear, qp.y),
            tried=_parts(problem, linear, tried),
        ),
        size=jnp.max(jnp.abs(qp.y)),
        kkt_residual=qp.kkt_residual,
        cosine=_cosine(linear, qp.y, state.penalty),
        converged=solution.converged,
    )
    decision = decide(
        trial,
        state.step_bound,
        state.penalty,
        tol=settings.tol,
        step_tol=settings.step_tol,
        max_step_bound=settings.max_step_bound,
    )

    def moved():
        wound, compliance = _respond(problem, value, solution)
        return wound, solution, compliance

    reached, equilibrium, compliance = jax.lax.cond(
        decision.accepted,
        moved,
        lambda: (state.value, state.solution, state.compliance),
    )
    new = replace(
        state,
        value=reached,
        solution=equilibrium,
        compliance=compliance,
        step_bound=decision.step_bound,
        penalty=decision.penalty,
        last_step=trial.size,
        kkt_residual=trial.kkt_residual,
        newton_steps=solution.steps,
        accepted=decision.accepted,
        step=state.step + 1,
        vanished=decision.vanished,
        stalled=decision.stalled,
    )
    return _judged(problem, settings, new)


def _expected_parts(linear: Linear, y: Float[Array, " n_a"]):
    """Predict the parts after a step with the linear model [-]."""
    after = linear.W @ y + linear.error
    room = linear.rows.b - linear.rows.A @ y
    violation = jnp.sum(jnp.maximum(-room, 0.0))
    return jnp.concatenate([violation[None], 0.5 * jnp.sum(after**2, axis=1)])


def _cosine(linear: Linear, y: Float[Array, " n_a"], penalty):
    """Compute the cosine between the weighted errors and their reduction [-]."""
    weight = penalty[1:, None]
    change = linear.W @ y
    lengths = jnp.sum(weight * change**2) * jnp.sum(weight * linear.error**2)
    lengths = jnp.maximum(lengths, jnp.finfo(y.dtype).tiny)
    return -jnp.sum(weight * change * linear.error) / jnp.sqrt(lengths)
