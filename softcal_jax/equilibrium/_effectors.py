"""Effector coordinates e of a state, in rows of three (paper Sec. II)."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._module import one_line
from softcal_jax._typing import Array, Float
from softcal_jax.bodies import frames_at, rotation_vector
from softcal_jax.configurations import ConfigurationArrays, EffectorArrays, Observed
from softcal_jax.equilibrium._linearisation import residual, solved_forces
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._solution import EquilibriumSolution


def effector_values(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    multipliers: Float[Array, " n_a"] | None = None,
    unbalanced: Nodal | None = None,
) -> Float[Array, "n_rows 3"]:
    """Compute all effectors: positions [m], rotations [rad], scalars and forces [N].

    Rows are ordered as in `EffectorArrays`. The `multipliers` are estimated from the
    balance unless given; `unbalanced` is `residual`, if already known [N].
    """
    effectors = configuration.effectors
    rows = [_positions(model, effectors, u)]
    if not (effectors.has_forces or effectors.observed):
        return rows[0]
    if multipliers is None:
        multipliers = solved_forces(model, configuration, u)
    state = ObservedState(u, multipliers)
    observed = [
        # Not where another configuration has it: it may not exist here.
        jax.lax.cond(
            jnp.asarray(effectors.is_observed)[k],
            partial(_observe, own, model, configuration),
            lambda _: jnp.zeros((1, 3)),
            state,
        )
        for k, own in enumerate(effectors.observed)
    ]
    if not effectors.has_forces:
        return jnp.concatenate([*rows, *observed])
    if unbalanced is None:
        unbalanced = residual(model, configuration, u, multipliers)
    if effectors.force_actuator.shape[0] > 0:
        forces = actuator_forces(model, configuration, u, multipliers, unbalanced)
        rows.append(_in_first_column(forces[effectors.force_actuator]))
    weights = jnp.asarray(effectors.reaction_weights)
    # Spring forces are part of the balance, but the ground carries them too.
    ground = unbalanced - Posed.of(model, configuration).spring_force(u)
    held = ground[effectors.reaction_nodes]
    rows.append(jnp.sum(weights[:, :, None] * held, axis=1))
    return jnp.concatenate([*rows, *observed])


class ObservedState(NamedTuple):
    """What an `Observation` sees of a robot, beside model and configuration.

    `displacement` are those of the nodes [m], `multipliers` the forces of actuators
    whose displacement is imposed, 0 for the others.
    """

    displacement: Nodal
    multipliers: Float[Array, " n_a"]

    __repr__ = one_line


def _observe(
    own: Observed,
    model: Model,
    configuration: ConfigurationArrays,
    state: ObservedState,
) -> Float[Array, "1 3"]:
    """Compute an observation as a row.

    Raises:
        ValueError: If it does not have as many values as were declared.
    """
    value = jnp.asarray(own.function(model, configuration, state))
    if value.ndim > 1 or value.size != own.n_values:
        raise ValueError(
            f"observation {own.name!r} returned an array of shape {value.shape}, but "
            f"its measured value has {own.n_values}, or its std where nothing is "
            "measured: give as many as the function returns."
        )
    none = jnp.zeros(3 - own.n_values)
    return jnp.concatenate([jnp.ravel(value).astype(float), none])[None]


def _in_first_column(value: Float[Array, " n"]) -> Float[Array, "n 3"]:
    none = jnp.zeros_like(value)
    return jnp.stack([value, none, none], axis=1)


def _positions(
    model: Model, effectors: EffectorArrays, u: Nodal
) -> Float[Array, "n_rows_of_positions 3"]:
    """Compute the rows that depend on positions alone: points, rotations, scalars."""
    x = model.positions(u)
    weights = jnp.asarray(effectors.weights)
    points = jnp.sum(weights[:, :, None] * x[effectors.nodes], axis=1)
    centre = jnp.mean(jnp.asarray(model.mesh.points), axis=0)
    rows = [effectors.base.point(points, centre)]
    if effectors.only_points:
        return rows[0]
    bodies = model.mechanism.bodies
    if bodies.n_bodies > 0:
        rotation = frames_at(bodies, x[model.mesh.n_nodes :]).rotation
        reference = jnp.asarray(effectors.turn_reference)
        seen = effectors.base.turn(rotation[effectors.turn_body])
        # Rotation vectors from the reference orientations, in the frame of the mesh.
        turns = jnp.sum(seen[:, :, None] * reference[:, None], axis=-1)
        rows.append(jax.vmap(rotation_vector)(turns))
    else:
        rotation = jnp.broadcast_to(jnp.eye(3)[None], (1, 3, 3))
    if effectors.scalar_index.shape[0] > 0:
        first, second = effectors.scalar_index[:, 0], effectors.scalar_index[:, 1]
        axes = jnp.asarray(effectors.scalar_axis)
        angle = jax.vmap(_angle)(rotation[first], rotation[second], axes)
        value = angle
        if model.mechanism.n_actuators > 0:
            delta_a = model.displacements(u)
            value = jnp.where(second < 0, delta_a[first], angle)
        rows.append(_in_first_column(value))
    return jnp.concatenate(rows)


def marker_positions(
    model: Model, configuration: ConfigurationArrays, solution: EquilibriumSolution
) -> Float[Array, "n_markers 3"]:
    """Compute the positions of markers, then of points of other effectors [m].

    In the frame of the mesh; nan without equilibrium.
    """
    effectors = configuration.effectors
    n_points = effectors.nodes.shape[0]
    return _positions(model, effectors, solution.displacement)[:n_points]


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
