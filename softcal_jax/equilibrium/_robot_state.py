"""States of rigid bodies, actuators and supports at equilibrium, for results."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.bodies import KINDS, frames_at
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    SupportReaction,
    configuration_arrays,
)
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._effectors import actuator_forces
from softcal_jax.equilibrium._linearisation import residual
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._solution import EquilibriumSolution


class BodyPlace(eqx.Module):
    """Pose of a rigid body at equilibrium.

    Attributes:
        name: Its name.
        state: "free", "hinged", "held", or "tied" to another body.
        position: Origin of its frame [m].
        translation: How far the origin has moved from rest [m].
        rotation_vector: Rotation from rest [rad].
    """

    name: str
    state: str
    position: Float[HostArray, "3"]
    translation: Float[HostArray, "3"]
    rotation_vector: Float[HostArray, "3"]


class ActuatorState(eqx.Module):
    """Force and displacement of an actuator.

    Attributes:
        name: Its name.
        kind: Kind of actuator, like "cable".
        imposed: Which of the two the configuration imposes; the other follows.
        force: lambda_a.
        force_unit: Its unit.
        displacement: delta_a; None if the actuator has none.
        displacement_unit: Its unit.
    """

    name: str
    kind: str
    imposed: Literal["force", "displacement"]
    force: float
    force_unit: str
    displacement: float | None
    displacement_unit: str | None


class Reaction(eqx.Module):
    """Force with which the ground holds a support or a rigid body.

    Attributes:
        name: Group of the support, or name of the rigid body.
        force: Force on the robot [N].
    """

    name: str
    force: Float[HostArray, "3"]


class RobotState(eqx.Module):
    """Rigid bodies, actuators and reactions at an equilibrium.

    Attributes:
        bodies: The rigid bodies.
        actuators: The actuators.
        reactions: Supports of the configuration, then rigid bodies that are held or
            turn on a hinge.
        displacement: Displacement of the nodes of mesh and body frames [m].
    """

    bodies: tuple[BodyPlace, ...]
    actuators: tuple[ActuatorState, ...]
    reactions: tuple[Reaction, ...]
    displacement: Float[HostArray, "n_points 3"]


class _Balance(eqx.Module):
    """Results of the balance of forces of one configuration."""

    of_ground: Float[Array, "n_points 3"]
    forces: Float[Array, " n_a"]
    displacements: Float[Array, " n_a"]
    rotation: Float[Array, "n_b 3 3"]


@eqx.filter_jit
def _balance(model: Model, lane: ConfigurationArrays, u, multipliers) -> _Balance:
    unbalanced = residual(model, lane, u, multipliers)
    bodies, n = model.mechanism.bodies, model.mechanism.n_actuators
    none = jnp.zeros(0)
    x = actuation.positions(model, u)
    return _Balance(
        # What springs of the ground hold is balanced already.
        unbalanced - Posed.of(model, lane).spring_force(u),
        actuator_forces(model, lane, u, multipliers, unbalanced) if n else none,
        actuation.displacements(model, u) if n else none,
        frames_at(bodies, x[model.mesh.n_nodes :]).rotation
        if bodies.n_bodies
        else jnp.zeros((0, 3, 3)),
    )


def robot_states(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
    arrays: ConfigurationArrays | None = None,
) -> tuple[RobotState | None, ...]:
    """Compute poses of bodies, forces of actuators and reactions at equilibria.

    Args:
        model: The model.
        configurations: The configurations that were solved.
        solution: Their equilibria, one lane per configuration.
        arrays: The same configurations as arrays, if already stacked.

    Returns:
        One entry per configuration; None where there is no equilibrium, and for a
        model without rigid bodies and actuators.
    """
    if model.mechanism.bodies.n_bodies + model.mechanism.n_actuators == 0:
        return (None,) * len(configurations)
    if arrays is None:
        arrays = configuration_arrays(model.mesh, configurations, model.mechanism)
    states = []
    for i, configuration in enumerate(configurations):
        if not bool(solution.converged[i]):
            states.append(None)
            continue
        lane = jax.tree.map(lambda leaf, i=i: leaf[i], arrays)
        u, multipliers = solution.displacement[i], solution.multipliers[i]
        found = _balance(model, lane, u, multipliers)
        states.append(_state(model, configuration, lane, np.asarray(u), found))
    return tuple(states)


def _state(
    model: Model,
    configuration: Configuration,
    lane: ConfigurationArrays,
    u: Float[HostArray, "n_points 3"],
    found: _Balance,
) -> RobotState:
    of_ground = np.asarray(found.of_ground)
    return RobotState(
        _bodies(model, lane, u, np.asarray(found.rotation)),
        _actuators(model, lane, found),
        tuple(
            Reaction(name, of_ground[nodes].sum(axis=0))
            for name, nodes in _grounds(model, configuration, lane)
        ),
        u,
    )


def _kinds(model: Model, lane: ConfigurationArrays) -> list[str]:
    """Return the state of each rigid body; motors hold or hinge theirs."""
    bodies, actuators = model.mechanism.bodies, model.mechanism.actuators
    kinds = [KINDS[int(kind)] for kind in lane.bodies.kind]
    for a, k in enumerate(actuators.motor_body):
        if k >= 0:
            kinds[k] = "held" if lane.actuation.by_displacement[a] else "hinged"
    own = enumerate(bodies.owner)
    return ["tied" if owner != k else kinds[k] for k, owner in own]


def _bodies(
    model: Model, lane: ConfigurationArrays, u, rotation: Float[HostArray, "n_b 3 3"]
) -> tuple[BodyPlace, ...]:
    bodies = model.mechanism.bodies
    places = []
    for k, kind in enumerate(_kinds(model, lane)):
        moved = u[model.mesh.n_nodes + 4 * k]
        places.append(
            BodyPlace(
                name=bodies.names[k],
                state=kind,
                position=bodies.origin[k] + moved,
                translation=moved,
                rotation_vector=Rotation.from_matrix(rotation[k]).as_rotvec(),
            )
        )
    return tuple(places)


def _actuators(
    model: Model, lane: ConfigurationArrays, found: _Balance
) -> tuple[ActuatorState, ...]:
    actuators = model.mechanism.actuators
    by_displacement = lane.actuation.by_displacement
    states = []
    for a, (name, kind) in enumerate(
        zip(actuators.names, actuators.kinds, strict=True)
    ):
        unit = kind.displacement_unit
        states.append(
            ActuatorState(
                name=name,
                kind=kind.noun,
                imposed="displacement" if by_displacement[a] else "force",
                force=float(found.forces[a]),
                force_unit=kind.force_unit,
                displacement=None if unit is None else float(found.displacements[a]),
                displacement_unit=unit,
            )
        )
    return tuple(states)


def _grounds(
    model: Model, configuration: Configuration, lane: ConfigurationArrays
) -> list[tuple[str, Int[HostArray, " n"]]]:
    """List what holds the robot, by name, with the nodes held."""
    mesh, mechanism = model.mesh, model.mechanism
    bodies = mechanism.bodies
    nodes_of = lambda where: (
        SupportReaction("reaction", where).rows(mesh, mechanism)[0].nodes
    )
    grounds: dict[str, Int[HostArray, " n"]] = {}
    for i, support in enumerate(configuration.supports, start=1):
        named = isinstance(support.where, str)
        name = str(support.where) if named else f"support {i}"
        grounds[name] = nodes_of(support.where)
    for k, kind in enumerate(_kinds(model, lane)):
        if kind in ("held", "hinged"):
            name = bodies.names[k]
            attached = bodies.attached[bodies.body == k]
            key = f"rigid body {name}" if name in grounds else name
            grounds[key] = nodes_of(attached)
    return list(grounds.items())
