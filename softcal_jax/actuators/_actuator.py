"""Base of all actuators: a name, units, and the cliques of nodes they act on."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from softcal_jax._module import Module, one_line
from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.actuators._cliques import AbstractCliques
from softcal_jax.mesh import TetMesh, locate

_OUTSIDE = 1e-3
"""Distance by which a point may lie outside the mesh, relative to its size [-]."""


class Kind(NamedTuple):
    """Name of a kind of actuator in messages, and its units.

    Those without a displacement have no unit of it; lambda_a of `unilateral` ones must
    not be negative.
    """

    noun: str
    force_unit: str
    displacement_unit: str | None
    unilateral: bool = False

    __repr__ = one_line


class RestState(Module):
    """The mesh and the rigid bodies at rest, to which actuators are attached.

    `points` are the nodes of the mesh, then four nodes for each rigid body k, from
    n_nodes + 4 k on: the origin of its frame and the ends of its three axes [m].
    `bodies` has the index k of each rigid body.
    """

    mesh: TetMesh
    points: Float[HostArray, "n_all 3"]
    bodies: Mapping[str, int]

    def frame_nodes(self, body: str, owner: str) -> Int[HostArray, "4"]:
        if body not in self.bodies:
            raise unknown_name(f"rigid body of {owner}", body, self.bodies)
        return self.mesh.n_nodes + 4 * self.bodies[body] + np.arange(4, dtype=np.int32)

    def on_mesh(
        self, point: Float[HostArray, "3"], owner: str
    ) -> tuple[Int[HostArray, " n_en"], Float[HostArray, " n_en"]]:
        """Return the nodes and weights [-] that carry a material point of the mesh."""
        near, names = _OUTSIDE * self.mesh.size, [f"the point of {owner}"]
        at = locate(self.mesh, point[None], max_distance=near, names=names)
        return at.nodes[0], at.weights[0]

    def on_body(
        self, point: Float[HostArray, "3"], body: str, owner: str
    ) -> tuple[Int[HostArray, "4"], Float[HostArray, "4"]]:
        """Return the frame nodes and weights [-] that carry a point of a rigid body.

        Affine weights: x = x_0 + sum_i w_i (x_i - x_0), exact under rigid motion.
        """
        nodes = self.frame_nodes(body, owner)
        origin, *ends = self.points[nodes]
        along = np.linalg.solve((np.stack(ends) - origin).T, point - origin)
        return nodes, np.concatenate([[1.0 - along.sum()], along])


class AbstractActuator(Module):
    """A part of the robot that drives it with a force lambda_a.

    Its displacement delta_a(x), zero at rest, may be imposed or measured, and
    H_a = d delta_a / dx. F_a, the force on the nodes for lambda_a = 1, equals H_a if
    the actuator has a potential. Some actuators have no displacement.
    """

    name: str
    kind: ClassVar[Kind]

    def __check_init__(self):
        if not self.name:
            raise ValueError(f"a {self.kind.noun} needs a name that is not empty.")

    @property
    def label(self) -> str:
        """Kind and name in messages, like "cable 'left'"."""
        return f"{self.kind.noun} {self.name!r}"

    @abstractmethod
    def cliques(self, rest: RestState, owner: int) -> tuple[AbstractCliques, ...]:
        """Attach the actuator, the one with the index `owner`, to sets of nodes.

        Raises:
            ValueError: If it does not fit the mesh or the rigid bodies.
        """
