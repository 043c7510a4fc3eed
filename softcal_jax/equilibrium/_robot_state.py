"""Effector coordinates e of a state (paper Sec. II), and what else is shown of it."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.bodies import KINDS, rotation_vector
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EffectorArrays,
    Observed,
    SupportReaction,
    configuration_arrays,
    following_each_other,
)
from softcal_jax.contact import ContactState
from softcal_jax.equilibrium._linearisation import residual, solved_forces
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed, check_lane, one_lane
from softcal_jax.equilibrium._solve import EquilibriumSolution
from softcal_jax.mesh import boundary_faces, face_indices


def effector_values(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Nodal | None = None,
) -> Float[Array, "n_rows 3"]:
    """Compute all effectors: positions [m], rotations [rad], then what is observed.

    Rows are ordered as in `EffectorArrays`; for other arguments see `observed_state`.
    """
    check_lane(model, configuration)
    if u.shape != (model.n_points, 3):
        raise ValueError(f"u has the shape {u.shape}; expected ({model.n_points}, 3).")
    read = partial(_effector_values, model, configuration)
    return where_known(read, u, multipliers, unbalanced)


def where_known(read: Callable[..., Array], u: Nodal, *more: Array | None) -> Array:
    """Read a state; nan where its u is nan, and without a derivative there.

    At nan itself, the derivative of a lane that is masked would be nan times zero.
    """
    known = jnp.all(jnp.isfinite(u))
    state = jax.tree.map(lambda leaf: jnp.where(known, leaf, 0.0), (u, *more))
    return jnp.where(known, read(*state), jnp.nan)


def _effector_values(
    model: Model, configuration: ConfigurationArrays, u, multipliers, unbalanced
) -> Float[Array, "n_rows 3"]:
    effectors = configuration.effectors
    points_and_turns = placed(model, effectors, u)
    if not effectors.observed:
        return points_and_turns
    state = observed_state(model, configuration, u, multipliers, unbalanced)
    observed = [
        # Only if this configuration has it: what it reads may be missing in others.
        jax.lax.cond(
            jnp.asarray(effectors.is_observed)[k],
            partial(_observe, observation, model, configuration),
            lambda _: jnp.zeros((1, 3)),
            state,
        )
        for k, observation in enumerate(effectors.observed)
    ]
    return jnp.concatenate([points_and_turns, *observed])


class ObservedState(NamedTuple):
    """What an `Observation` sees of a robot, beside model and configuration.

    Attributes:
        displacement: Displacement of the nodes [m].
        actuator_forces: lambda_a of all actuators, in their units.
        actuator_displacements: delta_a of all actuators, in their units.
        body_rotations: Rotations of rigid bodies from rest, as matrices [-].
        ground_forces: Forces with which the ground holds the nodes [N].
        contacts: What each obstacle feels, then each surface that another may touch, in
            the order of `Mechanism.contacts`.
    """

    displacement: Nodal
    actuator_forces: Float[Array, " n_a"]
    actuator_displacements: Float[Array, " n_a"]
    body_rotations: Float[Array, "n_b 3 3"]
    ground_forces: Nodal
    contacts: tuple[ContactState, ...]


def observed_state(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Nodal | None = None,
) -> ObservedState:
    """Compute what is observed of a state.

    The `multipliers` are estimated from the balance unless given; `unbalanced` is
    `residual`, if already known [N].
    """
    if multipliers is None:
        multipliers = solved_forces(model, configuration, u)
    if unbalanced is None:
        unbalanced = residual(model, configuration, u, multipliers)
    posed = Posed.of(model, configuration)
    return ObservedState(
        displacement=u,
        actuator_forces=actuator_forces(
            model, configuration, u, multipliers, unbalanced
        ),
        actuator_displacements=model.displacements(u),
        body_rotations=model.frames(u).rotation,
        # Spring forces are part of the balance, but the ground carries them too.
        ground_forces=unbalanced - posed.spring_force(u),
        contacts=posed.contact_states(u),
    )


def _observe(
    observed: Observed,
    model: Model,
    configuration: ConfigurationArrays,
    state: ObservedState,
) -> Float[Array, "1 3"]:
    """Compute an observation as a row.

    Raises:
        ValueError: If it does not have as many values as were declared.
    """
    value = jnp.asarray(observed.function(model, configuration, state))
    if value.ndim > 1 or value.size != observed.n_values:
        raise ValueError(
            f"observation {observed.name!r} returned an array of shape {value.shape}, "
            f"but its measured value has {observed.n_values}, or its std where nothing "
            "is measured: give as many as the function returns."
        )
    none = jnp.zeros(3 - observed.n_values)
    return jnp.concatenate([jnp.ravel(value).astype(float), none])[None]


def placed(
    model: Model, effectors: EffectorArrays, u: Nodal
) -> Float[Array, "n_points_and_turns 3"]:
    """Compute the rows that a recording sees: points and turns."""
    x = model.positions(u)
    points = jnp.sum(effectors.shares[:, :, None] * x[effectors.nodes], axis=1)
    centre = jnp.mean(jnp.asarray(model.mesh.points), axis=0)
    points = effectors.base.point(points, centre)
    if effectors.turn_body.shape[0] == 0:
        return points
    rotation = model.frames(u).rotation
    reference = jnp.asarray(effectors.turn_reference)
    seen = effectors.base.turn(rotation[effectors.turn_body])
    # Rotation vectors from the reference orientations, in the frame of the mesh.
    turns = jnp.sum(seen[:, :, None] * reference[:, None], axis=-1)
    return jnp.concatenate([points, jax.vmap(rotation_vector)(turns)])


def actuator_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    multipliers: Float[Array, " n_a"],
    unbalanced: Nodal,
) -> Float[Array, " n_a"]:
    """Compute the forces lambda_a of all actuators; arguments as `effector_values`.

    For a motor with an imposed angle this is the torque that holds its body.
    """
    forces = configuration.actuation.forces
    posed = Posed.of(model, configuration)
    forces = jnp.where(posed.by_multiplier, multipliers, forces)
    gathered = posed.gather(u, unbalanced)
    for a, body in enumerate(model.mechanism.actuators.motor_body):
        if body >= 0:
            # Angles count in metres at the end of the frame's axis, hence the length.
            torque = gathered[u.size + 6 * body + 5] * model.mechanism.bodies.length
            held = configuration.actuation.by_displacement[a]
            forces = forces.at[a].set(jnp.where(held, torque, forces[a]))
    return forces


class BodyPlace(Module):
    """Pose of a rigid body at equilibrium.

    Attributes:
        state: One of `bodies.KINDS`, or "tied" to another body.
        position: Origin of its frame [m].
        translation: How far the origin has moved from rest [m].
        rotation_vector: Rotation from rest [rad].
    """

    name: str
    state: str
    position: Float[HostArray, "3"]
    translation: Float[HostArray, "3"]
    rotation_vector: Float[HostArray, "3"]


class ActuatorState(Module):
    """Force lambda_a of an actuator, and its displacement delta_a, if it has any.

    `kind` is a noun like "cable"; of the two, one is `imposed` and the other follows.
    """

    name: str
    kind: str
    imposed: Literal["force", "displacement"]
    force: float
    force_unit: str
    displacement: float | None
    displacement_unit: str | None


class Reaction(Module):
    """Force with which the ground holds a support or a rigid body.

    Attributes:
        force: Force on the robot [N].
    """

    name: str
    force: Float[HostArray, "3"]


class RobotState(Module):
    """Rigid bodies, actuators, reactions and contacts at an equilibrium.

    Attributes:
        reactions: Of supports, then of rigid bodies that are held or turn on a hinge.
        contacts: With the obstacles that are there, and of the body with itself.
        displacement: Displacement of the nodes of mesh and body frames [m].
    """

    bodies: tuple[BodyPlace, ...]
    actuators: tuple[ActuatorState, ...]
    reactions: tuple[Reaction, ...]
    contacts: tuple[ContactState, ...]
    displacement: Float[HostArray, "n_points 3"]

    def surface_pressure(self, model: Model) -> Float[HostArray, " n_faces"]:
        """Add up the mean pressures of contact on `mesh.boundary_faces` [Pa]."""
        surface = boundary_faces(model.mesh)
        total = np.zeros(len(surface))
        for contact in self.contacts:
            faces = model.mechanism.contacts.faces_of(contact.name)
            np.add.at(total, face_indices(faces, surface), contact.pressure)
        return total


@eqx.filter_jit
def _observed(model: Model, lane: ConfigurationArrays, u, multipliers):
    """Compute what is observed, and the kind of state of each body in `KINDS`."""
    states = Posed.of(model, lane).states
    kinds = jnp.zeros(0, int) if states is None else states.kind
    return observed_state(model, lane, u, multipliers), kinds


def robot_states(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
    arrays: ConfigurationArrays | None = None,
) -> tuple[RobotState | None, ...]:
    """Compute poses of bodies, forces of actuators and reactions at equilibria.

    `solution` has one lane per configuration; `arrays` are the configurations, if
    already stacked. The state is None for a lane without equilibrium, and for all lanes
    of a model without rigid bodies, actuators and surfaces that may touch.
    """
    mechanism = model.mechanism
    n = mechanism.bodies.n_bodies + mechanism.n_actuators
    if n == 0 and not mechanism.contacts.can_touch:
        return (None,) * len(configurations)
    if arrays is None:
        arrays = configuration_arrays(model.mesh, configurations, model.mechanism)
    states: list[RobotState | None] = [None] * len(configurations)
    lanes = following_each_other([*arrays], np.asarray(solution.displacement))
    for i, configuration in enumerate(configurations):
        if bool(solution.converged[i]):
            states[i] = _state(model, configuration, lanes[i], lane_of(solution, i))
    return tuple(states)


def _state(
    model: Model,
    configuration: Configuration,
    lane: ConfigurationArrays,
    solution: EquilibriumSolution,
) -> RobotState:
    u, multipliers = solution.displacement, solution.multipliers
    u, (state, of_bodies) = jax.device_get((u, _observed(model, lane, u, multipliers)))
    bodies = model.mechanism.bodies
    kinds = [
        KINDS[int(kind)] if owner == k else "tied"
        for k, (kind, owner) in enumerate(zip(of_bodies, bodies.owner, strict=True))
    ]
    moved = u[model.mesh.n_nodes :: 4]
    turns = [Rotation.from_matrix(R).as_rotvec() for R in state.body_rotations]
    places = map(BodyPlace, bodies.names, kinds, bodies.origin + moved, moved, turns)
    of_actuators = state.actuator_forces, state.actuator_displacements
    actuators = actuator_states(model, lane, *of_actuators)
    reactions = (
        Reaction(name, of_nodes(model, lane, state))
        for name, of_nodes in _grounds(model, configuration, kinds).items()
    )
    obstacles = model.mechanism.contacts
    plain = lambda leaf: leaf if leaf.ndim else float(leaf)
    contacts = (
        jax.tree.map(plain, felt)
        for k, felt in enumerate(state.contacts)
        if k >= obstacles.n_obstacles
        or KINDS[int(of_bodies[bodies.owner[obstacles.body[k]]])] != "absent"
    )
    return RobotState(tuple(places), actuators, tuple(reactions), tuple(contacts), u)


def actuator_states(
    model: Model,
    lane: ConfigurationArrays,
    forces: Float[Array | HostArray, " n_a"],
    displacements: Float[Array | HostArray, " n_a"],
) -> tuple[ActuatorState, ...]:
    """Return forces and displacements of all actuators, and which are imposed."""
    actuators = model.mechanism.actuators
    by_displacement = lane.actuation.by_displacement
    named = zip(actuators.names, actuators.kinds, strict=True)
    return tuple(
        ActuatorState(
            name=name,
            kind=kind.noun,
            imposed="displacement" if by_displacement[a] else "force",
            force=float(forces[a]),
            force_unit=kind.force_unit,
            displacement=float(displacements[a]) if kind.displacement_unit else None,
            displacement_unit=kind.displacement_unit,
        )
        for a, (name, kind) in enumerate(named)
    )


def _grounds(
    model: Model, configuration: Configuration, kinds: list[str]
) -> dict[str, Callable[..., Any]]:
    """Return functions that read the reactions, as an `Observation` does, by name."""
    mesh, mechanism = model.mesh, model.mechanism
    bodies = mechanism.bodies
    reaction = lambda where: SupportReaction("reaction", where).rows(mesh, mechanism)[0]
    grounds = {}
    for i, support in enumerate(configuration.supports, start=1):
        named = isinstance(support.where, str)
        name = str(support.where) if named else f"support {i}"
        grounds[name] = reaction(support.where).function
    for k, kind in enumerate(kinds):
        if kind in ("held", "hinged", "sliding") and bodies.has_nodes[k]:
            name = bodies.names[k]
            attached = bodies.attached[bodies.body == k]
            key = f"rigid body {name}" if name in grounds else name
            grounds[key] = reaction(attached).function
    return grounds


def marker_positions(
    model: Model,
    configuration: Configuration | ConfigurationArrays,
    solution: EquilibriumSolution,
) -> Float[Array, "n_markers 3"]:
    """Compute the positions of markers, then of points of other effectors [m].

    In the frame of the mesh; nan without equilibrium.

    Raises:
        ValueError: If the configuration is a batch, or of another model.
    """
    effectors = one_lane(model, configuration).effectors
    return _points(model, effectors, solution.displacement)


@eqx.filter_jit
def _points(model: Model, effectors: EffectorArrays, u) -> Float[Array, "n 3"]:
    rows = where_known(partial(placed, model, effectors), u)
    return rows[: effectors.nodes.shape[0]]
