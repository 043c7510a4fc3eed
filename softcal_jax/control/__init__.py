"""Inverse control: find the actuation for goals of the effectors (paper Eqs. 4 to 6).

The search is compiled once for all goals and all models of the same shapes.
"""

from softcal_jax.control._compliance import (
    ActuatorCompliance,
    ActuatorReadings,
    actuator_compliance,
    actuator_readings,
    with_inputs,
)
from softcal_jax.control._goals import Goal, with_goals
from softcal_jax.control._limits import Limits
from softcal_jax.control._result import (
    OUTCOMES,
    Attempt,
    BlindDirection,
    GoalFit,
    InverseResult,
    StepRecord,
    TrajectoryResult,
)
from softcal_jax.control._solve import (
    ControlWarning,
    follow_trajectory,
    solve_inverse,
)
from softcal_jax.control._step import ControlSettings
from softcal_jax.control._workspace import Workspace, sample_workspace

__all__ = [
    "OUTCOMES",
    "ActuatorCompliance",
    "ActuatorReadings",
    "Attempt",
    "BlindDirection",
    "ControlSettings",
    "ControlWarning",
    "Goal",
    "GoalFit",
    "InverseResult",
    "Limits",
    "StepRecord",
    "TrajectoryResult",
    "Workspace",
    "actuator_compliance",
    "actuator_readings",
    "follow_trajectory",
    "sample_workspace",
    "solve_inverse",
    "with_goals",
    "with_inputs",
]
