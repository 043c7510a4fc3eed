"""The results folder, whole or not at all."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    RobotState,
    robot_states,
)
from softcal_jax.export import (
    file_stems,
    outlook_dict,
    result_dict,
    results_folder,
    simulation_dict,
    write_effectors_csv,
    write_json,
    write_markers_csv,
    write_robot_csv,
    write_robot_vtu,
    write_vtu,
)
from softcal_jax.identifiability import Identifiability, Ranking
from softcal_jax.plotting import (
    SensorFrame,
    plot_convergence,
    render_body,
    render_configuration,
    rendering_problem,
)


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
    and a .png; of a robot with other effectors, rigid bodies or actuators also
    `effectors.csv` and `robot.csv`. A calibration that did not converge is written too,
    and says so in all. A configuration without an equilibrium has neither .vtu nor
    .png.

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
        files = ["convergence.png", *_write_effectors(folder, data)]
        files += _write_robot(folder, data)
        plot_convergence(result, folder / "convergence.png", name=name)
        stems = file_stems([fit.name for fit in result.configurations])
        for fit, entry, stem in zip(
            result.configurations, data["configurations"], stems, strict=True
        ):
            entry["files"] = [f"{stem}.vtu"]
            write_vtu(folder / f"{stem}.vtu", result.model, fit.displacement)
            entry["files"] += _write_robot_vtu(folder, stem, result.model, fit.robot)
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
    the reason. Of a robot with rigid bodies or actuators also `robot.csv`.

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
    states = robot_states(model, configurations, solution)
    with results_folder(directory, force=force) as folder:
        stems = file_stems([configuration.name for configuration in configurations])
        for lane, (entry, stem) in enumerate(
            zip(data["configurations"], stems, strict=True)
        ):
            entry["files"] = []
            if not entry["converged"]:
                continue
            u = np.asarray(solution.displacement[lane])[: model.mesh.n_nodes]
            entry["files"].append(f"{stem}.vtu")
            write_vtu(folder / f"{stem}.vtu", model, u)
            entry["files"] += _write_robot_vtu(folder, stem, model, states[lane])
            if problem is None:
                entry["files"].append(f"{stem}.png")
                path = folder / f"{stem}.png"
                _render_simulated(model, u, entry, states[lane], path)
        data["notes"] = [problem] if problem else []
        data["files"] = [f for entry in data["configurations"] for f in entry["files"]]
        data["files"] += _write_robot(folder, data)
        write_json(folder / "simulation.json", data)
    return Path(directory)


def write_identifiability(
    found: Identifiability | None,
    ranking: Ranking | None,
    directory: str | Path,
    *,
    name: str = "identifiability",
    force: bool = False,
    timing_s: Mapping[str, float] | None = None,
) -> Path:
    """Write what data would tell to a folder, whole or not at all.

    The folder holds `identifiability.json` (see `outlook_dict`) and the same in words,
    `identifiability.txt`.

    Args:
        found: What the configurations tell; None if there are none.
        ranking: What candidates would add; None if there are none.
        directory: The folder; it must be new or empty, or hold earlier results.
        name: Name of the project.
        force: Replace earlier results; files that a user added stay.
        timing_s: Wall time per part [s].

    Returns:
        The folder.

    Raises:
        FileExistsError: If the folder has something in it, and `force` is off or it is
            not a results folder.
    """
    data = outlook_dict(found, ranking, name=name, timing_s=timing_s)
    text = "\n\n".join(str(part) for part in (found, ranking) if part is not None)
    with results_folder(directory, force=force) as folder:
        path = folder / "identifiability.txt"
        path.write_text(f"{name}\n\n{text}\n", encoding="utf-8")
        write_json(folder / "identifiability.json", {**data, "files": [path.name]})
    return Path(directory)


def _write_effectors(folder: Path, data: Mapping[str, Any]) -> list[str]:
    """Markers and other points, then the other effectors, if there are any."""
    files = []
    writers = {"markers": write_markers_csv, "effectors": write_effectors_csv}
    for key, write in writers.items():
        if any(entry[key] for entry in data["configurations"]):
            write(folder / f"{key}.csv", data)
            files.append(f"{key}.csv")
    return files


def _write_robot(folder: Path, data: Mapping[str, Any]) -> list[str]:
    """What rigid bodies, actuators and the ground do, if there are any."""
    if all(entry["robot"] is None for entry in data["configurations"]):
        return []
    write_robot_csv(folder / "robot.csv", data)
    return ["robot.csv"]


def _write_robot_vtu(
    folder: Path, stem: str, model: Model, state: RobotState | None
) -> list[str]:
    if state is None:
        return []
    write_robot_vtu(folder / f"{stem}_robot.vtu", model, state)
    return [f"{stem}_robot.vtu"]


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
    state: RobotState | None,
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
        robot=state,
        sensors=_sensors(entry),
    )


def _sensors(entry: Mapping[str, Any]) -> list[SensorFrame]:
    """Simulated poses of the 6-D sensors."""
    points = {m["name"]: 1e-3 * np.array(m["simulated_mm"]) for m in entry["markers"]}
    return [
        SensorFrame(
            points[own["name"]],
            Rotation.from_rotvec(own["simulated"]).as_matrix(),
        )
        for own in entry["effectors"]
        if own["is_turn"] and own["name"] in points
    ]
