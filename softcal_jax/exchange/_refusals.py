"""What several formats cannot hold of a robot."""

from collections.abc import Sequence

import numpy as np

from softcal_jax.actuators import AbstractActuator, free_rim_nodes
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model


def check_no_bodies(model: Model, format: str) -> None:
    """Raise ValueError if a robot has rigid bodies, whose nodes turn together."""
    names = model.mechanism.bodies.names
    if names:
        raise ValueError(
            f"the robot has rigid bodies ({', '.join(names)}), which are not written "
            f"to {format}. A body that is held: name its nodes in `supports` instead. "
            "A plate that only carries markers: leave it out, give [markers] "
            "`max_distance` and `base_radius`, and calibrate again."
        )


def check_actuators(
    model: Model, known: Sequence[type[AbstractActuator]], format: str
) -> None:
    """Raise ValueError if an actuator is of no known type, or has friction."""
    actuators, kinds = model.mechanism.actuators, [actuator.kind for actuator in known]
    every = zip(actuators.names, actuators.kinds, actuators.has_friction, strict=True)
    for name, kind, rough in every:
        if rough or kind not in kinds:
            raise ValueError(
                f"the {kind.noun}{' with friction' * rough} {name!r} has no "
                f"counterpart in {format}. Take it out of the project."
            )


def check_rim(
    model: Model, configuration: ConfigurationArrays, actuator: int, format: str
) -> None:
    """Raise ValueError if the lid of a chamber presses on a rim that is not held."""
    actuators, fixed = model.mechanism.actuators, np.asarray(configuration.fixed)
    free = free_rim_nodes(actuators.groups, actuator, fixed)
    if free:
        raise ValueError(
            f"the chamber {actuators.names[actuator]!r}: the pressure on what seals it "
            f"acts on the rim of its opening, of which {free} nodes are not held, and "
            f"{format} has no lid. Hold the rim, or close the cavity in the mesh."
        )
