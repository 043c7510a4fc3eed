"""Actuators as arrays: displacements delta_a, forces F_a and their derivatives."""

from collections.abc import Mapping, Sequence
from itertools import chain

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_unique
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.actuators._actuator import (
    AbstractActuator,
    AbstractCliques,
    AbstractDisplacedCliques,
    ActuatorGeometry,
    Kind,
    Motor,
    RestState,
    each_clique,
)
from softcal_jax.actuators._cable import FrictionalCables
from softcal_jax.mesh import TetMesh


class ActuatorArrays(Module):
    """All actuators of a robot, as the solver uses them.

    Properties that select code paths, such as `unilateral`, stay static under `jit`.

    Attributes:
        groups: The cliques of all actuators, by type and size.
        rest: Sum of the cliques' contributions at rest, in the units of delta_a.
        motor_body: Index of the rigid body that each motor turns; -1 if not a motor.
    """

    groups: tuple[AbstractCliques, ...]
    rest: Float[Array, " n_a"]
    names: tuple[str, ...] = eqx.field(static=True)
    kinds: tuple[Kind, ...] = eqx.field(static=True)
    motor_body: tuple[int, ...] = eqx.field(static=True)
    has_friction: tuple[bool, ...] = eqx.field(static=True)

    @property
    def unilateral(self) -> Bool[HostArray, " n_a"]:
        """Which lambda_a must not be negative."""
        return np.array([kind.unilateral for kind in self.kinds], bool)

    @property
    def has_displacement(self) -> Bool[HostArray, " n_a"]:
        """Which actuators have a delta_a, which could be imposed."""
        return np.array([k.displacement_unit is not None for k in self.kinds], bool)

    @property
    def motors(self) -> dict[str, int]:
        """Index of the rigid body that each motor turns, by the name of the motor."""
        both = zip(self.names, self.motor_body, strict=True)
        return {name: body for name, body in both if body >= 0}

    @property
    def _rough(self) -> list[FrictionalCables]:
        return [g for g in self.groups if isinstance(g, FrictionalCables)]

    @property
    def symmetric(self) -> bool:
        """Whether all have a potential, which makes their tangent symmetric."""
        return all(group.conservative for group in self.groups)

    def with_friction(
        self, index: int, mu: Float[Array, ""] | float
    ) -> "ActuatorArrays":
        """Change the coefficient of friction [-] of one actuator, differentiably.

        Raises:
            ValueError: If it was made without friction.
        """
        if not self.has_friction[index]:
            raise ValueError(
                f"{self.kinds[index].noun} {self.names[index]!r} has no friction that "
                "could change; make it with a positive one and its pulled_from."
            )
        values = lambda arrays: [group.friction for group in arrays._rough]
        changed = [jnp.where(g.owner == index, mu, g.friction) for g in self._rough]
        return eqx.tree_at(values, self, changed)

    def moving(self, releasing: Bool[Array | HostArray, " n_a"]) -> "ActuatorArrays":
        """Return them with friction opposing their motion, released or pulled."""
        if not any(self.has_friction):
            return self
        senses = lambda arrays: [group.sense for group in arrays._rough]
        released = [jnp.asarray(releasing)[group.owner] for group in self._rough]
        return eqx.tree_at(senses, self, [jnp.where(r, -1.0, 1.0) for r in released])

    def following(
        self, mesh: TetMesh, points: Float[Array, "n_all 3"]
    ) -> "ActuatorArrays":
        """Return them on other points at rest, differentiably [m]."""
        n_actuators = len(self.names)
        groups = tuple(group.following(mesh, n_actuators) for group in self.groups)
        rest = _contributions(groups, points, n_actuators)
        return eqx.tree_at(lambda a: (a.groups, a.rest), self, (groups, rest))

    def displacements(self, x: Float[Array, "n_all 3"]) -> Float[Array, " n_a"]:
        """Compute the displacements delta_a(x) at positions of all nodes [m].

        They are 0 at rest, and for an actuator without a displacement.
        """
        return _contributions(self.groups, x, len(self.names)) - self.rest

    def rows(self, x: Float[Array, "n_all 3"]) -> Float[Array, "n_a n_all 3"]:
        """Compute F_a by rows: forces on the nodes for lambda_a = 1 [N per unit].

        They equal H_a = d delta_a / dx where an actuator has a potential.
        """
        forces = [each_clique(type(g).row, g, x) for g in self.groups]
        return self._rows(self.groups, forces, x)

    def displacement_rows(
        self, x: Float[Array, "n_all 3"]
    ) -> Float[Array, "n_a n_all 3"]:
        """Compute H_a = d delta_a / dx by rows, in the unit of delta_a per metre.

        They are 0 for an actuator without displacement.
        """
        groups = [g for g in self.groups if isinstance(g, AbstractDisplacedCliques)]
        changes = [each_clique(type(g).displacement_row, g, x) for g in groups]
        return self._rows(groups, changes, x)

    def _rows(self, groups, parts, x):
        rows = jnp.zeros((len(self.names), *x.shape), x.dtype)
        for group, part in zip(groups, parts, strict=True):
            rows = rows.at[group.owner[:, None], group.nodes].add(part)
        return rows

    def curvature(
        self, x: Float[Array, "n_all 3"], lambda_a: Float[Array, " n_a"]
    ) -> tuple[Float[Array, "_ _ _"], ...]:
        """Differentiate the forces by the positions, clique by clique [N/m].

        Their sum is d(F_a^T lambda_a)/dx, by rows of forces and columns of positions:
        for each group of `clique_nodes`, square matrices over the coordinates, node by
        node.
        """
        return tuple(
            lambda_a[group.owner][:, None, None]
            * each_clique(type(group).curvature, group, x)
            for group in self.groups
            if group.curved
        )

    def clique_nodes(self) -> tuple[Int[HostArray, "_ _"], ...]:
        """List the nodes of the cliques with entries in the tangent, by group."""
        return tuple(np.asarray(group.nodes) for group in self.groups if group.curved)


def actuator_arrays(
    mesh: TetMesh,
    points: Float[HostArray, "n_all 3"],
    actuators: Sequence[AbstractActuator],
    bodies: Mapping[str, int],
    *,
    at_rest: bool = True,
) -> ActuatorArrays:
    """Attach actuators to the nodes of a mesh and of rigid bodies, see `RestState`.

    `at_rest` evaluates the cliques at rest, which compiles a program; without it, all
    displacements are NaN.

    Raises:
        ValueError: If a name is used twice, or an actuator does not fit the mesh or
            the rigid bodies.
    """
    names = tuple(actuator.name for actuator in actuators)
    check_unique("actuator", names)
    rest = RestState(mesh, points, bodies)
    cliques = [actuator.cliques(rest, a) for a, actuator in enumerate(actuators)]
    alike: dict[tuple, list[AbstractCliques]] = {}
    for some in chain(*cliques):
        sizes = [leaf.shape[1:] for leaf in jax.tree.leaves(some)]
        alike.setdefault((type(some), *sizes), []).append(some)
    # Joined on the host: on the device, each number of actuators is another program.
    join = lambda *leaves: jax.device_put(np.concatenate(leaves))
    groups = tuple(jax.tree.map(join, *same) for same in alike.values())
    return ActuatorArrays(
        groups=groups,
        rest=_at_rest(groups, jax.device_put(points), len(names))
        if at_rest and groups
        else jax.device_put(np.full(len(names), np.nan)),
        names=names,
        kinds=tuple(actuator.kind for actuator in actuators),
        motor_body=tuple(
            bodies[a.body] if isinstance(a, Motor) else -1 for a in actuators
        ),
        has_friction=tuple(
            any(isinstance(c, FrictionalCables) for c in each) for each in cliques
        ),
    )


def _contributions(
    groups: tuple[AbstractCliques, ...], x: Float[Array, "n_all 3"], n_actuators: int
) -> Float[Array, " n_a"]:
    total = jnp.zeros(n_actuators, x.dtype)
    for group in groups:
        if isinstance(group, AbstractDisplacedCliques):
            parts = each_clique(type(group).contribution, group, x)
            total = total.at[group.owner].add(parts)
    return total


_at_rest = eqx.filter_jit(_contributions)


def actuator_geometry(
    arrays: ActuatorArrays, x: Float[HostArray, "n_all 3"]
) -> ActuatorGeometry:
    """Collect what to draw of the actuators at positions of all nodes [m]."""

    def joined(none: HostArray, *parts: HostArray) -> HostArray:
        # Without empty parts: faces of a quadratic mesh have more nodes than `none`.
        some = [part for part in parts if len(part)]
        return np.concatenate(some).astype(none.dtype) if some else none

    pictures = [group.picture(x) for group in arrays.groups]
    return ActuatorGeometry(*map(joined, ActuatorGeometry(), *pictures))
