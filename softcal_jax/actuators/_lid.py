"""Lids of chambers: cones from the rim of an opening to its mean, without material."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.actuators._actuator import (
    AbstractPotentialCliques,
    ActuatorGeometry,
    RestState,
    owned,
)


class OpenEdges(NamedTuple):
    """Edges that faces do not traverse equally often in both directions.

    `ends` follow the direction that prevails, which occurs `excess` times more often.
    """

    ends: Int[HostArray, "n_edges 2"]
    mids: Int[HostArray, "n_edges n_mids"]
    excess: Int[HostArray, " n_edges"]


def open_edges(faces: Int[HostArray, "n_faces n_fn"]) -> OpenEdges:
    """Find the open edges of a surface, given its faces with consistent normals."""
    corners = faces[:, :3]
    ways = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    mids = faces[:, 3:].reshape(len(ways), -1)
    _, inverse = np.unique(np.sort(ways, axis=1), axis=0, return_inverse=True)
    sense = np.where(ways[:, 0] < ways[:, 1], 1, -1)
    edge = inverse.ravel()
    total = np.zeros(edge.max() + 1, int)
    np.add.at(total, edge, sense)
    excess = total[edge] * sense
    open_ways = np.flatnonzero(excess > 0)
    chosen = open_ways[np.unique(edge[open_ways], return_index=True)[1]]
    return OpenEdges(ways[chosen], mids[chosen], excess[chosen])


def rims(
    edges: OpenEdges, points: Float[HostArray, "n_all 3"], owner: str
) -> list[Int[HostArray, " m"]]:
    """Link open edges to closed rings of corners, with mid nodes between them."""
    starts, count = np.unique(edges.ends[:, 0], return_counts=True)
    crowded = starts[count > 1].tolist() + edges.ends[edges.excess > 1, 0].tolist()
    if crowded:
        where = readable_values(points[crowded[0]].tolist(), "m")
        raise ValueError(
            f"{owner}: openings of the wall meet at {where}. Choose the faces of the "
            "wall so that they are apart."
        )
    following = {int(a): k for k, a in enumerate(edges.ends[:, 0])}
    rings = []
    while following:
        node, ring = next(iter(following)), []
        while node in following:
            k = following.pop(node)
            ring += [node, *edges.mids[k].tolist()]
            node = int(edges.ends[k, 1])
        rings.append(np.array(ring, edges.ends.dtype))
    return rings


def lid_cone(
    arm: Float[Array | HostArray, "m 3"],
    weights: Float[Array | HostArray, " m"],
    *,
    quadratic: bool,
) -> Any:
    """Compute the volume of the cone from the origin to a lid, given its rim [m3]."""
    xp: Any = np if isinstance(arm, np.ndarray) else jnp
    if quadratic:
        # The integral of x cross dx along the parabola through a, m and b.
        a, m = arm[0::2], arm[1::2]
        b = xp.roll(a, -1, axis=0)
        turns = 4.0 * (xp.cross(a, m) + xp.cross(m, b)) - xp.cross(a, b)
        area = xp.sum(turns, axis=0) / 6.0
    else:
        area = 0.5 * xp.sum(xp.cross(arm, xp.roll(arm, -1, axis=0)), axis=0)
    return xp.dot(weights @ arm, area) / 3.0


class ChamberLids(AbstractPotentialCliques):
    """Lids of chambers, one ring of nodes each; each adds a cone's volume to delta_a.

    With c the mean of the rim, n dA out of the chamber, and o any point, the lid adds
    1/3 integral of (x - o) . n dA = 1/3 (c - o) . A, since (x - c) . n vanishes on a
    cone with the apex c. Its vector area is that of its rim, A = 1/2 integral of
    x cross dx.

    Attributes:
        weights: Shares of the nodes in the mean of the rim, by its length at rest [-].
        centre: The point o, the same as that of the wall [m].
        quadratic: Whether every second node is a mid node.
    """

    weights: Float[Array, "*cliques m"]
    centre: Float[Array, "*cliques 3"]
    quadratic: bool = eqx.field(static=True)

    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        return lid_cone(x - self.centre[None], self.weights, quadratic=self.quadratic)

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        return ActuatorGeometry()  # neither material nor faces


def free_rim_nodes(
    groups: Iterable[object], owner: int, fixed: Bool[HostArray, "n_points 3"]
) -> int:
    """Count the nodes on the rims of an actuator's lids that are not held.

    Where the rim is held, the supports bear the pressure on the lid, so that programs
    without lids need only the pressure on the wall.
    """
    lids = [group for group in groups if isinstance(group, ChamberLids)]
    rims = [np.asarray(each.nodes)[np.asarray(each.owner) == owner] for each in lids]
    return len({node for rim in rims for node in rim.ravel() if not fixed[node].all()})


def lid(
    rim: Int[HostArray, " m"],
    rest: RestState,
    centre: Float[HostArray, "3"],
    owner: int,
) -> ChamberLids:
    """Close an opening, given by its ring of nodes."""
    quadratic = rest.mesh.order == 2
    weights = jax.device_put(_shares(rest.points[rim], quadratic)[None])
    of, o = owned(rim[None], owner), jax.device_put(centre[None])
    return ChamberLids(*of, weights, o, quadratic=quadratic)


def _shares(x: Float[HostArray, "m 3"], quadratic: bool) -> Float[HostArray, " m"]:
    """Integrate the shape functions along a ring of straight edges; they sum to 1."""
    corners = x[:: 1 + quadratic]
    after = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    both = after + np.roll(after, 1)
    if quadratic:
        shares = np.stack([both / 6.0, after / 1.5], axis=1).ravel()
    else:
        shares = 0.5 * both
    return shares / after.sum()
