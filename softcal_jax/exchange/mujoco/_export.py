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
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange.mujoco._mjcf import Pose, mjcf
from softcal_jax.export import (
    check_results_folder,
    file_stems,
    results_folder,
    write_json,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.materials import (
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
)
from softcal_jax.report import LoadedResult, load_result


class MujocoExport(Module):
    """What was written for MuJoCo.

    Attributes:
        files: The file of each configuration, which is a keyframe there.
        result: Calibration of the model of MuJoCo, whose values the files have.
        lines: Values and predictions of both models, and notes.
    """

    files: dict[str, str]
    result: CalibrationResult
    lines: tuple[str, ...]


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
    project = formats.linear_project(loaded)
    model = model_for_law(project.model, law_for_mujoco(project.model.law))
    assert project.space is not None  # it has been calibrated
    at_rest = [np.zeros_like(model.mesh.points)] * len(project.configurations)
    every = project.configurations, at_rest
    mujoco_poses(model, project.space, loaded.z, *every)  # refused before the work
    refitted = formats.recalibrate(loaded, project, model, "MuJoCo", progress=progress)
    solved = formats.with_equilibrium(project, refitted)
    poses = mujoco_poses(refitted.model, refitted.space, refitted.z, *solved)
    lines = formats.lines_of_both(loaded, refitted, "MuJoCo")
    lines += ["", *formats.left_out(refitted, "MuJoCo")]
    lines.append(
        "Damping and time step only bring the body to rest: neither was calibrated, "
        "and motions take another time."
    )
    alike = len({_surroundings(pose) for pose in poses}) == 1
    stems = ["robot"] * len(poses) if alike else file_stems([p.name for p in poses])
    files = {pose.name: f"{stem}.xml" for pose, stem in zip(poses, stems, strict=True)}
    with results_folder(folder, force=force) as partial:
        written = sorted({*files.values()})
        for file in written:
            within = [pose for pose in poses if files[pose.name] == file]
            text = mjcf(project.name, refitted.model, within, lines)
            (partial / file).write_text(text, encoding="utf-8")
        index = {"format": "softcal_jax.mujoco/1", "configurations": files}
        write_json(partial / "robot.json", {**index, "files": written})
    return MujocoExport(files, refitted, tuple(lines))


def _surroundings(pose: Pose) -> bytes:
    """Return what the poses of one file have in common: supports and gravity."""
    lane = pose.lane
    parts = lane.fixed, lane.springs.coefficients(), lane.acceleration
    return b"".join(np.asarray(part).tobytes() for part in parts)


def law_for_mujoco(law: AbstractLaw) -> StVenantKirchhoff:
    """Return the law that a flex computes in place of another with E and nu.

    A ValueError says what to do if the law has other constants.
    """
    linear = StVenantKirchhoff, Corotational, ClassicalCorotational
    constants = law.elasticity if isinstance(law, linear) else law
    if isinstance(constants, NeoHookean | Isotropic):
        return StVenantKirchhoff(Isotropic(constants.E, constants.nu))
    name = type(law).__name__
    if constants is not law:
        name += f" with {type(constants).__name__}"
    raise ValueError(
        f"{name} has no counterpart in MuJoCo, whose flex has one law, with E and nu: "
        "calibrate an isotropic StVenantKirchhoff law or a NeoHookean one, and export "
        "that."
    )


def mujoco_poses(
    model: Model,
    space: ParameterSpace,
    z: Any,
    configurations: Sequence[Configuration],
    displacements: Sequence[Float[HostArray, "n_nodes 3"]],
) -> list[Pose]:
    """Return configurations with the fitted parameters, of scaled values `z`.

    A ValueError says why MuJoCo cannot hold a robot, support or displacement.
    """
    formats.check_no_bodies(model, "a model of MuJoCo")
    known = Cable, ForceActuator, SurfaceForceActuator
    holds = "cables without friction and forces of fixed direction"
    formats.check_actuators(model, known, f"MuJoCo; its models hold {holds}")
    if np.any(formats.vertex_masses(model) <= 0.0):
        raise ValueError(
            "parts of the body have no mass, and MuJoCo moves masses: give `density` "
            "in [material]."
        )
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism).arrays
    poses = []
    for i, (c, u) in enumerate(zip(configurations, displacements, strict=True)):
        _, lane = space.apply(model, lanes[i], z)
        if np.any(lane.imposed) or np.any(lane.springs.rest):
            raise ValueError(
                f"configuration {c.name!r}: a support that is moved is not written to "
                "MuJoCo, whose flex is at rest where it is built. Leave its "
                "displacement out."
            )
        moved = np.flatnonzero(lane.actuation.by_displacement)
        if moved.size:
            raise ValueError(
                f"configuration {c.name!r}: the displacement of the actuator "
                f"{lane.actuation.names[moved[0]]!r} is imposed, and controls of the "
                "model of MuJoCo are forces. Impose the force that the equilibrium "
                "has (robot.csv)."
            )
        poses.append(Pose(c.name, lane, u))
    return poses
