"""Configurations as arrays: what the solver sees, one lane per configuration."""

import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, SupportsIndex

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._typing import (
    Array,
    Bool,
    Float,
    HostArray,
    Int,
    is_traced,
    numpy_of,
)
from softcal_jax.bodies import BodyStateArrays, rotation_matrix

AnyArray = Array | HostArray
"""On the host while a configuration is assembled, then on the device."""


class RecordingBase(Module):
    """Offset of the frame of a recording from the frame of the mesh.

    A point at x is read at c + R (x - c) + translation [m], with c the centre of the
    mesh, and an orientation Q as R Q, with the rotation vector of R [rad]: markers, or
    the base of a tracker, are off as one rigid body. Both are 0 unless parameters.
    """

    translation: Float[AnyArray, "*batch 3"]
    rotation: Float[AnyArray, "*batch 3"]

    def point(
        self, x: Float[Array, "n 3"], centre: Float[Array, "3"]
    ) -> Float[Array, "n 3"]:
        R = rotation_matrix(jnp.asarray(self.rotation))
        turned = jnp.sum(R[None] * (x - centre[None])[:, None, :], axis=2)
        return turned + (centre + jnp.asarray(self.translation))[None]

    def turn(self, R: Float[Array, "n 3 3"]) -> Float[Array, "n 3 3"]:
        base = rotation_matrix(jnp.asarray(self.rotation))
        return jnp.sum(base[None, :, :, None] * R[:, None, :, :], axis=2)


class Observed(NamedTuple):
    """A function of a state, like that of `Observation`, and its number of values."""

    name: str
    n_values: int
    function: Callable[..., Any]


class EffectorArrays(Module):
    """Effectors in rows of three coordinates: points, turns, then observations.

    Points are markers and centroids, turns orientations of rigid bodies: a recording
    sees both in a frame of its own. Observations are functions of the state; one with
    fewer than three values uses the first coordinates. Configurations with fewer rows
    are padded with weight zero.

    Attributes:
        nodes: Nodes that carry each point.
        weights: Their weights at the nominal place of the point on the body [-].
        slopes: Change of the weights where the point lies elsewhere on it [1/m].
        which: Index in `movable` of each point that has slopes.
        offset: How far the `movable` points lie from their nominal places [m]; 0 unless
            they are parameters.
        turn_body: Body of each turn.
        turn_reference: Orientation from which each turn is counted, as a matrix [-].
        measured: Measured values, or goals, of all rows.
        inverse_std: 1 / standard deviation per coordinate; 0 where not measured.
        base: Offset of the frame of the recording.
        is_observed: Which of the observations this configuration has.
        movable: Names of the markers and frames whose place can be a parameter.
        observed: Functions of the observations, the same in all configurations.
    """

    nodes: Int[AnyArray, "*batch n_points n_carriers"]
    weights: Float[AnyArray, "*batch n_points n_carriers"]
    slopes: Float[AnyArray, "*batch n_points n_carriers 3"]
    which: Int[AnyArray, "*batch n_points"]
    offset: Float[AnyArray, "*batch n_movable 3"]
    turn_body: Int[AnyArray, "*batch n_turns"]
    turn_reference: Float[AnyArray, "*batch n_turns 3 3"]
    measured: Float[AnyArray, "*batch n_rows 3"]
    inverse_std: Float[AnyArray, "*batch n_rows 3"]
    base: RecordingBase
    is_observed: Bool[AnyArray, "*batch n_observed"]
    movable: tuple[str, ...] = eqx.field(static=True, default=())
    observed: tuple[Observed, ...] = eqx.field(static=True, default=())

    @property
    def shares(self) -> Float[Array, "n_points n_carriers"]:
        """Weights at the places of the points; position = sum of them times nodes."""
        if not self.movable:
            return jnp.asarray(self.weights)
        offset = jnp.asarray(self.offset)[jnp.asarray(self.which)]
        change = jnp.sum(jnp.asarray(self.slopes) * offset[:, None, :], axis=2)
        return jnp.asarray(self.weights) + change


class ActuationArrays(Module):
    """Imposed force or displacement of each actuator.

    Attributes:
        by_displacement: Whether its displacement delta_a is imposed, or its force.
        value: delta_a or lambda_a at full load, in the units of the actuator.
        force_factor: Factor on an imposed force [-]; 1 unless it is a parameter.
        releasing: Whether it was last released, which sets the sign of its friction.
    """

    by_displacement: Bool[AnyArray, "*batch n_a"]
    value: Float[AnyArray, "*batch n_a"]
    force_factor: Float[AnyArray, "*batch n_a"]
    releasing: Bool[AnyArray, "*batch n_a"]
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def forces(self) -> Float[Array, "*batch n_a"]:
        """Forces lambda_a at full load where they are imposed, 0 elsewhere."""
        xp = numpy_of(self)
        factor, value = xp.asarray(self.force_factor), xp.asarray(self.value)
        by_displacement = xp.asarray(self.by_displacement)
        return jax.device_put(xp.where(by_displacement, 0.0, factor * value))


class Springs(Module):
    """Elastic supports: springs between nodes and the places where they are held.

    The energy of a support is k/2 times the integral of |u - rest|^2 over its faces at
    rest, with u of the shape functions N. On faces of quadratic tets, springs between
    nodes add to those of single nodes: int N_a N_b = delta_ab int N_a + coupling_ab.
    Linear tets have none: there the integral is by nodes.

    Attributes:
        area: Area of each node in each support, along the axes of the support [m2].
        stiffness: Force per area and displacement of each support [N/m3].
        rest: Displacement at full load at which they exert no force [m].
        tets: The tet behind each face of all supports; none for linear tets.
        support: The support of each of these faces.
        coupling: Areas of pairs of nodes of these tets; rows sum to zero [m2].
    """

    area: Float[AnyArray, "*batch n_springs n_points 3"]
    stiffness: Float[AnyArray, "*batch n_springs"]
    rest: Float[AnyArray, "*batch n_points 3"]
    tets: Int[AnyArray, "*batch n_faces"]
    support: Int[AnyArray, "*batch n_faces"]
    coupling: Float[AnyArray, "*batch n_faces n_en n_en"]
    names: tuple[str, ...] = eqx.field(static=True)

    def coefficients(self) -> Float[Array, "n_points 3"]:
        """Compute the stiffness on each coordinate of each node [N/m]."""
        by_support = jnp.asarray(self.stiffness)[:, None, None]
        return jnp.sum(by_support * jnp.asarray(self.area), axis=0)

    def between_nodes(self) -> Float[Array, "n_faces n_en n_en 3"]:
        """Compute the stiffness between nodes of a tet, along the axes [N/m]."""
        along = jnp.any(jnp.asarray(self.area) > 0.0, axis=1)
        by_axis = jnp.where(along, jnp.asarray(self.stiffness)[:, None], 0.0)
        of_face = by_axis[jnp.asarray(self.support)][:, None, None, :]
        return of_face * jnp.asarray(self.coupling)[:, :, :, None]


_CANCELS = 1e-9
"""Resultant of a load, over the root of its squared forces, that is rounding [-]."""


class DeadLoads(Module):
    """Dead nodal forces [N] by the names of loads, a factor and an offset of each.

    The factor [-] is 1 and the offset [N] is 0 unless they are parameters. Those that
    are `spread` are shared out by areas or lengths at rest.
    """

    force: Float[AnyArray, "*batch n_loads n_points 3"]
    factor: Float[AnyArray, "*batch n_loads"]
    offset: Float[AnyArray, "*batch n_loads 3"]
    spread: Bool[AnyArray, "*batch n_loads"]
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def shares(self) -> Float[AnyArray, "*batch n_loads n_points"]:
        """How the nodes share an offset: as they share the resultant of the load [-].

        Zero for a load whose forces cancel, up to rounding.
        """
        xp = numpy_of(self.force)
        force = xp.asarray(self.force)
        resultant = xp.sum(force, axis=-2, keepdims=True)
        square = xp.sum(resultant**2, axis=-1)
        exists = square > _CANCELS**2 * xp.sum(force**2, axis=(-2, -1))[..., None]
        along = xp.sum(force * resultant, axis=-1) / xp.where(exists, square, 1.0)
        return xp.where(exists, along, 0.0)


class ConfigurationArrays(Module):
    """Supports, loads and effectors of one configuration, or of a batch.

    A batch has a length; `batch[0]` is its first configuration, a slice a batch. The
    nodes are those of the mesh, then those of the frames of the rigid bodies.

    Attributes:
        key: `name_key` of the configuration and of its recording: arrays hold no text.
        after: That of the configuration which it has to follow, 0 for none.
        fixed: Which coordinates are held.
        imposed: Their displacement, at full load [m].
        gravity: Acceleration of gravity as stated [m/s2].
        tilt: Angles by which its direction is off, about two axes perpendicular to it
            [rad]; 0 unless they are parameters. See `acceleration`.
        stages: Displacements at the equilibria before this one, in order, that friction
            remembers [m]; nan until `following` says them. As many as the longest of
            the batch has.
        is_stage: Which of them there are.
    """

    key: Int[AnyArray, "*batch 2"]
    after: Int[AnyArray, "*batch"]
    fixed: Bool[AnyArray, "*batch n_points 3"]
    imposed: Float[AnyArray, "*batch n_points 3"]
    springs: Springs
    loads: DeadLoads
    gravity: Float[AnyArray, "*batch 3"]
    tilt: Float[AnyArray, "*batch 2"]
    bodies: BodyStateArrays
    actuation: ActuationArrays
    effectors: EffectorArrays
    stages: Float[AnyArray, "*batch n_stages n_points 3"]
    is_stage: Bool[AnyArray, "*batch n_stages"]

    @property
    def is_batch(self) -> bool:
        """Whether there is a leading axis."""
        return np.ndim(self.gravity) > 1

    def _words(self) -> str:
        what = f"a batch of {len(self)}" if self.is_batch else "one configuration"
        return f"{what}, {np.shape(self.fixed)[-2]} nodes"

    def __len__(self) -> int:
        """Return the number of configurations of a batch."""
        if not self.is_batch:
            raise TypeError("this is one configuration, and no batch of them.")
        return len(self.gravity)

    def __bool__(self) -> bool:
        """Return True, also for one configuration, which has no length."""
        return True

    def __iter__(self) -> "Iterator[ConfigurationArrays]":
        """Go through the configurations of a batch."""
        return (self[i] for i in range(len(self)))

    def __getitem__(self, index: SupportsIndex | slice) -> "ConfigurationArrays":
        """Return one configuration of a batch, or a shorter batch."""
        n = len(self)
        if not isinstance(index, slice):
            index = operator.index(index)
            if not -n <= index < n:
                raise IndexError(f"there is no lane {index}: the batch has {n}.")
        if any(map(is_traced, jax.tree.leaves(self))):
            return jax.tree.map(lambda leaf: leaf[index], self)
        return lane_of(self, index)

    def without_forces(self) -> "ConfigurationArrays":
        """Return it with zero in place of the forces imposed on actuators."""
        acting = self.actuation
        value = np.where(acting.by_displacement, acting.value, 0.0)
        return eqx.tree_at(lambda c: c.actuation.value, self, value)

    def following(
        self, earlier: "ConfigurationArrays", displacement: Float[AnyArray, "n 3"]
    ) -> "ConfigurationArrays":
        """Return it as it comes `after` another lane, from its equilibrium [m].

        Friction remembers that, and what that had come after. Obstacles start where
        they did there.

        Raises:
            ValueError: If it is not to follow that one, or that has to follow another
                one first.
        """
        if not any(map(is_traced, (self.after, earlier.key, earlier.after))):
            if self.after != np.asarray(earlier.key)[0] or earlier.after:
                what = "is another one"
                if earlier.after:
                    what = "has to follow another one first"
                raise ValueError(
                    "a lane follows the one that `after` of its configuration names, "
                    f"of a batch lanes(model, poses) of both; the one given {what}."
                )
        none = np.zeros((), np.int64)
        if np.shape(self.is_stage)[-1] == 0:  # nothing remembers
            return eqx.tree_at(lambda c: c.after, self, none)
        xp = numpy_of(displacement, earlier.stages)
        join = lambda old, new: xp.concatenate([xp.asarray(old)[1:], new[None]])
        stages = join(earlier.stages, xp.asarray(displacement))
        is_stage = join(earlier.is_stage, xp.ones((), bool))
        starts = lambda c: (c.bodies.start_translation, c.bodies.start_rotation)
        new = *starts(earlier), stages, is_stage, none
        return eqx.tree_at(
            lambda c: (*starts(c), c.stages, c.is_stage, c.after), self, new
        )

    @property
    def acceleration(self) -> Float[Array, "3"]:
        """Gravity after its tilt [m/s2].

        The first axis of the tilt is the axis of the mesh that is farthest from
        gravity, made perpendicular to it; the second is perpendicular to both.
        """
        g, tilt = jnp.asarray(self.gravity), jnp.asarray(self.tilt)
        square = jnp.sum(g * g)
        start = jnp.eye(3)[jnp.argmin(jnp.abs(g))]
        first = start - g * jnp.sum(start * g) / jnp.where(square > 0.0, square, 1.0)
        first = first / jnp.linalg.norm(first)
        second = jnp.cross(g, first) / jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
        R = rotation_matrix(tilt[0] * first + tilt[1] * second)
        return jnp.sum(R * g[None, :], axis=1)

    @property
    def is_spread(self) -> Bool[Array, ""]:
        """Whether it has a load or an elastic support by areas or lengths at rest."""
        elastic = jnp.any(jnp.asarray(self.springs.stiffness) > 0.0)
        return elastic | jnp.any(jnp.asarray(self.loads.spread))

    @property
    def dead_loads(self) -> Float[Array, "n_points 3"]:
        """Sum of the dead nodal forces with their factors and offsets [N]."""
        loads = self.loads
        shares, offset = map(jnp.asarray, (loads.shares, loads.offset))
        of_each = jnp.asarray(loads.factor)[:, None, None] * jnp.asarray(loads.force)
        return jnp.sum(of_each + shares[:, :, None] * offset[:, None], axis=0)


def earlier_lanes(lanes: Sequence[ConfigurationArrays]) -> list[int | None]:
    """Return the index of the lane that each is to follow, None for none.

    Raises:
        ValueError: If it is not among them.
    """
    own = np.array([np.asarray(lane.key)[0] for lane in lanes])
    after = np.array([np.asarray(lane.after) for lane in lanes])
    earlier: list[int | None] = [None] * len(lanes)
    for c in np.flatnonzero(after).tolist():
        found = np.flatnonzero(own == after[c])
        if not found.size:
            raise ValueError(
                f"configuration {c} comes after one that is not among the {len(lanes)} "
                "that are solved: solve that too, or give this one its equilibrium by "
                "lane.following(earlier_lane, solution.displacement)."
            )
        earlier[c] = int(found[0])
    return earlier


def in_order(earlier: Sequence[int | None]) -> list[list[int]]:
    """Sort lanes into groups, of which each follows lanes of those before alone."""
    depth: list[int] = []
    for c in range(len(earlier)):
        d, p = 0, earlier[c]
        while p is not None:
            d, p = d + 1, earlier[p]
        depth.append(d)
    groups = range(max(depth, default=-1) + 1)
    return [[c for c, d in enumerate(depth) if d == g] for g in groups]


def following_each_other(
    lanes: Sequence[ConfigurationArrays], displacement: Float[AnyArray, "n n_points 3"]
) -> list[ConfigurationArrays]:
    """Return lanes as each follows the equilibrium of its earlier one [m]."""
    earlier, done = earlier_lanes(lanes), dict[int, ConfigurationArrays]()
    for c in [c for group in in_order(earlier) for c in group]:
        p, done[c] = earlier[c], lanes[c]
        if p is not None:
            done[c] = lanes[c].following(done[p], displacement[p])
    return [done[c] for c in range(len(lanes))]
