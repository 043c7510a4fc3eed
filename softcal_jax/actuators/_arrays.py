"""Actuators as arrays: displacements delta_a, rows H_a and their derivatives."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.actuators._actuator import AbstractActuator, Kind, RestState
from softcal_jax.actuators._cliques import (
    AbstractCliques,
    AbstractPotentialCliques,
    each_clique,
)
from softcal_jax.actuators._motor import Motor
from softcal_jax.mesh import TetMesh


class ActuatorArrays(eqx.Module):
    """All actuators of a robot: what the solver sees.

    What a program decides by, such as `unilateral`, stays on the host under `jit`.

    Attributes:
        groups: The cliques of all actuators, by type.
        rest: Sum of the contributions at rest, in the units of delta_a.
        names: Name of each actuator.
        kinds: Its kind, with the units of lambda_a and delta_a.
        motor_body: Number of the rigid body that it turns; -1 if it is no motor.
    """

    groups: tuple[AbstractCliques, ...]
    rest: Float[Array, " n_a"]
    names: tuple[str, ...] = eqx.field(static=True)
    kinds: tuple[Kind, ...] = eqx.field(static=True)
    motor_body: tuple[int, ...] = eqx.field(static=True)

    @property
    def n_actuators(self) -> int:
        """Number of actuators."""
        return len(self.names)

    @property
    def unilateral(self) -> Bool[HostArray, " n_a"]:
        """Which lambda_a must not be negative."""
        return np.array([kind.unilateral for kind in self.kinds], bool)

    @property
    def has_displacement(self) -> Bool[HostArray, " n_a"]:
        """Which actuators have a delta_a, so that it can be imposed."""
        return np.array([k.displacement_unit is not None for k in self.kinds], bool)

    @property
    def symmetric(self) -> bool:
        """Whether all have a potential, which makes their tangent symmetric."""
        return bool(np.all(self.has_displacement))


def actuator_arrays(
    mesh: TetMesh,
    points: Float[HostArray, "n_all 3"],
    actuators: Sequence[AbstractActuator],
    bodies: Mapping[str, int],
) -> ActuatorArrays:
    """Attaches actuators to the nodes of a mesh and of rigid bodies.

    Args:
        mesh: The mesh.
        points: Rest positions of the mesh's nodes, then of four nodes for each rigid
            body k, n_nodes + 4 k onwards: the origin of its frame, and the ends of its
            three axes, orthogonal and of one length [m].
        actuators: The actuators, none or more, with names of their own.
        bodies: The number k of each rigid body, by name.

    Returns:
        The arrays; lambda_a and delta_a have the order of `actuators`.

    Raises:
        ValueError: If a name is used twice, or an actuator does not fit the mesh or
            the rigid bodies.
    """
    names = tuple(actuator.name for actuator in actuators)
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(
            f"actuator {repeated[0]!r} is named more than once; give each actuator a "
            "name of its own."
        )
    rest = RestState(mesh, points, bodies)
    by_type: dict[type, list[AbstractCliques]] = {}
    for owner, actuator in enumerate(actuators):
        cliques = actuator.cliques(rest, owner)
        by_type.setdefault(type(cliques), []).append(cliques)
    groups = tuple(
        jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *same)
        for same in by_type.values()
    )
    return ActuatorArrays(
        groups=groups,
        rest=_contributions(groups, jnp.asarray(points), len(names)),
        names=names,
        kinds=tuple(actuator.kind for actuator in actuators),
        motor_body=tuple(
            bodies[a.body] if isinstance(a, Motor) else -1 for a in actuators
        ),
    )


def actuator_displacements(
    arrays: ActuatorArrays, x: Float[Array, "n_all 3"]
) -> Float[Array, " n_a"]:
    """Displacements delta_a(x) of the actuators, zero at rest.

    Args:
        arrays: The actuators.
        x: Positions of the mesh's nodes and the frame nodes [m].

    Returns:
        In the units of their kinds; 0 for an actuator without a displacement.
    """
    return _contributions(arrays.groups, x, arrays.n_actuators) - arrays.rest


def actuator_rows(
    arrays: ActuatorArrays, x: Float[Array, "n_all 3"]
) -> Float[Array, "n_a n_all 3"]:
    """Rows H_a = d delta_a / dx: the force on all nodes for lambda_a = 1.

    An actuator without a displacement has the force that it exerts all the same.

    Args:
        arrays: The actuators.
        x: Positions of the mesh's nodes and the frame nodes [m].

    Returns:
        The rows, in the unit of delta_a per metre, [N] per unit of lambda_a.
    """
    rows = jnp.zeros((arrays.n_actuators, *x.shape), x.dtype)
    for group in arrays.groups:
        forces = each_clique(type(group).row, group, x)
        rows = rows.at[group.owner[:, None], group.nodes].add(forces)
    return rows


def curvature_entries(
    arrays: ActuatorArrays, x: Float[Array, "n_all 3"], lambda_a: Float[Array, " n_a"]
) -> tuple[Float[Array, "_ _ _"], ...]:
    """Derivatives of the actuators' forces by the positions, clique by clique.

    Their sum is d(H_a^T lambda_a)/dx, which the tangent of equilibrium holds with a
    minus. Symmetric, lambda_a times the Hessian of delta_a, except on the faces of a
    surface pressure: there a row is the force, a column the position.

    Args:
        arrays: The actuators.
        x: Positions of the mesh's nodes and the frame nodes [m].
        lambda_a: Their forces, in the units of their kinds.

    Returns:
        For each group of `clique_nodes`, square matrices over the coordinates of its
        cliques, node by node [N/m].
    """
    return tuple(
        lambda_a[group.owner][:, None, None]
        * each_clique(type(group).curvature, group, x)
        for group in arrays.groups
        if group.curved
    )


def clique_nodes(arrays: ActuatorArrays) -> tuple[Int[HostArray, "_ _"], ...]:
    """Nodes of the cliques that have entries in the tangent, group by group.

    On the host, before `jit`. A node that stands twice in a clique is padding whose
    entries are zero.

    Args:
        arrays: The actuators.
    """
    return tuple(np.asarray(group.nodes) for group in arrays.groups if group.curved)


def _contributions(
    groups: tuple[AbstractCliques, ...], x: Float[Array, "n_all 3"], n_actuators: int
) -> Float[Array, " n_a"]:
    """Sum of the contributions of the cliques of each actuator."""
    total = jnp.zeros(n_actuators, x.dtype)
    for group in groups:
        if isinstance(group, AbstractPotentialCliques):
            parts = each_clique(type(group).contribution, group, x)
            total = total.at[group.owner].add(parts)
    return total
