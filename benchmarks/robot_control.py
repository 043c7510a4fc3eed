"""Open-loop control of a printed parallel robot by its model, ordered and calibrated.

Twenty goals are poses that the printed robot (`_robot.py`) takes at random angles of
its motors, so that it can reach each. The model says which angles they need, from its
working point; the printed robot is commanded these, and the error is that of its rod.
A hundred more goals are poses that the ordered model takes itself, and two more lie
beyond the farthest of these. `out_of_reach_over_reachable` is how long the slower of
these two searches takes, over the mean time for one of the hundred; the first of them
compiles.

What the errors come from, at fixed commands, where a model shows the goal and the
printed robot what it makes of it:

- `left_by_*_model_mm`: how far a model itself stays off its goals, which is all that
  the search leaves.
- `true_by_mesh_*`, `true_by_law_*`, `true_between_points_*`: the change of pose as the
  mesh, the law, and the material between control points of the printed robot are
  replaced by those of the true model one after the other, at its commands.
- `error_calibrated_noise_free_*`: of a calibration on readings without noise.
- `error_calibrated_own_law_*`: the same, of a robot with the law and mesh of the model;
  what seven poses and the prior leave open.
- `error_law_alone_*`: of the law and mesh of the model with all else as printed, and
  nothing calibrated to make up for them. This and the two above are at the commands of
  the calibrated model.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks._parallel_robot import ParallelRobot
from benchmarks._printed_robot import PrintedRobot
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._robot import (
    READ_STD,
    READ_STD_ANGLE,
    Measured,
    calibrated,
    measured_robot,
    model_robot,
)
from benchmarks._robot_errors import (
    Differences,
    differences,
    on_the_models_mesh,
    read_exactly,
    shown,
)
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import BodyFrame
from softcal_jax.control import (
    OUTCOMES,
    InverseResult,
    Limits,
    sample_workspace,
    solve_inverse,
)
from softcal_jax.equilibrium import Model
from softcal_jax.results import headline

N_GOALS = 20

N_OWN = 100

SEED = 0
"""Seed of the printed robot."""

ANGLES = 30.0 + 30.0 * np.random.default_rng(1).random((N_GOALS, 6))
"""Motor angles at which the printed robot shows the goals [degrees]."""

OWN_ANGLES = 30.0 + 30.0 * np.random.default_rng(2).random((N_OWN, 6))
"""Motor angles at which the ordered model shows its own poses [degrees]."""

BEYOND = (0.015, 0.06)
"""How far goals out of reach lie beyond the farthest of the model's own poses [m]."""

MATERIAL = ("E_", "theta")
"""How the names of the parameters of the material begin."""

RANGE = np.deg2rad((20.0, 70.0))
"""Limits of the motors [rad]."""


COLUMNS = ("model", "position [mm]", "orientation [deg]")


class Commanded(NamedTuple):
    """What came of the goals that a model was asked for.

    Attributes:
        results: The commands of the model.
        angles: Their motor angles [degrees].
        mm: How far the printed robot ended off the goals [mm].
        deg: The same of the orientation [degrees].
    """

    results: list[InverseResult]
    angles: Float[HostArray, "n_goals 6"]
    mm: list[float]
    deg: list[float]

    @property
    def met(self) -> int:
        """Goals that the model itself meets."""
        return sum(result.met for result in self.results)

    @property
    def left(self) -> list[float]:
        """How far the model itself stays off the goals [mm]."""
        return [1e3 * float(np.linalg.norm(r.goals[0].residual)) for r in self.results]


def run(options: Options) -> Outcome:
    """Goals, commands of all models, and what the printed robot makes of them."""
    robot = model_robot()
    read = model_robot(std=READ_STD, std_angle=READ_STD_ANGLE)
    measured = measured_robot(read, SEED)
    printed = measured.printed
    options.say("its own poses")
    own = own_poses(robot, OWN_ANGLES)
    results, seconds = timed(commands(robot, robot.model, own))
    met = sum(result.met for result in results)
    options.say(f"{met} of {len(results)} met; goals out of reach")
    far = farther(robot, own)
    beyond, seconds_beyond = timed(commands(robot, robot.model, far))
    figures: dict[str, Figure] = {
        "own_poses_reached_of_100": met,
        "own_poses_met_from_the_start": sum(len(r.attempts) == 1 for r in results),
        "out_of_reach_over_reachable": max(seconds_beyond) / float(np.mean(seconds)),
        "out_of_reach_called_nearest": sum(
            bool(r.outcome == OUTCOMES.nearest) for r in beyond
        ),
    }
    options.say("calibrating")
    models = {
        "uncalibrated": robot.model,
        "calibrated": fitted(robot, measured).model,
        "true": true_model(robot, printed),
    }
    goals = shown(robot, printed.model, ANGLES, first=printed.first)
    done = {}
    for name, model in models.items():
        options.say(f"commands of the {name} model")
        done[name] = commanded(
            robot, printed, list(commands(robot, model, goals)), goals
        )
    samples: dict[str, list[float]] = {}
    for name, one in done.items():
        figures |= _figures(name, one)
        samples |= {f"{name}_mm": one.mm, f"{name}_deg": one.deg}
        samples[f"{name}_model_off_mm"] = one.left
        for result in one.results:
            if not result.met:
                options.say(headline(result))
    before, after = done["uncalibrated"], done["calibrated"]
    for unit, old, new in (
        ("mm", before.mm, after.mm),
        ("deg", before.deg, after.deg),
    ):
        left = float(np.mean(new) / np.mean(old))
        figures[f"improvement_{unit}_percent"] = 100.0 * (1.0 - left)
    options.say("what the errors come from")
    at = {name: one.angles for name, one in done.items()}
    parts = causes(robot, measured, models["true"], at)
    for name, (distances, turns) in parts.items():
        samples[f"{name}_mm"] = distances
        figures[f"{name}_mm"] = float(np.mean(distances))
        figures[f"{name}_deg"] = float(np.mean(turns))
    wanted = {
        "own_poses_reached_of_100": Goal("at least", 98),
        "out_of_reach_over_reachable": Goal("at most", 3),
        "out_of_reach_called_nearest": Goal("at least", len(BEYOND)),
        "improvement_mm_percent": Goal("at least", 50),
    }
    return Outcome(figures, samples, wanted, tables=_tables(done, parts))


def _figures(name: str, one: Commanded) -> dict[str, Figure]:
    return {
        f"error_{name}_mm": float(np.mean(one.mm)),
        f"error_{name}_deg": float(np.mean(one.deg)),
        f"worst_{name}_mm": max(one.mm),
        f"goals_met_by_{name}_model": one.met,
        f"left_by_{name}_model_mm": float(np.mean(one.left)),
    }


def _tables(
    done: Mapping[str, Commanded], parts: Mapping[str, Differences]
) -> list[Table]:
    rows, causes = [], []
    for name, one in done.items():
        mean = (np.mean(one.mm), np.mean(one.deg))
        cells = (*mean, max(one.mm), max(one.deg), np.mean(one.left))
        met = f"{one.met} of {len(one.results)}"
        rows.append([name, *(f"{v:.3f}" for v in cells), met])
    for name, both in parts.items():
        mean = [f"{np.mean(values):.3f}" for values in both]
        causes.append([name.replace("_", " "), *mean])
    more = ("worst [mm]", "worst [deg]", "left by the model [mm]", "met")
    return [
        Table("Errors at goals", (*COLUMNS, *more), rows),
        Table("What they come from", COLUMNS, causes),
    ]


def commanded(
    robot: ParallelRobot,
    printed: PrintedRobot,
    results: list[InverseResult],
    goals: Sequence[Pose],
) -> Commanded:
    """Errors of the printed robot at the commands of a model."""
    angles = np.rad2deg([result.inputs for result in results])
    there = shown(robot, printed.model, angles, first=printed.first)
    return Commanded(results, angles, *differences(there, goals))


def causes(
    robot: ParallelRobot,
    measured: Measured,
    true: Model,
    at: Mapping[str, Float[HostArray, "n_goals 6"]],
) -> dict[str, Differences]:
    """Differences of pose [mm, degrees] that the errors come from, by their names.

    Args:
        robot: The ordered robot.
        measured: The printed one, and its readings.
        true: The model with the true material at its control points.
        at: Commands of the models by name [degrees].
    """
    printed, coarse = measured.printed, on_the_models_mesh(robot, SEED)
    there = shown(robot, printed.model, at["true"], first=printed.first)
    on_mesh = shown(robot, coarse.model, at["true"], first=coarse.first)
    by_law = shown(robot, coarse.first, at["true"])
    parts = {
        "true_by_mesh": differences(on_mesh, there),
        "true_by_law": differences(by_law, on_mesh),
        "true_between_points": differences(shown(robot, true, at["true"]), by_law),
    }
    known = at["calibrated"]
    shows = shown(robot, printed.model, known, first=printed.first)
    modelled = shown(robot, coarse.first, known)
    exact = read_exactly(measured, printed.model, first=printed.first)
    noise_free = shown(robot, fitted(robot, exact).model, known)
    exact = read_exactly(measured, coarse.first)
    own_law = shown(robot, fitted(robot, exact).model, known)
    return parts | {
        "error_calibrated_noise_free": differences(noise_free, shows),
        "error_calibrated_own_law": differences(own_law, modelled),
        "error_law_alone": differences(modelled, shows),
    }


def fitted(robot: ParallelRobot, measured: Measured) -> CalibrationResult:
    """The robot calibrated on readings.

    Raises:
        RuntimeError: If the calibration did not converge.
    """
    result = calibrated(robot, measured)
    if not result.converged:
        raise RuntimeError(f"the calibration of robot {SEED} did not converge.")
    return result


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


def farther(robot: ParallelRobot, poses: Sequence[Pose]) -> list[Pose]:
    """Poses beyond the farthest of some, seen from the middle of them, by `BEYOND`."""
    translations = np.array([pose.translation for pose in poses])
    outwards = translations - translations.mean(axis=0)
    distances = np.linalg.norm(outwards, axis=1)
    farthest = int(np.argmax(distances))
    direction = outwards[farthest] / distances[farthest]
    move = lambda by: replace(
        poses[farthest], translation=translations[farthest] + by * direction
    )
    return [move(by) for by in BEYOND]


def timed(
    results: Iterator[InverseResult],
) -> tuple[list[InverseResult], list[float]]:
    """Results, and the seconds that each took; the first of a model compiles."""
    done, seconds = [], []
    begin = time.perf_counter()
    for result in results:
        done.append(result)
        seconds.append(time.perf_counter() - begin)
        begin = time.perf_counter()
    return done, seconds


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
) -> Iterator[InverseResult]:
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
    return (
        solve_inverse(
            model,
            start,
            goals={name: goal},
            limits=limits,
            guess=at_work,
            throw=False,
        )
        for goal in goals
    )
