"""Results of inverse control."""

import equinox as eqx
import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.configurations import Configuration, EffectorRecord
from softcal_jax.equilibrium import ActuatorState, EquilibriumSolution, Model


class OUTCOMES(eqx.Enumeration):
    """Outcome of inverse control, compared with `==`."""

    met = "all goals are met"
    nearest = (
        "nearest reachable point: some goals are not met, and no step within the "
        "limits comes closer, from any start that was tried"
    )
    limits_violated = (
        "no actuation near the start keeps the limits of what follows the actuators; "
        "start inside them, or widen them"
    )
    stalled = (
        "steps were refused until none was left, short of a minimum; the equilibria "
        "may jump there, or newton.rtol be too coarse"
    )
    max_steps = "the search did not end within max_steps; raise it"
    interrupted = "the search was interrupted; this is the best actuation so far"
    no_equilibrium = "the start has no equilibrium; start from another actuation"
    singular = (
        "the tangent at the start is singular: something moves freely or loses its "
        "stability, or two actuators impose the same displacement; hold it, command "
        "one of them by force, or start from another actuation"
    )


def coordinate_names(effector: EffectorRecord) -> tuple[str, ...]:
    """Name the coordinates of an effector: axes, or nothing for a scalar."""
    if len(effector.std) == 1:
        return ("",)
    return tuple(f"{'turn ' * effector.is_turn}{axis}" for axis in "xyz")


class BlindDirection(Module):
    """A direction along which no commanded actuator moves the effectors.

    Attributes:
        coordinates: Names of the coordinates of the effectors, like "x of 'tip'".
        units: Their units.
        direction: Unit vector over them, each in units of its standard deviation [-].
            It points from the goals to the effectors.
        off: How far the effectors are from their goals along it, by coordinate, in
            their units.
        gain: How far the inputs move the effectors along it, relative to the direction
            in which they move them most [-].
    """

    coordinates: tuple[str, ...]
    units: tuple[str, ...]
    direction: Float[HostArray, " n"]
    off: Float[HostArray, " n"]
    gain: float

    def __str__(self) -> str:
        largest = np.abs(self.direction).max()
        parts = [
            f"{name} {component:+.2f} ({readable(float(f'{off:.3g}'), unit)})".strip()
            for name, unit, component, off in zip(
                self.coordinates, self.units, self.direction, self.off, strict=True
            )
            if abs(component) > 0.05 * largest
        ]
        return f"blind direction {', '.join(parts)}"


class Attempt(Module):
    """One descent of a search.

    Attributes:
        way: Where it started, in words.
        outcome: How it ended; None if it was given up because it hardly came closer.
        error: Largest error of an effector coordinate, in standard deviations [-].
        n_steps: Number of its steps towards the goals themselves.
    """

    way: str
    outcome: OUTCOMES | None
    error: float
    n_steps: int


class StepRecord(Module):
    """One step of the search.

    Attributes:
        size: Largest displacement of a node that it causes, per size of the robot [-].
        cost: Half the squared errors after the step, energy included [-].
        violation: Violated limits of the quantities that are not imposed [-].
        kkt_residual: Optimality residual of its QP [-].
        newton_steps: Newton iterations of the equilibrium on which it was tried.
        accepted: Whether it was kept.
    """

    size: float
    cost: float
    violation: float
    kkt_residual: float
    newton_steps: int
    accepted: bool


class InverseResult(Result):
    """Actuation that brings the effectors to their goals, or as near as it can.

    Attributes:
        outcome: How the search ended.
        configuration: The configuration with the actuation found.
        solution: Its equilibrium.
        goals: The effectors that have a goal, which is their measured value, and what
            they reach as the simulated one. Of a frame, its point [m] and turn [rad].
        actuators: What all actuators do; commanded are those in the actuation.
        active_limits: Limits that are reached, in words.
        held_by: Limits that keep the effectors from goals that are not met, in words,
            the strongest first.
        blind: Direction in which the effectors are off and in which no commanded
            actuator moves them; None if there is none.
        steps: The descent that led here, step by step.
        attempts: All descents that were tried.
        tol: Error at which a goal counts as met, in standard deviations [-].
        model: The model.
    """

    outcome: OUTCOMES
    configuration: Configuration
    solution: EquilibriumSolution
    goals: tuple[EffectorRecord, ...]
    actuators: tuple[ActuatorState, ...]
    active_limits: tuple[str, ...]
    held_by: tuple[str, ...]
    blind: BlindDirection | None
    steps: tuple[StepRecord, ...]
    attempts: tuple[Attempt, ...]
    tol: float
    model: Model

    @property
    def met(self) -> bool:
        """Whether all goals are met."""
        return bool(self.outcome == OUTCOMES.met)

    @property
    def unmet(self) -> tuple[EffectorRecord, ...]:
        """Goals that are not met, the farthest first, in standard deviations."""
        missed = [goal for goal in self.goals if not goal.worst <= self.tol]
        return tuple(sorted(missed, key=lambda goal: goal.worst, reverse=True))

    @property
    def forces(self) -> dict[str, float]:
        """lambda_a of every actuator, by name, in its unit."""
        return {state.name: state.force for state in self.actuators}

    @property
    def displacements(self) -> dict[str, float]:
        """delta_a likewise; 0 for an actuator without one."""
        return {state.name: state.displacement or 0.0 for state in self.actuators}

    @property
    def inputs(self) -> Float[HostArray, " n_inputs"]:
        """Imposed values in the order of the actuation, in the actuators' units."""
        return np.array([a.value for a in self.configuration.actuation.values()])


class TrajectoryResult(Result):
    """Commands along a trajectory.

    Attributes:
        points: The command for each goal, started where the previous one ended.
    """

    points: tuple[InverseResult, ...]

    @property
    def inputs(self) -> Float[HostArray, "n_goals n_inputs"]:
        """Imposed values at each goal, in the order of the actuation."""
        return np.array([point.inputs for point in self.points])

    @property
    def unmet(self) -> tuple[int, ...]:
        """Indices of the goals that are not met."""
        return tuple(i for i, point in enumerate(self.points) if not point.met)
