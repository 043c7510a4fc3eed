"""The folder of an inverse run: page, JSON, bodies and pictures."""

from collections.abc import Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softcal_jax.calibration import SourceFile
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.equilibrium import robot_states
from softcal_jax.export import (
    Made,
    file_dict,
    file_stems,
    inverse_dict,
    results_folder,
    write_json,
    write_pvd,
    write_robot_vtu,
    write_vtu,
)
from softcal_jax.plotting import render_body
from softcal_jax.report._html import Html, Section, bullets, page, table_html
from softcal_jax.report._inverse import (
    attempts_table,
    inverse_html,
    inverse_verdict,
)
from softcal_jax.report._pages import REPORT, shown_pictures
from softcal_jax.report._provenance import closing, files_of
from softcal_jax.report._write import COLLECTION, Picture, Told, picture_problem


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
    told: Told = lambda *_: None,
) -> Path:
    """Write a result of inverse control to a folder, whole or not at all.

    The folder holds `report.html`, `inverse.json` (see `inverse_dict`) and for each
    goal that has an equilibrium a .vtu for ParaView and a picture, with circles where
    the goals are. `configurations.pvd` opens all .vtu at once. Further arguments and
    errors are those of `write_results`.

    Args:
        result: The command, or those along a trajectory.
        directory: The folder.
        name: Its name.
        force: Replace earlier results.
        timing_s: Wall time per part [s].
        made: What it was computed from and with.
        calibration: The `result.json` that the model was loaded from; the page then
            gives the command that repeats it.
        options: Further words of that command, like "--goal" and its value.
        notes: What there is to doubt, for the page.
        pictures: Format of the pictures, "png" or "svg"; None writes none.
        told: Called with how many pictures are drawn, of how many.

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
        ValueError: If a trajectory has no points.
    """
    points = [result] if isinstance(result, InverseResult) else list(result.points)
    if not points:
        raise ValueError("the trajectory has no goals, so there is nothing to write.")
    more: dict[str, Any] = {"made": made, "directory": directory}
    data = inverse_dict(result, name=name, timing_s=timing_s, **more)
    names = ["command"]
    if len(points) > 1:
        names = [f"goal {i}" for i in range(1, len(points) + 1)]
    stems = file_stems(names)
    solved = [bool(point.solution.converged) for point in points]
    problem = picture_problem(list(compress(stems, solved)), pictures)
    data["notes"] = [*notes, *([problem] if problem else [])]
    own = None if calibration is None else SourceFile.of(Path(calibration))
    data["calibration"] = own and file_dict(own, directory)
    suffix = None if problem else pictures
    files, bodies, captions = [], [], {}
    with results_folder(directory, force=force) as folder:
        told(0, len(points))
        for k, (point, title, stem) in enumerate(
            zip(points, names, stems, strict=True)
        ):
            if solved[k]:
                written = _write_body(folder, point, stem, title, suffix)
                captions |= dict.fromkeys(written, f"{title}: {_SEEN}")
                files += written
                bodies.append([file for file in written if file.endswith(".vtu")])
            told(k + 1, len(points))
        if bodies:
            write_pvd(folder / COLLECTION, bodies)
            files.insert(0, COLLECTION)
        data["files"] = [REPORT, *files]
        shown = shown_pictures(captions, folder)
        text = _page(result, data, shown, options)
        (folder / REPORT).write_text(text, encoding="utf-8")
        write_json(folder / "inverse.json", data)
    return Path(directory)


_SEEN = (
    "the body at the commands found, coloured by displacement, with the goals "
    "(circles) and what is reached (crosses)"
)
"""What a picture shows."""


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


def _page(
    result: InverseResult | TrajectoryResult,
    data: Mapping[str, Any],
    pictures: Sequence[Html],
    options: Sequence[str],
) -> str:
    search = []
    if isinstance(result, InverseResult) and result.attempts:
        search = [table_html(attempts_table(result))]
    loaded, source = data["calibration"], data["source"]
    files = [] if source is None else files_of(source)
    words = []
    if loaded is not None:
        words, files = ["inverse", loaded["file"], *options], [loaded, *files]
    sections = [
        Section("notes", "Notes", [bullets(data["notes"])]),
        Section("goals", "Goals and commands", inverse_html(result)),
        Section("pictures", "Pictures", pictures),
        Section("search", "Course of the search", search),
        *closing(data, words, files=files),
    ]
    verdict = inverse_verdict(result)
    of = {"index": "inverse.json", "units": "SI"}
    return page(data["name"], "Inverse control", verdict, sections, **of)
