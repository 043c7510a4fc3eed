"""Open-loop control of a printed parallel robot by its model, ordered and calibrated.

Twenty goals are poses that the printed robot (`_robot.py`) takes at random angles of
its motors, so that each can be reached. The model says which angles they need; the
printed robot is commanded these, and the error is that of its rod.
"""

import numpy as np

from benchmarks._problem import Figure, Options, Outcome, Table
from benchmarks._robot import STD, STD_ANGLE, calibrated, measured_robot, model_robot
from softcal_jax.bodies import Pose
from softcal_jax.calibration import simulated_measurements
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.control import Limits, follow_trajectory
from softcal_jax.equilibrium import Model
from softcal_jax.robots import ParallelRobot, PrintedRobot, pose

N_GOALS = 20

SEED = 0
"""Seed of the printed robot."""

ANGLES = 30.0 + 30.0 * np.random.default_rng(1).random((N_GOALS, 6))
"""Motor angles at which the printed robot shows the goals [degrees]."""

RANGE = np.deg2rad((20.0, 70.0))
"""Limits of the motors [rad]."""


def run(options: Options) -> Outcome:
    """Goals, commands of both models, and what the printed robot makes of them."""
    robot = model_robot()
    measured = measured_robot(robot, SEED)
    options.say("calibrating")
    result = calibrated(robot, measured)
    if not result.converged:
        raise RuntimeError(f"the calibration of robot {SEED} did not converge.")
    options.say("goals")
    goals = reached(robot, measured.printed, ANGLES)
    models = {"uncalibrated": robot.model, "calibrated": result.model}
    figures: dict[str, Figure] = {}
    samples, rows = {}, []
    for name, model in models.items():
        options.say(f"commands of the {name} model")
        angles, met = commands(robot, model, goals)
        options.say("the printed robot")
        there = reached(robot, measured.printed, angles)
        errors = np.array([_error(a, b) for a, b in zip(there, goals, strict=True)])
        samples[f"{name}_mm"], samples[f"{name}_deg"] = errors.T.tolist()
        mean = errors.mean(axis=0)
        figures |= {
            f"error_{name}_mm": float(mean[0]),
            f"error_{name}_deg": float(mean[1]),
            f"worst_{name}_mm": float(errors[:, 0].max()),
            f"goals_met_by_{name}_model": met,
        }
        rows.append([name, *(f"{v:.2f}" for v in (*mean, *errors.max(axis=0)))])
    for unit in ("mm", "deg"):
        before, after = (float(figures[f"error_{name}_{unit}"]) for name in models)
        figures[f"improvement_{unit}_percent"] = 100.0 * (1.0 - after / before)
    columns = ["model", "position [mm]", "orientation [deg]", "worst [mm]", "worst"]
    table = Table("Errors at goals", columns, rows)
    return Outcome(figures, samples, tables=[table])


def _configurations(robot: ParallelRobot, angles) -> list[Configuration]:
    return [
        pose(robot.geometry, f"goal {k}", row, std=STD, std_angle=STD_ANGLE)
        for k, row in enumerate(angles, start=1)
    ]


def reached(robot: ParallelRobot, printed: PrintedRobot, angles) -> list[Pose]:
    """Poses of the rod of a printed robot at motor angles.

    Args:
        robot: The model, for its geometry.
        printed: The printed robot.
        angles: Angles of the motors, one row per pose [degrees].
    """
    found = simulated_measurements(
        printed.model, _configurations(robot, angles), first=printed.first
    )
    effectors = [c.effectors[0] for c in found]
    return [e.measured for e in effectors if isinstance(e, BodyFrame) and e.measured]


def commands(robot: ParallelRobot, model: Model, goals: list[Pose]):
    """Motor angles that bring a model to the goals, one after the other.

    Args:
        robot: The robot, for its names and its working point.
        model: The model, as ordered or calibrated.
        goals: Poses of the rod.

    Returns:
        Angles [degrees], and how many of the goals the model meets.
    """
    start = robot.configurations[0]
    name = start.effectors[0].name
    limits = {motor: Limits(displacement=tuple(RANGE)) for motor in start.actuation}
    found = follow_trajectory(
        model, start, [{name: goal} for goal in goals], limits=limits
    )
    return np.rad2deg(found.inputs), len(goals) - len(found.unmet)


def _error(reached: Pose, goal: Pose) -> tuple[float, float]:
    """Distance [mm] and angle [degrees] between two poses."""
    distance = np.linalg.norm(np.asarray(reached.translation - goal.translation))
    cosine = 0.5 * (np.trace(reached.matrix @ goal.matrix.T) - 1.0)
    return 1e3 * float(distance), float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
