"""Cables: a path through guide points, shortened by its tension."""

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._names import suggestion
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators._actuator import (
    AbstractActuator,
    Kind,
    RestState,
    Vector,
    as_vector,
    check_vector,
)
from softcal_jax.actuators._cliques import AbstractPotentialCliques

_COINCIDENT = 1e-9
"""Distance of guides that counts as none, relative to the extent of the cable."""


class Guide(eqx.Module):
    """A point that a cable runs through, or ends at.

    Attributes:
        point: Where it is at rest [m].
        on: What carries it: "mesh" for a material point of the body, "ground" for a
            point that never moves, or the name of a rigid body.
    """

    point: Float[HostArray, "3"] = eqx.field(converter=as_vector)
    on: str = "mesh"

    def __check_init__(self):
        check_vector("the point of a guide", "m", self.point)


def _as_guides(guides: Sequence[Guide | Vector]) -> tuple[Guide, ...]:
    return tuple(g if isinstance(g, Guide) else Guide(g) for g in guides)


class Cable(AbstractActuator):
    """A cable without friction along straight segments between its guides.

    delta_a = l(X) - l(x) with l the length of the path: the shortening since rest [m].
    lambda_a is the tension [N], which cannot push.

    Attributes:
        name: Its name.
        guides: The points that it runs through, both ends included; three bare numbers
            are a guide on the mesh.
    """

    name: str
    guides: tuple[Guide, ...] = eqx.field(converter=_as_guides)
    kind: ClassVar[Kind] = Kind("cable", "N", "m", unilateral=True)

    def __check_init__(self):
        if len(self.guides) < 2:
            raise ValueError(
                f"{self.label} has {len(self.guides)} guide(s), expected at least "
                "two: give both ends of the cable, and the points between them."
            )
        points = np.stack([guide.point for guide in self.guides])
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        near = np.flatnonzero(gaps <= _COINCIDENT * np.ptp(points, axis=0).max())
        if near.size:
            i = near[0]
            raise ValueError(
                f"{self.label}: guides {i} and {i + 1} are both at "
                f"{points[i].tolist()} m, expected points apart, because a segment of "
                "no length has no direction. Leave one of them out."
            )
        if all(map(_fixed_length, self.guides, self.guides[1:])):
            on = self.guides[0].on
            raise ValueError(
                f"{self.label}: all guides are on {on!r}, so its length cannot "
                "change. Put at least one on the mesh or on another rigid body."
            )

    def cliques(self, rest: RestState, owner: int) -> "CableSegments":
        """The segments whose length can change.

        Raises:
            ValueError: If a guide lies outside the mesh, or its body is unknown.
        """
        m = 2 * max(4, rest.mesh.tets.shape[1])
        carriers = [self._carriers(i, rest) for i in range(len(self.guides))]
        segments = [
            _segment(a, b, m)
            for (a, b), ends in zip(
                pairwise(carriers), pairwise(self.guides), strict=True
            )
            if not _fixed_length(*ends)
        ]
        nodes, weights, fixed = (
            jnp.asarray(np.stack(part)) for part in zip(*segments, strict=True)
        )
        return CableSegments(
            nodes, jnp.full(len(segments), owner, nodes.dtype), weights, fixed
        )

    def _carriers(self, i: int, rest: RestState):
        """Nodes and weights of a guide, and the part of its position that is fixed."""
        guide, owner = self.guides[i], f"{self.label}, guide {i}"
        if guide.on == "ground":
            return np.zeros(0, np.int32), np.zeros(0), guide.point
        if guide.on == "mesh":
            return *rest.on_mesh(guide.point, owner), np.zeros(3)
        if guide.on not in rest.bodies:
            known = ["mesh", "ground", *rest.bodies]
            raise ValueError(
                f"{owner} is on {guide.on!r}, expected 'mesh', 'ground' or the name "
                f"of a rigid body.{suggestion(guide.on, known)} Rigid bodies: "
                f"{', '.join(map(repr, rest.bodies)) or 'none'}."
            )
        return *rest.on_body(guide.point, guide.on, owner), np.zeros(3)


def _fixed_length(a: Guide, b: Guide) -> bool:
    """Whether two guides never change their distance."""
    return a.on == b.on and a.on != "mesh"


def _segment(a, b, m: int):
    """Nodes of both ends, once each; their weights in either end; the fixed parts."""
    own = np.unique(np.concatenate([a[0], b[0]]))
    # Padded with a node of its own, so that no other node enters the tangent.
    nodes = np.full(m, own[0], np.int32)
    nodes[: own.size] = own
    weights = np.zeros((2, m))
    for end, (carriers, w, _) in enumerate((a, b)):
        weights[end, np.searchsorted(own, carriers)] = w
    return nodes, weights, np.stack([a[2], b[2]])


class CableSegments(AbstractPotentialCliques):
    """Straight pieces of cables; each adds minus its length to delta_a.

    Attributes:
        nodes: Nodes that carry the two ends, once each.
        owner: Number of the cable.
        weights: Their weights in the positions of the two ends [-].
        fixed: What the positions have besides: a guide on the ground [m].
    """

    nodes: Int[Array, "*cliques m"]
    owner: Int[Array, "*cliques"]
    weights: Float[Array, "*cliques 2 m"]
    fixed: Float[Array, "*cliques 2 3"]
    curved: ClassVar[bool] = True

    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        """Minus the length of one segment [m]."""
        start, end = self.weights @ x + self.fixed
        square = jnp.sum((end - start) ** 2)
        # The root has no slope at zero: a collapsed segment would give NaN forces.
        positive = square > 0.0
        return -jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
