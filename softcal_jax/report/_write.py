"""Write a results folder, whole or not at all."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from softcal_jax._typing import Float, HostArray
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.calibration import CalibrationResult, SimulationResult
from softcal_jax.configurations import Traces
from softcal_jax.export import (
    Made,
    comparison_dict,
    file_stems,
    outlook_dict,
    result_dict,
    results_folder,
    simulation_dict,
    write_effectors_csv,
    write_json,
    write_markers_csv,
    write_pvd,
    write_robot_csv,
    write_robot_vtu,
    write_vtu,
)
from softcal_jax.fields import field_standard_errors
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess
from softcal_jax.layouts import ModelComparison
from softcal_jax.plotting import (
    plot_traces,
    render_configuration,
    rendering_problem,
)
from softcal_jax.report._outlook_pages import comparison_page, identifiability_page
from softcal_jax.report._pages import REPORT, calibration_page, simulation_page
from softcal_jax.report._view import PageView, body_view

COLLECTION = "configurations.pvd"
"""All configurations at once, for ParaView."""


Picture = Literal["png", "svg"]
"""Formats of pictures. In SVG, lines and words are drawn and bodies are images."""

Told = Callable[[int, int], None]
"""Told how many pictures are drawn, of how many."""


class PictureWarning(SoftcalWarning):
    """Results were written, but without the pictures of the body."""


class Drawn(NamedTuple):
    """What is drawn.

    Attributes:
        suffix: Format of the pictures; None for no picture.
        traces: Recordings of markers by configuration.
        told: Called before the first picture and after each.
    """

    suffix: Picture | None
    traces: Mapping[str, Traces]
    told: Told


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
    told: Told = lambda *_: None,
) -> Path:
    """Write a calibration to a folder, whole or not at all.

    The folder holds `report.html`, a page for people that needs no other file;
    `result.json` (see `result_dict`; its `files` lists the others), `markers.csv` and,
    for each configuration, a .vtu for ParaView and a .png; `configurations.pvd` opens
    all .vtu at once. For a robot with other effectors, rigid bodies or actuators there
    are `effectors.csv` and `robot.csv`, too; of a recording of markers over time a
    picture that ends with `_recording.png`. With `pictures="svg"` all pictures end in
    .svg; with None there are none, and the page has no view of the robot. A calibration
    that did not converge is written too, marked as such. A configuration without an
    equilibrium has neither .vtu nor .png.

    Args:
        result: The calibration.
        directory: The folder; it must be new or empty, or hold earlier results.
        name: Name of the calibration.
        force: Replace earlier results; files that a user added stay.
        assessment: Assessment of the calibration, if known already.
        timing_s: Wall time of further parts, added to those of the result [s].
        traces: Recordings of markers by configuration, as in a `Project`.
        pictures: Format of the pictures, "png" or "svg"; None writes none.
        told: Called with how many pictures are drawn, of how many.

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
    """
    found = assessment or assess(result)
    more: dict[str, Any] = {"assessment": found, "timing_s": timing_s}
    data = result_dict(result, name=name, directory=directory, **more)
    return _write(
        result,
        data,
        Path(directory),
        "result.json",
        page=lambda data, *more: calibration_page(result, found, data, *more),
        force=force,
        drawn=Drawn(pictures, traces or {}, told),
    )


def write_simulation(
    result: SimulationResult,
    directory: str | Path,
    *,
    name: str = "simulation",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    traces: Mapping[str, Traces] | None = None,
    pictures: Picture | None = "png",
    told: Told = lambda *_: None,
    made: Made | None = None,
) -> Path:
    """Write a forward simulation to a folder, whole or not at all.

    The folder holds `report.html`, `simulation.json` (see `simulation_dict`) and, for
    each configuration with an equilibrium, a .vtu and a .png; the others are listed
    with the reason. `configurations.pvd`, `markers.csv`, `effectors.csv` and
    `robot.csv` are as of `write_results`, without measured values. Arguments and errors
    are those of `write_results`, and `made`, what it was computed from and with, for
    the command that repeats it; returns the folder.
    """
    more: dict[str, Any] = {"made": made, "directory": directory}
    data = simulation_dict(result, name=name, timing_s=timing_s, **more)
    return _write(
        result,
        data,
        Path(directory),
        "simulation.json",
        page=lambda data, *more: simulation_page(result, data, *more),
        force=force,
        drawn=Drawn(pictures, traces or {}, told),
    )


def write_identifiability(
    found: Identifiability | None,
    ranking: Ranking | None,
    directory: str | Path,
    *,
    name: str = "identifiability",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: Made | None = None,
) -> Path:
    """Write an identifiability result to a folder, whole or not at all.

    The folder holds `report.html`, `identifiability.json` (see `outlook_dict`) and the
    same in words, `identifiability.txt`. Further arguments and errors are those of
    `write_results`; returns the folder.

    Args:
        found: Result of the configurations; None if there are none.
        ranking: Ranking of the candidates; None if there are none.
        directory: The folder.
        name: Name of the project.
        force: Replace earlier results.
        timing_s: Wall time per part [s].
        made: What it was computed from and with, for the command that repeats it.
    """
    more: dict[str, Any] = {"made": made, "directory": directory}
    data = outlook_dict(found, ranking, name=name, timing_s=timing_s, **more)
    text = "\n\n".join(str(part) for part in (found, ranking) if part is not None)
    page = lambda data: identifiability_page(found, ranking, data)
    text = f"{name}\n\n{text}\n"
    return _write_words(data, "identifiability", text, page, directory, force=force)


def write_comparison(
    comparison: ModelComparison,
    directory: str | Path,
    *,
    name: str = "comparison",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
    made: Mapping[str, Made] | None = None,
) -> Path:
    """Write a comparison of models to a folder, whole or not at all.

    The folder holds `report.html`, `comparison.json` (see `comparison_dict`) and the
    same in words, `comparison.txt`. Further arguments and errors are those of
    `write_results`; returns the folder.

    Args:
        comparison: The comparison.
        directory: The folder.
        name: Its name.
        force: Replace earlier results.
        timing_s: Wall time per part [s].
        made: What each model was computed from and with, by its name, in the order in
            which they were given, for the command that repeats it.
    """
    more: dict[str, Any] = {"made": made, "directory": directory}
    data = comparison_dict(comparison, name=name, timing_s=timing_s, **more)
    page = lambda data: comparison_page(comparison, data)
    text = f"{comparison}\n"
    return _write_words(data, "comparison", text, page, directory, force=force)


def _write_words(
    data: dict[str, Any],
    stem: str,
    text: str,
    page: Callable[[Mapping[str, Any]], str],
    directory: str | Path,
    *,
    force: bool,
) -> Path:
    """Write a result without bodies: as a page, as text, and last as its index."""
    data["files"] = [REPORT, f"{stem}.txt"]
    with results_folder(directory, force=force) as folder:
        (folder / REPORT).write_text(page(data), encoding="utf-8")
        (folder / f"{stem}.txt").write_text(text, encoding="utf-8")
        write_json(folder / f"{stem}.json", data)
    return Path(directory)


Result = CalibrationResult | SimulationResult

Page = Callable[[Mapping[str, Any], Path, PageView | None], str]
"""Writes a page of the content of the index, the pictures in a folder and a view."""


def _write(
    result: Result,
    data: dict[str, Any],
    directory: Path,
    index: str,
    *,
    page: Page,
    force: bool,
    drawn: Drawn,
) -> Path:
    """Write all files, and last the index, which lists them."""
    shown = result.configurations
    stems = file_stems([own.name for own in shown])
    bodies = [stem for own, stem in zip(shown, stems, strict=True) if own.converged]
    problem = picture_problem(bodies, drawn.suffix)
    with results_folder(directory, force=force) as folder:
        files = _write_tables(folder, result)
        errors = _field_errors(result)
        files += _write_bodies(folder, result, data, errors)
        of_each = _pictures(result, drawn, bodies=problem is None)
        draw = [file for plots in of_each for file in plots.items()]
        drawn.told(0, len(draw))
        for done, (file, plot) in enumerate(draw, start=1):
            plot(folder / file)
            drawn.told(done, len(draw))
        for entry, plots in zip(data["configurations"], of_each, strict=True):
            entry["files"] += plots
            files += entry["files"]
        data["notes"] = [*data.get("notes", []), *([problem] if problem else [])]
        data["files"] = [REPORT, *files]
        view = None if drawn.suffix is None else body_view(result, errors)
        (folder / REPORT).write_text(page(data, folder, view), encoding="utf-8")
        write_json(folder / index, data)
    return directory


def picture_problem(stems: Sequence[str], suffix: Picture | None) -> str | None:
    """Say which pictures cannot be drawn here, why, and the remedy, and warn of it.

    Args:
        stems: Their names, without suffix.
        suffix: Format of the pictures; None if there are to be none.

    Returns:
        What it says; None if all can be drawn.
    """
    if suffix is None or not stems:
        return None
    problem = rendering_problem()
    if problem is None:
        return None
    said = f"left out: {', '.join(f'{stem}.{suffix}' for stem in stems)}; {problem}"
    warnings.warn(said, PictureWarning, stacklevel=4)  # before the work is done
    return said


def _write_tables(folder: Path, result: Result) -> list[str]:
    """Write the values of all configurations, and return the names of the files."""
    shown = result.configurations
    files = []
    if any(fit.points for fit in shown):
        write_markers_csv(folder / "markers.csv", shown)
        files.append("markers.csv")
    if any(fit.others for fit in shown):
        write_effectors_csv(folder / "effectors.csv", shown)
        files.append("effectors.csv")
    if any(own.robot is not None for own in shown):
        write_robot_csv(folder / "robot.csv", shown)
        files.append("robot.csv")
    return files


FieldErrors = Mapping[str, Float[HostArray, " n_tets"]]
"""Standard errors of fields in each tet."""


def _field_errors(result: Result) -> FieldErrors | None:
    """Compute the standard errors of what was calibrated; None for a simulation."""
    if not isinstance(result, CalibrationResult):
        return None
    own = result.space, result.z, result.budget.covariance
    return field_standard_errors(result.model, *own)


def _write_bodies(
    folder: Path, result: Result, data: dict[str, Any], errors: FieldErrors | None
) -> list[str]:
    """Write .vtu of every equilibrium, and list them in its entry of `data`."""
    model, shown = result.model, result.configurations
    bodies, stems = [], file_stems([own.name for own in shown])
    for own, entry, stem in zip(shown, data["configurations"], stems, strict=True):
        files = entry["files"] = []
        if not own.converged:
            continue
        files.append(f"{stem}.vtu")
        write_vtu(folder / files[-1], model, own.displacement, standard_errors=errors)
        if own.robot is not None:
            files.append(f"{stem}_robot.vtu")
            write_robot_vtu(folder / files[-1], model, own.robot)
        bodies.append(list(files))
    if not bodies:
        return []
    write_pvd(folder / COLLECTION, bodies)
    return [COLLECTION]


Plots = dict[str, Callable[[Path], None]]
"""What draws a picture, by the name of its file."""


def _pictures(result: Result, drawn: Drawn, *, bodies: bool) -> list[Plots]:
    """Return the pictures of each configuration.

    Those of a calibration that did not converge say so.
    """
    trusted = not isinstance(result, CalibrationResult) or result.converged
    fits, suffix = result.configurations, drawn.suffix
    if suffix is None:
        return [{} for _ in fits]
    of_each: list[Plots] = []
    for fit, stem in zip(fits, file_stems([fit.name for fit in fits]), strict=True):
        plots: Plots = {}
        if fit.name in drawn.traces:
            plots[f"{stem}_recording.{suffix}"] = partial(
                plot_traces, drawn.traces[fit.name], name=fit.name
            )
        if fit.converged and bodies:
            plots[f"{stem}.{suffix}"] = partial(
                render_configuration, result.model, fit, converged=trusted
            )
        of_each.append(plots)
    return of_each
