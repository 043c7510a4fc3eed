"""How a body is held and pushed: supports, whether they are enough, and dead loads."""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from softcal_jax import mesh as meshes
from softcal_jax._module import Module, key
from softcal_jax._text import UNNAMED_LOADS, parse_axes
from softcal_jax._typing import Bool, Float, HostArray, Int, check_untraced
from softcal_jax.bodies import KINDS, three_numbers
from softcal_jax.configurations._arrays import Springs
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh

POINT = key("m", 'where it acts: "(50, 10, 0) mm"')
SURFACE = key(words='name of a surface group: "z_max"', key="surface")
FORCE = key("N", 'total force: "(0, 0, -1) N"')


class Support(Module):
    """Nodes held, or moved by a given displacement, along some axes.

    Attributes:
        where: Name of a node or surface group, or node indices.
        axes: The held axes: "xyz" clamps, "z" lets the nodes slide in x and y.
        displacement: Imposed displacement of the held axes [m].
        stiffness: Stiffness of an elastic support on a surface group, like a rubber
            clamp: force per area and displacement [N/m3]. Rigid by default.
    """

    where: str | Int[HostArray, " n"] = eqx.field(
        metadata=key(words="name of a group of the mesh", key="group")
    )
    axes: str = "xyz"
    displacement: tuple[float, float, float] = eqx.field(
        default=(0.0, 0.0, 0.0), metadata=key("m")
    )
    stiffness: float | None = eqx.field(
        default=None, metadata=key("N/m3", size="positive")
    )

    @property
    def name(self) -> str:
        """Name of its group; "support" where it has none."""
        return self.where if isinstance(self.where, str) else "support"

    def __check_init__(self):
        parse_axes(self.axes)
        three_numbers("displacement", "m", self.displacement, "lane.imposed")
        if self.stiffness is None:
            return
        check_untraced("a stiffness", self.stiffness, "lane.springs.stiffness")
        if not 0.0 < self.stiffness < np.inf:
            raise ValueError(
                f"stiffness of the support {self.name!r} must be positive and finite "
                f"[N/m3], got {self.stiffness!r}; leave it out for a rigid support."
            )
        if not isinstance(self.where, str):
            raise ValueError(
                "a support with a stiffness needs the name of a surface group, whose "
                "area it acts on; got node indices."
            )

    def apply(
        self,
        mesh: TetMesh,
        fixed: Bool[HostArray, "n_points 3"],
        imposed: Float[HostArray, "n_points 3"],
    ) -> None:
        """Write the support into the masks of a configuration."""
        nodes = meshes.node_indices(mesh, self.where, "a support")
        for axis in parse_axes(self.axes):
            other = imposed[nodes, axis] != self.displacement[axis]
            clash = fixed[nodes, axis] & other
            if np.any(clash):
                raise ValueError(
                    f"node {nodes[clash][0]} is held twice along "
                    f"{'xyz'[axis]} with different displacements."
                )
            fixed[nodes, axis] = True
            imposed[nodes, axis] = self.displacement[axis]

    def areas(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Compute the area of each node of an elastic support, along its axes [m2]."""
        areas = np.zeros((mesh.n_nodes, 3))
        shares = meshes.surface_shares(mesh, mesh.faces(str(self.where)))
        areas[:, parse_axes(self.axes)] = shares[:, None]
        return areas


def coupled_springs(
    mesh: TetMesh, groups: tuple[str, ...], rest: Float[HostArray, "n_points 3"]
) -> Springs:
    """Make springs on surface groups with their coupling, but no stiffness yet.

    The coupling is what nodal areas leave of the work of elastic supports on their
    faces. On quadratic tets the areas of corners are zero: alone, they would leave
    corners free. None on linear tets, whose nodal areas hold every node.
    """
    n_en, n_groups = mesh.tets.shape[1], len(groups)
    area, stiffness = np.zeros((n_groups, *rest.shape)), np.zeros(n_groups)
    if mesh.order == 1 or not groups:
        none, areas = np.zeros(0, np.int32), np.zeros((0, n_en, n_en))
        return Springs(area, stiffness, rest, none, none, areas, groups)
    several = [mesh.faces(group) for group in groups]
    faces = np.concatenate(several)
    tets = meshes.face_indices(faces, meshes.tet_faces(mesh.tets)) // 4
    local = np.argmax(mesh.tets[tets][:, None] == faces[:, :, None], axis=2)
    products = meshes.face_products(mesh, faces)
    diagonal = np.arange(6)
    products[:, diagonal, diagonal] -= products.sum(axis=2)
    areas = np.zeros((len(faces), n_en, n_en))
    which = np.arange(len(faces))[:, None, None]
    areas[which, local[:, :, None], local[:, None]] = products
    of = np.repeat(np.arange(len(several)), [len(part) for part in several])
    tets, of = tets.astype(np.int32), of.astype(np.int32)
    return Springs(area, stiffness, rest, tets, of, areas, groups)


def check_apart(mesh: TetMesh, mechanism: Mechanism, fixed, name: str) -> None:
    """Raise if a node is both held by a support and part of a rigid body."""
    bodies = mechanism.bodies
    both = np.flatnonzero(fixed[bodies.attached].any(axis=1))
    if both.size:
        node = bodies.attached[both[0]]
        body = bodies.names[bodies.body[both[0]]]
        raise ValueError(
            f"configuration {name!r}: its supports hold {both.size} nodes of rigid "
            f"bodies, such as node {node} of {body!r} at "
            f"{mesh.points[node].tolist()} m. Hold the body instead, with bodies="
            f'{{{body!r}: "held"}}, or keep the groups apart.'
        )


def check_held(
    mesh: TetMesh,
    mechanism: Mechanism,
    fixed: Bool[HostArray, "n_nodes 3"],
    kind: Int[HostArray, " n_b"],
    *,
    name: str,
    balanced: bool,
) -> None:
    """Raise unless all six rigid motions of the configuration `name` are blocked.

    The angle of a hinge needs something by which it is `balanced`: weight, a load, or
    an actuator other than motors. `kind` are states of bodies, indices of `KINDS`. What
    obstacles hold depends on where they touch: with them, equilibrium has to tell.
    """
    bodies, centre = mechanism.bodies, mesh.points.mean(axis=0)
    obstacles = np.array(mechanism.contacts.body, int)
    if np.any(kind[bodies.owner][obstacles] != KINDS.index("absent")):
        return
    motors = mechanism.actuators.motors.items()
    hinged = [name for name, body in motors if kind[body] == KINDS.index("hinged")]
    if hinged and balanced:
        kind = np.where(kind == KINDS.index("hinged"), KINDS.index("held"), kind)
    size = np.abs(mesh.points - centre).max()
    motions = lambda x: np.concatenate(
        [
            np.broadcast_to(np.eye(3)[:, None], (3, len(x), 3)),
            np.cross(np.eye(3)[:, None], ((x - centre) / size)[None]),
        ]
    )
    rows = [motions(mesh.points)[:, fixed]]
    for k in np.flatnonzero((kind != KINDS.index("free")) & bodies.has_nodes):
        shifts = motions(bodies.origin[k][None])[:, 0]
        turns = np.concatenate([np.zeros((3, 3)), bodies.axes[k].T])
        if kind[k] == KINDS.index("sliding"):
            shifts = shifts @ bodies.axes[k].T[:, :2]
        rows += [shifts, turns[:, :2] if kind[k] == KINDS.index("hinged") else turns]
    held = np.concatenate(rows, axis=1)
    rank = np.linalg.matrix_rank(held @ held.T) if held.size else 0
    if rank < 6:
        nodes = int(fixed.any(axis=1).sum())
        hint = " Motor {!r} is driven by its torque: nothing that balances it is given."
        raise ValueError(
            f"configuration {name!r} is not held: its supports ({nodes} nodes) leave "
            f"{6 - rank} of the 6 rigid motions free. Clamp a surface, add supports, "
            f"or hold a rigid body.{hint.format(hinged[0]) if hinged else ''}"
        )


_FORCES = "lane.loads.force"


class AbstractLoad(Module):
    """A load that becomes forces on nodes, consistent with the shape functions.

    Loads of one name share a factor and an offset where they are only roughly known,
    see `load_factor` and `load_offset`.
    """

    name: str = eqx.field(default=UNNAMED_LOADS, kw_only=True)

    @abstractmethod
    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Compute forces on all nodes [N].

        Raises:
            ValueError: If there is no such place, or a force is not finite.
        """


class PointForce(AbstractLoad):
    """Force at a material point of the body.

    Attributes:
        point: Where it acts at rest, on or in the mesh [m].
        force: The force [N].
    """

    point: tuple[float, float, float] = eqx.field(metadata=POINT)
    force: tuple[float, float, float] = eqx.field(metadata=FORCE)

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        point = three_numbers("point", "m", self.point)
        force = three_numbers("force", "N", self.force, _FORCES)
        near, names = 1e-3 * mesh.size, ["the point of the force"]
        place = meshes.locate(mesh, point[None], max_distance=near, names=names)
        return _added(mesh, place.nodes[0], place.weights[0][:, None] * force)


class NodalForces(AbstractLoad):
    """Forces on given nodes.

    Attributes:
        nodes: Node indices.
        forces: One force per node [N].
    """

    nodes: Int[HostArray, " n"]
    forces: Float[HostArray, "n 3"]

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        nodes = meshes.node_indices(mesh, self.nodes, "a nodal force")
        check_untraced("forces", self.forces, _FORCES)
        forces = np.asarray(self.forces, float)
        if forces.shape != (n := len(nodes), 3):
            raise ValueError(f"forces need the shape ({n}, 3), got {forces.shape}.")
        for node, force in zip(nodes, forces, strict=True):
            three_numbers(f"the force on node {node}", "N", force)
        return _added(mesh, nodes, forces)


class EdgeForce(AbstractLoad):
    """Force spread evenly over an edge of the body, by length.

    Attributes:
        where: Node group of the edge, or its node indices: all edges of boundary faces
            whose ends both belong to it are loaded.
        force: Total force [N].
    """

    where: str | Int[HostArray, " n"] = eqx.field(
        metadata=key(words="name of the node group of an edge", key="edge")
    )
    force: tuple[float, float, float] = eqx.field(metadata=FORCE)

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Share the force: 1/2, 1/2 on linear edges, 1/6, 1/6, 4/6 on quadratic [N]."""
        force = three_numbers("force", "N", self.force, _FORCES)
        nodes = meshes.node_indices(mesh, self.where, "an edge force")
        faces = meshes.boundary_faces(mesh)
        sides = [(0, 1, 3), (1, 2, 4), (2, 0, 5)]  # two ends, then the mid node if any
        n_ln = 2 if faces.shape[1] == 3 else 3
        edges = np.concatenate([faces[:, side[:n_ln]] for side in sides])
        edges[:, :2] = np.sort(edges[:, :2], axis=1)
        edges = np.unique(edges, axis=0)
        edges = edges[np.all(np.isin(edges[:, :2], nodes), axis=1)]
        if len(edges) == 0:
            raise ValueError(
                f"no edge of the boundary has both ends in {self.where!r}: an edge "
                "force needs the nodes along an edge, at least two neighbours."
            )
        ends = mesh.points[edges[:, :2]]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        shares = np.array([0.5, 0.5] if edges.shape[1] == 2 else [1 / 6, 1 / 6, 4 / 6])
        per_edge = (length / length.sum())[:, None] * shares
        return _added(mesh, edges, per_edge[:, :, None] * force)


class SurfaceForce(AbstractLoad):
    """Force spread evenly over a surface, by its area at rest.

    Attributes:
        where: Name of a surface group.
        force: Total force [N].
    """

    where: str = eqx.field(metadata=SURFACE)
    force: tuple[float, float, float] = eqx.field(metadata=FORCE)

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        shares = meshes.surface_shares(mesh, mesh.faces(self.where))
        force = three_numbers("force", "N", self.force, _FORCES)
        return (shares / shares.sum())[:, None] * force


class SurfaceTraction(AbstractLoad):
    """Force per area at rest, of fixed direction.

    Attributes:
        where: Name of a surface group.
        traction: Force per reference area [Pa].
    """

    where: str = eqx.field(metadata=SURFACE)
    traction: tuple[float, float, float] = eqx.field(
        metadata=key("Pa", 'force per area: "(0, 0, -1) kPa"')
    )

    def nodal_forces(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        shares = meshes.surface_shares(mesh, mesh.faces(self.where))
        return shares[:, None] * three_numbers("traction", "Pa", self.traction, _FORCES)


LOADS = PointForce, EdgeForce, SurfaceForce, SurfaceTraction
"""The loads that project files make; each has a key that no other one has."""


def _added(mesh: TetMesh, nodes, forces) -> Float[HostArray, "n_nodes 3"]:
    """Place forces on all nodes [N]; they add up where a node is named twice."""
    out = np.zeros_like(mesh.points)
    np.add.at(out, nodes, forces)
    return out
