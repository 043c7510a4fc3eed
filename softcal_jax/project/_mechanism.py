"""From the tables of a project file to rigid bodies and actuators."""

from pathlib import Path

import numpy as np

from softcal_jax.actuators import (
    AbstractActuator,
    Cable,
    Chamber,
    ForceActuator,
    Guide,
    Motor,
    SurfaceForceActuator,
    SurfacePressure,
)
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
from softcal_jax.configurations import build_mechanism
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import at
from softcal_jax.project._schema import ProjectTable
from softcal_jax.project._schema_mechanism import (
    ActuatorTable,
    BodyTable,
    MotionTable,
)

Parts = tuple[tuple[RigidBody, ...], tuple[AbstractActuator, ...]]


def build_parts(path: Path, table: ProjectTable, mesh: TetMesh) -> Parts:
    """Rigid bodies and actuators, each checked under its own key.

    Raises:
        ProjectError: If one does not fit the mesh, or another one.
    """
    bodies = []
    for name, own in table.bodies.items():
        with at(path, f"bodies.{name}"):
            bodies.append(_body(name, own))
            # Alone it has nothing to be tied to, which is judged below.
            if own.tied_to is None:
                build_mechanism(mesh, bodies[-1:])
    with at(path, "bodies"):
        build_mechanism(mesh, bodies)
    actuators = []
    for name, own in table.actuators.items():
        with at(path, f"actuators.{name}"):
            actuators.append(_actuator(name, own))
            build_mechanism(mesh, bodies, actuators[-1:])
    with at(path, "actuators"):
        build_mechanism(mesh, bodies, actuators)
    return tuple(bodies), tuple(actuators)


def motion(table: MotionTable) -> Pose:
    """A rigid motion of the file."""
    return Pose(table.translation, table.rotation_vector)


def _body(name: str, table: BodyTable) -> RigidBody:
    axes = None if table.axes is None else np.array(table.axes)
    return RigidBody(
        name,
        table.group,
        table.origin,
        axes if table.hinge is None else hinge_axes(table.hinge),
        motion(table.mounting),
        table.tied_to,
        table.mass,
        table.centre_of_mass,
    )


def _actuator(name: str, table: ActuatorTable) -> AbstractActuator:
    surface, body = str(table.surface), str(table.body)
    direction = table.direction or (0.0, 0.0, 0.0)
    if table.type == "cable":
        return Cable(name, [Guide(g.point, g.on) for g in table.guides])
    if table.type == "chamber":
        return Chamber(name, surface)
    if table.type == "surface-pressure":
        return SurfacePressure(name, surface)
    if table.type == "motor":
        return Motor(name, body)
    if table.type == "surface-force":
        return SurfaceForceActuator(name, surface, direction)
    assert table.point is not None  # `kind_problems` asks for it
    return ForceActuator(name, table.point, direction)
