"""What the errors of commands come from: mesh, law, material, or readings.

A model brings itself to a goal, so at its commands it shows the goal and the printed
robot (`_robot.py`) something else: the error of the command is the difference of the
two in the same pose. Replacing one thing at a time at fixed commands splits it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks._parallel_robot import ParallelRobot, pose
from benchmarks._printed_robot import PrintedRobot, printed_robot
from benchmarks._robot import SIZE, STD, STD_ANGLE, Measured
from softcal_jax.bodies import Pose
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.equilibrium import Model
from softcal_jax.robots import simulated_measurements


class Differences(NamedTuple):
    """Distances [mm] and angles [degrees] between poses."""

    mm: list[float]
    deg: list[float]


def posed(robot: ParallelRobot, angles) -> list[Configuration]:
    """Poses at motor angles, one row per pose [degrees]."""
    return [
        pose(robot.geometry, f"goal {k}", row, std=STD, std_angle=STD_ANGLE)
        for k, row in enumerate(angles, start=1)
    ]


def shown(
    robot: ParallelRobot, model: Model, angles, *, first: Model | None = None
) -> list[Pose]:
    """Poses of the rod of a model at motor angles.

    Args:
        robot: The robot, for its geometry.
        model: The model, or a printed robot.
        angles: Angles of the motors, one row per pose [degrees].
        first: The model whose equilibria serve as guesses.
    """
    poses = simulated_measurements(model, posed(robot, angles), first=first)
    effectors = [c.effectors[0] for c in poses]
    return [e.measured for e in effectors if isinstance(e, BodyFrame) and e.measured]


def read_exactly(
    measured: Measured, model: Model, *, first: Model | None = None
) -> Measured:
    """The same poses, read without noise.

    Args:
        measured: The poses, and what their readings are taken to be known to.
        model: The printed robot, or what takes its place.
        first: The model whose equilibria serve as guesses.
    """
    calibration, validation = (
        simulated_measurements(model, asked, first=first)
        for asked in (measured.calibration, measured.validation)
    )
    return Measured(measured.printed, calibration, validation)


def on_the_models_mesh(robot: ParallelRobot, seed: int) -> PrintedRobot:
    """The same printed robot, on a mesh as coarse as the model's.

    Its `first` has the law of the model, too, and differs from it by the material
    between control points alone.
    """
    return printed_robot(robot.geometry, seed=seed, size=SIZE)


def differences(reached: Sequence[Pose], goals: Sequence[Pose]) -> Differences:
    """Distances [mm] and angles [degrees] between poses."""
    pairs = [_difference(a, b) for a, b in zip(reached, goals, strict=True)]
    distances, angles = np.array(pairs).T
    return Differences(distances.tolist(), angles.tolist())


def _difference(reached: Pose, goal: Pose) -> tuple[float, float]:
    distance = np.linalg.norm(np.asarray(reached.translation - goal.translation))
    cosine = 0.5 * (np.trace(reached.matrix @ goal.matrix.T) - 1.0)
    return 1e3 * float(distance), float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
