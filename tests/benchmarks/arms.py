"""Where a motor's arm carries the end of its branch."""

from scipy.spatial.transform import Rotation

from benchmarks._parallel_robot_geometry import Arm
from softcal_jax.bodies import Pose


def arm_pose(arm: Arm, angle: float) -> Pose:
    """Motion of the end from the flat sheet: onto the arm, then about the motor axis.

    Its origin moves to axis_point + arm_length (-cos(angle) e_r + sin(angle) e_a), and
    the branch leaves the arm in the direction in parentheses.
    """
    turn = angle * arm.axis_direction
    mounted = arm.origin + arm.mounting.translation
    lever = Rotation.from_rotvec(turn).apply(mounted - arm.axis_point)
    return Pose(arm.axis_point + lever - arm.origin, turn)
