"""Load a project file, and warn of guesses and of what is probably a slip of a unit."""

import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._process import check_process
from softcal_jax._text import check_unique
from softcal_jax.calibration import ProjectSource
from softcal_jax.configurations import (
    build_mechanism,
    configuration_arrays,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import check_parameters
from softcal_jax.mesh import TetMesh, mesh_files
from softcal_jax.project._design import Posed, build_configuration, build_design
from softcal_jax.project._plausible import (
    ProjectWarning,
    check_bearable,
    implausible,
)
from softcal_jax.project._project import Project
from softcal_jax.project._reading import (
    MeshTables,
    ProjectTable,
    read_schema,
    read_tables,
    values_in,
)
from softcal_jax.project._sensors import build_effectors
from softcal_jax.project._setup import build_space
from softcal_jax.project._table import (
    WholeFile,
    WrongKeyError,
    in_file,
    one_by_one,
    under,
)


def load_project(
    path: str | os.PathLike[str],
    *,
    changes: Mapping[str, Any] | None = None,
    solve: bool = True,
) -> Project:
    """Read a project file, build all that it describes, and check it.

    Nothing is solved. Paths in the file are relative to the file. The commented file
    `softcal_jax.robots.ready_made_path("beam")` explains the keys.

    Args:
        path: A TOML file.
        changes: Values that replace those of the file, written as in it, by key:
            {"material.E": "200 kPa"}. An entry of a list goes by its name, whatever
            dots that has: "parameters.E.lower", "configurations.1.5 bar.role". A new
            name with a dot stands in double quotes. None removes a key.
        solve: Whether a solver is prepared. Without, a project is read faster, can be
            looked at, and raises RuntimeError where it is solved.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If anything in it is wrong; the text names each key, says what
            was expected and suggests the closest match.
        ValueError: If float64 is off in JAX.
        RuntimeError: If this process was forked from one that had computed.

    Warns:
        ProjectWarning: If a density, gravity, load or measured point is hard to
            believe, or the file has guesses of `softcal new` that are not confirmed.
    """
    check_process()
    path = Path(path)
    table = read_tables(path, changes)
    with in_file(path):
        project = _built(path, table, changes, solve=solve)
        posed = {f"configurations.{c.name}": c for c in project.configurations}
        posed |= {f"candidates.{c.name}": c for c in project.candidates}
        check_bearable(project.model, posed)
    if changes is None:  # a sweep would repeat it for each of its changes
        lines = [*implausible(project.model, posed)]
        guesses = len(guesses_left(path))
        if guesses:
            lines.append(
                f"{guesses} line{'s hold' if guesses > 1 else ' holds'} a guess that "
                "nobody has confirmed, of `softcal new`: what is found with them means "
                f'little. They have a remark "{CHANGE}..."; `softcal check` lists them.'
            )
        for line in lines:
            warnings.warn(f"{path}: {line}", ProjectWarning, stacklevel=2)
    return project


def load_mesh(path: str | os.PathLike[str]) -> TetMesh:
    """Make the mesh of a project file with its groups; the rest may be missing.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If anything in [mesh] or [groups] is wrong.
    """
    path = Path(path)
    table = read_schema(path, MeshTables, "project file")
    with in_file(path):
        return _mesh(path.parent, table)


def _built(
    path: Path, table: ProjectTable, changes: Mapping[str, Any] | None, *, solve: bool
) -> Project:
    """Build the project, reporting errors under the key they belong to."""
    solver = table.newton.solver if solve else "none"
    model, space = _model(path, table, solver), build_space(table)
    if space is not None:
        with under("parameters"):
            check_parameters(model, space)
            start = {q.name: q.start for q in space.parameters}
            model, _ = space.with_values(model, None, start)
    posed, candidates = _configurations(table, model)
    with_role = list(zip(posed, table.configurations, strict=True))
    goals = tuple(c for (c, _), row in with_role if row.goal is not None)
    of_role = lambda role: tuple(
        c for (c, _), row in with_role if row.role == role and row.goal is None
    )
    with under("design"):
        asked = build_design(table, goals)
    with under("settings"):
        settings = table.settings.build()
    with under("newton"):
        newton = table.newton.build()
    of_project = {"noise", "starts", "seed", "precision", "intervals"}
    return Project(
        name=table.name,
        path=path,
        model=model,
        space=space,
        calibration=of_role("calibration"),
        validation=of_role("validation"),
        candidates=tuple(c for c, _ in candidates),
        asked=asked,
        **table.settings.model_dump(include=of_project),
        uncertain=table.uncertain.build(),
        settings=settings,
        newton=newton,
        source=ProjectSource.of(path, _files(table), changes),
        registrations={
            c.name: seen.registration for c, seen in posed if seen.registration
        },
        traces={c.name: seen.traces for c, seen in posed if seen.traces},
    )


def _model(path: Path, table: ProjectTable, solver: str | None) -> Model:
    """Build the model; each body and each actuator is checked under its own key."""
    mesh, problems = _mesh(path.parent, table), []
    bodies, actuators = [], []
    for name, body in table.bodies.items():
        with under(f"bodies.{name}"):
            bodies.append(body.build(name))
            # A tied body needs the other ones, so it is checked below with them.
            if bodies[-1].tied_to is None:
                build_mechanism(mesh, bodies[-1:])
    with under("bodies"):
        build_mechanism(mesh, bodies)
    for name, actuator in table.actuators.items():
        try:
            with under(f"actuators.{name}"):
                actuators.append(actuator.build(name))
                build_mechanism(mesh, bodies, actuators[-1:], at_rest=False)
        except WrongKeyError as error:
            problems.append(str(error))
    if problems:
        raise one_by_one(path, problems)
    with under("actuators"):
        build_mechanism(mesh, bodies, actuators, at_rest=False)
    shapes = {}
    for name, shape in table.shapes.items():
        with under(f"shapes.{name}"):
            shapes[name] = shape.build(mesh)
    with under("material"):
        density = table.material.values("density", mesh)
        assert density is not None  # which every law has
        return build_model(
            mesh,
            table.material.build(mesh, table.mesh.tet_data),
            density=density,
            bodies=bodies,
            actuators=actuators,
            formulation=table.material.formulation,
            contact_scale=table.material.contact_scale,
            touching=table.material.touching,
            touching_reach=table.material.touching_reach,
            solver=solver,
            shapes=shapes,
        )


def _mesh(folder: Path, table: WholeFile) -> TetMesh:
    """Make the mesh and its groups, in the order of the file."""
    with under("mesh"):
        mesh = table.mesh.build(folder)
    for name, group in table.groups.items():
        with under(f"groups.{name}"):
            mesh = group.add(mesh, name)
    return mesh


def _configurations(
    table: ProjectTable, model: Model
) -> tuple[list[Posed], list[Posed]]:
    with under("effectors"):
        effectors = build_effectors(table.effectors, model.mesh, model.mechanism)
    posed: dict[str, list[Posed]] = {"configurations": [], "candidates": []}
    for key, built in posed.items():
        for pose in getattr(table, key):
            with under(f"{key}.{pose.name}"):
                built.append(build_configuration(pose, table, model, effectors))
        with under(key):
            if built:
                every = [configuration for configuration, _ in built]
                configuration_arrays(model.mesh, every, model.mechanism)
    with under("candidates"):
        every = [pose.name for pose in (*table.configurations, *table.candidates)]
        check_unique("configuration or candidate", every)
    return posed["configurations"], posed["candidates"]


def _files(table: ProjectTable) -> Mapping[Path, None]:
    """Return all files that are named, and those that an Abaqus file includes."""
    named = (file for _, file in values_in(table) if isinstance(file, Path))
    return dict.fromkeys(file for path in named for file in mesh_files(path))


CHANGE = "# CHANGE: "
"""How the remark on a guess begins, at the end of its line or on the line before."""

_GUESS = re.compile(rf"(?P<text>.*?)\s*{CHANGE}(?P<remark>.+)")


class Guess(NamedTuple):
    """A line of a project file, from 1, and the remark on what is to be confirmed."""

    line: int
    text: str
    remark: str


def guesses_left(path: str | os.PathLike[str]) -> tuple[Guess, ...]:
    """List the lines of a project file that still have the remark of a guess."""
    lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    return tuple(
        Guess(n, match["text"].strip(), match["remark"].strip())
        for n, line in enumerate(lines, start=1)
        if (match := _GUESS.match(line))
    )
