"""Results of inverse control."""

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Configuration, EffectorRecord
from softcal_jax.equilibrium import EquilibriumSolution


class OUTCOMES(eqx.Enumeration):
    """Outcome of inverse control, compared with `==`."""

    met = "all goals are met"
    nearest = (
        "nearest reachable point: some goals are not met, and no step within the "
        "limits comes closer"
    )
    limits_violated = (
        "no actuation near the start keeps the limits of what follows the actuators; "
        "start inside them, or widen them"
    )
    stalled = (
        "steps were refused until none was left, short of a minimum; the equilibria "
        "may jump there (buckling), or newton.rtol be too coarse"
    )
    max_steps = "the search did not end within max_steps; raise it"
    no_equilibrium = "the start has no equilibrium; start from another actuation"


class GoalFit(eqx.Module):
    """How close one effector came to its goal.

    Attributes:
        effector: Its record, with the goal in `measured` and the value reached in
            `simulated`. A frame has one for its point [m] and one for its turn [rad].
        priority: Its priority, 1 first.
    """

    effector: EffectorRecord
    priority: int

    @property
    def name(self) -> str:
        """Name of the effector."""
        return self.effector.name

    @property
    def reached(self) -> Float[HostArray, " k"]:
        """Coordinates reached; for a turn, the rotation vector from the goal."""
        assert self.effector.simulated is not None
        return self.effector.simulated

    @property
    def residual(self) -> Float[HostArray, " k"]:
        """Reached minus goal, 0 for coordinates without a goal."""
        return self.effector.error(self.reached)

    @property
    def in_std(self) -> Float[HostArray, " k"]:
        """The residual in units of the standard deviation [-]."""
        return self.residual / self.effector.std


class StepRecord(eqx.Module):
    """One step of the search.

    Attributes:
        size: Largest change of an input, as the displacement of a node that it causes,
            relative to the size of the robot [-].
        cost: Half the squared errors after the step, energy included [-].
        violation: Violated limits of the quantities that are not imposed [-].
        kkt_residual: Optimality residual of its QPs [-].
        newton_steps: Newton iterations of the equilibrium on which it was tried.
        accepted: Whether it was kept.
    """

    size: float
    cost: float
    violation: float
    kkt_residual: float
    newton_steps: int
    accepted: bool


class InverseResult(eqx.Module):
    """Actuation that brings the effectors to their goals, or as near as it can.

    Attributes:
        outcome: How the search ended; `message` says it in words.
        configuration: The configuration with the actuation found.
        solution: Its equilibrium.
        goals: How close each effector with a goal came to it.
        forces: lambda_a of every actuator, by name, in its unit.
        displacements: delta_a likewise; 0 for an actuator without one.
        active_limits: Limits that are reached, in words.
        steps: The search, step by step.
    """

    outcome: OUTCOMES
    configuration: Configuration
    solution: EquilibriumSolution
    goals: tuple[GoalFit, ...]
    forces: dict[str, float]
    displacements: dict[str, float]
    active_limits: tuple[str, ...]
    steps: tuple[StepRecord, ...]

    @property
    def met(self) -> bool:
        """Whether all goals are met."""
        return bool(self.outcome == OUTCOMES.met)

    @property
    def message(self) -> str:
        """The outcome in words, with the worst goal and the limits that bind."""
        text = f"configuration {self.configuration.name!r}: {OUTCOMES[self.outcome]}"
        if self.goals:
            worst = max(self.goals, key=lambda fit: np.max(np.abs(fit.in_std)))
            text += (
                f"; farthest is {worst.name!r}, by "
                f"{np.linalg.norm(worst.residual):.3g} {worst.effector.unit}"
            )
        if self.active_limits:
            text += f"; {', '.join(self.active_limits)}"
        return text + "."

    @property
    def inputs(self) -> Float[HostArray, " n_inputs"]:
        """Imposed values in the order of the actuation, in the actuators' units."""
        return np.array([a.value for a in self.configuration.actuation.values()])


class TrajectoryResult(eqx.Module):
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
