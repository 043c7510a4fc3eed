"""From the tables of a project file to configurations with measured positions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    AbstractLoad,
    Configuration,
    EdgeForce,
    Markers,
    Mechanism,
    PointForce,
    Registration,
    Support,
    SurfaceForce,
    SurfaceTraction,
    read_markers,
    register,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._actuation import build_actuation, build_states
from softcal_jax.project._effectors import Effectors, with_measured
from softcal_jax.project._problems import at, known_name, suggestion
from softcal_jax.project._schema_effectors import EffectorTable
from softcal_jax.project._schema_poses import (
    CandidateTable,
    ConfigurationTable,
    GravityTable,
    LoadTable,
    MarkerEntry,
    MarkersTable,
    MeasuredTable,
)


class Pose(NamedTuple):
    """A configuration, and what its camera frame left at the registered markers."""

    configuration: Configuration
    registration: Registration | None


class Robot(NamedTuple):
    """What all configurations share.

    Attributes:
        markers: All markers of the project.
        effector_tables: Its effectors, as the file has them.
        effectors: The same as objects, not measured.
        mesh: The mesh, which knows the groups.
        mechanism: Rigid bodies and actuators.
    """

    markers: MarkersTable | None
    effector_tables: Mapping[str, EffectorTable]
    effectors: Effectors
    mesh: TetMesh
    mechanism: Mechanism


def build_pose(path: Path, table: CandidateTable, robot: Robot) -> Pose:
    """One posed robot, with its measurement if it has one.

    Args:
        path: The project file, for messages and as the base of relative paths.
        table: The configuration or candidate, with [shared] merged in.
        robot: What all configurations share.

    Raises:
        ProjectError: If a group, a marker, a file or a value in it is wrong.
    """
    measurable = isinstance(table, ConfigurationTable)
    key = f"{'configurations' if measurable else 'candidates'}.{table.name}"
    supports, loads = _held_and_loaded(path, key, table, robot.mesh)
    with at(path, f"{key}.markers"):
        chosen = _markers(robot.markers, table.markers)
    effectors = _chosen_effectors(path, key, table, robot)
    mechanism = robot.mechanism
    actuation = build_actuation(
        path, f"{key}.actuation", table.actuation, mechanism, table.name
    )
    states = build_states(path, f"{key}.bodies", table.bodies, mechanism)
    measured = registration = None
    own = table.measured if isinstance(table, ConfigurationTable) else None
    if own is not None and own.file is not None:
        with at(path, f"{key}.measured"):
            measured, registration = _measured(path.parent, own, robot.markers, chosen)
    followed = with_measured(
        path,
        f"{key}.measured.effectors",
        effectors,
        {} if own is None else own.effectors,
        robot.effector_tables,
        mechanism,
    )
    with at(path, key):
        return Pose(
            Configuration(
                table.name,
                supports,
                _gravity(table),
                loads,
                chosen,
                measured,
                followed,
                states,
                actuation,
            ),
            registration,
        )


def _held_and_loaded(
    path: Path, key: str, table: CandidateTable, mesh: TetMesh
) -> tuple[tuple[Support, ...], tuple[AbstractLoad, ...]]:
    supports, loads = [], []
    for i, support in enumerate(table.supports, start=1):
        with at(path, f"{key}.supports[{i}]"):
            mesh.nodes(support.group)  # names a group that is not there
            supports.append(Support(support.group, support.axes, support.displacement))
    for i, load in enumerate(table.loads, start=1):
        with at(path, f"{key}.loads[{i}]"):
            loads.append(_load(load))
            loads[-1].nodal_forces(mesh)  # names a place that is not there
    return tuple(supports), tuple(loads)


def _chosen_effectors(
    path: Path, key: str, table: CandidateTable, robot: Robot
) -> Effectors:
    """The effectors of one configuration; all of the project if it names none."""
    if table.effectors is None:
        return robot.effectors
    with at(path, f"{key}.effectors"):
        for name in table.effectors:
            known_name("effector", name, robot.effectors, "effectors")
    return {name: robot.effectors[name] for name in table.effectors}


def _gravity(table: CandidateTable) -> tuple[float, float, float]:
    if not isinstance(table.gravity, GravityTable):
        return table.gravity
    x, y, z = (table.gravity.size * v for v in table.gravity.direction)
    return x, y, z


def _load(table: LoadTable) -> AbstractLoad:
    if table.point is not None and table.force is not None:
        return PointForce(table.point, table.force)
    if table.edge is not None and table.force is not None:
        return EdgeForce(table.edge, table.force)
    if table.surface is not None and table.force is not None:
        return SurfaceForce(table.surface, table.force)
    if table.surface is not None and table.traction is not None:
        return SurfaceTraction(table.surface, table.traction)
    raise AssertionError("the schema asks for one of the four")


def _positions(
    table: MarkersTable | None, names: Sequence[str]
) -> Float[HostArray, "n_markers 3"]:
    """Nominal positions of some markers [m]."""
    if table is None:
        raise ValueError("the project has no markers; add a table [markers].")
    rows = []
    for name in names:
        if name not in table.positions:
            raise ValueError(
                f"unknown marker {name!r}.{suggestion(name, table.positions)} "
                f"Known: {', '.join(table.positions)}."
            )
        entry = table.positions[name]
        rows.append(entry.position if isinstance(entry, MarkerEntry) else entry)
    return np.array(rows, float).reshape(-1, 3)


def _markers(
    table: MarkersTable | None, names: tuple[str, ...] | None
) -> Markers | None:
    """The markers of one configuration; all of the project if it names none."""
    if names is None:
        if table is None:
            return None
        names = tuple(table.positions)
    positions = _positions(table, names)
    if table is None or not names:
        raise ValueError("the list of markers is empty; leave it out to use all.")
    own = [table.positions[name] for name in names]
    std = [(e.std if isinstance(e, MarkerEntry) else None) or table.std for e in own]
    return Markers(
        names,
        positions,
        np.array(std),
        table.axes,
        table.max_distance,
        table.base_radius,
    )


def _measured(
    folder: Path,
    table: MeasuredTable,
    nominal: MarkersTable | None,
    markers: Markers | None,
) -> tuple[Float[HostArray, "n_markers 3"], Registration | None]:
    """Measured positions in the frame of the mesh [m].

    With `displacement_from`, the nominal position plus the motion between the two
    states, so that where exactly a marker was glued does not matter.
    """
    if markers is None:
        raise ValueError("the project has no markers; add a table [markers].")

    def read(select):
        return read_markers(
            folder / str(table.file),
            length_unit=table.length_unit,
            select={**table.recording, **select},
        )

    loaded = read(table.select).positions_of(markers.names)
    start = None
    if table.displacement_from is not None:
        start = read(table.displacement_from).positions_of(markers.names)
    registration = None
    if table.registration is not None:
        names = table.registration.markers
        seen = read(table.registration.select).positions_of(names)
        registration = register(seen, _positions(nominal, names))
        loaded = registration.apply(loaded)
        start = None if start is None else registration.apply(start)
    if start is not None:
        loaded = markers.positions + (loaded - start)
    return loaded, registration
