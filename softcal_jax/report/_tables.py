"""What robots do and what a calibration found, in tables and sentences."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Group
from rich.text import Text

from softcal_jax._text_table import STYLES, Cell, TextTable, Tone, or_dash, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.contact import ContactState
from softcal_jax.equilibrium import ActuatorState, Model, RobotState
from softcal_jax.export import readable_unit, readable_values
from softcal_jax.identifiability import Assessment, Identifiability, assess, percent
from softcal_jax.report._verdict import TONES, listed_fits, value_of

MOST_DIRECTIONS = 6  # blind directions that are listed; the others are only counted
MOST_CORRELATED = 12  # parameters whose correlations are shown as a matrix
MOST_PAIRS = 20  # pairs of parameters listed where a matrix would be too large


def simulation_tables(result: SimulationResult) -> list[TextTable]:
    """Tabulate the outcome in every configuration, and what the robot does there."""
    rows = []
    for pose in result.configurations:
        largest = pose.largest_displacement if pose.converged else math.nan
        outcome = Cell(pose.outcome, "good" if pose.converged else "bad")
        rows.append((pose.name, distance(largest), str(pose.newton_steps), outcome))
    columns = "configuration", "largest displacement", "Newton steps", "outcome"
    table = text_table("Simulation", columns, rows)
    return [table, *robot_tables(result.configurations)]


def robot_tables(configurations: Sequence[ConfigurationResult]) -> list[TextTable]:
    """Tabulate the state of the robot, and effectors that are no points."""
    roles = {result.role for result in configurations}
    values = ["measured", "before", "after"]
    if roles == {"simulation"}:
        values = ["simulated"]
    if "prediction" in roles:
        values = ["measured", "simulated"]
    if "design" in roles:
        values = ["goal", "reached"]
    titles = {
        "Other effectors": ["effector", *values],
        "Actuators": ["actuator", "force or pressure", "displacement or growth"],
        "Rigid bodies": ["rigid body", "state", "displacement", "rotation"],
        "Reactions": ["of", "force of the ground (x, y, z)"],
        "Contacts": ["with", "force on it (x, y, z)", "moment on it"],
        "Contact areas": ["with", "area", "largest depth", "sliding"],
    }
    rows: dict[str, list[tuple[str, ...]]] = {title: [] for title in titles}
    for result in configurations:
        rows["Other effectors"] += _effector_rows(result, values)
        robot = result.robot
        if robot is None:
            continue
        for state in robot.actuators:
            rows["Actuators"].append((result.name, state.name, *actuator_row(state)))
        rows["Rigid bodies"] += _body_rows(result.name, robot)
        for reaction in robot.reactions:
            force = readable_values(list(reaction.force), "N")
            rows["Reactions"].append((result.name, reaction.name, force))
        for contact in robot.contacts:
            name, felt = (result.name, contact.name), _felt(contact)
            rows["Contacts"].append((*name, *felt[:2]))
            rows["Contact areas"].append((*name, *felt[2:]))
    return [
        text_table(title, ("configuration", *columns), rows[title])
        for title, columns in titles.items()
        if rows[title]
    ]


def _effector_rows(
    result: ConfigurationResult, values: Sequence[str]
) -> Iterator[tuple[str, ...]]:
    for effector in result.others:
        if effector.is_turn and values != ["simulated"]:
            continue  # another table shows the errors of turns
        name = f"{effector.name}{' (turn)' if effector.is_turn else ''}"
        vectors = {
            "measured": effector.measured,
            "goal": effector.measured,
            "before": effector.simulated_before,
        }
        of_value = (vectors.get(value, effector.simulated) for value in values)
        yield (result.name, name, *(_values(effector, v) for v in of_value))


def _body_rows(pose: str, robot: RobotState) -> Iterator[tuple[str, ...]]:
    for body in robot.bodies:
        if body.state != "absent":
            moved = readable_values([_length(body.translation)], "m")
            turned = readable_values([_length(body.rotation_vector)], "rad")
            yield pose, body.name, body.state, moved, turned


def _felt(contact: ContactState) -> list[str]:
    """Write force, moment, area, depth and sliding."""
    if contact.area == 0.0:
        return ["not touched", "-", "-", "-", "-"]
    return [
        readable_values(list(contact.force), "N", digits=3),
        readable_values(list(contact.moment), "N m", digits=3),
        readable_values([float(contact.area)], "m2", digits=3),
        readable_values([float(contact.depth)], "m", digits=3),
        f"{100.0 * contact.sliding:.0f} %" if contact.sliding else "-",
    ]


def actuator_values(actuator: ActuatorState) -> dict[str, str]:
    """Write the force and the displacement of an actuator."""
    force = readable_values([actuator.force], actuator.force_unit)
    shown = {"force": force, "displacement": "-"}
    if actuator.displacement is not None and actuator.displacement_unit is not None:
        delta = readable_values([actuator.displacement], actuator.displacement_unit)
        shown["displacement"] = delta
    return shown


def actuator_row(actuator: ActuatorState) -> list[str]:
    """Write the force and the displacement of an actuator, and which is imposed."""
    shown = actuator_values(actuator)
    shown[actuator.imposed] += " (imposed)"
    return list(shown.values())


def _values(effector: EffectorRecord, values: Float[HostArray, " k"]) -> str:
    shown = [_length(values)] if effector.is_turn else list(values)
    return "-" if np.isnan(values).any() else readable_values(shown, effector.unit)


def _length(vector: Float[HostArray, "3"]) -> float:
    return float(np.linalg.norm(vector))


def distance(metres: float) -> str:
    """Write a distance in millimetres."""
    return or_dash(1e3 * metres, ".2f", "mm")


def model_words(model: Model) -> str:
    """Describe the size, the law and the elements of a model."""
    law = model.law
    parts = law, *(getattr(law, key, None) for key in ("elasticity", "matrix"))
    named = [type(part).__name__ for part in parts if part is not None]
    return f"{model.mesh.words}, {' of '.join(named)} ({model.formulation})"


def parameter_table(result: CalibrationResult, outlook: Identifiability) -> TextTable:
    """Tabulate values, standard errors, starts and bounds."""
    blind = {p.name for p in outlook.parameters if p.verdict == "not identifiable"}
    title = "Parameters" + ("" if result.intervals else ", ± not checked")
    rows = []
    for q in result.parameters:
        factor, unit = readable_unit([q.value], q.unit)
        bounds = f"{readable(q.lower, q.unit)} to {readable(q.upper, q.unit)}"
        sound = result.converged and not q.at_bound and q.name not in blind
        start = f"{q.start * factor:.4g} {unit}".rstrip()
        value = Cell(value_of(q), "strong" if sound else "bad")
        rows.append((q.name, value, start, bounds))
    columns = "parameter", "value ± standard error", "start", "bounds"
    return text_table(title, columns, rows)


def budget_table(result: CalibrationResult) -> TextTable:
    """Tabulate in words what the standard errors come from."""
    columns = "parameter", "relative standard error"
    rows = [(name, result.budget.sentence(name)) for name in result.budget.names]
    return text_table("Standard errors by cause", columns, rows)


def interval_tables(result: CalibrationResult) -> list[TextTable]:
    """Tabulate the intervals of the parameters, and how each was found."""
    if not result.intervals:
        return []
    rows = []
    for interval in result.intervals:
        tone = "bad" if interval.kind == "none" else "plain"
        rows.append((interval.name, Cell(str(interval), tone), interval.kind))
    level = f"{100.0 * result.intervals[0].level:g} % interval"
    return [text_table("Intervals", ("parameter", level, "kind"), rows)]


def error_tables(
    fits: Sequence[ConfigurationResult], checks: ResidualChecks | None
) -> list[TextTable]:
    """Tabulate the errors of points and of orientations.

    With three or more fitted configurations, a further table has the error of each when
    it is left out of the fit: in one table, this would not fit in 80 columns.
    """
    columns = ("configuration", "role", "before", "after", "motion", "relative error")
    points, turns = [], []
    for fit in listed_fits(fits):
        lengths = fit.rms_before, fit.rms_after, fit.motion
        before, after, motion = map(distance, lengths)
        share = or_dash(100.0 * fit.rms_share, ".1f", "%")
        first = (fit.name, fit.role)
        points.append((*first, before, Cell(after, "strong"), motion, share))
        if math.isfinite(fit.turn_after):
            angles = np.degrees([fit.turn_before, fit.turn_after])
            before, after = (or_dash(angle, ".2f", "deg") for angle in angles)
            turns.append((*first, before, Cell(after, "strong")))
    shown = []
    if any(math.isfinite(fit.rms_after) for fit in fits):
        shown.append(text_table("Residuals of the markers, rms", columns, points))
    left_out = [] if checks is None else checks.left_out
    rows = [(c.name, distance(c.rms), distance(c.expected)) for c in left_out]
    if rows:
        heads = ("configuration", "residual", "expected from known errors")
        title = "Each configuration, predicted from the others"
        shown.append(text_table(title, heads, rows))
    if turns:
        title = "Residuals of the orientations, rms"
        shown.append(text_table(title, columns[:4], turns))
    return shown


def outlook_table(assessment: Assessment) -> TextTable:
    """Tabulate what the data tell about each parameter."""
    rows = []
    for p in assessment.identifiability.parameters:
        tone = outlook_tone(p.verdict, assessment)
        verdict = Cell(assessment.seen(p.verdict), tone)
        rows.append((p.name, percent(p.ratio), verdict))
    columns = "parameter", "standard error / target", "verdict"
    return text_table("What the data determine", columns, rows)


def outlook_tone(verdict: str, assessment: Assessment) -> Tone:
    """Return the tone of a verdict, at best doubtful if the assessment has doubts."""
    doubtful = verdict == "identifiable" and not assessment.identified
    return "doubtful" if doubtful else TONES[verdict]


def outlook_legend(outlook: Identifiability) -> str:
    """Say what the verdicts mean, and give the condition numbers."""
    words = [outlook.scale]
    if outlook.has_prior:
        shares = f"{outlook.informed} of {outlook.n_parameters} directions"
        words.append(f"The data constrain {shares} more tightly than the prior.")
    if outlook.n_data:
        words.append(str(outlook.conditioning).splitlines()[0])
    return " ".join(words)


def blindness(outlook: Identifiability) -> list[str]:
    """Say how many directions the data hardly see, then list them, the worst first."""
    blind = outlook.blind[::-1]
    if not blind:
        return ["The data determine every combination of the parameters."]
    by = "the prior and the start" if outlook.has_prior else "the start"
    lines = [
        f"The data leave {len(blind)} of {outlook.n_parameters} directions of the "
        f"parameters undetermined; along these, the result depends on {by}. "
        "Worst first (standard error / target):"
    ]
    lines += [f"{d.words} ({percent(d.ratio)})" for d in blind[:MOST_DIRECTIONS]]
    if len(blind) > MOST_DIRECTIONS:
        lines.append(f"and {len(blind) - MOST_DIRECTIONS} more.")
    return lines


def correlation_table(outlook: Identifiability) -> TextTable:
    """Tabulate the correlation of all parameters, or the strongest pairs of many."""
    names = [p.name for p in outlook.parameters]
    C = outlook.correlation
    if len(names) <= MOST_CORRELATED:
        named = zip(names, C, strict=True)
        rows = [(name, *(or_dash(c, ".2f") for c in row)) for name, row in named]
        return text_table("Correlation", ("parameter", *names), rows)
    i, j = np.triu_indices(len(names), 1)
    strength = np.nan_to_num(np.abs(C[i, j]), nan=-1.0)
    first = np.argsort(-strength, kind="stable")[:MOST_PAIRS]
    pairs = zip(i[first], j[first], strict=True)
    rows = [(names[a], names[b], or_dash(float(C[a, b]), ".2f")) for a, b in pairs]
    columns = "parameter", "with", "correlation"
    return text_table(f"The {MOST_PAIRS} strongest correlations", columns, rows)


def history_table(result: CalibrationResult) -> TextTable:
    """Tabulate the steps of the fit."""
    rows = []
    for entry in result.history:
        rms = or_dash(1e3 * entry.rms, ".4g", "mm")
        size = f"{max(map(abs, entry.lambda_p)):.2g}" if entry.step else "-"
        outcome = "taken" if entry.accepted else Cell("refused", "doubtful")
        rows.append((str(entry.step), f"{entry.cost:.4g}", rms, size, outcome))
    columns = "step", "cost", "rms marker distance", "largest lambda_p", "outcome"
    return text_table("Steps of the fit", columns, rows)


def summary_table(
    result: CalibrationResult, assessment: Assessment | None = None
) -> Group:
    """Tabulate a calibration for the terminal; without `assessment`, it is assessed.

    Parameters come first, then configurations, identifiability and notes.
    """
    assessment = assessment or assess(result)
    outlook = assessment.identifiability
    shown = result.configurations
    style = STYLES[outlook_tone(outlook.verdict, assessment)]
    tables = [
        parameter_table(result, outlook),
        budget_table(result),
        *interval_tables(result),
        *error_tables(shown, result.checks),
        *robot_tables(listed_fits(shown)),
        outlook_table(assessment),
    ]
    return Group(
        *map(TextTable.drawn, tables),
        Text(outlook_legend(outlook)),
        Text("\n  ".join(blindness(outlook)), style=style),
        *([Text(assessment.prediction)] if assessment.prediction else []),
        *([] if result.starts is None else [Text(str(result.starts))]),
        *(Text(line) for line in (result.checks.agreement if result.checks else ())),
        *(Text(f"Note: {note}", style="yellow") for note in result.notes),
    )
