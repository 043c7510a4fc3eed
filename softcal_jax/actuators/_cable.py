"""Cables: a path through guide points, shortened by its tension."""

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray, Vector
from softcal_jax.actuators._actuator import (
    OUTSIDE,
    AbstractActuator,
    AbstractDisplacedCliques,
    ActuatorGeometry,
    Kind,
    RestState,
    owned,
)
from softcal_jax.bodies import as_floats, three_numbers
from softcal_jax.elements import vector_length
from softcal_jax.mesh import locate, ring_around

_COINCIDENT = 1e-9
"""Distance at which guides coincide, relative to the extent of the cable [-]."""

_IN_LINE = 1e-12  # sine of the angle at a guide below which the angle is only rounding


class Guide(Module):
    """A point that a cable runs through, or ends at.

    Attributes:
        point: Position at rest [m].
        on: What carries it: "mesh" for a material point of the mesh, "ground" for a
            fixed point, or the name of a rigid body.
    """

    point: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, metadata=key("m", 'where it is at rest: "(50, 10, 0) mm"')
    )
    on: str = "mesh"

    def __check_init__(self):
        three_numbers("the point of a guide", "m", self.point)


def _as_guides(guides: Sequence[Guide | Vector]) -> tuple[Guide, ...]:
    return tuple(g if isinstance(g, Guide) else Guide(g) for g in guides)


class Cable(AbstractActuator):
    """A cable along straight segments between its guides, with or without friction.

    delta_a = l(X) - l(x), with l the length of the path, is its shortening [m].
    lambda_a is the tension at the pulled end [N], which cannot be negative.

    With friction, the cable slides at all guides between its ends, and each reduces the
    tension (capstan equation of Euler and Eytelwein): from the pulled end to the other,
    it is multiplied by exp(-mu theta), with theta the angle between the segments on
    both sides; in a configuration that is `releasing` the cable, by exp(+mu theta).
    Friction has no potential: the model is not `conservative`, and its tangent couples
    all nodes that the cable touches. At theta = 0 the loss has a kink; the tangent
    there is that without loss.

    Attributes:
        guides: The points that it runs through, both ends included; three bare numbers
            make a guide on the mesh.
        friction: Coefficient of friction mu at the guides [-].
        pulled_from: The end that is pulled, the "first" or "last" guide; only used with
            friction.
        max_distance: How far guides on the mesh may lie outside it, as on eyelets,
            which move with the nearest point of the mesh [m]; None for a thousandth of
            its size. A guide in a channel follows the ring of wall around it instead: a
            mean of its nodes, which is exact for rigid motions and uniform strains.
    """

    guides: tuple[Guide, ...] = eqx.field(
        converter=_as_guides,
        metadata=key(
            words="the points that it runs through, both ends included: "
            '[{ point = "(0, 10, 0) mm", on = "ground" }, "(50, 10, 0) mm"]',
            bare="point",
        ),
    )
    friction: float | None = None
    pulled_from: Literal["first", "last"] | None = None
    max_distance: float | None = eqx.field(
        default=None, metadata=key("m", size="not negative")
    )
    kind: ClassVar[Kind] = Kind(
        "cable",
        "N",
        "m",
        unilateral=True,
        imposed='its tension, like "2 N", or its shortening, like "5 mm"',
    )

    def __check_init__(self):
        if len(self.guides) < 2:
            raise ValueError(
                f"{self.label} has {len(self.guides)} guide(s), expected at least "
                "two: both ends, and the points between them."
            )
        points = np.stack([guide.point for guide in self.guides])
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        near = np.flatnonzero(gaps <= _COINCIDENT * np.ptp(points, axis=0).max())
        if near.size:
            i = near[0]
            raise ValueError(
                f"{self.label}: guides {i} and {i + 1} are both at "
                f"{points[i].tolist()} m, expected points apart. Leave one of them out."
            )
        if all(map(_fixed_length, self.guides, self.guides[1:])):
            on = self.guides[0].on
            raise ValueError(
                f"{self.label}: all guides are on {on!r}, so its length cannot "
                "change. Put at least one on the mesh or on another rigid body."
            )
        known = ("first", "last") if self.friction else (None, "first", "last")
        if self.pulled_from not in known:
            raise ValueError(
                f"{self.label} has pulled_from={self.pulled_from!r}, expected 'first' "
                "or 'last', the end of its guides that the actuator pulls."
            )
        if not self.friction:
            return
        if not 0.0 <= self.friction < np.inf:
            raise ValueError(
                f"{self.label} has the coefficient of friction {self.friction:g}, "
                "expected a finite number that is not negative [-]."
            )
        if len(self.guides) < 3:
            raise ValueError(
                f"{self.label} has friction but no guide between its ends: add those "
                "that it runs through, or leave the friction out."
            )

    def cliques(
        self, rest: RestState, owner: int
    ) -> "tuple[CableSegments | FrictionalCables]":
        carriers = self._carriers(rest)
        if self.friction:
            # Tension is passed on from the pulled end, which is put last here.
            order = carriers[::-1] if self.pulled_from == "first" else carriers
            pulled = np.full(1, float(self.friction)), np.ones(1)
            return (FrictionalCables(*_stacked([_along(order)], owner, *pulled)),)
        m = 2 * max(4, rest.mesh.tets.shape[1], *(len(w) for _, w, _ in carriers))
        # Only segments that can change their length.
        both = zip(pairwise(carriers), pairwise(self.guides), strict=True)
        segments = [_along(ends, m) for ends, on in both if not _fixed_length(*on)]
        return (CableSegments(*_stacked(segments, owner)),)

    def _carriers(self, rest: RestState) -> list[tuple[HostArray, ...]]:
        """Return nodes and weights of each guide, and the fixed part of its place."""
        points = np.stack([guide.point for guide in self.guides])
        names = [f"{self.label}, guide {i}" for i in range(len(points))]
        near, carriers, beside = OUTSIDE * rest.mesh.size, [], []
        for i, guide in enumerate(self.guides):
            if guide.on == "ground":
                carried = np.zeros(0, np.int32), np.zeros(0)
            elif guide.on == "mesh":
                place = locate(rest.mesh, points[[i]], max_distance=np.inf)
                ring = place.distance[0] > near and ring_around(rest.mesh, points[i])
                carried = ring or (place.nodes[0], place.weights[0])
                beside += [i] * (ring is None)
            else:
                known = ["mesh", "ground", *rest.bodies]
                check_known(f"carrier of {names[i]}", known, guide.on)
                carried = rest.on_body(points[i], guide.on, names[i])
            carriers.append((*carried, points[i] * (guide.on == "ground")))
        if self.max_distance is not None:
            near = self.max_distance
        try:
            of_mesh = [names[i] for i in beside]
            locate(rest.mesh, points[beside], max_distance=near, names=of_mesh)
        except ValueError as error:
            more = "If they are on eyelets or rings, say how far these reach"
            raise ValueError(f"{error} {more}: max_distance.") from error
        return carriers


def _fixed_length(a: Guide, b: Guide) -> bool:
    return a.on == b.on and a.on != "mesh"


def _along(guides, n_nodes: int | None = None):
    """Return the nodes of guides, their weights in each guide, and its fixed part."""
    used = np.unique(np.concatenate([nodes for nodes, *_ in guides]))
    m = n_nodes or used.size
    # Pad with one of these nodes, so that no other node enters the tangent.
    nodes = np.full(m, used[0], np.int32)
    nodes[: used.size] = used
    weights = np.zeros((len(guides), m))
    for row, (carriers, w, _) in zip(weights, guides, strict=True):
        row[np.searchsorted(used, carriers)] = w
    return nodes, weights, np.stack([fixed for *_, fixed in guides])


def _stacked(pieces, owner: int, *more: HostArray) -> tuple[Array, ...]:
    """Stack what `_along` returns of several pieces, with their owner."""
    nodes, *others = map(np.stack, zip(*pieces, strict=True))
    return owned(nodes, owner, *others, *more)


def _turn(before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, ""]:
    """Compute the angle between two segments; zero derivative if in line [rad]."""
    across, along = vector_length(jnp.cross(before, after)), jnp.sum(before * after)
    turned = across > _IN_LINE * vector_length(before) * vector_length(after)
    angle = jnp.arctan2(jnp.where(turned, across, 1.0), jnp.where(turned, along, 1.0))
    return jnp.where(turned, angle, jnp.where(along < 0.0, jnp.pi, 0.0))


class AbstractGuided(AbstractDisplacedCliques):
    """Paths of cables through guides, which are at weights @ x + fixed [m].

    Attributes:
        weights: Weights of the nodes in the positions of the guides [-].
        fixed: Constant part of these positions, of guides on the ground [m].
    """

    weights: Float[Array, "*cliques n_guides m"]
    fixed: Float[Array, "*cliques n_guides 3"]

    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        nodes, weights = np.asarray(self.nodes), np.asarray(self.weights)
        guides = np.einsum("cem,cmi->cei", weights, x[nodes]) + np.asarray(self.fixed)
        segments = np.stack([guides[:, :-1], guides[:, 1:]], axis=2)
        return ActuatorGeometry(
            segments=segments.reshape(-1, 2, 3),
            segment_owner=np.repeat(np.asarray(self.owner), segments.shape[1]),
        )


class CableSegments(AbstractGuided):
    """Straight segments between two guides; each adds minus its length to delta_a."""

    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        start, end = self.weights @ x + self.fixed
        return -vector_length(end - start)


class FrictionalCables(AbstractGuided):
    """Whole cables with friction, pulled at their last guide.

    Attributes:
        friction: Coefficient of friction [-].
        sense: 1 if the actuator pulls, -1 if it is released.
    """

    friction: Float[Array, "*cliques"]
    sense: Float[Array, "*cliques"]
    conservative: ClassVar[bool] = False

    def _segments(self, x: Float[Array, "m 3"]) -> Float[Array, "n_segments 3"]:
        return jnp.diff(self.weights @ x + self.fixed, axis=0)

    def _lengths(self, x: Float[Array, "m 3"]) -> Float[Array, " n_segments"]:
        return jax.vmap(vector_length)(self._segments(x))

    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        return -jnp.sum(self._lengths(x))

    def tensions(self, x: Float[Array, "m 3"]) -> Float[Array, " n_segments"]:
        """Compute exp(-mu sum theta) over the guides from each segment to the end."""
        segments = self._segments(x)
        turns = jax.vmap(_turn)(segments[:-1], segments[1:])
        to_end = jnp.cumsum(turns[::-1])[::-1]
        loss = self.sense * self.friction * to_end
        return jnp.append(jnp.exp(-loss), 1.0)

    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Return forces on the nodes: each segment pulls its ends with its tension."""
        tensions = self.tensions(x)
        return jax.grad(lambda x: -jnp.sum(tensions * self._lengths(x)))(x)
