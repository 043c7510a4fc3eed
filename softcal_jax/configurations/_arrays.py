"""Configurations as arrays: what the solver sees, one lane per configuration."""

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import BodyStateArrays

AnyArray = Array | HostArray
"""On the host while a configuration is put together, then on the device."""


class EffectorArrays(eqx.Module):
    """Measured points; configurations with fewer markers are padded with weight zero.

    Attributes:
        nodes: Nodes that carry each marker.
        weights: Their weights [-]; position = sum of weights times node positions.
        measured: Measured positions, in the frame of the mesh [m].
        inverse_std: 1 / standard deviation per coordinate; 0 where not measured [1/m].
    """

    nodes: Int[AnyArray, "*batch n_markers n_carriers"]
    weights: Float[AnyArray, "*batch n_markers n_carriers"]
    measured: Float[AnyArray, "*batch n_markers 3"]
    inverse_std: Float[AnyArray, "*batch n_markers 3"]

    def positions(
        self, x: Float[AnyArray, "n_points 3"]
    ) -> Float[Array, "n_markers 3"]:
        """Simulated positions for the nodal positions `x` [m]."""
        return jnp.sum(jnp.asarray(self.weights)[:, :, None] * x[self.nodes], axis=1)


class ActuationArrays(eqx.Module):
    """What is asked of each actuator.

    Attributes:
        by_displacement: Whether its displacement delta_a is imposed, or its force.
        value: delta_a or lambda_a at full load, in the units of the actuator.
    """

    by_displacement: Bool[AnyArray, "*batch n_a"]
    value: Float[AnyArray, "*batch n_a"]


class ConfigurationArrays(eqx.Module):
    """Supports, loads and effectors of one configuration, or of a batch.

    The nodes are those of the mesh, then those of the frames of the rigid bodies.

    Attributes:
        fixed: Which coordinates are held.
        imposed: Their displacement, at full load [m].
        force: Dead nodal forces [N].
        gravity: Acceleration of gravity [m/s2].
        bodies: What the rigid bodies do.
        actuation: What is asked of the actuators.
        effectors: The measured points.
    """

    fixed: Bool[AnyArray, "*batch n_points 3"]
    imposed: Float[AnyArray, "*batch n_points 3"]
    force: Float[AnyArray, "*batch n_points 3"]
    gravity: Float[AnyArray, "*batch 3"]
    bodies: BodyStateArrays
    actuation: ActuationArrays
    effectors: EffectorArrays
