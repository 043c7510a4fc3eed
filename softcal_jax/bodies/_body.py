"""Poses and descriptions of rigid bodies, and their arrays for the solver."""

from collections.abc import Iterable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from softcal_jax._module import Module, if_any, key
from softcal_jax._text import check_known
from softcal_jax._typing import Float, HostArray, Int, Vector, check_untraced
from softcal_jax.contact import AbstractShape

_SOME_LEAF = "its leaf of a lane or of the model"


def as_floats(value: Float[ArrayLike, "..."] | Sequence) -> Float[HostArray, "..."]:
    """Convert a user's numbers to an array, as a converter of fields."""
    check_untraced("a vector", value, _SOME_LEAF)
    return np.array(value, float)  # a copy: SciPy's rotations need it writable


optional = if_any(as_floats)


def three_numbers(
    what: str,
    unit: str,
    value: Vector,
    leaf: str = _SOME_LEAF,
) -> Float[HostArray, "3"]:
    """Convert a vector to an array; raise ValueError unless it is finite and known.

    `leaf` is what to set in place of a traced one.
    """
    check_untraced(what, value, leaf)
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
        friction: Coefficient of friction mu of the obstacle: what touches it sticks,
            or slides against mu times the pressure; 0 lets it slide freely [-].
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
        check_untraced("mass", self.mass, "model.mechanism.bodies.mass")
        check_untraced("friction", self.friction, "model.mechanism.contacts.friction")
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
