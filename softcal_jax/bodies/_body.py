"""Poses and descriptions of rigid bodies, and their arrays for the solver."""

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module, if_any, key
from softcal_jax._text import check_known, check_unique
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.contact import AbstractShape
from softcal_jax.mesh import TetMesh, node_indices

Vector = Sequence[float] | Float[ArrayLike, "3"]
"""Three numbers, as a user types them."""


def as_floats(value: Float[ArrayLike, "..."] | Sequence) -> Float[HostArray, "..."]:
    """Convert a user's numbers to an array, as a converter of fields."""
    return np.array(value, float)  # a copy: SciPy's rotations need it writable


optional = if_any(as_floats)


def three_numbers(what: str, unit: str, value: Vector) -> Float[HostArray, "3"]:
    """Convert a vector to an array; raise ValueError unless it is finite."""
    vector = as_floats(value)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{what} must be three finite numbers [{unit}], got {value}.")
    return vector


def unit_vector(what: str, value: Vector) -> Float[HostArray, "3"]:
    """Normalise a direction [-]; raise ValueError for the zero vector."""
    vector = three_numbers(what, "-", value)
    length = np.linalg.norm(vector)
    if not 0.0 < length < np.inf:
        raise ValueError(f"{what} must be numbers that are not all zero, got {value}.")
    return vector / length


_ZERO = (0.0, 0.0, 0.0)


def _is_rotation(R: HostArray) -> bool:
    orthogonal = R.shape == (3, 3) and np.allclose(R @ R.T, np.eye(3), atol=1e-6)
    return bool(orthogonal and np.linalg.det(R) > 0.0)


class Pose(Module):
    """Rigid motion X -> rotation @ (X - origin) + origin + translation.

    The origin is that of the moving frame, for a body its `RigidBody.origin`.

    Attributes:
        translation: Displacement of the origin [m].
        rotation_vector: Axis of the rotation times its angle [rad].
    """

    translation: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, default=_ZERO, metadata=key("m")
    )
    rotation_vector: Float[HostArray, "3"] = eqx.field(
        converter=as_floats, default=_ZERO, metadata=key("rad")
    )

    def __check_init__(self):
        three_numbers("translation", "m", self.translation)
        three_numbers("rotation_vector", "rad", self.rotation_vector)
        angle = float(np.linalg.norm(self.rotation_vector))
        if angle > 2.0 * np.pi:
            raise ValueError(
                f"rotation_vector turns by {angle:.4g} rad, more than a full turn: "
                "give radians, not degrees (np.deg2rad)."
            )

    @classmethod
    def from_matrix(
        cls, rotation: Float[ArrayLike, "3 3"], translation: Float[ArrayLike, "3"]
    ) -> "Pose":
        """Make a pose from a rotation matrix [-] and a translation [m].

        Raises:
            ValueError: If the matrix is not a rotation.
        """
        R = np.array(rotation, float)
        if not _is_rotation(R):
            raise ValueError(
                "rotation must be an orthogonal 3 x 3 matrix, and none that mirrors "
                f"space, got {R}."
            )
        return cls(np.asarray(translation, float), Rotation.from_matrix(R).as_rotvec())

    @property
    def matrix(self) -> Float[HostArray, "3 3"]:
        """The rotation as a matrix [-]."""
        return Rotation.from_rotvec(self.rotation_vector).as_matrix()


def _as_groups(where) -> tuple:
    if isinstance(where, str | np.ndarray):
        return (where,)
    return tuple(where) if isinstance(where, Iterable) else (np.asarray(where),)


class RigidBody(Module):
    """Nodes of the mesh that move as one: a plate, a motor arm, the end of a branch.

    With a shape it is an obstacle, which the surface of the mesh cannot pass: a table,
    a probe, an object that is held. An obstacle may have no nodes of its own.

    The coupling is exact: the body has six unknowns, its nodes have none. A tet whose
    nodes all belong to one body does not deform but keeps its weight. A configuration
    lets the body move freely, holds it, hinges it about the third axis of its frame or
    lets it slide along that axis (`BodyState`); a `Motor` turns it about that axis.

    Attributes:
        where: Its nodes: name of a node or surface group, several names, or indices;
            none for an obstacle that stands beside the robot.
        origin: Origin of its frame at rest, through which a hinge passes; by default
            the mean of its nodes, or that of the mesh frame without any [m].
        axes: Axes of the frame at rest, by rows; by default those of the mesh [-].
        mounting: Motion from its pose in the mesh to its pose as mounted, as when a
            flat sheet is bent onto motors; relative to the other body if tied.
        tied_to: Another body, not tied itself, to which this one is fixed.
        mass: Mass in addition to that of its tets; none by default, and then it is
            named where gravity acts on a body without tets of its own [kg].
        centre_of_mass: Position of that mass in the mesh at rest; the origin of the
            frame by default [m].
        shape: Its shape as an obstacle; none by default.
        friction: Coefficient of friction up to which what touches the obstacle sticks
            to it; 0 lets it slide freely [-].
    """

    name: str
    where: tuple[str | Int[HostArray, " _"], ...] = eqx.field(
        converter=_as_groups, default=(), metadata=key(key="group")
    )
    origin: Float[HostArray, "3"] | None = eqx.field(
        converter=optional, default=None, metadata=key("m")
    )
    axes: Float[HostArray, "3 3"] | None = eqx.field(
        converter=optional, default=None, metadata=key("")
    )
    mounting: Pose = eqx.field(default_factory=Pose)
    tied_to: str | None = None
    mass: float | None = eqx.field(
        default=None, metadata=key("kg", size="not negative")
    )
    centre_of_mass: Float[HostArray, "3"] | None = eqx.field(
        converter=optional, default=None, metadata=key("m")
    )
    shape: AbstractShape | None = None
    friction: float = eqx.field(default=0.0, metadata=key(""))

    def __check_init__(self):
        if not self.where and self.shape is None:
            raise ValueError(
                f"rigid body {self.name!r} has no nodes: give `where`, or the `shape` "
                "of an obstacle."
            )
        if not 0.0 <= self.friction < np.inf or (self.friction and not self.shape):
            raise ValueError(
                f"friction of rigid body {self.name!r} must be finite and not "
                f"negative, and needs a shape, got {self.friction:g}."
            )
        for name in ("origin", "centre_of_mass"):
            if (value := getattr(self, name)) is not None:
                three_numbers(f"{name} of rigid body {self.name!r}", "m", value)
        if self.mass is not None and not 0.0 <= self.mass < np.inf:
            raise ValueError(
                f"mass of rigid body {self.name!r} must be finite and not negative "
                f"[kg], got {self.mass:g}."
            )
        if self.axes is not None and not _is_rotation(self.axes):
            raise ValueError(
                f"axes of rigid body {self.name!r} must be three orthogonal unit "
                f"vectors by rows, right-handed, got {self.axes.tolist()}; "
                "`hinge_axes` makes them from the axis of a hinge."
            )
        if self.tied_to == self.name:
            raise ValueError(f"rigid body {self.name!r} is tied to itself.")


def hinge_axes(axis: Vector) -> Float[HostArray, "3 3"]:
    """Return the axes of a frame, by rows, whose third is a hinge's axis [-].

    Raises:
        ValueError: If the axis is not three finite numbers, or has no length.
    """
    third = unit_vector("the axis of a hinge", axis)
    # The coordinate axis farthest from it gives a well-defined first axis.
    first = np.eye(3)[np.argmin(np.abs(third))]
    first = first - third * (third @ first)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third])


class BodyState(Module):
    """State of a rigid body in a configuration.

    Attributes:
        kind: "free", "held", "hinged" (it only turns about its third axis), "sliding"
            (it only moves along that axis), or "absent", for an obstacle.
        pose: Imposed motion from its mounting; a hinge or a slide uses only the
            translation, a free or absent body nothing.
        start: The pose before the load, from which a held, hinged or sliding body moves
            to `pose` on a straight way; by default where it is at rest.
    """

    kind: str
    pose: Pose = eqx.field(default_factory=Pose)
    start: Pose = eqx.field(default_factory=Pose)

    def __check_init__(self):
        check_known("state of a rigid body", KINDS, self.kind)
        poses = self.pose, self.start
        shift, turn = (
            [value for pose in poses for value in getattr(pose, name).tolist()]
            for name in ("translation", "rotation_vector")
        )
        unused = turn if self.kind in ("hinged", "sliding") else shift + turn
        if self.kind != "held" and any(unused):
            raise ValueError(
                f"a body that is {self.kind} ignores a part of its pose or start, with "
                f"translation {self.pose.translation.tolist()} m and rotation vector "
                f"{self.pose.rotation_vector.tolist()} rad. Hold it there with the "
                "Pose itself, or turn it by the axes or the mounting of its body."
            )


KINDS = ("free", "hinged", "held", "sliding", "absent")
"""Kinds of states, in the order of the indices in `BodyStateArrays.kind`."""


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
