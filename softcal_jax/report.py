"""The results folder and the tables for the terminal."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import EquilibriumSolution, Model
from softcal_jax.export import (
    file_stems,
    readable_estimate,
    readable_unit,
    result_dict,
    results_folder,
    simulation_dict,
    write_json,
    write_markers_csv,
    write_vtu,
)
from softcal_jax.plotting import (
    plot_convergence,
    render_body,
    render_configuration,
    rendering_problem,
)

if TYPE_CHECKING:
    import rich.console
    import rich.table


class PictureWarning(UserWarning):
    """Results were written, but without the pictures of the body."""


def write_results(
    result: CalibrationResult,
    directory: str | Path,
    *,
    name: str = "calibration",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
) -> Path:
    """Write a calibration to a folder, whole or not at all.

    The folder holds `result.json` (see `result_dict`; its `files` lists the others),
    `markers.csv`, `convergence.png` and, for each configuration, a .vtu for ParaView
    and a .png. A calibration that did not converge is written too, and says so in all.
    A configuration without an equilibrium has neither .vtu nor .png.

    Args:
        result: The calibration.
        directory: The folder; it must be new or empty, or hold earlier results.
        name: Name of the calibration.
        force: Replace earlier results; files that a user added stay.
        timing_s: Wall time of more parts, added to those of the result [s].

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder has something in it, and `force` is off or it is
            not a results folder.
    """
    data = result_dict(result, name=name, timing_s=timing_s)
    problem = _picture_problem()
    with results_folder(directory, force=force) as folder:
        files = ["convergence.png", "markers.csv"]
        plot_convergence(result, folder / "convergence.png", name=name)
        write_markers_csv(folder / "markers.csv", data)
        stems = file_stems([fit.name for fit in result.configurations])
        for fit, entry, stem in zip(
            result.configurations, data["configurations"], stems, strict=True
        ):
            entry["files"] = [f"{stem}.vtu"]
            write_vtu(folder / f"{stem}.vtu", result.model, fit.displacement)
            if problem is None:
                entry["files"].append(f"{stem}.png")
                render_configuration(
                    result.model,
                    fit,
                    folder / f"{stem}.png",
                    converged=result.converged,
                )
            files += entry["files"]
        data["notes"] += [problem] if problem else []
        write_json(folder / "result.json", {**data, "files": files})
    return Path(directory)


def write_simulation(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
    directory: str | Path,
    *,
    name: str = "simulation",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
) -> Path:
    """Write a forward simulation to a folder, whole or not at all.

    The folder holds `simulation.json` (see `simulation_dict`) and, for each
    configuration with an equilibrium, a .vtu and a .png; the others are listed with
    the reason.

    Args:
        model: The body.
        configurations: What was simulated.
        solution: Their equilibria, one lane per configuration.
        directory: The folder; it must be new or empty, or hold earlier results.
        name: Name of the simulation.
        force: Replace earlier results; files that a user added stay.
        timing_s: Wall time per part [s].

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder has something in it, and `force` is off or it is
            not a results folder.
    """
    data = simulation_dict(
        model, configurations, solution, name=name, timing_s=timing_s
    )
    problem = _picture_problem()
    with results_folder(directory, force=force) as folder:
        stems = file_stems([configuration.name for configuration in configurations])
        for lane, (entry, stem) in enumerate(
            zip(data["configurations"], stems, strict=True)
        ):
            entry["files"] = []
            if not entry["converged"]:
                continue
            u = np.asarray(solution.displacement[lane])
            entry["files"].append(f"{stem}.vtu")
            write_vtu(folder / f"{stem}.vtu", model, u)
            if problem is None:
                entry["files"].append(f"{stem}.png")
                _render_simulated(model, u, entry, folder / f"{stem}.png")
        data["notes"] = [problem] if problem else []
        data["files"] = [f for entry in data["configurations"] for f in entry["files"]]
        write_json(folder / "simulation.json", data)
    return Path(directory)


def summary_table(result: CalibrationResult) -> "rich.console.Group":
    """A calibration as tables for the terminal, to be printed by `rich`.

    Args:
        result: The calibration.

    Returns:
        Verdict, parameters, configurations and notes.
    """
    from rich.console import Group
    from rich.text import Text

    steps = len(result.history) - 1
    if result.converged:
        verdict = Text(f"Converged in {steps} steps.", style="bold green")
    else:
        verdict = Text(
            f"NOT CONVERGED after {steps} steps: do not use these values.",
            style="bold white on red",
        )
    parts: list[Any] = [_parameter_table(result), _configuration_table(result), verdict]
    parts += [Text(f"Note: {note}", style="yellow") for note in result.notes]
    return Group(*parts)


def simulation_table(data: Mapping[str, Any]) -> "rich.table.Table":
    """A forward simulation as a table for the terminal, to be printed by `rich`.

    Args:
        data: What `simulation_dict` returns.

    Returns:
        One line per configuration; one without an equilibrium gives the reason.
    """
    table = _table(
        "Simulation", "configuration", ["largest displacement", "Newton steps"]
    )
    table.add_column("outcome")
    for entry in data["configurations"]:
        largest = entry["largest_displacement_mm"]
        table.add_row(
            _plain(entry["name"]),
            _plain("-" if largest is None else f"{largest:.2f} mm"),
            _plain(str(entry["newton_steps"])),
            _plain(entry["outcome"], "green" if entry["converged"] else "bold red"),
        )
    return table


def _picture_problem() -> str | None:
    """Why there will be no pictures; known, and said, before the work is done."""
    problem = rendering_problem()
    if problem is not None:
        warnings.warn(problem, PictureWarning, stacklevel=3)
    return problem


def _render_simulated(
    model: Model,
    u: Float[HostArray, "n_nodes 3"],
    entry: Mapping[str, Any],
    path: Path,
) -> None:
    markers = [marker["simulated_mm"] for marker in entry["markers"]]
    render_body(
        model,
        u,
        path,
        title=entry["name"],
        subtitle=f"simulated; moves by up to {entry['largest_displacement_mm']:.2f} mm",
        simulated=1e-3 * np.array(markers) if markers else None,
        marker_names=[marker["name"] for marker in entry["markers"]],
    )


def _parameter_table(result: CalibrationResult) -> "rich.table.Table":
    table = _table("Parameters", "parameter", ["value ± std. error", "start", "bounds"])
    for q in result.parameters:
        text = readable_estimate(q.value, q.standard_error, q.unit)
        if q.at_bound:
            text += " (on a bound)"
        factor, unit = readable_unit([q.value], q.unit)
        bounds = f"{q.lower * factor:.4g} to {q.upper * factor:.4g} {unit}"
        style = "bold" if result.converged and not q.at_bound else "bold red"
        table.add_row(
            _plain(q.name),
            _plain(text, style),
            _plain(f"{q.start * factor:.4g} {unit}".rstrip()),
            _plain(bounds.rstrip()),
        )
    return table


def _configuration_table(result: CalibrationResult) -> "rich.table.Table":
    table = _table(
        "Rms distance of the markers",
        "configuration",
        ["role", "before", "after", "moved", "after/moved"],
    )
    for entry in result_dict(result)["configurations"]:
        percent = entry["rms_after_percent_of_motion"]
        table.add_row(
            _plain(entry["name"]),
            _plain(entry["role"]),
            _plain(_distance(entry["rms_before_mm"])),
            _plain(_distance(entry["rms_after_mm"]), "bold"),
            _plain(f"{entry['motion_mm']:.2f} mm"),
            _plain("-" if percent is None else f"{percent:.1f} %"),
        )
    return table


def _distance(millimetres: float | None) -> str:
    return "-" if millimetres is None else f"{millimetres:.2f} mm"


def _table(title: str, first: str, columns: Sequence[str]) -> "rich.table.Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="left" if column == "role" else "right")
    return table


def _plain(text: str, style: str = "") -> Any:
    """Text as it stands: a name like "[a]" is no markup."""
    from rich.text import Text

    return Text(text, style=style)
