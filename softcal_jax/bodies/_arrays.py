"""Rigid bodies as arrays; their nodes follow four frame nodes each."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import check_known, check_unique
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies._body import KINDS, RigidBody
from softcal_jax.mesh import TetMesh, node_indices


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

    @property
    def n_bodies(self) -> int:
        return len(self.names)

    @property
    def tied(self) -> Bool[Array, " n_b"]:
        return self.owner != jnp.arange(self.n_bodies, dtype=jnp.int32)

    @property
    def frame_points(self) -> Float[HostArray, "n_frame_nodes 3"]:
        """The frame nodes at rest: origin and ends of the axes of each body [m]."""
        ends = self.origin[:, None] + self.length * self.axes
        return np.concatenate([self.origin[:, None], ends], axis=1).reshape(-1, 3)

    def at(self, body: int, points: Float[HostArray, "n 3"]) -> Float[HostArray, "n 4"]:
        """Return the weights on the frame nodes [-] for points fixed on a body [m]."""
        return _affine(self.origin[body], self.axes[body], self.length, points)


def _affine(origin, axes, length, points):
    local = (np.asarray(points) - origin) @ axes.T / length
    return np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)


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
        origins.append(points.mean(axis=0) if b.origin is None else b.origin)
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
        mass=jax.device_put(stacked([b.mass for b in bodies])),
        mass_weights=stacked(centres, 4),
        length=length,
        names=names,
    )


def _nodes(mesh: TetMesh, body: RigidBody) -> HostArray:
    what = f"rigid body {body.name!r}"
    groups = [node_indices(mesh, where, what) for where in body.where]
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


class BodyStateArrays(Module):
    """States of the bodies in a configuration: indices in `KINDS`, and poses.

    The translation displaces held and hinged bodies from their mounting [m]; the
    rotation vector turns held bodies only [rad].
    """

    kind: Int[Array | HostArray, "*batch n_b"]
    translation: Float[Array | HostArray, "*batch n_b 3"]
    rotation: Float[Array | HostArray, "*batch n_b 3"]

    @property
    def is_free(self) -> Bool[HostArray, "*batch n_b"]:
        """Which bodies are neither held nor hinged."""
        return np.asarray(self.kind) == KINDS.index("free")
