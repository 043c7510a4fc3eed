"""A calibration as one file: read, checked as a whole, ready to run."""

import dataclasses
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
from pydantic import ValidationError

from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    HistoryEntry,
    calibrate,
)
from softcal_jax.configurations import (
    Configuration,
    Registration,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.project._body import build_body, build_mesh, build_parameters
from softcal_jax.project._poses import build_pose
from softcal_jax.project._problems import (
    ProjectError,
    at,
    describe,
    one_by_one,
    suggestion,
)
from softcal_jax.project._schema import ConfigurationTable, ProjectTable


class Project(eqx.Module):
    """A project file as objects; everything in it has been checked.

    Attributes:
        name: Name of the project.
        path: The file it came from.
        model: The body, with the start values of the parameters.
        parameters: What is calibrated; may be empty for a simulation.
        calibration: Configurations that are fitted.
        validation: Configurations that are only predicted.
        noise: Where the noise comes from: "estimated" or "stated".
        settings: Settings of the calibration.
        newton: Settings of the equilibrium.
        registrations: How each camera frame was placed, by configuration; `rms` of
            each says how well.
    """

    name: str
    path: Path
    model: Model
    parameters: tuple[Parameter, ...]
    calibration: tuple[Configuration, ...]
    validation: tuple[Configuration, ...]
    noise: Literal["estimated", "stated"]
    settings: CalibrationSettings
    newton: NewtonSettings
    registrations: dict[str, Registration]

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All configurations, the fitted ones first."""
        return self.calibration + self.validation

    def check_calibration(self) -> None:
        """Checks that there is something to calibrate, and data to do it with.

        Raises:
            ProjectError: If parameters, fitted configurations or measurements are
                missing, which a simulation does not need.
        """
        problems = []
        if not self.parameters:
            problems.append("parameters: nothing to calibrate; add [[parameters]].")
        if not self.calibration:
            problems.append(
                'configurations: none has role = "calibration", so there is nothing '
                "to fit."
            )
        problems += [
            f"configurations.{c.name}: it has no `measured` positions."
            for c in self.configurations
            if c.measured is None
        ]
        if problems:
            raise one_by_one(self.path, problems)

    def calibrate(
        self, *, progress: Callable[[HistoryEntry], None] | None = None
    ) -> CalibrationResult:
        """Finds the parameters, then predicts the validation configurations.

        Args:
            progress: Called after the first evaluation and after each step.

        Returns:
            The result; `result.converged` says whether lambda_p vanished. Its notes
            hold how well the camera frames were registered.

        Raises:
            ProjectError: If there is nothing to calibrate.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_calibration()
        result = calibrate(
            self.model,
            self.parameters,
            self.calibration,
            validation=self.validation,
            noise=self.noise,
            settings=self.settings,
            newton=self.newton,
            progress=progress,
        )
        if not self.registrations:
            return result
        listed = ", ".join(
            f"{name} {1e3 * registration.rms:.2f} mm"
            for name, registration in self.registrations.items()
        )
        note = f"Camera frames registered to the mesh with an rms of: {listed}."
        return dataclasses.replace(result, notes=(*result.notes, note))

    def simulate(self) -> EquilibriumSolution:
        """Equilibria of all configurations with the start values.

        Returns:
            One lane per configuration, in the order of `configurations`;
            `check_converged` raises where one has no equilibrium.
        """
        lanes = configuration_arrays(self.model.mesh, self.configurations)
        return _simulate(self.model, lanes, self.newton)


@eqx.filter_jit
def _simulate(model, lanes, newton):
    solve = lambda lane: solve_equilibrium(model, lane, settings=newton)
    return jax.vmap(solve)(lanes)


def load_project(path: str | os.PathLike[str]) -> Project:
    """Reads a project file, builds all that it describes, and checks it.

    Nothing is solved. Paths in the file are relative to the file. The project file
    of `softcal_jax.robots.silicone_beam_path()` shows and explains all keys.

    Args:
        path: A TOML file.

    Returns:
        The project, ready for `calibrate` or `simulate`.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If anything in it is wrong: the text names each key, says what
            was expected, and suggests the near one.
        ValueError: If JAX is not in float64.
    """
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "a calibration needs float64, which is off: call "
            'jax.config.update("jax_enable_x64", True) at the start of the program.'
        )
    path = Path(path)
    table = _read(path)
    mesh = build_mesh(path, table)
    model = build_body(path, table.material, mesh)
    parameters = build_parameters(path, table.parameters, table.material)
    if parameters:
        with at(path, "parameters"):
            space = ParameterSpace(parameters)
            model = space.apply(model, space.start())
    poses = [build_pose(path, c, table.markers, mesh) for c in table.configurations]
    with at(path, "configurations"):
        configuration_arrays(mesh, [pose.configuration for pose in poses])
    of_role = lambda role: tuple(
        pose.configuration
        for pose, c in zip(poses, table.configurations, strict=True)
        if c.role == role
    )
    given = table.settings.model_dump(exclude={"noise"}, exclude_none=True)
    with at(path, "settings"):
        settings = CalibrationSettings(**given)
    with at(path, "newton"):
        newton = NewtonSettings(**table.newton.model_dump(exclude_none=True))
    return Project(
        name=table.name,
        path=path,
        model=model,
        parameters=parameters,
        calibration=of_role("calibration"),
        validation=of_role("validation"),
        noise=table.settings.noise,
        settings=settings,
        newton=newton,
        registrations={
            pose.configuration.name: pose.registration
            for pose in poses
            if pose.registration is not None
        },
    )


def _read(path: Path) -> ProjectTable:
    """The file as tables, with [shared] merged into each configuration."""
    if not path.exists():
        raise FileNotFoundError(f"project file {path} does not exist.")
    if not path.is_file():
        raise ProjectError(f"project file {path} is a directory; name the file in it.")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    shared = raw.get("shared", {})
    problems = _shared_problems(shared)
    if problems:
        raise one_by_one(path, problems)
    merged = {key: value for key, value in raw.items() if key != "shared"}
    if isinstance(raw.get("configurations"), list):
        merged["configurations"] = [
            _merged(shared, own) if isinstance(own, dict) else own
            for own in raw["configurations"]
        ]
    try:
        return ProjectTable.model_validate(merged)
    except ValidationError as error:
        raise one_by_one(path, describe(error, ProjectTable, raw)) from error


def _shared_problems(shared: Any) -> list[str]:
    """What does not belong into [shared]; its values are judged where they land."""
    if not isinstance(shared, dict):
        return [f"shared: got {shared!r}; expected a table [shared]."]
    known = [key for key in ConfigurationTable.model_fields if key != "name"]
    return [
        f"shared.{key}: unknown key.{suggestion(key, known)} Known here: "
        f"{', '.join(known)}."
        for key in shared
        if key not in known
    ]


def _merged(shared: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The own table on top of the shared one; tables in both are merged alike."""
    out = dict(shared)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = _merged(out[key], value) if both else value
    return out
