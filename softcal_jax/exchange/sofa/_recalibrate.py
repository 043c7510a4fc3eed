"""A calibration repeated with the mesh and the law that SOFA will run."""

from collections.abc import Callable
from dataclasses import replace

from softcal_jax.calibration import CalibrationResult, HistoryEntry, calibrate
from softcal_jax.equilibrium import Model, model_for_law
from softcal_jax.exchange.sofa._component import SofaLaw, law_for_sofa
from softcal_jax.exchange.sofa._plugin_elasticity import PluginElasticity
from softcal_jax.fields import exactly_known
from softcal_jax.materials import SofaRotation
from softcal_jax.project import Project, load_project
from softcal_jax.report import LoadedResult


class NotConvergedError(RuntimeError):
    """The model of SOFA could not be calibrated, so nothing is written."""


def linear_project(result: LoadedResult) -> Project:
    """Load the project of a result with linear tets in place of quadratic ones."""
    project = result.project
    if project.model.mesh.order == 1:
        return project
    changes = {**project.source.changes, "mesh.element": "linear"}
    return load_project(project.path, changes=changes)


def model_of_sofa(project: Project, law: SofaLaw, rotation: SofaRotation) -> Model:
    """Return the model of a linear project with the law that SOFA computes.

    Raises:
        ValueError: If SOFA has no counterpart of the law; the text says why.
    """
    model = project.model
    own = law_for_sofa(model.law, model.mesh, choice=law, rotation=rotation)
    assert project.space is not None  # it has been calibrated
    of_plugin = isinstance(getattr(own, "elasticity", None), PluginElasticity)
    if of_plugin and "mu_l" in project.space.field_names:
        raise ValueError(
            "mu_l is a parameter, but the plugin Anisotropy takes the shear modulus "
            "along the fibre from E_t; calibrate without it, and export that."
        )
    return model_for_law(model, own)


def recalibrate(
    result: LoadedResult,
    project: Project,
    model: Model,
    *,
    progress: Callable[[HistoryEntry], None] | None = None,
) -> CalibrationResult:
    """Fit the model of SOFA to the same measurements, from the calibrated values.

    Standard errors are left out: the values make up for the mesh, and belong to it.

    Args:
        result: The calibration.
        project: Its project with linear tets.
        model: The model of SOFA.
        progress: Called after the first evaluation and after each step.

    Raises:
        NotConvergedError: If the fit does not converge.
        RuntimeError: If a configuration has no equilibrium; the text names it.
    """
    assert project.space is not None  # it has been calibrated
    found = calibrate(
        model,
        project.space,
        project.calibration,
        validation=project.validation,
        noise=project.noise,
        uncertain=replace(exactly_known(), recordings=project.uncertain.recordings),
        precision=project.precision,
        settings=project.settings,
        newton=project.newton,
        start=result.z,
        intervals=None,
        progress=progress,
    )
    if not found.converged:
        raise NotConvergedError(
            f"the calibration of the model of SOFA did not converge after "
            f"{len(found.history) - 1} steps: "
            f"{' '.join(found.notes) or 'raise max_steps under [settings].'}"
        )
    return found
