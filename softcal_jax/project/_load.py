"""From a project file to a project."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from softcal_jax.calibration import CalibrationSettings
from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import check_parameters
from softcal_jax.project._body import build_body, build_mesh
from softcal_jax.project._effectors import build_effectors
from softcal_jax.project._mechanism import build_parts
from softcal_jax.project._parameters import build_space
from softcal_jax.project._poses import Pose, Robot, build_pose
from softcal_jax.project._problems import at
from softcal_jax.project._project import Project
from softcal_jax.project._reading import read_tables
from softcal_jax.project._schema import ProjectTable


def load_project(
    path: str | os.PathLike[str], *, changes: Mapping[str, Any] | None = None
) -> Project:
    """Reads a project file, builds all that it describes, and checks it.

    Nothing is solved. Paths in the file are relative to the file. The project file
    of `softcal_jax.robots.silicone_beam_path()` shows and explains the keys.

    Args:
        path: A TOML file.
        changes: Values that take the place of those in the file, as it would write
            them, by their key: {"material.E": "200 kPa"}. An entry of a list goes by
            its name, "parameters.E.lower"; None takes a key out.

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
    table = read_tables(path, changes)
    mesh = build_mesh(path, table)
    model = build_body(path, table, mesh, build_parts(path, table, mesh))
    space = build_space(path, table)
    if space is not None:
        with at(path, "parameters"):
            check_parameters(model, space)
            model = space.model_at(model, space.start())
    poses, candidates = _poses(path, table, model)
    of_role = lambda role: tuple(
        pose.configuration
        for pose, c in zip(poses, table.configurations, strict=True)
        if c.role == role
    )
    given = table.settings.model_dump(
        exclude={"noise", "starts", "seed", "intervals"}, exclude_none=True
    )
    with at(path, "settings"):
        settings = CalibrationSettings(**given)
    with at(path, "newton"):
        given = table.newton.model_dump(exclude={"solver"}, exclude_none=True)
        newton = NewtonSettings(**given)
    return Project(
        name=table.name,
        path=path,
        model=model,
        space=space,
        calibration=of_role("calibration"),
        validation=of_role("validation"),
        candidates=tuple(candidates),
        noise=table.settings.noise,
        starts=table.settings.starts,
        intervals=table.settings.intervals,
        seed=table.settings.seed,
        settings=settings,
        newton=newton,
        files=_files(path, table),
        registrations={
            pose.configuration.name: pose.registration
            for pose in poses
            if pose.registration is not None
        },
    )


def _poses(
    path: Path, table: ProjectTable, model: Model
) -> tuple[list[Pose], list[Configuration]]:
    """The configurations, and the candidates."""
    mesh = model.mesh
    robot = Robot(
        table.markers,
        table.effectors,
        build_effectors(path, table.effectors, mesh, model.mechanism),
        mesh,
        model.mechanism,
    )
    pose = lambda own: build_pose(path, own, robot)
    poses = [pose(c) for c in table.configurations]
    candidates = [pose(c).configuration for c in table.candidates]
    known = [pose.configuration for pose in poses]
    for key, posed in (("configurations", known), ("candidates", candidates)):
        if posed:
            with at(path, key):
                configuration_arrays(mesh, posed, model.mechanism)
    with at(path, "candidates"):
        _check_new(known, candidates)
    return poses, candidates


def _files(path: Path, table: ProjectTable) -> tuple[Path, ...]:
    """The file, and those that it names."""
    names = [table.mesh.file]
    for configuration in table.configurations:
        measured = configuration.measured
        if measured is not None:
            readings = measured.effectors.values()
            names += [measured.file, *(getattr(r, "file", None) for r in readings)]
    named = dict.fromkeys(name for name in names if name is not None)
    return (path, *(path.parent / name for name in named))


def _check_new(known: list[Configuration], candidates: list[Configuration]) -> None:
    names = {configuration.name for configuration in known}
    for candidate in candidates:
        if candidate.name in names:
            raise ValueError(
                f"{candidate.name!r} is a configuration already; give the candidate a "
                "name of its own."
            )
