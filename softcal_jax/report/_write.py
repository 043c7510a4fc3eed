"""Write a results folder: the results whole or not at all, then the bodies, too."""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from softcal_jax import export
from softcal_jax._places import with_remedy
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.calibration import CalibrationResult, SimulationResult, SourceFile
from softcal_jax.configurations import Traces
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.fields import field_standard_errors
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess
from softcal_jax.layouts import ModelComparison
from softcal_jax.plotting import plot_traces, render_configuration, rendering_problem
from softcal_jax.project import Project, printed_project
from softcal_jax.report import _pages
from softcal_jax.report._charts import budget_chart, course_charts, error_charts
from softcal_jax.report._goals import commanded, design_dict
from softcal_jax.report._view import PageView, body_view

COLLECTION = "configurations.pvd"  # all configurations at once, for ParaView
Picture = Literal["png", "svg", "pdf"]
"""Formats of pictures. In SVG and PDF, lines and words are drawn, bodies are images."""

Progress = Callable[[int, int], None]
"""Called with the number of pictures drawn so far, and the number of all."""


class PictureWarning(SoftcalWarning):
    """Results were written, but without the pictures of the body."""


def write_results(
    result: CalibrationResult,
    directory: str | Path,
    *,
    name: str = "calibration",
    force: bool = False,
    assessment: Assessment | None = None,
    timing_s: Mapping[str, float] | None = None,
    traces: Mapping[str, Traces] | None = None,
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
) -> Path:
    """Write a calibration to a folder, whole or not at all.

    The folder holds `report.html`, a page for people that needs no other file;
    `result.json` (see `result_dict`; its `files` lists the others), `markers.csv` and,
    for each configuration with an equilibrium, a .vtu for ParaView and a picture;
    `configurations.pvd` opens all .vtu at once. For a robot with other effectors, rigid
    bodies or actuators there are `effectors.csv` and `robot.csv`, too; for a recording
    of markers over time, a picture whose name ends with `_recording.png`. A calibration
    that did not converge is written too, marked as such. The results are there, as
    a whole, before .vtu and pictures are made.

    Args:
        result: The calibration.
        directory: The folder; it must be new or empty, or hold earlier results.
        name: Name of the calibration.
        force: Replace earlier results; files that a user added stay.
        assessment: Assessment of the calibration, if known already.
        timing_s: Wall time of further parts, added to those of the result [s].
        traces: Recordings of markers by configuration, as in a `Project`.
        pictures: Format of all pictures; with None there are none, and the page has no
            view of the robot.
        progress: Called with the numbers of pictures drawn so far and of all.

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
    """
    assessment = assessment or assess(result)
    data = export.result_dict(
        result, name=name, directory=directory, assessment=assessment, timing_s=timing_s
    )
    errors = error_charts(result.configurations)
    charts = errors, budget_chart(result), course_charts(result)
    page = partial(_pages.calibration_page, result, assessment, charts)
    drawn = {"traces": traces, "suffix": pictures, "progress": progress}
    return _write(result, data, directory, page, force=force, **drawn)


def write_simulation(
    result: SimulationResult,
    directory: str | Path,
    *,
    name: str = "simulation",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    traces: Mapping[str, Traces] | None = None,
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
    made: export.Made | None = None,
    calibration: str | Path | None = None,
) -> Path:
    """Write a forward simulation to a folder, whole or not at all.

    The folder holds `report.html`, `simulation.json` (see `simulation_dict`) and, for
    each configuration with an equilibrium, a .vtu and a .png; the page says why others
    have none. `configurations.pvd`, `markers.csv`, `effectors.csv` and `robot.csv` are
    as in `write_results`. Arguments, errors and what is returned are those of
    `write_results`; `made`, what the simulation was computed from and with, and
    `calibration`, the file of the values it took, give the command that repeats it.
    """
    data = export.simulation_dict(
        result, name=name, timing_s=timing_s, made=made, directory=directory
    )
    values = None if calibration is None else SourceFile.of(Path(calibration))
    data["calibration"] = values and export.file_dict(values, directory)
    page = partial(_pages.simulation_page, result)
    drawn = {"traces": traces, "suffix": pictures, "progress": progress}
    return _write(result, data, directory, page, force=force, **drawn)


def write_design(
    result: DesignResult,
    directory: str | Path,
    *,
    name: str = "design",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
    project: Project | None = None,
) -> Path:
    """Write a design to a folder, whole or not at all.

    The folder holds `report.html`, `design.json` and the files of the bodies, as in
    `write_simulation`; and, if the `project` that was designed is given, `project.toml`
    for the robot as it is printed, see `printed_project`. Other arguments, errors and
    what is returned are those of `write_results`.
    """
    posed = [replace(pose, role="design") for pose in result.fit.configurations]
    shown = SimulationResult(result.fit.model, tuple(posed))
    source = None if project is None else project.source
    made = export.Made(result.fit.model, {"loop": result.fit.settings}, source)
    data = export.simulation_dict(
        shown, name=name, timing_s=timing_s, made=made, directory=directory
    )
    data |= {"format": "softcal_jax.design/1", "design": design_dict(result)}
    printed = lambda project: printed_project(project, result, Path(directory))
    texts = {} if project is None else {"project.toml": printed(project)}
    page = partial(_pages.design_page, result)
    drawn = {"suffix": pictures, "progress": progress, "texts": texts}
    return _write(shown, data, directory, page, force=force, **drawn)


def write_identifiability(
    outlook: Identifiability | None,
    ranking: Ranking | None,
    directory: str | Path,
    *,
    name: str = "identifiability",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: export.Made | None = None,
) -> Path:
    """Write an identifiability result to a folder, whole or not at all.

    The folder holds `report.html`, `identifiability.json` (see `outlook_dict`) and the
    same in words, `identifiability.txt`. `outlook` is None if there are no
    configurations, `ranking` if there are no candidates. Further arguments, errors and
    what is returned are those of `write_simulation`.
    """
    data = export.outlook_dict(
        outlook, ranking, name=name, timing_s=timing_s, made=made, directory=directory
    )
    text = "\n\n".join(str(p) for p in (name, outlook, ranking) if p is not None)
    page = lambda data, *_: _pages.identifiability_page(outlook, ranking, data)
    texts = {"identifiability.txt": f"{text}\n"}
    return _write(None, data, directory, page, force=force, texts=texts)


def write_comparison(
    comparison: ModelComparison,
    directory: str | Path,
    *,
    name: str = "comparison",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: Mapping[str, export.Made] | None = None,
) -> Path:
    """Write a comparison of models to a folder, whole or not at all.

    The folder holds `report.html`, `comparison.json` (see `comparison_dict`) and the
    same in words, `comparison.txt`. `made` is what each model was computed from and
    with, by its name, in the order in which they were given. Further arguments, errors
    and what is returned are those of `write_simulation`.
    """
    data = export.comparison_dict(
        comparison, name=name, timing_s=timing_s, made=made, directory=directory
    )
    page = lambda data, *_: _pages.comparison_page(comparison, data)
    texts = {"comparison.txt": f"{comparison}\n"}
    return _write(None, data, directory, page, force=force, texts=texts)


def write_inverse(
    result: InverseResult | TrajectoryResult,
    directory: str | Path,
    *,
    name: str = "inverse",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: export.Made | None = None,
    calibration: str | Path | None = None,
    options: Sequence[str] = (),
    notes: Sequence[str] = (),
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
) -> Path:
    """Write a result of inverse control to a folder, whole or not at all.

    The folder holds `report.html`, `inverse.json` (see `inverse_dict`) and the files of
    the bodies, as in `write_simulation`, with circles where the goals are. With
    `calibration`, the `result.json` that the model was loaded from, the page gives the
    command that repeats the run; `options` are further words of it, like "--goal" and
    its value, and `notes` are doubts about the result. A trajectory has at least one
    point. Other arguments, errors and what is returned are those of `write_results`.
    """
    points = [result] if isinstance(result, InverseResult) else result.points
    names = [f"goal {i}" for i in range(1, len(points) + 1)]
    names = ["command"] if len(points) == 1 else names
    data = export.inverse_dict(
        result, name=name, timing_s=timing_s, made=made, directory=directory
    )
    poses = tuple(map(commanded, points, names))
    data["configurations"] = [{"name": pose.name, "role": pose.role} for pose in poses]
    data["notes"] = notes
    loaded = None if calibration is None else SourceFile.of(Path(calibration))
    data["calibration"] = loaded and export.file_dict(loaded, directory)
    shown = SimulationResult(points[0].model, poses)
    page = partial(_pages.inverse_page, result, options)
    drawn = {"suffix": pictures, "progress": progress}
    return _write(shown, data, directory, page, force=force, **drawn)


Result = CalibrationResult | SimulationResult


def _write(
    result: Result | None,
    data: dict[str, Any],
    directory: str | Path,
    page: Callable[[Mapping[str, Any], Path, PageView | None], str],
    *,
    force: bool,
    texts: Mapping[str, str] | None = None,
    **drawn: Any,
) -> Path:
    """Write the results, and then once more with the files of the bodies.

    So no results are lost by what befalls those, which take long and a larger disk.
    `texts` are files by name; `drawn` says how the bodies of a result are drawn.
    """
    kept = f"{directory} holds the results, without pictures and files for ParaView"
    index = re.split("[./]", data["format"])[1] + ".json"  # softcal_jax.result/2

    def write(folder: Path, view: PageView | None = None, bodies: Sequence[str] = ()):
        files = [_pages.REPORT, *(texts or ())]
        for file, text in (texts or {}).items():
            (folder / file).write_text(text, encoding="utf-8")
        if result is not None:
            files += export.write_csv(folder, result.configurations)
        data["files"] = [*files, *bodies]
        (folder / _pages.REPORT).write_text(page(data, folder, view), encoding="utf-8")
        export.write_json(folder / index, data)

    data.setdefault("notes", [])
    for entry in data["configurations"] if result is not None else ():
        entry["files"] = []
    with export.results_folder(directory, force=force) as folder:
        write(folder)
    if result is None:
        return Path(directory)
    again = with_remedy(kept, "free disk space, and run this again")
    try:
        with export.results_folder(directory, force=True) as folder, again:
            write(folder, *_write_bodies(folder, result, data, **drawn))
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{kept}.") from error
    return Path(directory)


def _write_bodies(
    folder: Path,
    result: Result,
    data: dict[str, Any],
    *,
    suffix: Picture | None,
    progress: Progress,
    traces: Mapping[str, Traces] | None = None,
) -> tuple[PageView | None, list[str]]:
    """Write bodies and pictures; return the view, and the names of the files.

    The configurations of `data` get theirs; its notes say which pictures are left out.
    """
    model, shown = result.model, result.configurations
    stems = export.file_stems([pose.name for pose in shown])
    moved = [stem for pose, stem in zip(shown, stems, strict=True) if pose.converged]
    problem = rendering_problem() if suffix and moved else None
    if problem is not None:
        left_out = ", ".join(f"{stem}.{suffix}" for stem in moved)
        problem = f"left out: {left_out}; {problem}"
        warnings.warn(problem, PictureWarning, stacklevel=4)  # before the work is done
    data["notes"] = [*data["notes"], *([problem] if problem else [])]
    trusted = not isinstance(result, CalibrationResult) or result.converged
    errors, files, bodies = None, [], []
    if isinstance(result, CalibrationResult):
        estimate = result.space, result.z, result.budget.covariance
        errors = field_standard_errors(model, *estimate)
    plots: dict[str, Callable[[Path], None]] = {}
    for pose, entry, stem in zip(shown, data["configurations"], stems, strict=True):
        entry["files"] = written = []
        if pose.converged:
            written.append(f"{stem}.vtu")
            path = folder / written[-1]
            export.write_vtu(path, model, pose.displacement, standard_errors=errors)
            if pose.robot is not None:
                written.append(f"{stem}_robot.vtu")
                export.write_robot_vtu(folder / written[-1], model, pose.robot)
            bodies.append(list(written))
        if traces and pose.name in traces and suffix:
            written.append(f"{stem}_recording.{suffix}")
            plots[written[-1]] = partial(plot_traces, traces[pose.name], name=pose.name)
        if pose.converged and suffix and problem is None:
            written.append(f"{stem}.{suffix}")
            draw = partial(render_configuration, model, pose, converged=trusted)
            plots[written[-1]] = draw
    if bodies:
        export.write_pvd(folder / COLLECTION, bodies)
        files.append(COLLECTION)
    progress(0, len(plots))
    for done, (file, plot) in enumerate(plots.items(), start=1):
        plot(folder / file)
        progress(done, len(plots))
    files += [file for entry in data["configurations"] for file in entry["files"]]
    return None if suffix is None else body_view(result, errors), files
