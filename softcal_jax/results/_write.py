"""Write a results folder: the results whole or not at all, then the bodies, too."""

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from softcal_jax._module import Result
from softcal_jax._places import replacing, with_remedy
from softcal_jax._text import SoftcalWarning
from softcal_jax.calibration import (
    CalibrationResult,
    SourceFile,
)
from softcal_jax.designs import DesignResult
from softcal_jax.fields import field_standard_errors
from softcal_jax.identifiability import Assessment, Ranking, assess
from softcal_jax.plotting import (
    PICTURES,
    plot_traces,
    render_configuration,
    rendering_problem,
)
from softcal_jax.project import Project, printed_project
from softcal_jax.readings import Traces
from softcal_jax.results._folder import file_stems, results_folder
from softcal_jax.results._html import (
    Html,
    figure,
    framed,
    head_html,
    node,
    page,
    picture,
    resource,
    section_html,
)
from softcal_jax.results._json import plain, result_dict, write_json
from softcal_jax.results._made import Made, closing, file_dict, made_dict
from softcal_jax.results._outline import ROLES
from softcal_jax.results._poses import csv_tables
from softcal_jax.results._sections import RESULT_KINDS, Bodies, sections
from softcal_jax.results._sweep import sweep_page_sections
from softcal_jax.results._tree import Section, write_csv
from softcal_jax.results._view import PageView, body_view
from softcal_jax.results._vtu import write_pvd, write_robot_vtu, write_vtu
from softcal_jax.sweeps import Sweep, SweepResult

REPORT = "report.html"  # name of the page in a results folder
_SWEEP = "Sweep"  # said on the page; an earlier page of a sweep is recognised by it
MOST_PICTURES = 3_400_000  # bytes of pictures; base64 adds a third, still below 5 MB
COLLECTION = "configurations.pvd"  # all configurations at once, for ParaView
Picture = Literal["png", "svg", "pdf"]
"""Formats of pictures. In SVG and PDF, lines and words are drawn, bodies are images."""

Progress = Callable[[int, int], None]
"""Called with the number of pictures drawn so far, and the number of all."""


class PictureWarning(SoftcalWarning):
    """Results were written, but without the pictures of the body."""


def write_results(
    result: Result,
    directory: str | Path,
    *,
    known: Assessment | Ranking | None = None,
    name: str = "",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: Made | Mapping[str, Made] | None = None,
    traces: Mapping[str, Traces] | None = None,
    project: Project | None = None,
    calibration: str | Path | None = None,
    options: Sequence[str] = (),
    notes: Sequence[str] = (),
    pictures: Picture | None = "png",
    progress: Progress = lambda *_: None,
) -> Path:
    """Write a result to a folder, whole or not at all.

    The folder holds `report.html`, a page for people that needs no other file; its
    numbers for programs (see `result_dict`; its `files` lists the others): of a
    calibration `result.json`, else `simulation.json`, `design.json`, `inverse.json`,
    `identifiability.json` or `comparison.json`; and, for each configuration with an
    equilibrium, a .vtu for ParaView and a picture; `configurations.pvd` opens all .vtu
    at once. `markers.csv` has points, `effectors.csv` other effectors, `robot.csv`
    rigid bodies, actuators and contacts, as far as there are any; the name of the
    picture of a recording over time ends with `_recording.png`. What has no bodies is
    there in words, as .txt. A calibration that did not converge is written too, marked
    as such. The results are there, as a whole, before .vtu and pictures are made.

    Args:
        result: The result.
        directory: The folder; it must be new or empty, or hold earlier results.
        known: What is known of it besides, see `sections`.
        name: Name of the result; by default its kind.
        force: Replace earlier results; files that a user added stay.
        timing_s: Wall time of further parts, added to those of the result [s].
        made: What it was computed from and with; of models that are compared by their
            names, in the order in which they were given. A calibration knows it.
        traces: Recordings of markers by configuration, as in a `Project`.
        project: The project that was designed: `project.toml` describes the robot as it
            is printed, see `printed_project`.
        calibration: The file of the values of a simulation or of inverse control.
        options: Further words of the command that repeats inverse control.
        notes: Doubts about the result.
        pictures: Format of all pictures; with None there are none, and the page has no
            view of the robot.
        progress: Called with the numbers of pictures drawn so far and of all.

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
    """
    if isinstance(result, CalibrationResult):
        known = known or assess(result)
        notes = *result.notes, *notes
    kind = RESULT_KINDS[type(result)]
    texts, shown = {}, kind.bodies(result)
    if isinstance(result, DesignResult):
        source = project and project.source
        made = Made(result.fit.model, {"loop": result.fit.settings}, source)
        printed = project and printed_project(project, result, Path(directory))
        texts = {"project.toml": printed} if printed else {}
    data = result_dict(
        result,
        known,
        name=name,
        timing_s=timing_s,
        made=made,
        directory=directory,
    )
    data["notes"] = notes
    if kind.command in ("simulate", "inverse"):
        values = calibration and SourceFile.of(Path(calibration))
        data["calibration"] = values and file_dict(values, directory)
    if shown is None:
        words = (str(part) for part in (name, result, known) if part)
        texts[f"{kind.file}.txt"] = "\n\n".join(words) + "\n"
    else:
        posed = [{"name": p.name, "role": p.role} for p in shown.configurations]
        posed = data.get("configurations", posed)
        data["configurations"] = [{**entry, "files": []} for entry in posed]
    tables = {} if shown is None else csv_tables(shown.configurations)
    tree = sections(result, known)
    ready = {s.key: section_html(s) for s in tree if s.title and s.charts}

    def write(folder: Path, view: PageView | None = None, bodies: Sequence[str] = ()):
        for file, content in texts.items():
            (folder / file).write_text(content, encoding="utf-8")
        for file, table in tables.items():
            write_csv(folder / file, table)
        data["files"] = [REPORT, *texts, *tables, *bodies]
        pictures = [] if shown is None else pictures_of(data, folder, view)
        every = [
            *(section for section in tree if not section.title),
            Section("notes", "Notes", tuple(data["notes"])),
            *(s for s in tree if s.title and not s.folded and s.key != "notes"),
            *(section for section, _ in pictures),
            *(section for section in tree if section.folded),
            *closing(kind.command, data, options=options),
        ]
        whole = page(
            data["name"],
            kind.words,
            every,
            index=f"{kind.file}.json",
            units="SI" if kind.command in ("design", "inverse") else "SI and mm",
            drawn=ready | {section.key: drawn for section, drawn in pictures},
            robot=view and view.content,
            script=view.script if view else "",
        )
        (folder / REPORT).write_text(whole, encoding="utf-8")
        write_json(folder / f"{kind.file}.json", data)

    with results_folder(directory, force=force) as folder:
        write(folder)
    if shown is None:
        return Path(directory)
    # No results are lost by what befalls the bodies, which take long and a larger disk.
    kept = f"{directory} holds the results, without pictures and files for ParaView"
    remedy = with_remedy(kept, "free disk space, and run this again")
    draw = partial(_write_bodies, suffix=pictures, progress=progress, traces=traces)
    try:
        with results_folder(directory, force=True) as folder, remedy:
            write(folder, *draw(folder, shown, data))
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{kept}.") from error
    return Path(directory)


def write_sweep(
    result: SweepResult,
    folder: str | os.PathLike[str],
    *,
    sweep: Sweep | None = None,
    timing_s: Mapping[str, float] | None = None,
) -> Path:
    """Write the page of a sweep beside its folder, whole or not at all.

    Trials that failed or did not converge are in no mean or chart. With `sweep`, the
    page also has settings, files with their SHA-256 and the command that repeats it.

    Args:
        result: The sweep, finished or not.
        folder: That of its rows; the page of `sweep` is `sweep_report.html`.
        sweep: The sweep file as it was loaded; None for a function of your own.
        timing_s: Wall time per part [s].

    Returns:
        The page.

    Raises:
        FileExistsError: If another file has the name of the page.
        OSError: If the page cannot be written.
    """
    path, folder = check_sweep_page(folder), Path(folder)
    made, files = None, []
    if sweep is not None:
        project = sweep.project
        made = Made(project.model, sweep.settings, project.source)
        files.append(file_dict(sweep.file, folder.parent))
    data = plain({**made_dict(made, folder.parent), "timing_s": timing_s or {}})
    data["files"] = [folder.name]
    tree = [*sweep_page_sections(result), *closing("sweep", data, files=files)]
    text = page(result.name, _SWEEP, tree, index=folder.name, units="SI")
    with replacing(path) as partial_file:
        partial_file.write_text(text, encoding="utf-8")
    return path


def check_sweep_page(folder: str | os.PathLike[str]) -> Path:
    """Raise unless the page of a sweep can be written; call it before a long run.

    Returns:
        Where it is written: beside the folder of the sweep.

    Raises:
        FileExistsError: If another file has the name of the page.
    """
    folder = Path(folder)
    folder = folder if folder.name else folder.absolute()
    path = folder.parent / f"{folder.name}_report.html"
    head = path.read_bytes()[:200_000] if path.is_file() else b""
    is_page = str(node("p", _SWEEP, class_="kind")).encode() in head
    if path.exists() and not is_page:
        raise FileExistsError(
            f"{path} is not a page of a sweep and would be overwritten. Move it away, "
            "or give the folder another name."
        )
    return path


def notebook_html(result: object) -> str:
    """Write a result as the output of a cell: all of its sections that are not folded.

    It is HTML that needs no other file, in the style of our pages, whatever that of the
    page around it is; `write_results` writes the whole page.

    Raises:
        TypeError: If there is no output for such a result.
    """
    tree = sections(result)
    style = Html(f"@scope (.softcal) {{\n{resource('page.css')}}}")
    content = (
        node("style", style),
        *head_html([section for section in tree if not section.title]),
        *(section_html(s) for s in tree if s and s.title and not s.folded),
    )
    plain = "background: #fff; color: #1a1a1a; padding: .5rem 1rem; max-width: 62rem"
    return node("div", *content, class_="softcal", style=plain)


def pictures_of(
    data: Mapping[str, Any], folder: Path, view: PageView | None
) -> list[tuple[Section, Html]]:
    """Show pictures of the configurations, as many as a page should hold.

    The view hides the pictures of what it shows, except in print or without scripts.
    """
    shown, hidden = [], []
    left = MOST_PICTURES - (0 if view is None else 3 * view.size // 4)  # as base64
    for entry in data["configurations"]:
        posed, role = entry["name"], ROLES.get(entry.get("role", ""), "simulated")
        for path in (folder / name for name in entry["files"]):
            if path.suffix not in PICTURES:
                continue
            caption = f"{posed} ({role}): the deformed body, coloured by displacement"
            is_recording = path.stem.endswith("_recording")
            if is_recording:
                caption = f"{posed}: the recording of the markers over time"
            left -= path.stat().st_size
            if left < 0 or path.suffix == ".pdf":  # which no page can show
                link = node("a", path.name, href=path.name)
                text = "this picture is a separate file, "
                drawn = node("p", f"{caption}; {text}", link, ".")
            else:
                drawn = figure(picture(path, caption), f"{caption}.")
            viewed = view is not None and posed in view.names and not is_recording
            shown.append(node("div", drawn, class_="viewed") if viewed else drawn)
            hidden.append(viewed)
    if not shown:
        return []
    section = Section("pictures", "Pictures")
    if not all(hidden):
        return [(section, framed(section, shown))]
    # No link leads to what the view hides.
    head = node("section", node("h2", section.title), *shown, class_="viewed")
    return [(section._replace(folded=True), head)]


def _write_bodies(
    folder: Path,
    result: Bodies,
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
    stems = file_stems([pose.name for pose in shown])
    moved = [stem for pose, stem in zip(shown, stems, strict=True) if pose.converged]
    problem = rendering_problem() if suffix and moved else None
    if problem is not None:
        left_out = ", ".join(f"{stem}.{suffix}" for stem in moved)
        problem = f"left out: {left_out}; {problem}"
        warnings.warn(problem, PictureWarning, stacklevel=3)  # before the work is done
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
            more = {"standard_errors": errors, "state": pose.robot}
            write_vtu(path, model, pose.displacement, **more)
            parts = model.mechanism.bodies.n_bodies + model.mechanism.n_actuators
            if pose.robot is not None and parts > 0:
                written.append(f"{stem}_robot.vtu")
                write_robot_vtu(folder / written[-1], model, pose.robot)
            bodies.append(list(written))
        if traces and pose.name in traces and suffix:
            written.append(f"{stem}_recording.{suffix}")
            plots[written[-1]] = partial(plot_traces, traces[pose.name], name=pose.name)
        if pose.converged and suffix and problem is None:
            written.append(f"{stem}.{suffix}")
            draw = partial(render_configuration, model, pose, converged=trusted)
            plots[written[-1]] = draw
    if bodies:
        write_pvd(folder / COLLECTION, bodies)
        files.append(COLLECTION)
    progress(0, len(plots))
    for done, (file, plot) in enumerate(plots.items(), start=1):
        plot(folder / file)
        progress(done, len(plots))
    files += [file for entry in data["configurations"] for file in entry["files"]]
    return None if suffix is None else body_view(result, errors), files
