"""Inverse control: find the actuation for goals of the effectors (paper Eqs. 4 to 6).

The search is compiled once for all goals and limits of the same actuators, and all
models of the same shapes.
"""

from softcal_jax.control._command import ControlSettings as ControlSettings
from softcal_jax.control._goals import (
    Goal as Goal,
    Limits as Limits,
    commanded as commanded,
    with_goals as with_goals,
    with_marker_goals as with_marker_goals,
)
from softcal_jax.control._inputs import (
    ActuatorCompliance as ActuatorCompliance,
    ActuatorReadings as ActuatorReadings,
    Workspace as Workspace,
    actuator_compliance as actuator_compliance,
    actuator_readings as actuator_readings,
    sample_workspace as sample_workspace,
    with_inputs as with_inputs,
)
from softcal_jax.control._result import (
    OUTCOMES as OUTCOMES,
    Attempt as Attempt,
    BlindDirection as BlindDirection,
    InverseResult as InverseResult,
    StepRecord as StepRecord,
    TrajectoryResult as TrajectoryResult,
    coordinate_names as coordinate_names,
)
from softcal_jax.control._solve import (
    ControlWarning as ControlWarning,
    follow_trajectory as follow_trajectory,
    solve_inverse as solve_inverse,
    strongest_limits as strongest_limits,
)
