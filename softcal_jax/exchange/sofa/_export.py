"""Export a calibrated robot as a scene of SOFA, calibrated again for it."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from softcal_jax._module import Module
from softcal_jax._names import unknown_name
from softcal_jax.calibration import CalibrationResult, HistoryEntry
from softcal_jax.equilibrium import Model, model_for_law
from softcal_jax.exchange._recalibrated import (
    left_out,
    linear_project,
    lines_of_both,
    recalibrate,
    vertex_masses,
    with_equilibrium,
)
from softcal_jax.exchange.sofa._component import (
    SCALES,
    PluginElasticity,
    SofaLaw,
    SofaRelease,
    SofaUnits,
    component_of,
    law_for_sofa,
)
from softcal_jax.exchange.sofa._configurations import check_robot, scene_configurations
from softcal_jax.exchange.sofa._write import Scene, write_scene
from softcal_jax.export import check_results_folder
from softcal_jax.materials import SofaRotation
from softcal_jax.project import Project
from softcal_jax.report import LoadedResult, load_result


class SofaExport(Module):
    """What was written for SOFA.

    Attributes:
        folder: The folder of the scene.
        release: The release that it is written for.
        component: The component that computes the law.
        calibrated: The calibration that was exported.
        result: Calibration of the model of SOFA, whose values the scene has.
        notes: What to know of the scene, in sentences.
    """

    folder: Path
    release: str
    component: str
    calibrated: LoadedResult
    result: CalibrationResult
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Write parameters, predictions and notes, line by line."""
        return "\n".join([*self.lines, "", *self.notes]).strip()

    @property
    def lines(self) -> list[str]:
        """The values of both models, and a table of what they predict."""
        return lines_of_both(self.calibrated, self.result, "SOFA")


def export_sofa(
    result: LoadedResult | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    release: SofaRelease = "v26.06",
    units: SofaUnits = "mm-kg-s",
    law: SofaLaw = "same",
    rotation: SofaRotation = "edge",
    force: bool = False,
    progress: Callable[[HistoryEntry], None] | None = None,
) -> SofaExport:
    """Write a calibrated robot as a static scene of SOFA, calibrated again for it.

    SOFA runs linear tets, which are too stiff, with a rotation of its own, so the
    calibrated moduli are not the ones that it needs. The model is therefore fitted once
    more to the same measurements, with the mesh and the law that SOFA will run, and its
    values are written.

    The folder holds `scene.py` for SofaPython3, `robot.vtk` (the linear mesh),
    `robot.json` (all numbers, in the units of the scene), and `README.md` with the
    command that runs it. The scene holds all configurations, follows their markers and
    compares them with what the model predicts.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        directory: The folder; it must be new or empty, or hold an earlier scene.
        release: Release of SOFA.
        units: Unit system of the scene.
        law: "same" writes the counterpart of the calibrated law; "corotational" takes
            SOFA's corotational tets for laws with the constants E and nu.
        rotation: Rotation of the corotational tets, see `SofaCorotational`; laws with a
            fibre take that of the plugin Anisotropy.
        force: Replace an earlier scene; files that a user added stay.
        progress: Called after each step of the calibration.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it holds
            something else.
        NotConvergedError: If the calibration for SOFA does not converge. Nothing is
            written then.
        RuntimeError: If a configuration has no equilibrium with the model of SOFA.
        ValueError: If an option is unknown, or the law, the robot or a support has no
            counterpart in SOFA; the text says why, and what to do.
    """
    for kind, name, known in (
        ("release", release, get_args(SofaRelease)),
        ("unit system", units, get_args(SofaUnits)),
        ("law", law, get_args(SofaLaw)),
    ):
        if name not in known:
            raise unknown_name(kind, name, known)
    scale = SCALES[units]
    folder = Path(directory)
    check_results_folder(folder, force=force)
    loaded = result if isinstance(result, LoadedResult) else load_result(result)
    project = linear_project(loaded)  # SOFA does not run quadratic tets
    check_robot(project.model)
    model = _model_of_sofa(project, law, rotation)
    component_of(model.law, model.n_tets, release, scale)  # before the work is done
    refitted = recalibrate(loaded, project, model, "SOFA", progress=progress)
    posed, displacements = with_equilibrium(project, refitted)
    scene = Scene(
        name=project.name,
        release=release,
        scale=scale,
        mesh=model.mesh,
        elasticity=component_of(refitted.model.law, model.n_tets, release, scale),
        vertex_mass=vertex_masses(refitted.model),
        configurations=scene_configurations(
            refitted.model, refitted.space, refitted.z, posed, displacements, scale
        ),
    )
    export = SofaExport(
        folder=folder,
        release=release,
        component=scene.elasticity.component,
        calibrated=loaded,
        result=refitted,
        notes=_notes(refitted, scene),
    )
    write_scene(folder, scene, text=export.lines, notes=export.notes, force=force)
    return export


def _model_of_sofa(project: Project, law: SofaLaw, rotation: SofaRotation) -> Model:
    """Return the model of a linear project with the law that SOFA computes."""
    model = project.model
    sofa_law = law_for_sofa(model.law, model.mesh, choice=law, rotation=rotation)
    assert project.space is not None  # it has been calibrated
    of_plugin = isinstance(getattr(sofa_law, "elasticity", None), PluginElasticity)
    if of_plugin and "mu_l" in project.space.field_names:
        raise ValueError(
            "mu_l is a parameter, but the plugin Anisotropy takes the shear modulus "
            "along the fibre from E_t; calibrate without it, and export that."
        )
    return model_for_law(model, sofa_law)


def _notes(refitted: CalibrationResult, scene: Scene) -> tuple[str, ...]:
    notes = left_out(refitted, "SOFA")
    others = [
        f"{effector.name} ({c.name})"
        for c in refitted.configurations
        for effector in c.others
    ]
    if others:
        notes.append(
            "Only points are followed; lengths, volumes and forces are not: "
            f"{', '.join(others)}."
        )
    if scene.elasticity.plugin == "Anisotropy":
        notes.append(
            "The plugin Anisotropy takes the shear modulus along the fibre from E_t, "
            "and its C13 is not that of the textbook: the values make up for both, and "
            "are no material constants."
        )
    return tuple(notes)
