"""Results of inverse control: their tables, and the folder with their page."""

from collections.abc import Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from softcal_jax._text_table import Cell, TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import SourceFile
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.equilibrium import robot_states
from softcal_jax.export import (
    Made,
    file_dict,
    file_stems,
    inverse_dict,
    readable_values,
    results_folder,
    write_json,
    write_pvd,
    write_robot_vtu,
    write_vtu,
)
from softcal_jax.plotting import render_body
from softcal_jax.report._html import (
    Html,
    Section,
    bullets,
    closing,
    output,
    page,
    sentences,
    table_html,
)
from softcal_jax.report._pages import REPORT, notebook_html, shown_pictures
from softcal_jax.report._tables import HEADS, actuator_row, actuator_values
from softcal_jax.report._verdict import RunVerdict
from softcal_jax.report._write import COLLECTION, Picture, Progress, picture_problem

if TYPE_CHECKING:
    import rich.console


def inverse_verdict(result: InverseResult | TrajectoryResult) -> RunVerdict:
    """Say whether the goals are met, and by which command."""
    if isinstance(result, TrajectoryResult):
        missed = tuple(result.points[i].message for i in result.unmet)
        tone = "doubtful" if missed or not result.points else "good"
        return RunVerdict(result.headline, tone, missed)
    reasons = (f"Commanded: {_inputs(result)}.",)
    return RunVerdict(result.message, "good" if result.met else "doubtful", reasons)


def inverse_html(result: InverseResult | TrajectoryResult) -> list[Html]:
    """Show how closely the goals are met, and what the actuators do for it."""
    if isinstance(result, InverseResult):
        tables = map(table_html, (goal_table(result.goals), actuator_table(result)))
        limits = "Active limits:" if result.active_limits else ""
        return [*tables, *sentences([limits]), bullets(result.active_limits)]
    rows = [
        (str(i), _inputs(point), Cell(point.message, "good" if point.met else "bad"))
        for i, point in enumerate(result.points, 1)
    ]
    columns = "goal", "inputs", "outcome"
    return [table_html(text_table("Commands", columns, rows, words=["inputs"]))]


def inverse_table(result: InverseResult) -> "rich.console.Group":
    """Tabulate a result of inverse control for the terminal: goals and actuators."""
    from rich.console import Group
    from rich.text import Text

    verdict = inverse_verdict(result)
    tables = map(TextTable.drawn, (goal_table(result.goals), actuator_table(result)))
    return Group(*tables, Text(verdict.sentence, HEADS[verdict.tone]))


def goal_table(goals: Sequence[GoalFit]) -> TextTable:
    """Tabulate goals, what is reached, and how far that is off."""
    rows = []
    for fit in goals:
        name = f"{fit.name} (turn)" if fit.effector.is_turn else fit.name
        pair = [_coordinates(fit, x) for x in (fit.effector.measured, fit.reached)]
        worst = f"{np.max(np.abs(fit.in_std), initial=0.0):.2g}"
        rows.append((name, *pair, fit.off, worst))
    columns = "effector", "goal", "reached", "off by", "standard deviations"
    return text_table("Goals", columns, rows)


def _coordinates(fit: GoalFit, values: Float[HostArray, " k"]) -> str:
    """Write the coordinates that have a goal, with their axes if some have none."""
    effector, seen = fit.effector, np.asarray(fit.effector.seen)
    text = readable_values(values[seen].tolist(), effector.unit).rstrip()
    if len(seen) == 1 or seen.all():
        return text
    return f"{', '.join(compress('xyz', seen))} = {text}"


def actuator_table(result: InverseResult) -> TextTable:
    """Tabulate what the actuators do, each in its own units."""
    columns = "actuator", "kind", "force", "displacement"
    rows = []
    for actuator in result.actuators:
        commanded = actuator.name in result.configuration.actuation
        kind = actuator.kind if commanded else f"{actuator.kind}, not commanded"
        rows.append((actuator.name, kind, *actuator_row(actuator)))
    return text_table("Actuators", columns, rows)


def _inputs(result: InverseResult) -> str:
    """Write the commanded forces and displacements of the actuators."""
    return ", ".join(
        f"{actuator.name} = {actuator_values(actuator)[actuator.imposed]}"
        for actuator in result.actuators
        if actuator.name in result.configuration.actuation
    )


def write_inverse(
    result: InverseResult | TrajectoryResult,
    directory: str | Path,
    *,
    name: str = "inverse",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
    calibration: str | Path | None = None,
    options: Sequence[str] = (),
    notes: Sequence[str] = (),
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
) -> Path:
    """Write a result of inverse control to a folder, whole or not at all.

    The folder holds `report.html`, `inverse.json` (see `inverse_dict`) and for each
    goal that has an equilibrium a .vtu for ParaView and a picture, with circles where
    the goals are. `configurations.pvd` opens all .vtu at once. With `calibration`, the
    `result.json` that the model was loaded from, the page gives the command that
    repeats the run; `options` are further words of it, like "--goal" and its value, and
    `notes` are doubts about the result. Other arguments, errors and what is returned
    are those of `write_results`.
    """
    points = [result] if isinstance(result, InverseResult) else list(result.points)
    more: dict[str, Any] = {"made": made, "directory": directory}
    data = inverse_dict(result, name=name, timing_s=timing_s, **more)
    several = [f"goal {i}" for i in range(1, len(points) + 1)]
    names = ["command"] if len(points) == 1 else several
    stems = file_stems(names)
    solved = [bool(point.solution.converged) for point in points]
    problem = picture_problem(list(compress(stems, solved)), pictures)
    data["notes"] = [*notes, *([problem] if problem else [])]
    loaded = None if calibration is None else SourceFile.of(Path(calibration))
    data["calibration"] = loaded and file_dict(loaded, directory)
    suffix = None if problem else pictures
    seen = "the body at the commands found, coloured by displacement, with the goals "
    seen += "(circles) and the positions reached (crosses)"
    bodies, captions = [], {}
    with results_folder(directory, force=force) as folder:
        progress(0, len(points))
        for k, (point, title, stem) in enumerate(
            zip(points, names, stems, strict=True)
        ):
            if solved[k]:
                written = _write_body(folder, point, stem, title, suffix)
                captions |= dict.fromkeys(written, f"{title}: {seen}")
                bodies.append([file for file in written if file.endswith(".vtu")])
            progress(k + 1, len(points))
        if bodies:
            write_pvd(folder / COLLECTION, bodies)
        data["files"] = [REPORT, *([COLLECTION] if bodies else []), *captions]
        shown = shown_pictures(captions, folder)
        text = _page(result, data, shown, options)
        (folder / REPORT).write_text(text, encoding="utf-8")
        write_json(folder / "inverse.json", data)
    return Path(directory)


def _write_body(
    folder: Path, point: InverseResult, stem: str, title: str, suffix: Picture | None
) -> list[str]:
    """Write the equilibrium of a command, and return the names of the files."""
    model = point.model
    u = np.asarray(point.solution.displacement)[: model.mesh.n_nodes]
    files = [f"{stem}.vtu"]
    write_vtu(folder / files[0], model, u)
    # On the host: on the device, each shape would compile a program.
    solution = jax.tree.map(lambda leaf: np.asarray(leaf)[None], point.solution)
    (robot,) = robot_states(model, [point.configuration], solution)
    if robot is not None:
        files.append(f"{stem}_robot.vtu")
        write_robot_vtu(folder / files[-1], model, robot)
    if suffix is not None:
        files.append(f"{stem}.{suffix}")
        fits = [fit for fit in point.goals if fit.effector.quantity == "point"]
        # A coordinate without a goal does not contribute to the drawn distance.
        goals = [
            np.where(fit.effector.seen, fit.effector.measured, fit.reached)
            for fit in fits
        ]
        render_body(
            model,
            u,
            folder / files[-1],
            title=f"{title} - inverse control from {point.configuration.name!r}",
            subtitle="all goals are met" if point.met else "not all goals are met",
            measured=np.array(goals) if fits else None,
            simulated=np.array([fit.reached for fit in fits]) if fits else None,
            marker_names=[fit.name for fit in fits],
            labels=("goal", "reached"),
            robot=robot,
            posed=point.configuration,
        )
    return files


@notebook_html.register(InverseResult)
@notebook_html.register(TrajectoryResult)
def _cell(result: InverseResult | TrajectoryResult) -> Html:
    return output(inverse_verdict(result), inverse_html(result))


def _page(
    result: InverseResult | TrajectoryResult,
    data: Mapping[str, Any],
    pictures: Sequence[Html],
    options: Sequence[str],
) -> str:
    search = []
    if isinstance(result, InverseResult) and result.attempts:
        rows = [(a.way, str(a.n_steps), f"{a.error:.3g}") for a in result.attempts]
        columns = "started from", "steps", "largest error, in standard deviations"
        search = [table_html(text_table("Descents", columns, rows))]
    loaded = [file for file in [data["calibration"]] if file is not None]
    sections = [
        Section("notes", "Notes", [bullets(data["notes"])]),
        Section("goals", "Goals and commands", inverse_html(result)),
        Section("pictures", "Pictures", pictures[1:]),
        Section("search", "Course of the search", search, folded=True),
        *closing("inverse", data, [data["source"]], files=loaded, options=options),
    ]
    verdict = inverse_verdict(result)
    of: dict[str, Any] = {"index": "inverse.json", "units": "SI"}
    if pictures:
        of["robot"] = pictures[0]
    return page(data["name"], "Inverse control", verdict, sections, **of)
