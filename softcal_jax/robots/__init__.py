"""Ready-made robots, with the data they were measured with."""

from softcal_jax.robots._anisotropic_beam import AnisotropicBeam, anisotropic_beam
from softcal_jax.robots._measured import pneumatic_arm_path, silicone_beam_path
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

__all__ = [
    "CALIBRATION_ANGLES",
    "PRIOR",
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
    "silicone_beam_path",
]
