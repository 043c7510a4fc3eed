"""Effector coordinates e of a state, in rows of three (paper Sec. II)."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.bodies import rotation_vector
from softcal_jax.configurations import ConfigurationArrays, EffectorArrays, Observed
from softcal_jax.contact import ContactState
from softcal_jax.equilibrium._linearisation import residual, solved_forces
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed


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
        contacts: What each obstacle feels, in the order of `Mechanism.contacts`.
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
