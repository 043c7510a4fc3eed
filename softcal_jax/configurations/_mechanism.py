"""Rigid bodies and actuators of a robot, and what a configuration asks of them."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax import bodies as rigid
from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Bool, Float, HostArray, check_untraced, is_traced
from softcal_jax.actuators import (
    AbstractActuator,
    ActuatorArrays,
    actuator_arrays,
)
from softcal_jax.configurations._arrays import ActuationArrays
from softcal_jax.contact import (
    Contacts,
    Obstacle,
    Standing,
    build_contacts,
    build_touching,
)
from softcal_jax.mesh import TetMesh

OTHER_POINTS = (
    "the points of the mesh are not those from which the model was made: its shape "
    "gradients, volumes and mechanism are of others. with_points(model, points) sets "
    "all of them."
)


class Mechanism(Module):
    """Rigid bodies and actuators of a model; either may be missing.

    The nodes of the mesh are followed by four nodes for the frame of each body.

    Attributes:
        points: All nodes at rest, the frame nodes of the bodies last [m].
        contacts: Which of them are obstacles, and the surfaces that they may touch.
        motor_zero: Zero error of each motor, added to the angle of its encoder [rad];
            0 for other actuators.
    """

    points: Float[HostArray, "n_points 3"]
    bodies: rigid.BodyArrays
    contacts: Contacts
    actuators: ActuatorArrays
    motor_zero: Float[Array, " n_a"]

    @property
    def n_actuators(self) -> int:
        return len(self.actuators.names)

    @property
    def conservative(self) -> bool:
        """Whether all its forces have a potential, as friction has none."""
        return self.actuators.symmetric and not any(self.contacts.sticks)

    def following(self, mesh: TetMesh) -> "Mechanism":
        """Return the mechanism of a mesh with other points, see `with_points`."""
        n, points = mesh.n_nodes, jnp.asarray(mesh.points)
        bodies = self.bodies.following(jnp.asarray(self.points)[:n], points)
        shifts = jnp.repeat(bodies.origin - self.bodies.origin, 4, axis=0)
        points = jnp.concatenate([points, self.points[n:] + shifts])
        contacts = self.contacts.following(mesh, points)
        actuators = self.actuators.following(mesh, points)
        where = lambda m: (m.points, m.bodies, m.contacts, m.actuators)
        return eqx.tree_at(where, self, (points, bodies, contacts, actuators))

    def check_on(self, mesh: TetMesh) -> None:
        """Raise ValueError if the points of the mesh are others than those at rest."""
        both = mesh.points, self.points[: mesh.n_nodes]
        traced = [is_traced(points) for points in both]
        if all(traced) or (not any(traced) and np.array_equal(*both)):
            return
        raise ValueError(OTHER_POINTS)

    def is_off(self, mesh: TetMesh) -> Bool[Array, ""]:
        """Tell the same of points that are traced, when a program runs."""
        both = jnp.asarray(mesh.points), jnp.asarray(self.points)[: mesh.n_nodes]
        return jnp.any(both[0] != both[1])

    def displacements(self, x: Float[Array, "n_points 3"]) -> Float[Array, " n_a"]:
        """Compute displacements delta_a at positions x [m], as imposed and measured.

        For a motor it is the reading of its encoder: the angle minus the zero error.
        """
        return self.actuators.displacements(x) - self.motor_zero

    def standing(
        self, states: rigid.BodyStateArrays, *, mounted: bool = True
    ) -> Standing:
        """Return how the obstacles stand in a configuration.

        Those without nodes start as they are mounted, since to stand a little elsewhere
        is no slip; unless `mounted` is false: then they start where the model has them.
        """
        bodies, which = self.bodies, np.array(self.contacts.body, int)
        present = jnp.asarray(states.is_present)[bodies.owner[which]]
        share = jnp.where(bodies.has_nodes, 0.0, float(mounted))[:, None]
        turn = jax.vmap(rigid.rotation_matrix)
        first = turn(share * bodies.mounting_rotation)
        frames = rigid.Frames(
            jnp.asarray(bodies.origin)
            + share * bodies.mounting_translation
            + jnp.asarray(states.start_translation),
            turn(jnp.asarray(states.start_rotation)) @ first,
        )
        ends = bodies.frame_nodes(frames)
        return Standing(present, ends[which])


def build_mechanism(
    mesh: TetMesh,
    bodies: Sequence[rigid.RigidBody] = (),
    actuators: Sequence[AbstractActuator] = (),
    *,
    at_rest: bool = True,
    contact_scale: float | None = None,
    touching: Sequence[tuple[str, str]] = (),
    touching_reach: float | None = None,
) -> Mechanism:
    """Stack the rigid bodies and actuators of a mesh at rest.

    To check or to draw actuators, `at_rest` is not needed, see `actuator_arrays`; for
    contact see `build_contacts` and `build_touching`.

    Raises:
        ValueError: If a body or an actuator does not fit the mesh, or a motor turns a
            body that is tied to another or has a motor already.
    """
    stacked = rigid.body_arrays(mesh, bodies)
    points = np.concatenate([mesh.points, stacked.frame_points])
    index_of = {name: k for k, name in enumerate(stacked.names)}
    arrays = actuator_arrays(mesh, points, actuators, index_of, at_rest=at_rest)
    # Each motor turns a free body of its own, mounted without a turn.
    turned: dict[int, str] = {}
    for name, body in arrays.motors.items():
        driven, root = stacked.names[body], stacked.names[stacked.owner[body]]
        what = f"motor {name!r} turns {driven!r}"
        if driven != root:
            raise ValueError(
                f"{what}, which is tied to {root!r}: let it turn {root!r}."
            )
        if body in turned:
            raise ValueError(f"{what}, and so does motor {turned[body]!r}.")
        if np.any(np.asarray(stacked.mounting_rotation)[body] != 0.0):
            raise ValueError(
                f"{what}, whose mounting turns it already: give that rotation to the "
                "axes of the body, or to the angle."
            )
        turned[body] = name
    # Not jnp.zeros, which would compile a program for every number.
    zeros = jax.device_put(np.zeros(len(arrays.names)))
    obstacles = [
        Obstacle(k, b.name, b.shape, b.friction, stacked.attached[stacked.body == k])
        for k, b in enumerate(bodies)
        if b.shape is not None
    ]
    carrier = np.full(mesh.n_nodes, -1)
    carrier[stacked.attached] = stacked.owner[stacked.body]
    contacts = build_contacts(
        mesh,
        points,
        obstacles,
        length=stacked.length,
        scale=contact_scale,
        touching=build_touching(mesh, touching, carrier=carrier, reach=touching_reach),
    )
    return Mechanism(points, stacked, contacts, arrays, zeros)


class ImposedForce(Module):
    """The force lambda_a of an actuator is given; its displacement follows.

    Attributes:
        value: Tension [N], pressure [Pa], torque [N m] or force [N].
        releasing: Whether it was last released, not pulled: the sign of its friction.
    """

    value: float
    releasing: bool = False


class ImposedDisplacement(Module):
    """The displacement delta_a of an actuator is given; its force is solved for.

    Attributes:
        value: Shortening of a cable [m], volume growth of a chamber [m3], angle of a
            motor as its encoder shows it [rad], displacement of a point [m].
        releasing: As for `ImposedForce`.
    """

    value: float
    releasing: bool = False


Actuation = Mapping[str, ImposedForce | ImposedDisplacement]
BodyStates = Mapping[str, rigid.BodyState | rigid.Pose | str]


def actuation_arrays(
    mechanism: Mechanism, actuation: Actuation, configuration: str
) -> ActuationArrays:
    """Stack what is imposed on each actuator; messages name the `configuration`.

    A cable or chamber that is not named has no force, a motor stays at its zero.

    Raises:
        ValueError: If a name is unknown, or an actuator cannot have such a value.
    """
    actuators = mechanism.actuators
    what = f"configuration {configuration!r}"
    motors = actuators.motors
    by_displacement = np.array([name in motors for name in actuators.names], bool)
    value = np.zeros(len(actuators.names))
    releasing = np.zeros(len(actuators.names), bool)
    for name, asked in actuation.items():
        check_known(f"actuator of {what}", actuators.names, name)
        a = actuators.names.index(name)
        kind = actuators.kinds[a]
        label = f"{what}: {kind.noun} {name!r}"
        imposed = isinstance(asked, ImposedDisplacement)
        check_untraced(label, asked.value, "lane.actuation.value")
        unit = kind.displacement_unit if imposed else kind.force_unit
        if unit is None:
            raise ValueError(
                f"{label} has no displacement that could be imposed; give "
                f"ImposedForce(...) [{kind.force_unit}]."
            )
        turns, pulls = name in motors and imposed, kind.unilateral and not imposed
        low = -np.pi if turns else 0.0 if pulls else -np.inf
        high = np.pi if turns else np.inf
        if not (np.isfinite(asked.value) and low <= asked.value <= high):
            raise ValueError(
                f"{label} has the value {asked.value:g} {unit}; expected a finite one, "
                "not negative where it only pulls, and from -pi to pi for an angle "
                "(np.deg2rad turns degrees into radians)."
            )
        if asked.releasing and not actuators.has_friction[a]:
            raise ValueError(
                f"{label} is said to be releasing, but has no friction: leave it out, "
                f"or give the {kind.noun} friction."
            )
        by_displacement[a], value[a] = imposed, asked.value
        releasing[a] = asked.releasing
    return ActuationArrays(
        by_displacement=by_displacement,
        value=value,
        force_factor=np.ones_like(value),
        releasing=releasing,
        names=actuators.names,
    )


def body_state_arrays(
    mechanism: Mechanism, states: BodyStates, configuration: str
) -> rigid.BodyStateArrays:
    """Stack the states of the rigid bodies; those not named are free.

    An obstacle without nodes of its own is held unless something else is said.

    A `Pose` holds the body there, and a text is the `kind` of a `BodyState`.

    Raises:
        ValueError: If a name is unknown, or a body cannot have such a state.
    """
    bodies = mechanism.bodies
    turned_by = {body: motor for motor, body in mechanism.actuators.motors.items()}
    what = f"configuration {configuration!r}"
    free, held = map(rigid.KINDS.index, ("free", "held"))
    kind = np.where(bodies.has_nodes, free, held).astype(np.int32)
    places = np.zeros((4, bodies.n_bodies, 3))
    for name, given in states.items():
        check_known(f"rigid body of {what}", bodies.names, name)
        k = bodies.names.index(name)
        if bodies.owner[k] != k:
            raise ValueError(
                f"{what}: rigid body {name!r} is tied to "
                f"{bodies.names[bodies.owner[k]]!r}, and moves with it; pose that one."
            )
        if k in turned_by:
            raise ValueError(
                f"{what}: rigid body {name!r} is turned by motor {turned_by[k]!r}; "
                "impose the motor's angle or torque in `actuation` instead."
            )
        if isinstance(given, rigid.Pose):
            state = rigid.BodyState("held", given)
        else:
            state = rigid.BodyState(given) if isinstance(given, str) else given
        if state.kind == "absent" and bodies.has_nodes[k]:
            raise ValueError(
                f"{what}: rigid body {name!r} has nodes of the mesh and cannot be "
                "absent; only an obstacle beside the robot can."
            )
        kind[k] = rigid.KINDS.index(state.kind)
        poses = state.pose, state.start
        places[:, k] = [v for p in poses for v in (p.translation, p.rotation_vector)]
    return rigid.BodyStateArrays(kind, *places)
