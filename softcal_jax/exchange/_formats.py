"""What the formats share: what they cannot hold, poses, and calibrating once more."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import nan
from os import PathLike
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_estimate
from softcal_jax.actuators import AbstractActuator, CableSegments, free_rim_nodes
from softcal_jax.calibration import CalibrationResult, Watch
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace, exactly_known
from softcal_jax.materials import AbstractLaw, Isotropic, NeoHookean
from softcal_jax.project import Project, load_project
from softcal_jax.results import (
    LoadedResult,
    Section,
    Table,
    check_results_folder,
    load_result,
    text,
)

_ON_NODE = 1e-9  # weight below which a guide does not depend on a node [-]


def check_no_bodies(model: Model, format: str) -> None:
    """Raise ValueError if a robot has obstacles or rigid bodies."""
    contacts = model.mechanism.contacts
    names = ", ".join(contacts.touched)
    if names:
        what = "obstacles" if contacts.names else "itself"
        raise ValueError(
            f"the robot touches {what} ({names}), and contact is not written to "
            f"{format}. Take them out of the project, with what was measured while it "
            "touched them, and calibrate again."
        )
    names = ", ".join(model.mechanism.bodies.names)
    if names:
        raise ValueError(
            f"the robot has rigid bodies ({names}), which are not written "
            f"to {format}. A body that is held: name its nodes in `supports` instead. "
            "A plate that only carries markers: leave it out, give [markers] "
            "`max_distance` and `base_radius`, and calibrate again."
        )


def check_actuators(
    model: Model, known: Sequence[type[AbstractActuator]], format: str
) -> None:
    """Raise ValueError if an actuator is of no known type, or has friction."""
    actuators, kinds = model.mechanism.actuators, [actuator.kind for actuator in known]
    every = zip(actuators.names, actuators.kinds, actuators.has_friction, strict=True)
    for name, kind, rough in every:
        if rough or kind not in kinds:
            raise ValueError(
                f"the {kind.noun}{' with friction' * rough} {name!r} has no "
                f"counterpart in {format}. Take it out of the project."
            )


def check_rim(
    model: Model, configuration: ConfigurationArrays, actuator: int, format: str
) -> None:
    """Raise ValueError if the lid of a chamber presses on a rim that is not held."""
    actuators, fixed = model.mechanism.actuators, np.asarray(configuration.fixed)
    free = free_rim_nodes(actuators.groups, actuator, fixed)
    if free:
        raise ValueError(
            f"the chamber {actuators.names[actuator]!r}: the pressure on what seals it "
            f"acts on the rim of its opening, of which {free} nodes are not held, and "
            f"{format} has no lid. Hold the rim, or close the cavity in the mesh."
        )


def hooke_of(law: AbstractLaw) -> Isotropic | None:
    """Return E and nu of a law that has no other constants; None if it has."""
    constants = getattr(law, "elasticity", law)
    if isinstance(constants, NeoHookean | Isotropic):
        return Isotropic(constants.E, constants.nu)
    return None


def law_name(law: AbstractLaw) -> str:
    """Name a law and its elasticity, like "Corotational with Isotropic"."""
    parts = law, getattr(law, "elasticity", None)
    return " with ".join(type(part).__name__ for part in parts if part is not None)


class NotConvergedError(RuntimeError):
    """The model of another program could not be calibrated, so nothing is written."""


class ExportedPose(NamedTuple):
    """A configuration with fitted parameters, and displacements of the nodes [m]."""

    name: str
    lane: ConfigurationArrays
    effectors: Sequence[EffectorRecord]
    displacement: Float[HostArray, "n_nodes 3"]


def exported_poses(
    model: Model,
    space: ParameterSpace,
    z: Any,
    configurations: Sequence[Configuration],
    displacements: Sequence[Float[HostArray, "n_nodes 3"]] | None = None,
) -> list[ExportedPose]:
    """Set the parameters of configurations, by their scaled values `z`.

    Without displacements [m] they are at rest.
    """
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    if displacements is None:
        displacements = [np.zeros_like(model.mesh.points)] * len(configurations)
    set_lanes = [space.apply(model, lane, z)[1] for lane in lanes.arrays]
    names = [configuration.name for configuration in configurations]
    parts = zip(names, set_lanes, lanes.effectors, displacements, strict=True)
    return [ExportedPose(*part) for part in parts]


class Recalibration(NamedTuple):
    """The model of a program, calibrated for it, and what to say of it, in lines.

    The poses are those that have an equilibrium.
    """

    result: CalibrationResult
    poses: list[ExportedPose]
    lines: list[str]
    notes: list[str]


def linear_result(
    result: LoadedResult | str | PathLike[str], directory: Path, *, force: bool
) -> tuple[LoadedResult, Project]:
    """Load a result to be exported to a folder, and its project with linear tets."""
    check_results_folder(directory, force=force)
    loaded = result if isinstance(result, LoadedResult) else load_result(result)
    project = loaded.project
    if project.model.mesh.order == 1:
        return loaded, project
    changes = {**project.source.changes, "mesh.element": "linear"}
    return loaded, load_project(project.path, changes=changes)


def recalibrate(
    loaded: LoadedResult,
    project: Project,
    model: Model,
    program: str,
    watch: Watch | Literal[False] | None,
) -> Recalibration:
    """Fit the model of a program to the same measurements, from calibrated values.

    Standard errors are left out, since the values make up for errors of the mesh.

    Raises:
        NotConvergedError: If the calibration does not converge.
        RuntimeError: If no configuration has an equilibrium.
    """
    again = replace(
        project,
        model=model,
        uncertain=replace(exactly_known(), recordings=project.uncertain.recordings),
        registrations={},
        starts=None,
        seed=0,
        intervals=None,
    )
    refitted = again.calibrate(start=loaded.z, watch=watch)
    refitted = replace(refitted, source=None)  # its model is not that of the files
    if not refitted.converged:
        raise NotConvergedError(
            f"the calibration of the model of {program} did not converge after "
            f"{len(refitted.history) - 1} steps: "
            f"{' '.join(refitted.notes) or 'raise max_steps under [settings].'}"
        )
    solved = {c.name: c.displacement for c in refitted.configurations if c.converged}
    if not solved:
        raise RuntimeError(
            f"no configuration has an equilibrium in the model of {program}."
        )
    lost = ", ".join(c.name for c in refitted.configurations if not c.converged)
    left_out = f"Without an equilibrium in the model of {program}, and so left out: "
    posed = [c for c in project.configurations if c.name in solved]
    fitted = refitted.model, refitted.space, refitted.z
    return Recalibration(
        refitted,
        exported_poses(*fitted, posed, [np.asarray(solved[c.name]) for c in posed]),
        _lines_of_both(loaded, refitted, program),
        [f"{left_out}{lost}."] if lost else [],
    )


def _lines_of_both(
    calibrated: LoadedResult, refitted: CalibrationResult, program: str
) -> list[str]:
    """Write the values of both models, and a table of what they predict."""
    lines = []
    for fitted in refitted.parameters:
        values = calibrated.values[fitted.name], fitted.value
        before, now = (readable_estimate(value, nan, fitted.unit) for value in values)
        bound = " (on a bound: widen it, and calibrate again)" * fitted.at_bound
        lines.append(f"{fitted.name}: {before} calibrated, {now} for {program}{bound}")
    # How far points move, then errors of three models: the calibrated one, that of the
    # program with the same values, and that of the program calibrated itself.
    rows, fitted = [], calibrated.column("rms_after_mm")
    for c in refitted.configurations:
        errors = fitted[c.name], c.rms_before, c.rms_after
        rows.append((c.name, c.role, c.motion, *errors))
    heads = "configuration | role | motion [m] | calibrated model [m]"
    heads += f" | {program}, same values [m] | {program}, own values [m]"
    title = "Distances of points from where they were measured, rms"
    table = Table.of(title, heads, rows)
    return [*lines, "", text([Section("errors", "", (), (table,))])]


def cable_guides(
    model: Model, owner: int
) -> Iterator[tuple[Float[HostArray, "3"], Float[HostArray, " n_nodes"]]]:
    """Yield place at rest [m] and weights of nodes of each guide, 0 on the ground."""
    groups, points = model.mechanism.actuators.groups, model.mesh.points
    cables = (group for group in groups if isinstance(group, CableSegments))
    segments = next(group for group in cables if owner in np.asarray(group.owner))
    last = None
    for i in np.flatnonzero(np.asarray(segments.owner) == owner):
        ends = np.asarray(segments.weights[i]), np.asarray(segments.fixed[i])
        for share, ground in zip(*ends, strict=True):
            weights = np.zeros(len(points))
            np.add.at(weights, np.asarray(segments.nodes[i]), share)
            weights[np.abs(weights) < _ON_NODE] = 0.0
            point = weights @ points + ground
            if last is None or not np.allclose(point, last, rtol=1e-9):
                yield point, weights
            last = point


def vertex_masses(model: Model) -> Float[HostArray, " n_nodes"]:
    """Compute the mass of each node, a quarter of that of each of its tets [kg]."""
    density = np.broadcast_to(np.asarray(model.density), (model.n_tets,))
    mass = density[:, None] * np.asarray(model.node_volumes)
    nodes = model.mesh.tets.ravel()
    return np.bincount(nodes, mass.ravel(), model.mesh.n_nodes)
