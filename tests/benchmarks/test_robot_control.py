"""What the control benchmark takes the readings of its printed robot to be known to."""

import numpy as np
import pytest

from benchmarks._parallel_robot import parallel_robot
from benchmarks._printed_robot import printed_robot, read_poses_of
from benchmarks._robot import READ_STD, READ_STD_ANGLE, READINGS
from benchmarks._robot_errors import differences
from softcal_jax.robots import simulated_measurements


@pytest.mark.slow  # a printed robot, whose equilibria compile for half a minute
def test_mean_readings_scatter_as_stated():
    """Readings less the poses themselves, in units of what they are stated to."""
    robot = parallel_robot(size=0.02, std=READ_STD, std_angle=READ_STD_ANGLE)
    printed = printed_robot(robot.geometry, seed=0, size=0.02)
    poses = robot.configurations + robot.validation
    read = read_poses_of(printed, poses, seed=0, readings=READINGS)
    exact = simulated_measurements(printed.model, poses, first=printed.first)
    posed = ([c.effectors[0].measured for c in each] for each in (read, exact))
    mm, deg = differences(*posed)
    stated = read[0].effectors[0]
    # 42 draws each: their variance is 1 within three times sqrt(2 / 42).
    for off, std in (
        (1e-3 * np.array(mm), stated.std),
        (np.deg2rad(deg), stated.std_angle),
    ):
        variance = np.sum(off**2) / (3 * len(poses) * std**2)
        assert abs(variance - 1.0) < 3.0 * np.sqrt(2.0 / 42.0)
