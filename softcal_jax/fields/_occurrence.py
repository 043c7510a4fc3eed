"""Where an error of the setup, the loads or a recording can occur, and who shares it.

An error of what a configuration lacks cannot occur, and nothing can be learnt of it.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Bool, HostArray

Scope = tuple[Hashable | None, ...]
"""For each configuration a key, None where the error cannot occur; configurations with
the same key have the same error."""


class Poses(Module):
    """Configurations of a model, as the functions below ask for them.

    Attributes:
        model: The model.
        arrays: The configurations as arrays on the host.
        recordings: Name of the recording of each.
    """

    model: Any
    arrays: Any
    recordings: Sequence[str]

    def shared(self, present: Bool[HostArray, " n_c"]) -> Scope:
        """Return one error for all configurations that have what it belongs to."""
        return tuple("" if has_it else None for has_it in present)


Occurs = Callable[[Poses], Mapping[str, Scope]]
"""Scopes of an error by the name of what it belongs to, like the motor."""


def each_of(names: Sequence[str], present: HostArray, poses: Poses) -> dict[str, Scope]:
    """Return one error for each name, of the configurations that have it."""
    return {
        name: poses.shared(flags)
        for name, flags in zip(names, present.T, strict=True)
        if name
    }


def with_gravity(poses: Poses) -> dict[str, Scope]:
    """Return one error for all configurations that state the same gravity."""
    gravity = [tuple(g) for g in np.asarray(poses.arrays.gravity)]
    return {"": tuple(g if any(g) else None for g in gravity)}


def of_recordings(poses: Poses) -> dict[str, Scope]:
    """Return one error for each recording."""
    return {"": tuple(poses.recordings)}


def with_loads(poses: Poses) -> dict[str, Scope]:
    """Return one error for each name of dead loads."""
    loads = poses.arrays.loads
    return each_of(loads.names, np.any(loads.force, axis=(2, 3)), poses)


def with_forces(poses: Poses) -> dict[str, Scope]:
    """Return one error for each actuator, where its force is imposed."""
    actuation = poses.arrays.actuation
    forced = ~actuation.by_displacement & (actuation.value != 0.0)
    return each_of(actuation.names, forced, poses)


def with_springs(poses: Poses) -> dict[str, Scope]:
    """Return one error for each elastic support."""
    springs = poses.arrays.springs
    return each_of(springs.names, springs.stiffness > 0.0, poses)


def driven_by_angle(poses: Poses) -> dict[str, Scope]:
    """Return one error for each motor, where its angle is imposed."""
    actuators = poses.model.mechanism.actuators
    of_motor = np.asarray(actuators.motor_body) >= 0
    names = np.where(of_motor, actuators.names, "").tolist()
    return each_of(names, poses.arrays.actuation.by_displacement, poses)


def grounded_bodies(poses: Poses) -> Bool[HostArray, "n_c n_b"]:
    """Flag the bodies that are held, hinged or on a motor, or tied to such a body."""
    bodies = poses.model.mechanism.bodies
    driven = np.isin(
        np.arange(bodies.n_bodies), poses.model.mechanism.actuators.motor_body
    )
    return (~poses.arrays.bodies.is_free | driven)[:, bodies.owner]


def with_mounting(poses: Poses) -> dict[str, Scope]:
    """Return one error for each rigid body, where it is grounded."""
    names = poses.model.mechanism.bodies.names
    return each_of(names, grounded_bodies(poses), poses)
