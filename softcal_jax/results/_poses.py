"""What is said of poses: the state of the robot, errors, and what is predicted."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from softcal_jax import plotting
from softcal_jax._text import MOST_NAMED, listed
from softcal_jax._units import readable
from softcal_jax.calibration import (
    ConfigurationResult,
    ResidualChecks,
    SimulationResult,
)
from softcal_jax.configurations import (
    Configuration,
    EffectorRecord,
    ImposedDisplacement,
    ImposedForce,
    beyond,
    rms_distance,
)
from softcal_jax.equilibrium import ActuatorState, Model
from softcal_jax.results._tree import Chart, Section, Table, Value, verdict

MOST_LISTED = 6  # held-out configurations that are listed one by one


def simulation_sections(result: SimulationResult) -> Iterator[Section]:
    """Write the outcome in every configuration, and the state of the robot."""
    poses, tone = result.configurations, "doubtful" if result.doubts else "good"
    n, n_converged = len(poses), sum(pose.converged for pose in poses)
    text = f"{n_converged} of {n} configurations have an equilibrium."
    if n_converged == n:
        every = "The configuration has" if n == 1 else f"All {n} configurations have"
        text = f"{every} an equilibrium."
    yield verdict(text, tone if result.converged else "bad", result.doubts)
    rows = [
        (
            c.name,
            c.largest_displacement if c.converged else None,
            c.newton_steps,
            Value(c.outcome, tone="good" if c.converged else "bad"),
        )
        for c in poses
    ]
    heads = "configuration | largest displacement [distance] | Newton steps | outcome"
    outcomes = Table.of("Simulation", heads, rows)
    yield Section("states", "States", (), (outcomes, *robot_tables(poses)))
    yield Section("errors", "Errors", held_out_sentences(poses))
    yield Section("model", "Model", (f"{model_words(result.model)}.",), folded=True)


def model_words(model: Model) -> str:
    """Describe the size, the law and the elements of a model."""
    law = model.law
    parts = law, *(getattr(law, key, None) for key in ("elasticity", "matrix"))
    named = [type(part).__name__ for part in parts if part is not None]
    return f"{model.mesh.words}, {' of '.join(named)} ({model.formulation})"


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
    heads = "rigid body | state | displacement [m] | rotation [rad]"
    ground = "of | force of the ground (x, y, z) [N]"
    forces = "with | force on it (x, y, z) [N] | moment on it [N m]"
    shares = "with | area [m2] | largest depth [m] | sliding [percent]"
    tables = [
        _effectors(configurations),
        table("Actuators", f"actuator | {MOVED}", "actuators", actuator_cells),
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

    def cell(effector: EffectorRecord, key: str) -> Value:
        values = getattr(effector, key)
        if np.isnan(values).any():
            return Value(None)
        size = np.linalg.norm(values) if effector.is_turn else values
        return Value(size, effector.unit)

    cells = [
        (pose, effector_name(e), *(cell(e, key) for key in shown.values()))
        for pose, e in rows
    ]
    heads = " | ".join(["configuration", "effector", *shown])
    return Table.of("Other effectors", heads, cells)


def effector_name(effector: EffectorRecord) -> str:
    """Name an effector; the turn of a frame is another than its point."""
    return f"{effector.name}{' (turn)' * effector.is_turn}"


def imposed(
    model: Model, c: Configuration
) -> Iterator[tuple[str, ImposedForce | ImposedDisplacement, str]]:
    """Yield the commanded actuators by name, what is imposed on each, and its unit."""
    actuators = model.mechanism.actuators
    for name, command in c.actuation.items():
        kind = actuators.kinds[actuators.names.index(name)]
        by_displacement = isinstance(command, ImposedDisplacement)
        unit = kind.displacement_unit if by_displacement else kind.force_unit
        yield name, command, unit or ""


MOVED = "force or pressure | displacement or growth"
"""Heads of what `actuator_cells` returns."""


def actuator_cells(state: ActuatorState) -> list[Value]:
    """Show force and displacement of an actuator, and which of them is imposed."""
    return [
        Value(value, unit or "", note="(imposed)" * (state.imposed == what))
        for what, value, unit in (
            ("force", state.force, state.force_unit),
            ("displacement", state.displacement, state.displacement_unit),
        )
    ]


def listed_fits(fits: Sequence[ConfigurationResult]) -> list[ConfigurationResult]:
    """Return the configurations to list one by one: all that were fitted, few others.

    Of many that were held out these are the three with the largest errors and the one
    with the smallest, in this order.
    """
    held_out = [fit for fit in fits if fit.role == "validation"]
    if len(held_out) <= MOST_LISTED:
        return list(fits)
    ranked = sorted(held_out, key=lambda fit: -np.nan_to_num(fit.rms_after))
    return [f for f in fits if f.role != "validation"] + [*ranked[:3], ranked[-1]]


def held_out_sentences(fits: Sequence[ConfigurationResult]) -> list[str]:
    """Say how well configurations are predicted that were not fitted, in a sentence."""
    asked = ("validation", "prediction")
    poses = [fit for fit in fits if fit.role in asked and fit.converged]
    points = [e for fit in poses for e in fit.points if e.seen.any()]
    turns = [e for fit in poses for e in fit.turns if e.seen.any()]
    if not (points or turns):
        return []
    parts = []
    if points:
        rms, motion = (
            rms_distance(points, values)
            for values in (lambda e: e.simulated, lambda e: e.at_rest)
        )
        parts.append(f"{readable(rms, 'distance')} rms over {_points(points, turns)}")
        if motion > 0.0:
            parts[0] += f", {readable(rms / motion, 'share')} of the motion"
    if turns:
        off = rms_distance(turns, lambda e: e.simulated)
        parts.append(f"{readable(off, 'turn')} rms in orientation")
    poses = [fit for fit in poses if any(e.seen.any() for e in fit.effectors)]
    held_out = poses[0].role == "validation"
    head = "Held-out error" if held_out else "Prediction error"
    of = poses[0].name if len(poses) == 1 else f"{len(poses)} poses"
    seen = " not used in the fit" * (held_out and len(poses) > 1)
    sentences = [f"{head} of {of}{seen}: {'; '.join(parts)}{_range(poses)}."]
    fitted = [fit.posed for fit in fits if fit.role == "calibration" and fit.posed]
    names: dict[str, list[str]] = {}
    for pose in poses if fitted else ():
        if pose.posed is not None:
            names.setdefault(beyond(fitted, pose.posed), []).append(pose.name)
    names.pop("", None)
    return sentences + [
        f"Beyond what was fitted: {listed(of_text, MOST_NAMED)}, as {text}."
        for text, of_text in names.items()
    ]


def _range(poses: Sequence[ConfigurationResult]) -> str:
    """Name the poses that are predicted best and worst, and quantiles of many."""
    poses = [pose for pose in poses if math.isfinite(pose.rms_after)]
    if len(poses) < 2:
        return ""
    ranked = sorted(poses, key=lambda pose: pose.rms_after)
    size = lambda metres: readable(metres, "distance")
    ends = (f"{size(pose.rms_after)} ({pose.name})" for pose in (ranked[0], ranked[-1]))
    text = f"; {' to '.join(ends)}"
    if len(poses) <= MOST_LISTED:
        return text
    half, most = np.quantile([pose.rms_after for pose in poses], [0.5, 0.95])
    return f"{text}, median {size(half)}, 95th percentile {size(most)}"


def _points(points: Sequence[EffectorRecord], turns: Sequence[EffectorRecord]) -> str:
    """Count the markers and the 6-D sensors that were measured, in words."""
    turning, names = ({e.name for e in of} for of in (turns, points))
    counts = {"marker": len(names - turning), "6-D sensor": len(names & turning)}
    return listed([f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n])


def error_tables(
    fits: Sequence[ConfigurationResult], checks: ResidualChecks | None
) -> list[Table]:
    """Tabulate the errors of points and of orientations.

    With three or more fitted configurations, a further table has the error of each when
    it is left out of the fit: in one table, this would not fit in 80 columns.
    """

    def errors(of: str, heads: str, fits: Sequence[Any], *keys: str) -> Table:
        values = map(attrgetter("name", "role", *keys), fits)
        rows = ((*r[:3], Value(r[3], tone="strong"), *r[4:]) for r in values)
        title = f"Residuals of the {of}, rms"
        return Table.of(title, f"configuration | role | {heads}", rows)

    listed, sizes = listed_fits(fits), "before [distance] | after [distance]"
    sizes += " | motion [distance] | relative error [share]"
    keys = "rms_before", "rms_after", "motion", "rms_share"
    turned = [fit for fit in listed if math.isfinite(fit.turn_after)]
    turns = "before [turn] | after [turn]"
    title, heads = "Each configuration, predicted from the others", "configuration"
    heads += " | residual [distance] | expected from known errors [distance]"
    left_out = () if checks is None else checks.left_out
    tables = [
        errors("markers", sizes, listed, *keys),
        Table.of(title, heads, map(attrgetter("name", "rms", "expected"), left_out)),
        errors("orientations", turns, turned, "turn_before", "turn_after"),
    ]
    seen = any(math.isfinite(fit.rms_after) for fit in fits)
    return [table for table in tables[not seen :] if table]


def error_charts(fits: Sequence[ConfigurationResult]) -> tuple[Chart, ...]:
    """Draw errors before and after beside the motion; of many poses, where they are."""
    listed = listed_fits(fits)
    rows = sum(math.isfinite(fit.rms_after) for fit in listed)
    if not rows:
        return ()
    caption = "Root mean square distance between simulated and measured markers."
    draw = partial(plotting.draw_errors, fits=listed)
    charts = [chart_of("Errors of the markers", draw, caption, rows)]
    if len(listed) < len(fits):
        caption = (
            "Each circle is at the mean position of the points of a configuration."
        )
        draw = partial(plotting.draw_workspace, fits=fits)
        charts.append(chart_of("Errors over the workspace", draw, caption))
    return tuple(charts)


def chart_of(
    title: str, draw: Callable[..., Any], caption: str, rows: int | None = None
) -> Chart:
    """Make a chart, as high as its rows need where it has any."""
    lines = None if rows is None else 2.0 + 1.6 * rows
    plot = partial(plotting.plot_panels, drawn=[draw], lines=lines)
    return Chart(title, plot, caption)


_VALUES = ("measured", "simulated_before", "simulated", "residual")
_BODY = {"position": "m", "translation": "m", "rotation_vector": "rad"}
_CONTACT = {"force": "N", "moment": "N m", "area": "m2", "depth": "m", "sliding": "-"}
"""Attributes of bodies and of contacts that are written, and their units."""


def csv_tables(configurations: Sequence[ConfigurationResult]) -> dict[str, Table]:
    """Tabulate the values of all configurations, by the names of files.

    A line of `markers.csv` is a marker or other point, in mm; one of `effectors.csv` a
    coordinate of an effector that is not a point, in SI; one of `robot.csv` a value of
    a body, actuator, reaction or contact, in SI. A file without lines is left out.
    """
    values = lambda e: [getattr(e, column) for column in _VALUES]
    points = [
        (c.name, c.role, p.name, *np.concatenate(values(p)), p.distance(p.simulated))
        for c in configurations
        for p in c.points
    ]
    others = [
        (c.name, c.role, e.name, name, e.unit, *coordinate)
        for c in configurations
        for e in c.others
        for name, *coordinate in zip(
            _coordinates("turn" if e.is_turn else "value", len(e.measured)),
            *values(e),
            strict=True,
        )
    ]
    state = [(c.name, *line) for c in configurations for line in _robot(c)]
    places = " | ".join(f"{v}_{axis} [distance]" for v in _VALUES for axis in "xyz")
    heads = f"configuration | role | marker | {places} | distance [distance]"
    rest = f"effector | coordinate | unit | {' | '.join(_VALUES)}"
    robot = "configuration | part | name | what | quantity | value | unit"
    tables = {
        "markers.csv": Table.of("", heads, points),
        "effectors.csv": Table.of("", f"configuration | role | {rest}", others),
        "robot.csv": Table.of("", robot, state),
    }
    return {name: table for name, table in tables.items() if table}


def _coordinates(what: str, n: int) -> list[str]:
    return [f"{what}_{axis}" for axis in "xyz"[:n]] if n > 1 else [what]


def _robot(result: ConfigurationResult) -> Iterator[tuple[Any, ...]]:
    """Yield part, name, what it is, quantity, value and unit."""
    robot = result.robot
    if robot is None:
        return
    for body in robot.bodies:
        yield from _components("rigid body", body, body.state, _BODY)
    for a in robot.actuators:
        for what in ("force", "displacement"):
            value, unit = getattr(a, what), getattr(a, f"{what}_unit")
            if value is not None:
                quantity = f"{what}{' (imposed)' * (a.imposed == what)}"
                yield "actuator", a.name, a.kind, quantity, value, unit
    for reaction in robot.reactions:
        what = "force of the ground"
        yield from _components("reaction", reaction, what, {"force": "N"})
    bodies = {body.name for body in robot.bodies}
    for contact in robot.contacts:
        what = "obstacle" if contact.name in bodies else "pair of surfaces"
        yield from _components("contact", contact, what, _CONTACT)


def _components(
    part: str, of: Any, what: str, units: Mapping[str, str]
) -> Iterator[tuple[Any, ...]]:
    for key, unit in units.items():
        values = np.atleast_1d(getattr(of, key))
        for name, value in zip(_coordinates(key, len(values)), values, strict=True):
            yield part, of.name, what, name, value, unit
