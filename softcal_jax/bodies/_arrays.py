"""Rigid bodies as arrays for the solver: their frames, mounting and twists.

A step of a body is a twist: three displacements of the origin of its frame and three
angles, along its mounted axes. Angles count in metres at the ends of the frame's axes
(times `BodyArrays.length`), so that all unknowns have one unit.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_known, check_unique
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies._body import KINDS, RigidBody
from softcal_jax.bodies._kinematics import rotation_matrix
from softcal_jax.mesh import TetMesh, node_indices

_GUIDED = 2  # axis of a frame, of three, about which a hinge turns, or a slide moves


class Frames(NamedTuple):
    """Origins of the frames of the bodies [m], and their rotations from rest [-]."""

    origin: Float[Array, "n_b 3"]
    rotation: Float[Array, "n_b 3 3"]

    def where(self, mask: Bool[Array, " n_b"], others: "Frames") -> "Frames":
        return Frames(
            jnp.where(mask[:, None], self.origin, others.origin),
            jnp.where(mask[:, None, None], self.rotation, others.rotation),
        )


class Mounted(NamedTuple):
    """Frames after a share of their mounting.

    The share is `load`, which also applies to imposed poses [-]; `rotation` is that of
    the mountings, `axes` are by rows [-], and `home` are the origins of held and hinged
    bodies [m].
    """

    load: Float[Array, ""]
    rotation: Float[Array, "n_b 3 3"]
    axes: Float[Array, "n_b 3 3"]
    home: Float[Array, "n_b 3"]


class BodyStateArrays(Module):
    """States of the bodies in a configuration: indices in `KINDS`, and poses.

    The translation displaces held, hinged and sliding bodies from their mounting [m];
    the rotation vector turns held bodies only [rad]. Both are reached at full load,
    from those at the start.
    """

    kind: Int[Array | HostArray, "*batch n_b"]
    translation: Float[Array | HostArray, "*batch n_b 3"]
    rotation: Float[Array | HostArray, "*batch n_b 3"]
    start_translation: Float[Array | HostArray, "*batch n_b 3"]
    start_rotation: Float[Array | HostArray, "*batch n_b 3"]

    def translation_at(self, load: Float[Array, ""]) -> Float[Array, "n_b 3"]:
        """Return the translations at a share of the load [m]."""
        start = (1.0 - load) * jnp.asarray(self.start_translation)
        return start + load * jnp.asarray(self.translation)

    def rotation_at(self, load: Float[Array, ""]) -> Float[Array, "n_b 3"]:
        """Return the rotation vectors at a share of the load [rad]."""
        start = (1.0 - load) * jnp.asarray(self.start_rotation)
        return start + load * jnp.asarray(self.rotation)

    @property
    def is_present(self) -> Bool[Array | HostArray, "*batch n_b"]:
        """Which bodies are there."""
        return self.kind != KINDS.index("absent")

    @property
    def is_guided(self) -> Bool[HostArray, "*batch n_b"]:
        """Which bodies are held, hinged or sliding."""
        guided = [KINDS.index(kind) for kind in ("held", "hinged", "sliding")]
        return np.isin(np.asarray(self.kind), guided)


class BodyArrays(Module):
    """The rigid bodies of a model.

    Each body adds four nodes to those of the mesh: the origin of its frame and the ends
    of its axes, `length` away [m]. Every point fixed on the body is an affine
    combination of them, so markers, cables and masses need no special treatment.

    Attributes:
        attached: Nodes of the mesh that belong to a body.
        body: Index of the body that each of these nodes belongs to.
        weights: Their weights on the four frame nodes [-].
        origin: Origin of each frame at rest [m].
        axes: Axes of each frame at rest, by rows [-].
        owner: Index of the body whose six unknowns move each body: itself unless tied.
        mounting_translation: Translation of the mounting [m].
        mounting_rotation: Rotation vector of the mounting [rad].
        mass: Mass in addition to that of the tets [kg].
        mass_weights: Weights of the centre of this mass on the frame nodes [-].
        is_weighed: Whether this mass was stated, be it zero.
    """

    attached: Int[HostArray, " n_attached"]
    body: Int[HostArray, " n_attached"]
    weights: Float[HostArray, "n_attached 4"]
    origin: Float[HostArray, "n_b 3"]
    axes: Float[HostArray, "n_b 3 3"]
    owner: Int[HostArray, " n_b"]
    mounting_translation: Float[Array, "n_b 3"]
    mounting_rotation: Float[Array, "n_b 3"]
    mass: Float[Array, " n_b"]
    mass_weights: Float[HostArray, "n_b 4"]
    length: Float[HostArray, ""]
    names: tuple[str, ...] = eqx.field(static=True)
    is_weighed: tuple[bool, ...] = eqx.field(static=True)

    @property
    def n_bodies(self) -> int:
        return len(self.names)

    @property
    def has_nodes(self) -> Bool[Array | HostArray, " n_b"]:
        """Which bodies have nodes of the mesh; obstacles may have none."""
        bodies = np.arange(self.n_bodies, dtype=np.int32)
        return (bodies[:, None] == self.body[None]).any(axis=1)

    @property
    def tied(self) -> Bool[Array, " n_b"]:
        return self.owner != jnp.arange(self.n_bodies, dtype=jnp.int32)

    @property
    def frame_points(self) -> Float[HostArray, "n_frame_nodes 3"]:
        """The frame nodes at rest: origin and ends of the axes of each body [m]."""
        ends = self.origin[:, None] + self.length * self.axes
        return np.concatenate([self.origin[:, None], ends], axis=1).reshape(-1, 3)

    def following(
        self, old: Float[Array | HostArray, "n 3"], new: Float[Array, "n 3"]
    ) -> "BodyArrays":
        """Return the bodies on other points at rest, with frames that follow them [m].

        A frame moves with the mean of the nodes of its body, and what is fixed on the
        body with the frame. An obstacle without nodes stays.
        """
        body, nodes = jnp.asarray(self.body), jnp.asarray(self.attached)
        total = lambda rows: jax.ops.segment_sum(rows, body, self.n_bodies)
        count = jnp.maximum(total(jnp.ones((len(body), 1))), 1.0)
        origin = self.origin + total((new - old)[nodes]) / count
        axes, affine = jnp.asarray(self.axes)[body], jax.vmap(_affine, (0, 0, None, 0))
        weights = affine(origin[body], axes, self.length, new[nodes])
        return eqx.tree_at(lambda b: (b.origin, b.weights), self, (origin, weights))

    def at(self, body: int, points: Float[HostArray, "n 3"]) -> Float[HostArray, "n 4"]:
        """Return the weights on the frame nodes [-] for points fixed on a body [m]."""
        return _affine(self.origin[body], self.axes[body], self.length, points)

    def frames_at(self, ends: Float[Array, "n_frame_nodes 3"]) -> Frames:
        """Compute frames from the positions of the frame nodes, four per body [m].

        Axes are orthogonalised in case a linear prediction distorted them.
        """
        ends = ends.reshape(self.n_bodies, 4, 3)
        now = (ends[:, 1:] - ends[:, :1]) / self.length
        first = now[:, 0] / jnp.linalg.norm(now[:, 0], axis=1, keepdims=True)
        second = now[:, 1] - first * jnp.sum(first * now[:, 1], axis=1, keepdims=True)
        second = second / jnp.linalg.norm(second, axis=1, keepdims=True)
        orthogonal = jnp.stack([first, second, jnp.cross(first, second)], axis=1)
        rotation = jnp.sum(orthogonal[:, :, :, None] * self.axes[:, :, None, :], axis=1)
        return Frames(ends[:, 0], rotation)

    def frame_nodes(self, frames: Frames) -> Float[Array, "n_b 4 3"]:
        """Compute the positions of the frame nodes [m]."""
        axes = _apply(frames.rotation[:, None], jnp.asarray(self.axes))
        ends = frames.origin[:, None] + self.length * axes
        return jnp.concatenate([frames.origin[:, None], ends], axis=1)

    def mounted(self, load: Float[Array, ""]) -> Mounted:
        """Return frames after a share of their mounting, before any imposed pose."""
        R = jax.vmap(rotation_matrix)(load * self.mounting_rotation)
        home = jnp.asarray(self.origin) + load * self.mounting_translation
        return Mounted(load, R, _apply(R[:, None], jnp.asarray(self.axes)), home)

    def place(
        self,
        state: BodyStateArrays,
        mounted: Mounted,
        frames: Frames,
        twist: Float[Array, "n_b 6"],
    ) -> Frames:
        """Move bodies that are not held by twists [m]; place others as imposed."""
        load, mounting, axes, home = mounted
        along = lambda v: jnp.sum(axes * v[:, :, None], axis=1)
        turned = _product(frames.rotation, jnp.swapaxes(mounting, 1, 2))
        first = _apply(turned, axes[:, 0])
        about = lambda axis: jnp.sum(first * axes[:, axis], axis=1)
        displacements, angles = twist[:, :3], twist[:, 3:]
        angle = jnp.arctan2(about(1), about(0)) + angles[:, _GUIDED] / self.length
        turn, hinge = along(angles) / self.length, angle[:, None] * axes[:, 2]
        turns = jnp.stack([turn, hinge, state.rotation_at(load)])
        # One stacked call, since each separate one would be compiled again.
        by_twist, by_angle, by_pose = jax.vmap(jax.vmap(rotation_matrix))(turns)
        free = Frames(
            frames.origin + along(displacements), _product(by_twist, frames.rotation)
        )
        hinged = Frames(home, _product(by_angle, mounting))
        held = Frames(home, _product(by_pose, mounting))
        slide = axes[:, _GUIDED]
        way = jnp.sum(slide * (frames.origin - home), axis=1)
        way = way + displacements[:, _GUIDED]
        sliding = Frames(home + way[:, None] * slide, mounting)
        untied = hinged.where(state.kind == KINDS.index("hinged"), held)
        untied = sliding.where(state.kind == KINDS.index("sliding"), untied)
        untied = free.where(state.kind == KINDS.index("free"), untied)
        # A tied body follows its owner, after its own mounting.
        rest = jnp.asarray(self.origin)
        arm = rest + load * self.mounting_translation - rest[self.owner]
        origin, rotation = untied.origin[self.owner], untied.rotation[self.owner]
        tied = Frames(origin + _apply(rotation, arm), _product(rotation, mounting))
        return tied.where(self.tied, untied)

    def blocked(self, state: BodyStateArrays):
        """Flag the entries of the twists that are not unknowns."""
        kind = state.kind[:, None]
        free = kind == KINDS.index("free")
        for name, way in (("hinged", 3 + _GUIDED), ("sliding", _GUIDED)):
            free = free | ((kind == KINDS.index(name)) & (jnp.arange(6)[None] == way))
        return ~free | self.tied[:, None]


def _apply(R: Float[Array, "... 3 3"], v: Float[Array, "... 3"]):
    return jnp.sum(R * v[..., None, :], axis=-1)


def _product(A: Float[Array, "n_b 3 3"], B: Float[Array, "n_b 3 3"]):
    return jnp.sum(A[:, :, :, None] * B[:, None], axis=2)


def _affine(origin, axes, length, points):
    xp: Any = jnp if isinstance(points, Array) else np
    local = (xp.asarray(points) - origin) @ axes.T / length
    return xp.concatenate([1.0 - local.sum(axis=-1, keepdims=True), local], axis=-1)


def body_arrays(mesh: TetMesh, bodies: Sequence[RigidBody]) -> BodyArrays:
    """Stack the rigid bodies of a mesh at rest; there may be none.

    Raises:
        ValueError: If they do not fit the mesh or each other.
    """
    names = tuple(body.name for body in bodies)
    check_unique("rigid body", names)
    nodes = [_nodes(mesh, body) for body in bodies]
    _check_disjoint(mesh, names, nodes)
    # As an array, since a Python float would force a new compilation for each mesh.
    length = np.asarray(mesh.size, float)
    weights, centres, origins, axes = [], [], [], []
    for b, n in zip(bodies, nodes, strict=True):
        points = mesh.points[n]
        middle = points.mean(axis=0) if len(n) else np.zeros(3)
        origins.append(middle if b.origin is None else b.origin)
        axes.append(np.eye(3) if b.axes is None else b.axes)
        centre = origins[-1] if b.centre_of_mass is None else b.centre_of_mass
        weights.append(_affine(origins[-1], axes[-1], length, points))
        centres.append(_affine(origins[-1], axes[-1], length, centre[None]))
    stacked = lambda rows, *shape: np.array(rows, float).reshape(len(bodies), *shape)
    translations = stacked([b.mounting.translation for b in bodies], 3)
    rotations = stacked([b.mounting.rotation_vector for b in bodies], 3)
    counts = [len(n) for n in nodes]
    return BodyArrays(
        attached=np.concatenate([np.zeros(0, int), *nodes]).astype(np.int32),
        body=np.repeat(np.arange(len(bodies)), counts).astype(np.int32),
        weights=np.concatenate([np.zeros((0, 4)), *weights]),
        origin=stacked(origins, 3),
        axes=stacked(axes, 3, 3),
        owner=_owners(bodies, names),
        # Not jnp.asarray, which would compile a program for every shape.
        mounting_translation=jax.device_put(translations),
        mounting_rotation=jax.device_put(rotations),
        mass=jax.device_put(stacked([b.mass or 0.0 for b in bodies])),
        mass_weights=stacked(centres, 4),
        length=length,
        names=names,
        is_weighed=tuple(b.mass is not None for b in bodies),
    )


def _nodes(mesh: TetMesh, body: RigidBody) -> HostArray:
    what = f"rigid body {body.name!r}"
    groups = [node_indices(mesh, where, what) for where in body.where]
    if not groups:
        return np.zeros(0, int)
    nodes = np.unique(np.concatenate(groups))
    x = mesh.points[nodes] - mesh.points[nodes].mean(axis=0)
    spread = np.linalg.svd(x, compute_uv=False) if len(nodes) > 2 else np.zeros(3)
    if spread[1] < 1e-6 * mesh.size:
        raise ValueError(
            f"{what} holds {len(nodes)} nodes on a line or a point: it needs three "
            "that span a plane. For a hinge or a clamp along an edge, use a Support."
        )
    return nodes


def _check_disjoint(mesh: TetMesh, names, nodes) -> None:
    first = np.full(mesh.n_nodes, -1)
    for k, of_body in enumerate(nodes):
        shared = of_body[first[of_body] >= 0]
        if shared.size:
            node = shared[0]
            raise ValueError(
                f"rigid bodies {names[first[node]]!r} and {names[k]!r} share "
                f"{shared.size} nodes, such as node {node} at "
                f"{mesh.points[node].tolist()} m: make them one body, or tie one to "
                "the other with disjoint groups."
            )
        first[of_body] = k


def _owners(bodies: Sequence[RigidBody], names: tuple[str, ...]) -> HostArray:
    owner = np.arange(len(bodies), dtype=np.int32)
    for k, body in enumerate(bodies):
        if body.tied_to is None:
            continue
        check_known(f"tied_to of body {body.name!r}", names, body.tied_to)
        owner[k] = names.index(body.tied_to)
        root = bodies[owner[k]].tied_to
        if root is not None:
            raise ValueError(
                f"rigid body {body.name!r} is tied to {body.tied_to!r}, which is tied "
                f"itself: tie both to {root!r}."
            )
    return owner
