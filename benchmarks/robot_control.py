"""Open-loop control of a printed parallel robot by its model, ordered and calibrated.

Twenty goals are poses that the printed robot (`_robot.py`) takes at random angles of
its motors, so that it can reach each. The model says which angles they need, from its
working point; the printed robot is commanded these, and the error is that of its rod.
The same command by the model with the true material and setup of the printed robot
shows what is left without a calibration: its coarser mesh, its law, and the search.

A hundred more goals are poses that the ordered model takes itself.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._robot import STD, STD_ANGLE, calibrated, measured_robot, model_robot
from softcal_jax.bodies import Pose
from softcal_jax.calibration import simulated_measurements
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.control import InverseResult, Limits, sample_workspace, solve_inverse
from softcal_jax.equilibrium import Model
from softcal_jax.robots import ParallelRobot, PrintedRobot, pose

N_GOALS = 20

N_OWN = 100

SEED = 0
"""Seed of the printed robot."""

ANGLES = 30.0 + 30.0 * np.random.default_rng(1).random((N_GOALS, 6))
"""Motor angles at which the printed robot shows the goals [degrees]."""

OWN_ANGLES = 30.0 + 30.0 * np.random.default_rng(2).random((N_OWN, 6))
"""Motor angles at which the ordered model shows its own poses [degrees]."""

MATERIAL = ("E_", "theta")
"""How the names of the parameters of the material begin."""

RANGE = np.deg2rad((20.0, 70.0))
"""Limits of the motors [rad]."""


def run(options: Options) -> Outcome:
    """Goals, commands of all models, and what the printed robot makes of them."""
    robot = model_robot()
    measured = measured_robot(robot, SEED)
    options.say("its own poses")
    own = own_poses(robot, OWN_ANGLES)
    found = commands(robot, robot.model, own)
    met = sum(result.met for result in found)
    figures: dict[str, Figure] = {
        "own_poses_reached_of_100": met,
        "own_poses_met_from_the_start": sum(len(r.attempts) == 1 for r in found),
    }
    options.say(f"{met} of {len(own)} met; calibrating")
    result = calibrated(robot, measured)
    if not result.converged:
        raise RuntimeError(f"the calibration of robot {SEED} did not converge.")
    options.say("goals")
    goals = reached(robot, measured.printed, ANGLES)
    models = {
        "uncalibrated": robot.model,
        "calibrated": result.model,
        "true": true_model(robot, measured.printed),
    }
    samples, rows = {}, []
    for name, model in models.items():
        options.say(f"commands of the {name} model")
        found = commands(robot, model, goals)
        options.say("the printed robot")
        angles = np.rad2deg([result.inputs for result in found])
        there = reached(robot, measured.printed, angles)
        errors = np.array([_error(a, b) for a, b in zip(there, goals, strict=True)])
        left = np.array([_left(result) for result in found])
        samples[f"{name}_mm"], samples[f"{name}_deg"] = errors.T.tolist()
        samples[f"{name}_model_off_mm"] = left[:, 0].tolist()
        mean, met = errors.mean(axis=0), sum(result.met for result in found)
        figures |= {
            f"error_{name}_mm": float(mean[0]),
            f"error_{name}_deg": float(mean[1]),
            f"worst_{name}_mm": float(errors[:, 0].max()),
            f"goals_met_by_{name}_model": met,
            f"left_by_{name}_model_mm": float(left[:, 0].mean()),
        }
        cells = (*mean, *errors.max(axis=0), left[:, 0].mean())
        rows.append([name, *(f"{v:.3f}" for v in cells), f"{met}"])
        for result in found:
            if not result.met:
                options.say(result.message)
    for unit in ("mm", "deg"):
        before, after = (
            float(figures[f"error_{name}_{unit}"])
            for name in ("uncalibrated", "calibrated")
        )
        figures[f"improvement_{unit}_percent"] = 100.0 * (1.0 - after / before)
    columns = [
        "model",
        "position [mm]",
        "orientation [deg]",
        "worst [mm]",
        "worst [deg]",
        "left by the model [mm]",
        "met",
    ]
    wanted = {
        "own_poses_reached_of_100": Goal("at least", 98),
        "improvement_mm_percent": Goal("at least", 50),
    }
    table = Table("Errors at goals", columns, rows)
    return Outcome(figures, samples, wanted, tables=[table])


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


def own_poses(robot: ParallelRobot, angles) -> list[Pose]:
    """Poses of the rod of the ordered model at motor angles [degrees]."""
    asked = robot.configurations[0]
    workspace = sample_workspace(robot.model, asked, np.deg2rad(angles))
    if workspace.failures:
        raise RuntimeError("; ".join(workspace.failures))
    (rod,) = asked.effectors
    rows = workspace.effectors[rod.name]
    posed = [rod.measured_as(row, robot.model.mechanism) for row in rows]
    return [e.measured for e in posed if isinstance(e, BodyFrame) and e.measured]


def true_model(robot: ParallelRobot, printed: PrintedRobot) -> Model:
    """The calibrated model with the truth in place of what a calibration finds.

    Its control points carry the material of the printed robot there, and its motors the
    zeros and mountings of that robot. Mesh and law remain those of the model.
    """
    space = robot.space
    known = [
        printed.parameters[q.name] if q.name.startswith(MATERIAL) else q.start
        for q in space.parameters
    ]
    model = space.model_at(robot.model, space.to_scaled(jnp.array(known)))
    setup = lambda m: (
        m.mechanism.motor_zero,
        m.mechanism.bodies.mounting_translation,
    )
    return eqx.tree_at(setup, model, setup(printed.model))


def commands(
    robot: ParallelRobot, model: Model, goals: Sequence[Pose]
) -> list[InverseResult]:
    """Commands that bring a model to the goals, each from its working point.

    Args:
        robot: The robot, for its names and its working point.
        model: The model, as ordered or calibrated.
        goals: Poses of the rod.
    """
    start = robot.configurations[0]
    name = start.effectors[0].name
    limits = {motor: Limits(displacement=tuple(RANGE)) for motor in start.actuation}
    angles = [asked.value for asked in start.actuation.values()]
    at_work = sample_workspace(model, start, [angles]).solution.displacement[0]
    return [
        solve_inverse(
            model,
            start,
            goals={name: goal},
            limits=limits,
            guess=at_work,
            throw=False,
        )
        for goal in goals
    ]


def _left(result: InverseResult) -> tuple[float, float]:
    """How far a model itself stays off its goal: distance [mm], angle [degrees]."""
    point, turn = (np.linalg.norm(fit.residual) for fit in result.goals)
    return 1e3 * float(point), float(np.rad2deg(turn))


def _error(reached: Pose, goal: Pose) -> tuple[float, float]:
    """Distance [mm] and angle [degrees] between two poses."""
    distance = np.linalg.norm(np.asarray(reached.translation - goal.translation))
    cosine = 0.5 * (np.trace(reached.matrix @ goal.matrix.T) - 1.0)
    return 1e3 * float(distance), float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
