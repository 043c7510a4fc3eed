"""What all actuators share: a name, units, and cliques of nodes that they act on."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import suggestion
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.actuators._cliques import AbstractCliques
from softcal_jax.mesh import TetMesh, locate

Vector = Sequence[float] | Float[ArrayLike, "3"]
"""Three numbers, as a user types them."""

_OUTSIDE = 1e-3
"""How far outside the mesh a point of it may lie, in sizes of the mesh."""


class Kind(NamedTuple):
    """What an actuator is called and measured in.

    Attributes:
        noun: What it is called in messages.
        force_unit: Unit of lambda_a.
        displacement_unit: Unit of delta_a; None where there is no displacement that
            could be imposed or measured.
        unilateral: Whether lambda_a must not be negative.
    """

    noun: str
    force_unit: str
    displacement_unit: str | None
    unilateral: bool = False


class RestState(eqx.Module):
    """The mesh and the rigid bodies at rest, which actuators are attached to.

    Attributes:
        mesh: The mesh.
        points: Rest positions of the mesh's nodes, then of four nodes for each rigid
            body k, n_nodes + 4 k onwards: the origin of its frame, and the ends of its
            three axes, orthogonal and of one length [m].
        bodies: The index k of each rigid body, by name.
    """

    mesh: TetMesh
    points: Float[HostArray, "n_all 3"]
    bodies: Mapping[str, int]

    def __check_init__(self):
        n = self.mesh.n_nodes + 4 * len(self.bodies)
        if self.points.shape != (n, 3):
            raise ValueError(
                f"{self.mesh.n_nodes} nodes and {len(self.bodies)} rigid bodies of "
                f"four frame nodes need points of shape ({n}, 3), got "
                f"{self.points.shape}."
            )

    def frame_nodes(self, body: str, owner: str) -> Int[HostArray, "4"]:
        """The four nodes of the frame of a rigid body.

        Raises:
            ValueError: If no rigid body has the name.
        """
        if body not in self.bodies:
            known = ", ".join(map(repr, self.bodies)) or "none"
            raise ValueError(
                f"{owner}: unknown rigid body {body!r}."
                f"{suggestion(body, self.bodies)} Known: {known}."
            )
        return self.mesh.n_nodes + 4 * self.bodies[body] + np.arange(4, dtype=np.int32)

    def on_mesh(
        self, point: Float[HostArray, "3"], owner: str
    ) -> tuple[Int[HostArray, " n_en"], Float[HostArray, " n_en"]]:
        """Nodes and weights [-] that carry a material point of the mesh.

        Raises:
            ValueError: If the point lies outside the mesh.
        """
        at = locate(self.mesh, point[None], max_distance=np.inf)
        if at.distance[0] > _OUTSIDE * self.mesh.size:
            raise ValueError(
                f"{owner}: the point {point.tolist()} m lies {at.distance[0]:.3g} m "
                "outside the mesh, expected a point on or in it. Check its "
                "coordinates and their length unit."
            )
        return at.nodes[0], at.weights[0]

    def on_body(
        self, point: Float[HostArray, "3"], body: str, owner: str
    ) -> tuple[Int[HostArray, "4"], Float[HostArray, "4"]]:
        """Frame nodes and weights [-] that carry a point of a rigid body.

        Affine weights: x = x_0 + sum_i w_i (x_i - x_0), exact under rigid motion.

        Raises:
            ValueError: If no rigid body has the name.
        """
        nodes = self.frame_nodes(body, owner)
        origin, *ends = self.points[nodes]
        along = np.linalg.solve((np.stack(ends) - origin).T, point - origin)
        return nodes, np.concatenate([[1.0 - along.sum()], along])


class AbstractActuator(eqx.Module):
    """A part of the robot that pushes on it by a force lambda_a.

    delta_a(x) is its displacement (zero at rest), which may be imposed and measured,
    and H_a = d delta_a / dx. F_a, the force on the nodes for lambda_a = 1, is H_a where
    it has a potential, and another one where it has none; the type of its cliques says
    which. A force may also come without a displacement.
    """

    name: eqx.AbstractVar[str]
    kind: ClassVar[Kind]

    def __check_init__(self):
        if not self.name:
            raise ValueError(
                f"a {self.kind.noun} needs a name that is not empty: results and "
                "messages refer to it."
            )

    @property
    def label(self) -> str:
        """How messages call it, like "cable 'left'"."""
        return f"{self.kind.noun} {self.name!r}"

    @abstractmethod
    def cliques(self, rest: RestState, owner: int) -> AbstractCliques:
        """The sets of nodes that it acts on.

        Args:
            rest: What it is attached to.
            owner: Its index among the actuators.

        Raises:
            ValueError: If it does not fit the mesh or the rigid bodies.
        """


def as_vector(value: Vector) -> HostArray:
    """A user's three numbers as an array."""
    return np.asarray(value, float)


def check_vector(what: str, unit: str, value: HostArray):
    """Refuses what is not three finite numbers.

    Raises:
        ValueError: If it is not.
    """
    if value.shape != (3,) or not np.all(np.isfinite(value)):
        raise ValueError(f"{what} must be three finite numbers [{unit}], got {value}.")


def check_direction(what: str, value: HostArray):
    """Refuses what has no direction.

    Raises:
        ValueError: If the vector is not finite, or zero.
    """
    check_vector(what, "-", value)
    if not np.linalg.norm(value) > 0.0:
        raise ValueError(
            f"{what} is zero, expected a vector of any other length: give the "
            "direction in which a positive force pushes."
        )
