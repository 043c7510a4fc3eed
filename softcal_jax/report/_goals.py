"""What designs and inverse control found: verdicts, tables, and what they become."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import jax
import numpy as np

from softcal_jax import export
from softcal_jax._text_table import Cell, TextTable, or_dash, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_unit
from softcal_jax.calibration import ConfigurationResult, simulation_result
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.designs import LEVEL, DesignResult
from softcal_jax.fields import ControlPointParameters
from softcal_jax.materials import youngs_moduli
from softcal_jax.report._html import Part, bullets
from softcal_jax.report._tables import actuator_row
from softcal_jax.report._verdict import RunVerdict


def design_verdict(result: DesignResult) -> RunVerdict:
    """Say whether the goals are met, what holds those that are not, and its worth."""
    tone = "good" if result.met else "doubtful"
    return RunVerdict(result.headline, tone, (*result.reasons, *result.worth))


def design_tables(result: DesignResult) -> list[TextTable]:
    """Tabulate fields as ordered, goals, commands, limits, and what less could do."""
    limits = [_limits(result)] if result.peaks else []
    goals = [_designed(result), _commands(result), *limits]
    return [_ordered(result), *goals, _worth(result)]


def _ordered(result: DesignResult) -> TextTable:
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
    show = lambda value, unit: readable(float(f"{value:.4g}"), unit).strip()
    foam, model = result.foam, result.fit.model
    ordered = [path.rpartition(".")[2] for path, _ in youngs_moduli(model.law)]
    table = []
    for point, of_point in rows.items():
        cells = [
            show(of_point[field], unit) if field in of_point else "-"
            for field, unit in of_unit.items()
        ]
        moduli = [of_point[name] for name in ordered if name in of_point]
        if foam is not None and moduli:
            found = foam.find(np.array([min(moduli)]), np.array([max(moduli)]))
            cells += [f"{100 * found.density[0]:.3g} %", f"{found.anisotropy[0]:.3g}"]
        table.append((point, *cells))
    columns = ["control point", *(field or "value" for field in of_unit)]
    if foam is not None and table:
        columns += ["density", foam.setting]
    return text_table("As ordered", columns, table)


def _designed(result: DesignResult) -> TextTable:
    rows = []
    for goal in result.goals:
        unit = goal.effector.unit
        show = lambda value, unit=unit: readable(float(f"{value:.2g}"), unit).strip()
        low, high = map(show, goal.interval)
        hangs = f"{goal.hangs_on} ({100 * goal.share:.0f} %)"
        printed = show(goal.expected), f"{low} to {high}", hangs
        if not goal.hangs_on:  # nothing that is printed moves it
            printed = "-", "-", "-"
        name = f"{goal.name}{' (turn)' if goal.effector.is_turn else ''}"
        met = Cell("met", "good") if goal.met else Cell("missed", "bad")
        rows.append((goal.configuration, name, met, show(goal.error), *printed))
    columns = (
        *("configuration", "effector", "goal", "off by", "printed, rms"),
        *(f"{100 * LEVEL:g} % of prints", "hangs on"),
    )
    return text_table("Goals", columns, rows)


def _commands(result: DesignResult) -> TextTable:
    actuators = result.fit.model.mechanism.actuators
    rows = []
    for configuration in result.configurations:
        for name, imposed in configuration.actuation.items():
            kind = actuators.kinds[actuators.names.index(name)]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            value = readable(float(f"{imposed.value:.4g}"), unit or "").strip()
            rows.append((configuration.name, name, value))
    return text_table("Commands", ("configuration", "actuator", "imposed"), rows)


def _limits(result: DesignResult) -> TextTable:
    """Tabulate what is largest anywhere in the body, where it has a limit."""
    rows = []
    for peak in result.peaks:
        unit = "" if peak.unit == "-" else peak.unit
        show = lambda value, u=unit: readable(float(f"{value:.4g}"), u).strip()
        kept = Cell("kept", "good") if peak.kept else Cell("exceeded", "bad")
        values = show(peak.value), show(peak.limit), kept
        rows.append((peak.configuration, peak.name, *values))
    columns = ("configuration", "anywhere in the body", "value", "limit", "")
    return text_table("Limits", columns, rows)


def _worth(result: DesignResult) -> TextTable:
    rows = [("this design", f"{result.error:.3g}", f"{result.expected:.3g}")]
    for a in result.alternatives:
        name = a.name if a.result.converged else f"{a.name} (not converged)"
        printed = f"{a.expected:.3g}" if np.isfinite(a.expected) else "-"
        rows.append((name, f"{a.error:.3g}", printed))
    columns = "with", "error over all goals, in tolerances", "as printed"
    return text_table("What the design is worth", columns, rows)


def design_dict(result: DesignResult) -> dict[str, Any]:
    """Convert a design to the key `design` of `design.json`, in SI units."""
    goal = "configuration name met error expected interval hangs_on share"
    return export.plain(
        {
            "met": result.met,
            "verdict": result.headline,
            "reasons": result.reasons,
            "foam": None if result.foam is None else result.foam.infill,
            "values": result.values,
            "commands": {
                c.name: {name: imposed.value for name, imposed in c.actuation.items()}
                for c in result.configurations
            },
            "goals": [
                {key: getattr(g, key) for key in goal.split()} for g in result.goals
            ],
            "peaks": [vars(peak) for peak in result.peaks],
            "robust": result.robust,
            "error": result.error,
            "expected": result.expected,
            "alternatives": {a.name: a.error for a in result.alternatives},
        }
    )


def inverse_verdict(result: InverseResult | TrajectoryResult) -> RunVerdict:
    """Say whether the goals are met, and by which command."""
    if isinstance(result, TrajectoryResult):
        missed = tuple(result.points[i].message for i in result.unmet)
        tone = "doubtful" if missed else "good"
        return RunVerdict(result.headline, tone, missed)
    reasons = (f"Commanded: {result.commanded}.",)
    return RunVerdict(result.message, "good" if result.met else "doubtful", reasons)


def inverse_parts(result: InverseResult | TrajectoryResult) -> list[Part]:
    """Show how closely the goals are met, and what the actuators do for it."""
    if isinstance(result, InverseResult):
        limits = "Active limits:" if result.active_limits else ""
        return [*inverse_tables(result), limits, bullets(result.active_limits)]
    rows = [
        (str(i), point.commanded, Cell(point.message, "good" if point.met else "bad"))
        for i, point in enumerate(result.points, 1)
    ]
    columns = "goal", "inputs", "outcome"
    return [text_table("Commands", columns, rows, words=["inputs"])]


def inverse_tables(result: InverseResult) -> list[TextTable]:
    """Tabulate goals and what is reached, and what the actuators do for it."""
    return [_goals(result.goals), _actuators(result)]


def _goals(goals: Sequence[GoalFit]) -> TextTable:
    rows = []
    for fit in goals:
        name = f"{fit.name} (turn)" if fit.effector.is_turn else fit.name
        both = fit.effector.measured, fit.reached
        pair = [_coordinates(fit, values, np.concatenate(both)) for values in both]
        worst = or_dash(float(np.max(np.abs(fit.in_std), initial=0.0)), ".2g")
        rows.append((name, *pair, fit.off, worst))
    columns = "effector", "goal", "reached", "off by", "standard deviations"
    return text_table("Goals", columns, rows)


def _coordinates(
    fit: GoalFit, values: Float[HostArray, " k"], beside: Float[HostArray, " n"]
) -> str:
    """Write the coordinates that have a goal, in the unit of all that stands beside.

    Axes are named if some have none.
    """
    seen = np.asarray(fit.effector.seen)
    if np.isnan(values[seen]).any():
        return "unknown"
    factor, unit = readable_unit(beside, fit.effector.unit)
    numbers = [f"{round(factor * v, 6) + 0.0:.4g}" for v in values[seen]]
    text = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
    axes = "" if seen.all() else f"{', '.join(compress('xyz', seen))} = "
    return f"{axes}{text} {unit}".rstrip()


def _actuators(result: InverseResult) -> TextTable:
    columns = "actuator", "kind", "force or pressure", "displacement or growth"
    rows = []
    for actuator in result.actuators:
        commanded = actuator.name in result.configuration.actuation
        kind = actuator.kind if commanded else f"{actuator.kind}, not commanded"
        rows.append((actuator.name, kind, *actuator_row(actuator)))
    return text_table("Actuators", columns, rows)


def commanded(point: InverseResult, name: str) -> ConfigurationResult:
    """Describe the equilibrium of a command, to compare it with its goals."""
    # On the host: on the device, each shape would compile a program.
    solution = jax.tree.map(lambda leaf: np.asarray(leaf)[None], point.solution)
    solved = simulation_result(point.model, [point.configuration], solution)
    goals = tuple(fit.effector for fit in point.goals)
    (pose,) = solved.configurations
    return replace(pose, name=name, role="command", effectors=goals)
