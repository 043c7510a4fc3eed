"""What designs and inverse control found."""

from collections.abc import Sequence
from itertools import compress
from typing import Any

import numpy as np

from softcal_jax._tree import Column, Section, Table, Tone
from softcal_jax._units import readable, readable_values
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.designs import LEVEL, DesignResult
from softcal_jax.fields import ControlPointParameters
from softcal_jax.materials import youngs_moduli
from softcal_jax.report._tables import actuator_columns
from softcal_jax.report._verdict import verdict


def design_sections(result: DesignResult) -> tuple[Section, ...]:
    """Write fields as ordered, goals, commands, limits, and what less could do."""
    reasons = *result.reasons, *result.worth
    goals = _designed(result), _commands(result), _limits(result)
    return (
        verdict(result.headline, "good" if result.met else "doubtful", reasons),
        Section("goals", "Goals", (), goals),
        Section("ordered", "As ordered", (), (_ordered(result),)),
        Section("worth", "What it is worth", (), (_worth(result),)),
    )


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
        # What nothing that is printed moves has no spread.
        printed: list[Any] = [None, None, "-"]
        if goal.hangs_on:
            unit, share = goal.effector.unit, readable(goal.share, "percent")
            ends = (readable_values([e], unit, digits=2) for e in goal.interval)
            printed = [goal.expected, " to ".join(ends).rstrip()]
            printed.append(f"{goal.hangs_on} ({share})")
        met = "met" if goal.met else "missed"
        rows.append((goal.configuration, _name(goal), met, goal.error, *printed))
    heads = "configuration | effector | goal | off by [*] | printed, rms [*] | "
    heads += f"{100 * LEVEL:g} % of prints | hangs on"
    units = [goal.effector.unit for goal in result.goals]
    tones: list[Tone] = ["good" if goal.met else "bad" for goal in result.goals]
    about = {"units": units, "digits": 2, "about": {"goal": {"tones": tones}}}
    return Table.of("Goals", heads, rows, **about)


def _name(goal: GoalFit) -> str:
    return f"{goal.name}{' (turn)' * goal.effector.is_turn}"


def _commands(result: DesignResult) -> Table:
    actuators = result.fit.model.mechanism.actuators
    rows, units = [], []
    for configuration in result.configurations:
        for name, imposed in configuration.actuation.items():
            kind = actuators.kinds[actuators.names.index(name)]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            rows.append((configuration.name, name, imposed.value))
            units.append(unit or "")
    heads = "configuration | actuator | imposed [*]"
    return Table.of("Commands", heads, rows, units=units)


def _limits(result: DesignResult) -> Table:
    """Tabulate what is largest anywhere in the body, where it has a limit."""
    rows = [
        (p.configuration, p.name, p.value, p.limit, "kept" if p.kept else "exceeded")
        for p in result.peaks
    ]
    tones: list[Tone] = ["good" if peak.kept else "bad" for peak in result.peaks]
    units = [peak.unit.strip("-") for peak in result.peaks]
    heads = "configuration | anywhere in the body | value [*] | limit [*] | "
    return Table.of("Limits", heads, rows, units=units, about={"": {"tones": tones}})


def _worth(result: DesignResult) -> Table:
    rows: list[tuple[str, float, float | None]]
    rows = [("this design", result.error, result.expected)]
    for a in result.alternatives:
        lost = "" if a.result.converged else " (not converged)"
        rows.append((f"{a.name}{lost}", a.error, a.expected))
    heads = "with | error over all goals, in tolerances [ratio] | as printed [ratio]"
    return Table.of("What the design is worth", heads, rows)


def inverse_sections(result: InverseResult | TrajectoryResult) -> tuple[Section, ...]:
    """Write how closely goals are met, and what the actuators do for it."""
    if isinstance(result, TrajectoryResult):
        return _trajectory(result)
    commanded = (f"Commanded: {result.commanded}.",)
    reached = ("Active limits:", *result.active_limits) if result.active_limits else ()
    tried = [(a.way, a.n_steps, a.error) for a in result.attempts]
    heads = "started from | steps | largest error, in standard deviations [ratio]"
    search = (Table.of("Descents", heads, tried),)
    tables = goal_table(result.goals), _actuators(result)
    return (
        verdict(result.message, "good" if result.met else "doubtful", commanded),
        Section("goals", "Goals and commands", reached, tables),
        Section("search", "Course of the search", (), search, folded=True),
    )


def _trajectory(result: TrajectoryResult) -> tuple[Section, ...]:
    points = result.points
    missed = [points[i].message for i in result.unmet]
    rows = [(i, point.commanded, point.message) for i, point in enumerate(points, 1)]
    tones: list[Tone] = ["good" if point.met else "bad" for point in points]
    table = Table.of(
        "Commands", "goal | inputs | outcome", rows, about={"outcome": {"tones": tones}}
    )
    return (
        verdict(result.headline, "doubtful" if missed else "good", missed),
        Section("goals", "Goals and commands", (), (table,)),
    )


def goal_table(goals: Sequence[GoalFit]) -> Table:
    """Tabulate goals, and what is reached."""
    rows: list[Any] = []
    for fit in goals:
        both = [fit.effector.measured, fit.reached]
        worst = float(np.max(np.abs(fit.in_std), initial=0.0))
        pair = (_coordinates(fit, values, both) for values in both)
        rows.append((_name(fit), *pair, fit.off, worst))
    heads = "effector | goal | reached | off by | standard deviations [step]"
    return Table.of("Goals", heads, rows)


def _coordinates(fit: GoalFit, values: Any, beside: Any) -> str:
    """Write the coordinates that have a goal, in the unit of all that stands beside.

    Axes are named if some have none.
    """
    seen = np.asarray(fit.effector.seen)
    if np.isnan(values[seen]).any():
        return "unknown"
    axes = "" if seen.all() else f"{', '.join(compress('xyz', seen))} = "
    known = np.concatenate(beside)
    text = readable_values(values[seen].tolist(), fit.effector.unit, beside=known)
    return f"{axes}{text.rstrip()}"


def _actuators(result: InverseResult) -> Table:
    states, commanded = result.actuators, result.configuration.actuation
    other = lambda a: "" if a.name in commanded else ", not commanded"
    columns = (
        Column("actuator", [a.name for a in states]),
        Column("kind", [f"{a.kind}{other(a)}" for a in states]),
        *actuator_columns(states),
    )
    return Table("Actuators", columns)
