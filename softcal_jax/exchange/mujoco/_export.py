"""Export a calibrated robot for MuJoCo, calibrated again for its flex."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import Cable, ForceActuator, SurfaceForceActuator
from softcal_jax.calibration import CalibrationResult, HistoryEntry
from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.equilibrium import Model, model_for_law
from softcal_jax.exchange._recalibrated import (
    left_out,
    linear_project,
    lines_of_both,
    recalibrate,
    vertex_masses,
    with_equilibrium,
)
from softcal_jax.exchange._refusals import check_actuators, check_no_bodies
from softcal_jax.exchange.mujoco._flex import law_for_mujoco
from softcal_jax.exchange.mujoco._mjcf import Pose, mjcf
from softcal_jax.export import (
    check_results_folder,
    file_stems,
    results_folder,
    write_json,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.report import LoadedResult, load_result


class MujocoExport(Module):
    """What was written for MuJoCo.

    Attributes:
        folder: The folder of the model.
        files: The file of each configuration, which is a keyframe there.
        calibrated: The calibration that was exported.
        result: Calibration of the model of MuJoCo, whose values the files have.
        notes: What to know of the model, in sentences.
    """

    folder: Path
    files: dict[str, str]
    calibrated: LoadedResult
    result: CalibrationResult
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Write parameters, predictions and notes, line by line."""
        return "\n".join([*self.lines, "", *self.notes]).strip()

    @property
    def lines(self) -> list[str]:
        """The values of both models, and a table of what they predict."""
        return lines_of_both(self.calibrated, self.result, "MuJoCo")


def export_mujoco(
    result: LoadedResult | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[HistoryEntry], None] | None = None,
) -> MujocoExport:
    """Write a calibrated robot as a model of MuJoCo, calibrated again for it.

    MuJoCo's flex has linear tets, which are too stiff, with the St. Venant-Kirchhoff
    law. The model is therefore fitted once more to the same measurements with both, and
    its values are written. In SI.

    The folder holds `robot.xml` with a keyframe per configuration, its controls and
    equilibrium; or a file per configuration if their gravity or supports differ.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        directory: The folder; it must be new or empty, or hold an earlier model.
        force: Replace an earlier model; files that a user added stay.
        progress: Called after each step of the calibration.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it holds
            something else.
        NotConvergedError: If the calibration for MuJoCo does not converge. Nothing is
            written then.
        RuntimeError: If no configuration has an equilibrium with MuJoCo's law.
        ValueError: If the law, the robot or a support has no counterpart in MuJoCo; the
            text says why, and what to do.
    """
    folder = Path(directory)
    check_results_folder(folder, force=force)
    loaded = result if isinstance(result, LoadedResult) else load_result(result)
    project = linear_project(loaded)
    model = model_for_law(project.model, law_for_mujoco(project.model.law))
    check_robot(model)
    assert project.space is not None  # it has been calibrated
    at_rest = [np.zeros_like(model.mesh.points)] * len(project.configurations)
    posed = project.configurations
    mujoco_poses(model, project.space, loaded.z, posed, at_rest)  # refuses early
    refitted = recalibrate(loaded, project, model, "MuJoCo", progress=progress)
    posed = with_equilibrium(project, refitted)
    poses = mujoco_poses(refitted.model, refitted.space, refitted.z, *posed)
    files = _files(poses)
    export = MujocoExport(
        folder=folder,
        files=files,
        calibrated=loaded,
        result=refitted,
        notes=(*left_out(refitted, "MuJoCo"), _ON_DAMPING),
    )
    with results_folder(folder, force=force) as partial:
        for file in set(files.values()):
            alike = [pose for pose in poses if files[pose.name] == file]
            text = mjcf(project.name, refitted.model, alike, str(export).split("\n"))
            (partial / file).write_text(text, encoding="utf-8")
        index = {"format": "softcal_jax.mujoco/1", "configurations": files}
        names = sorted(set(files.values()))
        write_json(partial / "robot.json", {**index, "files": names})
    return export


_ON_DAMPING = (
    "Damping and time step only bring the body to rest: neither was calibrated, and "
    "motions take another time."
)


def check_robot(model: Model) -> None:
    """Raise ValueError unless MuJoCo can hold the body and what is attached to it."""
    check_no_bodies(model, "a model of MuJoCo")
    known = Cable, ForceActuator, SurfaceForceActuator
    holds = "cables without friction and forces of fixed direction"
    check_actuators(model, known, f"MuJoCo; its models hold {holds}")
    if np.any(vertex_masses(model) <= 0.0):
        raise ValueError(
            "parts of the body have no mass, and MuJoCo moves masses: give `density` "
            "in [material]."
        )


def mujoco_poses(
    model: Model,
    space: ParameterSpace,
    z: Any,
    configurations: Sequence[Configuration],
    displacements: Sequence[Float[HostArray, "n_nodes 3"]],
) -> list[Pose]:
    """Return configurations with the fitted parameters, of scaled values `z`.

    Raises:
        ValueError: If MuJoCo cannot hold a support or an imposed displacement.
    """
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism).arrays
    poses = []
    for i, (c, u) in enumerate(zip(configurations, displacements, strict=True)):
        _, lane = space.apply(model, lanes[i], z)
        if np.any(np.asarray(lane.imposed)) or np.any(np.asarray(lane.springs.rest)):
            raise ValueError(
                f"configuration {c.name!r}: a support that is moved is not written to "
                "MuJoCo, whose flex is at rest where it is built. Leave its "
                "displacement out."
            )
        moved = np.flatnonzero(np.asarray(lane.actuation.by_displacement))
        for actuator in moved:
            kind = model.mechanism.actuators.kinds[actuator].noun
            raise ValueError(
                f"configuration {c.name!r}: the displacement of the {kind} "
                f"{lane.actuation.names[actuator]!r} is imposed, and controls of the "
                "model of MuJoCo are forces. Impose the force that the equilibrium "
                "has (robot.csv)."
            )
        poses.append(Pose(c.name, lane, u))
    return poses


def _files(poses: Sequence[Pose]) -> dict[str, str]:
    """Return the file of each pose: one for all, if supports and gravity are alike."""
    of_body = [
        (pose.lane.fixed, pose.lane.springs.coefficients(), pose.lane.acceleration)
        for pose in poses
    ]
    first, names = of_body[0], [pose.name for pose in poses]
    alike = all(
        np.array_equal(a, b)
        for other in of_body
        for a, b in zip(first, other, strict=True)
    )
    stems = ["robot"] * len(poses) if alike else file_stems(names)
    return {name: f"{stem}.xml" for name, stem in zip(names, stems, strict=True)}
