"""Ready-made robots, with the data they are calibrated to."""

from softcal_jax.robots._anisotropic_beam import AnisotropicBeam, anisotropic_beam
from softcal_jax.robots._parallel_robot import (
    CALIBRATION_ANGLES,
    PRIOR,
    SETUP,
    VALIDATION_ANGLES,
    ParallelRobot,
    parallel_robot,
    pose,
)
from softcal_jax.robots._parallel_robot_geometry import Arm, ParallelRobotGeometry
from softcal_jax.robots._printed_robot import (
    PrintedRobot,
    PrintingErrors,
    printed_robot,
    read_poses_of,
)
from softcal_jax.robots._ready_made import (
    READY_MADE,
    pneumatic_arm_path,
    ready_made_path,
    silicone_beam_path,
)

__all__ = [
    "CALIBRATION_ANGLES",
    "PRIOR",
    "READY_MADE",
    "SETUP",
    "VALIDATION_ANGLES",
    "AnisotropicBeam",
    "Arm",
    "ParallelRobot",
    "ParallelRobotGeometry",
    "PrintedRobot",
    "PrintingErrors",
    "anisotropic_beam",
    "parallel_robot",
    "pneumatic_arm_path",
    "pose",
    "printed_robot",
    "read_poses_of",
    "ready_made_path",
    "silicone_beam_path",
]
