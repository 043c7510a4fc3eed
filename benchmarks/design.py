"""Goals that homogeneous robots miss: what a design reaches, as ordered and as printed.

- `finger`: a beam under one cable takes a curve that is bent more at its tip, little
  and much, with E_t, E_l and theta at three control points.
- `wrist`: a hollow box under pressure turns about its axis without bending, though its
  cavity is off its middle; fibres wind around the axis, with four control points.
- `parallel`: the rod of the parallel robot turns about its axis, one way and the other,
  and stays in its place otherwise. Six motors bend two equal sheets, of one material
  all over they do not turn it; a control point on each branch, shared by both.

Each is designed within what Polyfoam reaches, and printed thirty times with errors of
30 % and 20 degrees at each control point:

- `goal_error_over_homogeneous`: the error over all goals, over that of the best
  homogeneous material; the median over the tasks.
- `as_printed_coverage_95`: how many errors of prints, each solved anew, lie in the
  interval that the design says has 95 % of them [%].
- `printed_error_after_calibration_over_before`: of three prints, measured in seven
  poses, calibrated from the design with the errors of printing as prior, and commanded
  again, over the error under the commands of the design; the median.
- `goals_called_met_but_missed`: by the commanded design, solved anew.
- `outside_the_foam`: tets whose moduli Polyfoam does not have.
- `seconds_over_calibration`: of the design, with what less could do, over those of a
  calibration of as many poses from as many starts; without what both compile.

`run design --count finger=30` does one task, with that many prints.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._hollow import hollow
from benchmarks._parallel_robot import EFFECTOR, parallel_robot
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.actuators import Cable, Chamber
from softcal_jax.bodies import Pose
from softcal_jax.calibration import CalibrationResult, calibrate
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ImposedForce,
    Markers,
    Support,
)
from softcal_jax.control import Limits
from softcal_jax.designs import (
    DesignResult,
    FoamTable,
    Printing,
    design,
    published_foam,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    exactly_known,
)
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

STD = 0.5e-3
"""Tolerance of the goals, per coordinate [m]."""

STD_ANGLE = float(np.deg2rad(0.25))
"""The same of an orientation [rad]."""

READ = 1e-4
"""Standard deviation of what is read off a print [m]."""

READ_ANGLE = float(np.deg2rad(0.05))
"""The same of an orientation [rad]."""

COARSE = 0.012
"""Edge length in the sheets of the parallel robot [m]."""

CALIBRATED = 3
"""Prints that are measured, calibrated and commanded again, of each task."""

COUNTS = {"finger": 30, "wrist": 30, "parallel": 30}

GOALS = {
    "goal_error_over_homogeneous": Goal("at most", 0.2),
    "as_printed_coverage_95": Goal("between", 90.0, 98.0),
    "printed_error_after_calibration_over_before": Goal("at most", 0.5),
    "goals_called_met_but_missed": Goal("at most", 0),
    "outside_the_foam": Goal("at most", 0),
    "seconds_over_calibration": Goal("at most", 3.0),
}

REST = (0.0, 0.0, 0.0)


class Designed(NamedTuple):
    """A robot, its goals, and the limits of the actuators that are designed.

    Prints are measured in the seven `poses`; without any, under shares of the largest
    commands of the design.
    """

    model: Model
    space: ParameterSpace
    goals: tuple[Configuration, ...]
    limits: dict[str, Limits]
    poses: tuple[Configuration, ...] = ()


def run(options: Options) -> Outcome:
    """Each task by itself; a figure of all is a median, a sum or a share of all."""
    foam, figures, rows = published_foam(), {}, []
    every: dict[str, list[float]] = {name: [] for name in GOALS}
    for name, prints in (options.counts or COUNTS).items():
        options.say(name)
        found = _figures(_TASKS[name](), foam, prints)
        figures |= {f"{name}_{key}": value for key, value in found.items()}
        for key, value in found.items():
            every[key].append(value)
        rows.append((name, *(f"{value:.3g}" for value in found.values())))
    whole: dict[str, Callable[[Sequence[float]], float]] = {
        "as_printed_coverage_95": np.mean,
        "goals_called_met_but_missed": sum,
        "outside_the_foam": sum,
        "seconds_over_calibration": max,
    }
    total: dict[str, Figure] = {
        key: float(whole.get(key, np.median)(values)) for key, values in every.items()
    }
    table = Table("Designs", ("task", *GOALS), rows)
    return Outcome({**total, **figures}, goals=GOALS, tables=[table])


def finger() -> Designed:
    """A beam that a cable bends, more at its tip than at its root."""
    length, side = 0.12, 0.015
    mesh = beam(length, side, side, (8, 2, 2), order=2)
    law = ReducedTransverseIsotropic(6e5, 4e5, 0.3, Fibre(0.0, plane="xy"))
    middle = side / 2
    at = lambda x, z=middle: (x * length, middle, z)
    guides = [at(x, 0.001) for x in (0.0, 1 / 3, 2 / 3, 1.0)]
    model = build_model(
        mesh, Corotational(law), density=1000.0, actuators=[Cable("cable", guides)]
    )
    points = ControlPoints({"root": at(0.0), "middle": at(0.5), "tip": at(1.0)})
    places = np.array([at(x) for x in (1 / 3, 2 / 3, 1.0)])
    markers = Markers(("a", "b", "c"), places, STD, axes="z")
    goals = [
        Configuration(
            name,
            "x_min",
            gravity=REST,
            markers=markers,
            measured=places - np.outer(_drop(length, bend, places[:, 0]), [0, 0, 1]),
            actuation={"cable": ImposedForce(0.5)},
        )
        for name, bend in (("little", 0.35), ("much", 0.7))
    ]
    limits = {"cable": Limits(force=(0.0, 10.0))}
    return Designed(model, _fields(points), tuple(goals), limits)


def _drop(length: float, bend: float, x: Float[HostArray, " n"]) -> HostArray:
    """How far a curve falls that turns by `bend` in all, linearly more along it [m]."""
    s = np.linspace(0.0, length, 1001)
    angle = bend * (s / length) ** 2
    fall = np.concatenate([[0.0], np.cumsum(np.sin(angle[:-1]) * np.diff(s))])
    return np.interp(x, s, fall)


def wrist() -> Designed:
    """A hollow box, its cavity off its middle, that is to turn without bending."""
    full = beam(0.06, 0.025, 0.02, (6, 5, 4))
    centroids = full.points[full.tets].mean(axis=1)
    low, high = np.array([0.01, 0.005, 0.005]), np.array([0.05, 0.015, 0.015])
    inside = np.all((centroids > low) & (centroids < high), axis=1)
    mesh = hollow(full, inside, order=2)
    middle = (0.0, 0.0125, 0.01)
    fibre = Fibre.helix(0.7, np.asarray(mesh.centroids), (1.0, 0.0, 0.0), middle)
    law = ReducedTransverseIsotropic(8e5, 4e5, 0.3, fibre)
    air = Chamber("air", "cavity")
    model = build_model(mesh, Corotational(law), density=1000.0, actuators=[air])
    sides = {
        "front": (0.03, 0.0, 0.01),
        "back": (0.03, 0.025, 0.01),
        "bottom": (0.03, 0.0125, 0.0),
        "top": (0.03, 0.0125, 0.02),
    }
    corners = np.array([(0.06, y, z) for y in (0.0, 0.025) for z in (0.0, 0.02)])
    markers = Markers(("a", "b", "c", "d"), corners, STD, axes="yz")
    held = Support(np.flatnonzero(np.isclose(mesh.points[:, 0], 0.0)))
    goals = [
        Configuration(
            name,
            held,
            gravity=REST,
            markers=markers,
            measured=_turned(corners, np.array(middle), np.deg2rad(turn)),
            actuation={"air": ImposedForce(1e4)},
        )
        for name, turn in (("little", 2.0), ("much", 4.0))
    ]
    limits = {"air": Limits(force=(0.0, 2e5))}
    return Designed(model, _fields(ControlPoints(sides)), tuple(goals), limits)


def _turned(points: HostArray, middle: HostArray, angle: float) -> HostArray:
    """Turn points about an axis along x."""
    c, s = np.cos(angle), np.sin(angle)
    return middle + (points - middle) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def parallel() -> Designed:
    """The parallel robot, its rod to turn about its axis and not to move otherwise."""
    robot = parallel_robot(size=COARSE, setup=None, std=READ, std_angle=READ_ANGLE)
    working, up = robot.configurations[0], robot.geometry.rod_pull
    goals = [
        replace(
            working,
            name=name,
            effectors=(
                BodyFrame(
                    EFFECTOR,
                    EFFECTOR,
                    Pose((0.0, up, 0.0), (0.0, np.deg2rad(turn), 0.0)),
                    std=STD,
                    std_angle=STD_ANGLE,
                ),
            ),
        )
        for name, turn in (("left", -2.0), ("right", 1.0))
    ]
    theirs = robot.geometry.control_points()
    each = zip(theirs.names, np.asarray(theirs.positions), strict=True)
    branches = {name: place for name, place in each if name.endswith("outer")}
    points = ControlPoints(branches, axes=theirs.axes)
    reach = Limits(displacement=(np.deg2rad(30.0), np.deg2rad(60.0)))
    return Designed(
        robot.model,
        _fields(points),
        tuple(goals),
        dict.fromkeys(working.actuation, reach),
        robot.configurations,
    )


_TASKS: dict[str, Callable[[], Designed]] = {
    "finger": finger,
    "wrist": wrist,
    "parallel": parallel,
}


def _fields(points: ControlPoints) -> ParameterSpace:
    """E_t, E_l and theta at control points, as Polyfoam needs them."""
    moduli: dict[str, Any] = {"interpolation": "log", "unit": "Pa"}
    theta: dict[str, Any] = {"interpolation": "director", "scale": "linear", "S": 1.0}
    return ParameterSpace(
        [
            ControlPointParameters("E_t", points, 6e5, 1e5, 5e6, **moduli),
            ControlPointParameters("E_l", points, 4e5, 5e4, 3e6, **moduli),
            ControlPointParameters(
                "theta",
                points,
                0.5,
                -np.pi / 2,
                np.pi / 2,
                unit="rad",
                core=0.1,
                **theta,
            ),
        ],
        axes=[("E_l", "E_t", "theta")],
    )


def _figures(task: Designed, foam: FoamTable, prints: int) -> dict[str, float]:
    """Design, print, measure, calibrate, command again."""
    begin = time.perf_counter()
    made = design(task.model, task.space, task.goals, limits=task.limits, foam=foam)
    fits = [made.fit, *(alternative.result for alternative in made.alternatives)]
    seconds = time.perf_counter() - begin - sum(f.timing_s["compile"] for f in fits)
    homogeneous = made.alternatives[0].error
    again = _errors(task, made, np.asarray(made.fit.z))
    met = [goal.met for goal in made.goals]
    tolerances = [goal.effector.std[goal.effector.seen] for goal in made.goals]
    pairs = zip(again, tolerances, strict=True)
    missed = [np.any(np.abs(error) > tolerance) for error, tolerance in pairs]
    inside, random = [], np.random.default_rng(1)
    std = Printing().deviations(made.fit)
    printed = [
        np.asarray(made.fit.z) + std * random.standard_normal(len(std))
        for _ in range(prints)
    ]
    for z in printed:
        sizes = [float(np.linalg.norm(e)) for e in _errors(task, made, z)]
        ends = (goal.interval for goal in made.goals)
        pairs = zip(ends, sizes, strict=True)
        inside += [low <= size <= high for (low, high), size in pairs]
    ratios = []
    for z in printed[:CALIBRATED]:
        found = _calibrated(task, made, z)
        commands = _commands(task, found)
        before, after = (
            np.concatenate(_errors(task, made, z, posed)) / np.concatenate(tolerances)
            for posed in (made.configurations, commands)
        )
        ratios.append(float(np.linalg.norm(after) / np.linalg.norm(before)))
    law: Any = getattr(made.fit.model.law, "elasticity", None)
    moduli = np.asarray(law.E_l), np.asarray(law.E_t)
    return {
        "goal_error_over_homogeneous": made.error / homogeneous,
        "as_printed_coverage_95": 100.0 * float(np.mean(inside)),
        "printed_error_after_calibration_over_before": float(np.median(ratios)),
        "goals_called_met_but_missed": float(
            sum(a and b for a, b in zip(met, missed, strict=True))
        ),
        "outside_the_foam": float(np.sum(foam.find(*moduli).error > 1e-6)),
        "seconds_over_calibration": seconds / _seconds_of_calibration(task, made),
    }


def _errors(
    task: Designed,
    made: DesignResult,
    z: Float[HostArray, " n_p"],
    commanded: Sequence[Configuration] | None = None,
) -> list[Float[HostArray, " k"]]:
    """Solve a print under commands, and return its errors by goal, each in its unit."""
    posed = made.configurations if commanded is None else commanded
    shown = _read(task, made, z, posed)
    pairs = zip(task.goals, shown, strict=True)
    return [error for goal, seen in pairs for error in _off(goal, seen)]


def _off(goal: Configuration, seen: Configuration) -> list[Float[HostArray, " k"]]:
    """How far a pose is off its goals: markers [m], or position [m] and turn [rad]."""
    if goal.markers is not None:
        columns = ["xyz".index(axis) for axis in goal.markers.axes]
        return list((np.asarray(seen.measured) - np.asarray(goal.measured))[:, columns])
    target, reached = (_pose(c) for c in (goal, seen))
    turn = Rotation.from_matrix(reached.matrix @ target.matrix.T).as_rotvec()
    return [reached.translation - target.translation, turn]


def _pose(configuration: Configuration) -> Pose:
    """Return the measured pose of a rod."""
    (effector,) = configuration.effectors
    assert isinstance(effector, BodyFrame)
    assert effector.measured is not None
    return effector.measured


def _read(
    task: Designed,
    made: DesignResult,
    z: Float[HostArray, " n_p"],
    posed: Sequence[Configuration],
    *,
    noise: bool = False,
) -> tuple[Configuration, ...]:
    """Read a print in poses, from equilibria of its own near those of the design."""
    ordered, printed = (_model(task, made, at) for at in (made.fit.z, z))
    return simulated_measurements(printed, posed, first=ordered, noise=noise, seed=7)


def _model(
    task: Designed, made: DesignResult, z: Float[Array | HostArray, " n_p"]
) -> Model:
    """Return the model of a print, of the material without the commands."""
    values = made.fit.space.from_scaled(jnp.asarray(z))[: len(task.space.names)]
    return task.space.model_at(task.model, task.space.to_scaled(values))


def _calibrated(
    task: Designed, made: DesignResult, z: Float[HostArray, " n_p"]
) -> CalibrationResult:
    """Read seven poses of a print, and calibrate it from the design."""
    poses = task.poses or _under_shares(task, made)
    measured = _read(task, made, z, poses, noise=True)
    values, printing = made.values, Printing()
    known = [
        replace(
            entry,
            start=np.array([values[q.name] for q in entry.parameters]),
            prior_std=printing.angle if entry.unit == "rad" else printing.moduli,
        )
        for entry in task.space.entries
        if isinstance(entry, ControlPointParameters)
    ]
    return calibrate(
        task.model,
        replace(task.space, entries=known),
        measured,
        noise="stated",
        uncertain=exactly_known(),
        starts=1,
        intervals=None,
    )


def _under_shares(task: Designed, made: DesignResult) -> list[Configuration]:
    """Seven poses with markers, under shares of the largest commands."""
    largest = {
        name: max(c.actuation[name].value for c in made.configurations)
        for name in task.limits
    }
    first = made.configurations[0]
    assert first.markers is not None
    return [
        replace(
            first,
            name=f"pose {k}",
            markers=replace(first.markers, axes="xyz", std=READ),
            measured=None,
            actuation={name: ImposedForce(share * f) for name, f in largest.items()},
        )
        for k, share in enumerate(np.linspace(0.3, 1.2, 7), start=1)
    ]


def _seconds_of_calibration(task: Designed, made: DesignResult) -> float:
    """Time a calibration of what the design as ordered does, from the usual starts."""
    poses = _read(task, made, np.asarray(made.fit.z), made.configurations)
    begin = time.perf_counter()
    known = exactly_known()
    found = calibrate(
        task.model, task.space, poses, noise="stated", uncertain=known, intervals=None
    )
    return time.perf_counter() - begin - found.timing_s["compile"]


def _commands(task: Designed, found: CalibrationResult) -> tuple[Configuration, ...]:
    """Command the goals anew, by the model of the print.

    From where the design began: some prints have no equilibrium under its commands.
    """
    model = found.space.model_at(task.model, jnp.asarray(found.z))
    return design(model, None, task.goals, limits=task.limits).configurations
