"""What designs and inverse control found, what robots do, in tables."""

import math
from collections.abc import Callable, Sequence
from itertools import compress
from operator import attrgetter
from typing import Any

import numpy as np

from softcal_jax._tree import Column, Section, Table, Tone
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    MultiStartResult,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.designs import LEVEL, Alternative, DesignResult
from softcal_jax.equilibrium import ActuatorState, Model
from softcal_jax.export import headline, missed_words, off_words
from softcal_jax.fields import ControlPointParameters
from softcal_jax.identifiability import LOST, Assessment, Identifiability
from softcal_jax.inference import ErrorBudget
from softcal_jax.materials import youngs_moduli
from softcal_jax.report._verdict import TONES, listed_fits, value_column, verdict


def design_sections(result: DesignResult) -> tuple[Section, ...]:
    """Write fields as ordered, goals, commands, limits, and what less could do."""
    reasons = *missed_words(result), *_sentences_on_worth(result)
    goals = _designed(result), _commands(result), _limits(result)
    return (
        verdict(headline(result), "good" if result.met else "doubtful", reasons),
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


def _sentences_on_worth(result: DesignResult) -> tuple[str, ...]:
    """Say what the design is worth, one sentence for each alternative."""

    def sentence(a: Alternative) -> str:
        text, error = f"{a.error:.3g} tolerances off", f"{result.error:.3g}"
        if np.isfinite(a.expected):
            text += f", {a.expected:.3g} as printed"
            error += f" and {result.expected:.3g}"
        if not a.result.converged:
            text += " or less (its search did not converge)"
        return f"With {a.name} the goals are {text}, with this design {error}."

    return tuple(map(sentence, result.alternatives))


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
    inputs = (f"Commanded: {_commanded(result)}.",)
    reached = ("Active limits:", *result.active_limits) if result.active_limits else ()
    tried = [(a.way, a.n_steps, a.error) for a in result.attempts]
    heads = "started from | steps | largest error, in standard deviations [ratio]"
    search = (Table.of("Descents", heads, tried),)
    tables = goal_table(result.goals), _actuators(result)
    return (
        verdict(headline(result), "good" if result.met else "doubtful", inputs),
        Section("goals", "Goals and commands", reached, tables),
        Section("search", "Course of the search", (), search, folded=True),
    )


def _commanded(result: InverseResult) -> str:
    """Say what is imposed on the commanded actuators, in words."""
    imposed = lambda a: (getattr(a, a.imposed), getattr(a, f"{a.imposed}_unit"))
    return ", ".join(
        f"{a.name} = {readable_values([value], unit or '')}"
        for a in result.actuators
        if a.name in result.configuration.actuation
        for value, unit in [imposed(a)]
    )


def _trajectory(result: TrajectoryResult) -> tuple[Section, ...]:
    points = result.points
    far = [headline(points[i]) for i in result.unmet]
    rows = [(i, _commanded(p), headline(p)) for i, p in enumerate(points, 1)]
    tones: list[Tone] = ["good" if point.met else "bad" for point in points]
    table = Table.of(
        "Commands", "goal | inputs | outcome", rows, about={"outcome": {"tones": tones}}
    )
    return (
        verdict(headline(result), "doubtful" if far else "good", far),
        Section("goals", "Goals and commands", (), (table,)),
    )


def goal_table(goals: Sequence[GoalFit]) -> Table:
    """Tabulate goals, and what is reached."""
    rows: list[Any] = []
    for fit in goals:
        both = [fit.effector.measured, fit.reached]
        worst = float(np.max(np.abs(fit.in_std), initial=0.0))
        pair = (_coordinates(fit, values, both) for values in both)
        rows.append((_name(fit), *pair, off_words(fit), worst))
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


MOST_CORRELATED = 12  # parameters whose correlations are shown as a matrix
MOST_PAIRS = 20  # pairs of parameters listed where a matrix would be too large
MOST_OPTIMA = 5  # optima that are listed


def simulation_table(result: SimulationResult) -> Table:
    """Tabulate the outcome in every configuration."""
    poses = result.configurations
    largest = [c.largest_displacement if c.converged else None for c in poses]
    found = map(attrgetter("name", "newton_steps", "outcome"), poses)
    rows = [(name, u, *rest) for (name, *rest), u in zip(found, largest, strict=True)]
    heads = "configuration | largest displacement [distance] | Newton steps | outcome"
    tones: list[Tone] = ["good" if c.converged else "bad" for c in poses]
    return Table.of("Simulation", heads, rows, about={"outcome": {"tones": tones}})


def robot_tables(configurations: Sequence[ConfigurationResult]) -> list[Table]:
    """Tabulate the state of the robot, and effectors that are no points."""
    robots = [(c.name, c.robot) for c in configurations if c.robot is not None]

    def table(title: str, heads: str, part: str, values: Callable[..., Any]) -> Table:
        rows = [
            (pose, of.name, *values(of))
            for pose, robot in robots
            for of in getattr(robot, part)
            if getattr(of, "state", "") != "absent"
        ]
        return Table.of(title, f"configuration | {heads}", rows)

    size = lambda vector: float(np.linalg.norm(vector))
    place = lambda b: (b.state, size(b.translation), size(b.rotation_vector))
    felt = lambda c: (c.force, c.moment) if c.area else ("not touched", None)
    areas = lambda c: (c.area, c.depth, c.sliding or None) if c.area else [None] * 3
    actuators = table("Actuators", "actuator", "actuators", lambda _: ())
    moved = actuator_columns([a for _, robot in robots for a in robot.actuators])
    heads = "rigid body | state | displacement [m] | rotation [rad]"
    ground = "of | force of the ground (x, y, z) [N]"
    forces = "with | force on it (x, y, z) [N] | moment on it [N m]"
    shares = "with | area [m2] | largest depth [m] | sliding [percent]"
    tables = [
        _effectors(configurations),
        actuators._replace(columns=(*actuators.columns, *moved)),
        table("Rigid bodies", heads, "bodies", place),
        table("Reactions", ground, "reactions", lambda r: (r.force,)),
        table("Contacts", forces, "contacts", felt),
        table("Contact areas", shares, "contacts", areas),
    ]
    return [table for table in tables if table]


def _effectors(configurations: Sequence[ConfigurationResult]) -> Table:
    """Tabulate effectors that are no points; another table has the errors of turns."""
    roles = {result.role for result in configurations}
    shown = {"measured": "measured", "before": "simulated_before", "after": "simulated"}
    if roles == {"simulation"}:
        shown = {"simulated": "simulated"}
    if "prediction" in roles:
        shown = {"measured": "measured", "simulated": "simulated"}
    if "design" in roles:
        shown = {"goal": "measured", "reached": "simulated"}
    rows = [(c.name, e) for c in configurations for e in c.others]
    rows = [row for row in rows if roles == {"simulation"} or not row[1].is_turn]

    def value(effector: Any, key: str) -> Any:
        values = getattr(effector, key)
        if np.isnan(values).any():
            return None
        return np.linalg.norm(values) if effector.is_turn else values

    cells = [
        (
            pose,
            f"{e.name}{' (turn)' * e.is_turn}",
            *(value(e, k) for k in shown.values()),
        )
        for pose, e in rows
    ]
    heads = " | ".join(
        ["configuration", "effector", *(f"{head} [*]" for head in shown)]
    )
    return Table.of("Other effectors", heads, cells, units=[e.unit for _, e in rows])


def actuator_columns(states: Sequence[ActuatorState]) -> list[Column]:
    """Return force and displacement of actuators, and which of them is imposed."""
    heads = {"force": "force or pressure", "displacement": "displacement or growth"}
    return [
        Column(
            head,
            [getattr(a, what) for a in states],
            [getattr(a, f"{what}_unit") or "" for a in states],
            notes=["(imposed)" * (a.imposed == what) for a in states],
        )
        for what, head in heads.items()
    ]


def model_words(model: Model) -> str:
    """Describe the size, the law and the elements of a model."""
    law = model.law
    parts = law, *(getattr(law, key, None) for key in ("elasticity", "matrix"))
    named = [type(part).__name__ for part in parts if part is not None]
    return f"{model.mesh.words}, {' of '.join(named)} ({model.formulation})"


def parameter_table(result: CalibrationResult, outlook: Identifiability) -> Table:
    """Tabulate values, standard errors, starts and bounds."""
    every = result.parameters
    blind = {p.name for p in outlook.parameters if p.verdict == "not identifiable"}
    sound = (result.converged and not (q.at_bound or q.name in blind) for q in every)
    tones: list[Tone] = ["strong" if good else "bad" for good in sound]
    ends = lambda q: (readable(end, q.unit) for end in (q.lower, q.upper))
    columns = (
        Column("parameter", [q.name for q in every]),
        value_column("value ± standard error", every, tones),
        Column("start", [q.start for q in every], [q.unit for q in every]),
        Column("bounds", [" to ".join(ends(q)) for q in every]),
    )
    return Table("Parameters" + ", ± not checked" * (not result.intervals), columns)


def budget_table(budget: ErrorBudget) -> Table:
    """Tabulate in words what the standard errors come from."""
    rows = [(name, budget.sentence(name)) for name in budget.names]
    heads = "parameter | relative standard error"
    return Table.of("Standard errors by cause", heads, rows)


def interval_table(result: CalibrationResult) -> Table:
    """Tabulate the intervals of the parameters, and how each was found."""
    every = result.intervals
    tones: list[Tone] = ["bad" if i.kind == "none" else "plain" for i in every]
    level = f"{100.0 * every[0].level:g} % interval" if every else "interval"
    rows = [(interval.name, str(interval), interval.kind) for interval in every]
    heads = f"parameter | {level} | kind"
    return Table.of("Intervals", heads, rows, about={level: {"tones": tones}})


def optima_table(starts: MultiStartResult | None) -> Table:
    """Tabulate the distinct optima of a search from many starts, the best first."""
    optima = () if starts is None else starts.optima[:MOST_OPTIMA]
    rows = [(one.cost, len(one.starts), one.words) for one in optima]
    heads = "cost [ratio] | starts that end there | values"
    return Table.of("Optima", heads, rows, note=headline(starts) if starts else "")


def error_tables(
    fits: Sequence[ConfigurationResult], checks: ResidualChecks | None
) -> list[Table]:
    """Tabulate the errors of points and of orientations.

    With three or more fitted configurations, a further table has the error of each when
    it is left out of the fit: in one table, this would not fit in 80 columns.
    """

    def errors(of: str, heads: str, keys: str, fits: Sequence[Any]) -> Table:
        strong: list[Tone] = ["strong"] * len(fits)
        rows = map(attrgetter("name", "role", *keys.split()), fits)
        title, heads = f"Residuals of the {of}, rms", f"configuration | role | {heads}"
        return Table.of(title, heads, rows, about={"after": {"tones": strong}})

    listed, sizes = listed_fits(fits), "before [distance] | after [distance]"
    turned = [fit for fit in listed if math.isfinite(fit.turn_after)]
    sizes += " | motion [distance] | relative error [share]"
    keys, angles = (
        "rms_before rms_after motion rms_share",
        "before [turn] | after [turn]",
    )
    title = "Each configuration, predicted from the others"
    heads = (
        "configuration | residual [distance] | expected from known errors [distance]"
    )
    left_out = () if checks is None else checks.left_out
    tables = [
        errors("markers", sizes, keys, listed),
        Table.of(title, heads, map(attrgetter("name", "rms", "expected"), left_out)),
        errors("orientations", angles, "turn_before turn_after", turned),
    ]
    seen = any(math.isfinite(fit.rms_after) for fit in fits)
    return [table for table in tables[not seen :] if table]


def outlook_table(assessment: Assessment) -> Table:
    """Tabulate what the data tell about each parameter."""
    outlook = assessment.identifiability
    rows = [
        (p.name, p.ratio if p.ratio <= LOST else "blind", assessment.seen(p.verdict))
        for p in outlook.parameters
    ]
    heads = "parameter | standard error / target [percent] | verdict"
    tones = [outlook_tone(p.verdict, assessment) for p in outlook.parameters]
    about = {"note": outlook_legend(outlook), "about": {"verdict": {"tones": tones}}}
    return Table.of("What the data determine", heads, rows, **about)


def outlook_tone(verdict: str, assessment: Assessment) -> Tone:
    """Return the tone of a verdict, at best doubtful if the assessment has doubts."""
    doubtful = verdict == "identifiable" and not assessment.identified
    return "doubtful" if doubtful else TONES[verdict]


def outlook_legend(outlook: Identifiability) -> str:
    """Say what the verdicts mean, and give the condition numbers."""
    words = [outlook.scale]
    if outlook.has_prior:
        n = outlook.n_parameters
        shares = f"{outlook.informed} of {n} direction{'s' * (n != 1)}"
        words.append(f"The data constrain {shares} more tightly than the prior.")
    if outlook.n_data:
        words.append(str(outlook.conditioning))
    return " ".join(words)


def inner_tables(outlook: Identifiability) -> list[Table]:
    """Tabulate the correlation of the parameters and the singular values of W_ep."""
    singular = outlook.conditioning.singular_values if outlook.n_data else ()
    title = "Singular values of W_ep in units of the noise"
    rows = enumerate(singular, 1)
    values = Table.of(title, "number | singular value [ratio]", rows)
    names, C = [p.name for p in outlook.parameters], outlook.correlation
    columns = [Column(name, C[:, k], "correlation") for k, name in enumerate(names)]
    table = Table("Correlation", (Column("parameter", names), *columns))
    if len(names) > MOST_CORRELATED:
        i, j = np.triu_indices(len(names), 1)
        strength = np.nan_to_num(np.abs(C[i, j]), nan=-1.0)
        first = np.argsort(-strength, kind="stable")[:MOST_PAIRS]
        pairs = zip(i[first], j[first], strict=True)
        rows = [(names[a], names[b], C[a, b]) for a, b in pairs]
        heads = "parameter | with | correlation [correlation]"
        table = Table.of(f"The {MOST_PAIRS} strongest correlations", heads, rows)
    return [table for table in (table, values)[len(names) < 2 :] if table]


def history_table(result: CalibrationResult) -> Table:
    """Tabulate the steps of the fit."""
    steps = result.history
    size = [max(map(abs, s.lambda_p)) if s.step else None for s in steps]
    outcome = ["taken" if s.accepted else "refused" for s in steps]
    first = zip(*map(attrgetter("step", "cost", "rms"), steps), strict=True)
    rows = zip(*first, size, outcome, strict=True)
    tones: list[Tone] = ["plain" if s.accepted else "doubtful" for s in steps]
    heads = "step | cost | rms marker distance [m] | largest lambda_p [step] | outcome"
    return Table.of(
        "Steps of the fit", heads, rows, about={"outcome": {"tones": tones}}
    )
