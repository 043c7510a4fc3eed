"""Rigid bodies and actuators of a robot, as arrays."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.actuators import (
    AbstractActuator,
    ActuatorArrays,
    actuator_arrays,
    actuator_displacements,
)
from softcal_jax.bodies import BodyArrays, RigidBody, body_arrays
from softcal_jax.mesh import Refinement, TetMesh


class Mechanism(Module):
    """Rigid bodies and actuators of a model; either may be missing.

    Node indices run on from those of the mesh to four for each body's frame.

    Attributes:
        points: All nodes at rest, the frame nodes of the bodies last [m].
        bodies: The rigid bodies.
        actuators: The actuators.
        motor_zero: Zero error of each motor, added to the angle of its encoder [rad];
            0 for other actuators.
    """

    points: Float[HostArray, "n_points 3"]
    bodies: BodyArrays
    actuators: ActuatorArrays
    motor_zero: Float[Array, " n_a"]

    @property
    def n_actuators(self) -> int:
        return len(self.actuators.names)

    def displacements(self, x: Float[Array, "n_points 3"]) -> Float[Array, " n_a"]:
        """Compute displacements delta_a at positions x [m], as imposed and measured.

        For a motor it is the reading of its encoder: the angle minus the zero error.
        """
        return actuator_displacements(self.actuators, x) - self.motor_zero

    def refined(self, refinement: Refinement) -> "Mechanism":
        """Return the same bodies and actuators on a finer mesh."""
        groups = tuple(g.refined(refinement) for g in self.actuators.groups)
        frames = self.points[refinement.coarse.n_nodes :]
        return Mechanism(
            points=np.concatenate([refinement.mesh.points, frames]),
            bodies=self.bodies.refined(refinement),
            actuators=replace(self.actuators, groups=groups),
            motor_zero=self.motor_zero,
        )


def build_mechanism(
    mesh: TetMesh,
    bodies: Sequence[RigidBody] = (),
    actuators: Sequence[AbstractActuator] = (),
    *,
    at_rest: bool = True,
) -> Mechanism:
    """Stack the rigid bodies and actuators of a mesh at rest.

    To check or to draw actuators, `at_rest` is not needed, see `actuator_arrays`.

    Raises:
        ValueError: If a body or an actuator does not fit the mesh, or a motor turns a
            body that is tied to another or has a motor already.
    """
    stacked = body_arrays(mesh, bodies)
    points = np.concatenate([mesh.points, stacked.frame_points])
    index_of = {name: k for k, name in enumerate(stacked.names)}
    arrays = actuator_arrays(mesh, points, actuators, index_of, at_rest=at_rest)
    _check_motors(stacked, arrays)
    # Not jnp.zeros, which would compile a program for every number.
    zeros = jax.device_put(np.zeros(len(arrays.names)))
    return Mechanism(points, stacked, arrays, zeros)


def _check_motors(bodies: BodyArrays, actuators: ActuatorArrays) -> None:
    """Raise unless each motor turns a free body of its own, mounted without a turn."""
    turned: dict[int, str] = {}
    for name, body in zip(actuators.names, actuators.motor_body, strict=True):
        if body < 0:
            continue
        driven, root = bodies.names[body], bodies.names[bodies.owner[body]]
        what = f"motor {name!r} turns {driven!r}"
        if driven != root:
            raise ValueError(
                f"{what}, which is tied to {root!r}: let it turn {root!r}."
            )
        if body in turned:
            raise ValueError(f"{what}, and so does motor {turned[body]!r}.")
        if np.any(np.asarray(bodies.mounting_rotation)[body] != 0.0):
            raise ValueError(
                f"{what}, whose mounting turns it already: give that rotation to the "
                "axes of the body, or to the angle."
            )
        turned[body] = name
