"""Configurations with other measured values."""

from dataclasses import replace

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations._configuration import Configuration, effector_rows
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh


def measured_as(
    c: Configuration,
    values: Float[HostArray, "n 3"],
    mesh: TetMesh,
    mechanism: Mechanism,
) -> Configuration:
    """Replace the measured values of a configuration.

    Args:
        c: The configuration.
        values: Values of its effectors in their order; turns from rest.
        mesh: The mesh.
        mechanism: Rigid bodies and actuators of the model.
    """
    n_markers = 0 if c.markers is None else len(c.markers.names)
    used, effectors = n_markers, []
    for effector in c.effectors:
        n = len(effector.rows(mesh, mechanism))
        effectors.append(effector.measured_as(values[used : used + n], mechanism))
        used += n
    measured = None if c.markers is None else values[:n_markers]
    return replace(c, measured=measured, effectors=tuple(effectors))


def measured_at_rest(
    c: Configuration, mesh: TetMesh, mechanism: Mechanism
) -> Configuration:
    """Give all effectors of a configuration placeholder values, so that all count.

    Args:
        c: The configuration.
        mesh: The mesh.
        mechanism: Rigid bodies and actuators of the model.

    Raises:
        ValueError: If it has neither markers nor other effectors.
    """
    if c.markers is None and not c.effectors:
        raise ValueError(
            f"configuration {c.name!r} has no markers and no other effectors: it sees "
            "nothing."
        )
    rest = np.zeros((len(effector_rows(mesh, c, mechanism)), 3))
    if c.markers is not None:
        rest[: len(c.markers.names)] = c.markers.positions
    return measured_as(c, rest, mesh, mechanism)
