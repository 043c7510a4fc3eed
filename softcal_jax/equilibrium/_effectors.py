"""Effector coordinates e of a state, in rows of three (paper Sec. II)."""

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.bodies import frames_at, rotation_vector
from softcal_jax.configurations import ConfigurationArrays, EffectorArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._linearisation import residual, solved_forces
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._solution import EquilibriumSolution


def effector_values(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Float[Array, "n_points 3"] | None = None,
) -> Float[Array, "n_rows 3"]:
    """Compute all effectors: positions [m], rotations [rad], scalars and forces [N].

    Args:
        model: The model.
        configuration: One configuration, with its effectors.
        u: Equilibrium displacement [m].
        multipliers: Forces of actuators whose displacement is imposed; estimated from
            the balance by default.
        unbalanced: Value of `residual`, if already known [N].

    Returns:
        Rows in the order of `EffectorArrays`.
    """
    kinematic = effector_positions(model, configuration.effectors, u)
    if not configuration.effectors.has_forces:
        return kinematic
    forces = effector_forces(model, configuration, u, multipliers, unbalanced)
    return jnp.concatenate([kinematic, forces])


def effector_positions(
    model: Model, effectors: EffectorArrays, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_rows_of_positions 3"]:
    """Compute the rows that depend on positions alone: points, rotations, scalars.

    Args:
        model: The model.
        effectors: The effectors.
        u: Displacement [m].
    """
    x = actuation.positions(model, u)
    weights = jnp.asarray(effectors.weights)
    points = jnp.sum(weights[:, :, None] * x[effectors.nodes], axis=1)
    centre = jnp.mean(jnp.asarray(model.mesh.points), axis=0)
    rows = [effectors.base.point(points, centre)]
    if effectors.only_points:
        return rows[0]
    bodies = model.mechanism.bodies
    n_scalars = effectors.scalar_index.shape[0]
    if bodies.n_bodies > 0:
        rotation = frames_at(bodies, x[model.mesh.n_nodes :]).rotation
        reference = jnp.asarray(effectors.turn_reference)
        seen = effectors.base.turn(rotation[effectors.turn_body])
        rows.append(jax.vmap(_turn)(seen, reference))
    else:
        rotation = jnp.broadcast_to(jnp.eye(3)[None], (1, 3, 3))
    if n_scalars > 0:
        first, second = effectors.scalar_index[:, 0], effectors.scalar_index[:, 1]
        axes = jnp.asarray(effectors.scalar_axis)
        angle = jax.vmap(_angle)(rotation[first], rotation[second], axes)
        value = angle
        if model.mechanism.n_actuators > 0:
            delta_a = actuation.displacements(model, u)
            value = jnp.where(second < 0, delta_a[first], angle)
        none = jnp.zeros_like(value)
        rows.append(jnp.stack([value, none, none], axis=1))
    return jnp.concatenate(rows)


def marker_positions(
    model: Model, configuration: ConfigurationArrays, solution: EquilibriumSolution
) -> Float[Array, "n_markers 3"]:
    """Compute the simulated marker positions of one configuration [m].

    Args:
        model: The model.
        configuration: One configuration, with markers.
        solution: Its equilibrium.

    Returns:
        Positions in the frame of the mesh, markers first, then the points of other
        effectors; nan where there is no equilibrium.
    """
    effectors = configuration.effectors
    n_points = effectors.nodes.shape[0]
    return effector_positions(model, effectors, solution.displacement)[:n_points]


def _turn(R: Float[Array, "3 3"], reference: Float[Array, "3 3"]):
    """Compute the rotation vector from a reference orientation, in the mesh frame."""
    return rotation_vector(jnp.sum(R[:, None, :] * reference[None, :, :], axis=-1))


def _angle(
    R: Float[Array, "3 3"], other: Float[Array, "3 3"], axis: Float[Array, "3"]
) -> Float[Array, ""]:
    """Compute the angle of the rotation other^T R about an axis fixed on the other."""
    relative = jnp.sum(other[:, :, None] * R[:, None, :], axis=0)
    # A direction normal to the axis, from the coordinate axis farthest from it.
    start = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    across = start - axis * jnp.sum(axis * start)
    size = jnp.sum(across**2)
    across = across / jnp.sqrt(jnp.where(size > 0.0, size, 1.0))
    turned = jnp.sum(relative * across[None, :], axis=1)
    y = jnp.sum(turned * jnp.cross(axis, across))
    x = jnp.sum(turned * across)
    # Padding has a zero axis, and atan2(0, 0) has no derivative.
    return jnp.arctan2(y, jnp.where((x == 0.0) & (y == 0.0), 1.0, x))


def actuator_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Float[Array, "n_points 3"] | None = None,
) -> Float[Array, " n_a"]:
    """Compute the forces lambda_a of all actuators, in their units.

    For a motor with an imposed angle this is the torque that holds its body. Arguments
    as for `effector_values`.
    """
    forces = configuration.actuation.forces
    if unbalanced is None:
        unbalanced = residual(model, configuration, u, multipliers)
    if multipliers is None:
        multipliers = solved_forces(model, configuration, u)
    forces = jnp.where(
        actuation.by_multiplier(model, configuration.actuation), multipliers, forces
    )
    gathered = Posed.of(model, configuration).gather(u, unbalanced)
    for a, body in enumerate(model.mechanism.actuators.motor_body):
        if body >= 0:
            # Angles count in metres at the end of the frame's axis, hence the length.
            torque = gathered[u.size + 6 * body + 5] * model.mechanism.bodies.length
            held = configuration.actuation.by_displacement[a]
            forces = forces.at[a].set(jnp.where(held, torque, forces[a]))
    return forces


def effector_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Float[Array, "n_points 3"] | None = None,
) -> Float[Array, "n_rows_of_forces 3"]:
    """Compute the rows that need the balance: actuator forces and reactions [N].

    Arguments as for `effector_values`.
    """
    effectors = configuration.effectors
    rows = []
    if unbalanced is None:
        unbalanced = residual(model, configuration, u, multipliers)
    if effectors.force_actuator.shape[0] > 0:
        forces = actuator_forces(model, configuration, u, multipliers, unbalanced)
        value = forces[effectors.force_actuator]
        none = jnp.zeros_like(value)
        rows.append(jnp.stack([value, none, none], axis=1))
    weights = jnp.asarray(effectors.reaction_weights)
    # Spring forces are part of the balance, but the ground carries them too.
    ground = unbalanced - Posed.of(model, configuration).spring_force(u)
    held = ground[effectors.reaction_nodes]
    rows.append(jnp.sum(weights[:, :, None] * held, axis=1))
    return jnp.concatenate(rows)
