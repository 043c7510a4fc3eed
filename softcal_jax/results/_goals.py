"""What is said of goals: of a design, of a command, and of commands along a course."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import jax
import numpy as np

from softcal_jax._text import listed
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import SimulationResult, simulation_result
from softcal_jax.configurations import EffectorRecord
from softcal_jax.control import (
    OUTCOMES,
    InverseResult,
    TrajectoryResult,
    coordinate_names,
)
from softcal_jax.designs import LEVEL, DesignResult
from softcal_jax.fields import ControlPointParameters
from softcal_jax.materials import youngs_moduli
from softcal_jax.results._poses import MOVED, actuator_cells, effector_name, imposed
from softcal_jax.results._tree import Column, Section, Table, Value, verdict

_LISTED = 4  # missed goals that a message lists


def design_sections(result: DesignResult) -> Iterator[Section]:
    """Write fields as ordered, goals, commands, limits, and what less could do."""
    n, missed = len(result.goals), result.unmet
    text = f"Designed: all {n} goals are met." if n > 1 else "Designed: it is met."
    if not result.fit.converged:
        text = "Not designed: the search did not converge."
    elif missed:
        text = f"Not designed: {len(missed)} of {n} goals are missed."
    elif result.lost:
        text = "Not designed: a robust design was not found."
    elif not result.met:
        text = "Not designed: a limit is exceeded."
    reasons = *missed_words(result), *_sentences_on_worth(result)
    yield verdict(text, "good" if result.met else "doubtful", reasons)
    goals = _designed(result), _commands(result), _limits(result)
    yield Section("goals", "Goals", (), goals)
    yield Section("ordered", "As ordered", (), (_ordered(result),))
    yield Section("worth", "What it is worth", (), (_worth(result),))


def missed_words(result: DesignResult) -> tuple[str, ...]:
    """Say what goals are off by, and what holds them there, one sentence each."""
    reasons = [
        f"{goal.label} is off by {off_words(goal.effector)}."
        for goal in result.unmet[:_LISTED]
    ]
    if len(result.unmet) > _LISTED:
        reasons.append(f"{len(result.unmet) - _LISTED} more are off by less.")
    if result.lost:
        reasons.append(f"This is the one of least error as ordered: {result.lost}")
    if result.robust and result.unmet:
        reasons.append("As ordered it is farther off, to be closer as printed.")
    reasons += [f"{peak}." for peak in result.peaks if not peak.kept]
    if result.held_by:
        reasons.append(f"They are held by {listed(result.held_by)}.")
    return (*reasons, *(f"{trade}." for trade in result.trades))


def _ordered(result: DesignResult) -> Table:
    """Tabulate what is ordered at each control point, with its foam."""
    values = result.values
    rows: dict[str, dict[str, float]] = {}
    of_unit: dict[str, str] = {}
    for entry in result.fit.space.entries:
        for q in entry.parameters:
            if q.name in values:
                at_points = isinstance(entry, ControlPointParameters)
                field = entry.field if at_points else ""
                point = q.name.removeprefix(f"{field} of ")
                rows.setdefault(point, {})[field] = values[q.name]
                of_unit[field] = q.unit
    columns = [
        Column(field or "value", [row.get(field) for row in rows.values()], unit)
        for field, unit in of_unit.items()
    ]
    foam, law = result.foam, result.fit.model.law
    names = [path.rpartition(".")[2] for path, _ in youngs_moduli(law)]
    moduli = [[row[n] for n in names if n in row] for row in rows.values()]
    if foam is not None and any(moduli):
        infill = [
            foam.find(np.array([min(m)]), np.array([max(m)])) if m else None
            for m in moduli
        ]
        density = [None if found is None else found.density[0] for found in infill]
        shape = [None if found is None else found.anisotropy[0] for found in infill]
        columns += [Column("density", density, "percent")]
        columns += [Column(foam.setting, shape, "ratio")]
    columns = Column("control point", [*rows]), *columns
    return Table("As ordered", columns)


def _designed(result: DesignResult) -> Table:
    rows = []
    for goal in result.goals:
        effector, met = goal.effector, "met" if goal.met else "missed"
        # What nothing that is printed moves has no spread.
        printed: list[Any] = [None, None, "-"]
        if goal.hangs_on:
            ends = (
                readable_values([e], effector.unit, digits=2) for e in goal.interval
            )
            share = f"{goal.hangs_on} ({readable(goal.share, 'percent')})"
            printed = [goal.expected, " to ".join(ends).rstrip(), share]
        rows.append(
            (
                goal.configuration,
                effector_name(effector),
                Value(met, tone="good" if goal.met else "bad"),
                Value(goal.error, effector.unit),
                Value(printed[0], effector.unit),
                *printed[1:],
            )
        )
    heads = "configuration | effector | goal | off by | printed, rms | "
    heads += f"{100 * LEVEL:g} % of prints | hangs on"
    return Table.of("Goals", heads, rows, digits=2)


def _commands(result: DesignResult) -> Table:
    rows = [
        (c.name, name, Value(command.value, unit))
        for c in result.configurations
        for name, command, unit in imposed(result.fit.model, c)
    ]
    return Table.of("Commands", "configuration | actuator | imposed", rows)


def _limits(result: DesignResult) -> Table:
    """Tabulate what is largest anywhere in the body, where it has a limit."""
    rows = []
    for p in result.peaks:
        sizes = (Value(size, p.unit.strip("-")) for size in (p.value, p.limit))
        kept = Value("kept", tone="good") if p.kept else Value("exceeded", tone="bad")
        rows.append((p.configuration, p.name, *sizes, kept))
    heads = "configuration | anywhere in the body | value | limit | "
    return Table.of("Limits", heads, rows)


def _sentences_on_worth(result: DesignResult) -> Iterator[str]:
    """Say what the design is worth, one sentence for each alternative."""
    for a in result.alternatives:
        text, error = f"{a.error:.3g} tolerances off", f"{result.error:.3g}"
        if np.isfinite(a.expected):
            text += f", {a.expected:.3g} as printed"
            error += f" and {result.expected:.3g}"
        if not a.result.converged:
            text += " or less (its search did not converge)"
        yield f"With {a.name} the goals are {text}, with this design {error}."


def _worth(result: DesignResult) -> Table:
    rows: list[tuple[str, float, float | None]]
    rows = [("this design", result.error, result.expected)]
    for a in result.alternatives:
        lost = "" if a.result.converged else " (not converged)"
        rows.append((f"{a.name}{lost}", a.error, a.expected))
    heads = "with | error over all goals, in tolerances [ratio] | as printed [ratio]"
    return Table.of("What the design is worth", heads, rows)


def inverse_sections(result: InverseResult) -> Iterator[Section]:
    """Write how closely goals are met, and what the actuators do for it."""
    inputs = (f"Commanded: {_commanded(result)}.",)
    yield verdict(_outcome(result), "good" if result.met else "doubtful", inputs)
    reached = ("Active limits:", *result.active_limits) if result.active_limits else ()
    rows = []
    for state in result.actuators:
        commanded = state.name in result.configuration.actuation
        kind = f"{state.kind}{', not commanded' * (not commanded)}"
        rows.append((state.name, kind, *actuator_cells(state)))
    actuators = Table.of("Actuators", f"actuator | kind | {MOVED}", rows)
    tables = goal_table(result.goals), actuators
    yield Section("goals", "Goals and commands", reached, tables)
    tried = [(a.way, a.n_steps, a.error) for a in result.attempts]
    heads = "started from | steps | largest error, in standard deviations [ratio]"
    search = (Table.of("Descents", heads, tried),)
    yield Section("search", "Course of the search", (), search, folded=True)


def trajectory_sections(result: TrajectoryResult) -> Iterator[Section]:
    """Write the outcome of each command along a course."""
    points = result.points
    far = [_outcome(points[i]) for i in result.unmet]
    text = f"{len(points) - len(far)} of {len(points)} goals are met."
    yield verdict(text, "doubtful" if far else "good", far)
    rows = [
        (i, _commanded(p), Value(_outcome(p), tone="good" if p.met else "bad"))
        for i, p in enumerate(points, 1)
    ]
    table = Table.of("Commands", "goal | inputs | outcome", rows)
    yield Section("goals", "Goals and commands", (), (table,))


def _outcome(result: InverseResult) -> str:
    """Say how a search ended, and what holds the goals that are missed."""
    text = f"configuration {result.configuration.name!r}: {OUTCOMES[result.outcome]}"
    unmet = result.unmet
    for goal in unmet[:_LISTED]:
        text += f"; {goal.name!r} is off by {off_words(goal)}"
    if len(unmet) > _LISTED:
        text += f"; {len(unmet) - _LISTED} more are off by less"
    if unmet and result.held_by:
        text += f"; held by {', '.join(result.held_by)}"
    if unmet and result.blind is not None:
        text += f"; held by a {result.blind}"
    return text + "."


def _commanded(result: InverseResult) -> str:
    """Say what is imposed on the commanded actuators, in words."""
    imposed = lambda a: (getattr(a, a.imposed), getattr(a, f"{a.imposed}_unit"))
    return ", ".join(
        f"{a.name} = {readable_values([value], unit or '')}"
        for a in result.actuators
        if a.name in result.configuration.actuation
        for value, unit in [imposed(a)]
    )


def goal_table(goals: Sequence[EffectorRecord]) -> Table:
    """Tabulate goals, and what is reached."""
    rows: list[Any] = []
    for goal in goals:
        both = [goal.measured, goal.simulated]
        pair = (_coordinates(goal, values, both) for values in both)
        rows.append((effector_name(goal), *pair, off_words(goal), goal.worst))
    heads = "effector | goal | reached | off by | standard deviations [step]"
    return Table.of("Goals", heads, rows)


def _coordinates(goal: EffectorRecord, values: Any, beside: Any) -> str:
    """Write the coordinates that have a goal, in the unit of all that stands beside.

    Axes are named if some have none.
    """
    seen = np.asarray(goal.seen)
    if np.isnan(values[seen]).any():
        return "unknown"
    axes = "" if seen.all() else f"{', '.join(compress('xyz', seen))} = "
    known = np.concatenate(beside)
    text = readable_values(values[seen].tolist(), goal.unit, beside=known)
    return f"{axes}{text.rstrip()}"


def off_words(goal: EffectorRecord) -> str:
    """Say how far it is off in each direction, in words: x 0.12 mm, turn x 0.3 deg."""
    show = lambda value: readable(float(f"{value:.3g}"), goal.unit)
    values = zip(coordinate_names(goal), goal.residual, goal.seen, strict=True)
    parts = [f"{name} {show(value)}".strip() for name, value, seen in values if seen]
    distance = goal.distance(goal.simulated)
    far = len(parts) > 1 and bool(np.isfinite(distance))
    return ", ".join(parts) + f" ({show(distance)} in all)" * far


def design_bodies(result: DesignResult) -> SimulationResult:
    """Return the equilibria of a design, as those of a simulation."""
    posed = [replace(pose, role="design") for pose in result.fit.configurations]
    return SimulationResult(result.fit.model, tuple(posed))


def commanded_bodies(result: InverseResult | TrajectoryResult) -> SimulationResult:
    """Describe the equilibrium of each command, to compare it with its goals."""
    points = [result] if isinstance(result, InverseResult) else [*result.points]
    poses = []
    for number, point in enumerate(points, 1):
        # On the host: on the device, each shape would compile a program.
        solution = jax.tree.map(lambda leaf: np.asarray(leaf)[None], point.solution)
        solved = simulation_result(point.model, [point.configuration], solution)
        about = {"role": "command", "effectors": point.goals}
        about["name"] = f"goal {number}" if len(points) > 1 else "command"
        poses.append(replace(solved.configurations[0], **about))
    return SimulationResult(points[0].model, tuple(poses))
