"""What robots do and what a calibration found, in tables."""

import math
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from softcal_jax._tree import Column, Table, Tone
from softcal_jax._units import readable
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    MultiStartResult,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.equilibrium import ActuatorState, Model
from softcal_jax.identifiability import LOST, Assessment, Identifiability
from softcal_jax.inference import ErrorBudget
from softcal_jax.report._verdict import TONES, listed_fits, value_column

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
    return Table.of("Optima", heads, rows, note=starts.words if starts else "")


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
