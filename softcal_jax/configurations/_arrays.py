"""Configurations as arrays: what the solver sees, one lane per configuration."""

import equinox as eqx

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import BodyStateArrays

AnyArray = Array | HostArray
"""On the host while a configuration is put together, then on the device."""


class EffectorArrays(eqx.Module):
    """Effectors in rows of three coordinates: points, turns, scalars, forces.

    A marker or the centroid of a group is a point, the orientation of a rigid body a
    turn; a scalar, which is the displacement of an actuator or an angle between two
    bodies, and the force of an actuator take the first place of their row; reactions of
    the ground come last. Configurations with fewer are padded with weight zero.

    Attributes:
        nodes: Nodes that carry each point.
        weights: Their weights [-]; position = sum of weights times node positions.
        turn_body: Body of each turn.
        turn_reference: Orientation that it is counted from, as a matrix [-].
        scalar_index: Actuator and -1, or the two bodies of an angle.
        scalar_axis: Axis of the angle, in the frame of the mesh at rest [-].
        force_actuator: Actuator of each force.
        reaction_nodes: Nodes of each reaction.
        reaction_weights: 1 for each of them, 0 for padding.
        measured: Measured values, or goals, of all rows.
        inverse_std: 1 / standard deviation per coordinate; 0 where not measured.
    """

    nodes: Int[AnyArray, "*batch n_points n_carriers"]
    weights: Float[AnyArray, "*batch n_points n_carriers"]
    turn_body: Int[AnyArray, "*batch n_turns"]
    turn_reference: Float[AnyArray, "*batch n_turns 3 3"]
    scalar_index: Int[AnyArray, "*batch n_scalars 2"]
    scalar_axis: Float[AnyArray, "*batch n_scalars 3"]
    force_actuator: Int[AnyArray, "*batch n_forces"]
    reaction_nodes: Int[AnyArray, "*batch n_reactions n_carriers"]
    reaction_weights: Float[AnyArray, "*batch n_reactions n_carriers"]
    measured: Float[AnyArray, "*batch n_rows 3"]
    inverse_std: Float[AnyArray, "*batch n_rows 3"]

    @property
    def has_forces(self) -> bool:
        """Whether some rows are forces, which depend on more than positions."""
        return self.force_actuator.shape[-1] + self.reaction_nodes.shape[-2] > 0

    @property
    def only_points(self) -> bool:
        """Whether all rows are points, so that they are linear in the positions."""
        return self.nodes.shape[-2] == self.measured.shape[-2]


class ActuationArrays(eqx.Module):
    """What is asked of each actuator.

    Attributes:
        by_displacement: Whether its displacement delta_a is imposed, or its force.
        value: delta_a or lambda_a at full load, in the units of the actuator.
        releasing: Whether it is let go, for the sign of its friction.
    """

    by_displacement: Bool[AnyArray, "*batch n_a"]
    value: Float[AnyArray, "*batch n_a"]
    releasing: Bool[AnyArray, "*batch n_a"]


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
