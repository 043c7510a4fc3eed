"""Pressures: in chambers, whose volume is their displacement, and on surfaces.

A wall may be open where a lid without material closes it: the cone from the rim of the
opening to its mean.
"""

from collections import defaultdict
from collections.abc import Iterable
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import key
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.actuators._actuator import (
    SURFACE,
    AbstractActuator,
    AbstractCliques,
    AbstractDisplacedCliques,
    ActuatorGeometry,
    Kind,
    RestState,
    owned,
)
from softcal_jax.elements import shape_functions, shape_gradients, triangle_rule
from softcal_jax.mesh import TetMesh, boundary_faces, face_indices, sides_of

AnyArray = Array | HostArray


class Chamber(AbstractActuator):
    """A cavity in the body, under pressure.

    delta_a = V(x) - V(X) is the growth of the enclosed volume since rest [m3].
    lambda_a is the gauge pressure in the cavity [Pa]: positive inflates, negative is
    vacuum.

    A wall that is open, like that of a real chamber at its inlet, can be sealed: each
    opening then gets a lid without material, from the nodes of its rim to their mean,
    and the pressure on it pulls at the rim, as it does where a tube is glued in.

    Attributes:
        surface: Name of the surface group that is the whole wall of the cavity.
        seal: Whether to close the openings of the wall.
    """

    surface: str = eqx.field(
        metadata=key(words='the surface group of its whole wall: "cavity"')
    )
    seal: bool = False
    kind: ClassVar[Kind] = Kind(
        "chamber",
        "Pa",
        "m3",
        imposed='its pressure, like "10 kPa", or its growth in volume, like "2 ml"',
    )

    def cliques(
        self, rest: RestState, owner: int
    ) -> "tuple[ChamberFaces | ChamberLids, ...]":
        faces = _outward_faces(rest.mesh, self.surface, self.label)
        openings = self._openings(rest, faces)
        centre = np.mean(rest.points[np.unique(faces)], axis=0, keepdims=True)
        wall = ChamberFaces(*owned(faces, owner, centre.repeat(len(faces), axis=0)))
        quadratic = rest.mesh.order == 2
        share = lambda rim: _shares(rest.points[rim], quadratic)[None]
        lids = [
            ChamberLids(
                *owned(rim[None], owner, share(rim), centre), quadratic=quadratic
            )
            for rim in openings
        ]
        volume = enclosed_volumes((wall, *lids), rest.points)[owner]
        if not volume > 0.0:
            raise ValueError(
                f"{self.label}: surface {self.surface!r} has the body on its inner "
                f"side (enclosed volume {volume:.3g} m3), expected the wall of a "
                "cavity. A pressure on the body from outside is a SurfacePressure."
            )
        return wall, *lids

    def _openings(
        self, rest: RestState, faces: Int[HostArray, "n_faces n_fn"]
    ) -> list[Int[HostArray, " m"]]:
        """Return the rims of the openings to seal, given faces with outward normals."""
        edges = open_edges(faces)
        if self.seal == bool(len(edges)):
            return rims(edges, rest.points, self.label)
        what = f"{self.label}: surface {self.surface!r}"
        if self.seal:
            raise ValueError(f"{what} is closed. Leave seal out.")
        where = rest.points[edges[0, [0, -1]]].mean(axis=0)
        raise ValueError(
            f"{what} is not closed, it has {len(edges)} open edges, one at "
            f"{where.tolist()} m. Add the faces of the wall that are missing, seal the "
            "opening if it is an inlet (seal = true), or take a SurfacePressure."
        )


class ChamberFaces(AbstractDisplacedCliques):
    """Faces of the walls of chambers; each adds a cone's volume to delta_a.

    V = -1/3 integral of (x - c) . n dA by the divergence theorem. The normal n points
    out of the body, hence into the cavity, which explains the minus sign.

    Attributes:
        centre: The point c. Any point gives a closed surface the same volume; one near
            the cavity avoids cancellation [m].
    """

    centre: Float[Array, "*cliques 3"]

    def contribution(self, x: Float[AnyArray, "*n n_fn 3"]) -> Any:
        arm = x - self.centre[..., None, :]
        n_dA, N = _vector_areas(arm)
        return -(n_dA * (N @ arm)).sum(axis=(-2, -1)) / 3.0


class SurfacePressure(AbstractActuator):
    """A pressure on a surface of the body that turns and grows with it.

    lambda_a is the pressure [Pa]; if positive it pushes against the outward normal. On
    an open surface there is in general no potential, hence no displacement delta_a, and
    the tangent is not symmetric.

    Attributes:
        surface: Name of a surface group on the boundary of the body.
    """

    surface: str = eqx.field(metadata=SURFACE)
    kind: ClassVar[Kind] = Kind(
        "surface pressure", "Pa", None, imposed='its pressure, like "10 kPa"'
    )

    def cliques(self, rest: RestState, owner: int) -> "tuple[PressureFaces]":
        faces = _outward_faces(rest.mesh, self.surface, self.label)
        return (PressureFaces(*owned(faces, owner)),)


class PressureFaces(AbstractCliques):
    """Faces under a following pressure, their normals out of the body."""

    def row(self, x: Float[Array, "n_fn 3"]) -> Float[Array, "n_fn 3"]:
        """Compute consistent forces per pressure, -integral of N n dA [m2]."""
        n_dA, N = _vector_areas(x)
        return -N.T @ n_dA


def _outward_faces(
    mesh: TetMesh, surface: str, owner: str
) -> Int[HostArray, "n_faces n_fn"]:
    """Return the faces of a surface group, once each, with outward normals.

    The order of nodes in a group is arbitrary, so the tet behind each face decides.
    """
    faces, boundary = mesh.faces(surface), boundary_faces(mesh)
    indices = face_indices(faces, boundary)
    inner = np.flatnonzero(indices < 0)
    if inner.size:
        where = mesh.points[faces[inner[0]][:3]].mean(axis=0)
        raise ValueError(
            f"{owner}: {inner.size} of {len(faces)} faces of surface {surface!r} are "
            f"not on the boundary of the body, one at {where.tolist()} m; "
            "`select_faces` gives those that are."
        )
    return boundary[np.unique(indices)]


def enclosed_volumes(
    cliques: Iterable[AbstractCliques], x: Float[HostArray, "n_all 3"]
) -> dict[int, float]:
    """Compute the volume of each chamber by the index of its actuator [m3].

    On the host, where nothing is compiled. `cliques` may be of any kind.
    """
    volumes: dict[int, float] = defaultdict(float)
    for group in cliques:
        if isinstance(group, ChamberFaces | ChamberLids):
            all_at_once = jax.device_get(group)
            cones = all_at_once.contribution(x[all_at_once.nodes])
            for owner, cone in zip(all_at_once.owner.tolist(), cones, strict=True):
                volumes[owner] += float(cone)
    return dict(volumes)


def _vector_areas(x: Float[AnyArray, "*n n_fn 3"]) -> tuple[Any, Any]:
    """Compute n dA [m2] and shape functions at the quadrature points of a face.

    n dA = 1/2 w_q dx/dxi x dx/deta. The rule is exact for the integral of N n dA: of
    degree 1 on linear faces, 4 on quadratic ones.
    """
    xp: Any = np if isinstance(x, np.ndarray) else jnp
    n_fn = x.shape[-2]
    rule = triangle_rule(1 if n_fn == 3 else 4)
    N = xp.asarray(shape_functions(rule.barycentric, n_fn), x.dtype)
    dN = xp.asarray(shape_gradients(rule.barycentric, n_fn), x.dtype)
    weights = xp.asarray(0.5 * rule.weights, x.dtype)
    tangents = xp.einsum("qaj,...ai->j...qi", dN, x)
    return weights[:, None] * xp.cross(tangents[0], tangents[1]), N


def open_edges(faces: Int[HostArray, "n _"]) -> Int[HostArray, "n_edges _"]:
    """Find the open edges of a surface, given its faces with consistent normals.

    Faces do not traverse them equally often in both directions. The nodes of each are
    in the direction that prevails; one that prevails twice is listed twice.
    """
    corners = faces[:, :3]
    sides = sides_of(corners)
    sense = np.where(sides.forwards, 1, -1)
    total = np.zeros(len(sides.counts), int)
    np.add.at(total, sides.edge, sense)
    excess = total[sides.edge] * sense
    open_sides = np.flatnonzero(excess > 0)
    chosen = open_sides[np.unique(sides.edge[open_sides], return_index=True)[1]]
    mids, ends = faces[:, 3:].reshape(corners.size, -1), np.roll(corners, -1, axis=1)
    nodes = np.column_stack([corners.ravel(), mids, ends.ravel()])
    return np.repeat(nodes[chosen], excess[chosen], axis=0)


def rims(
    edges: Int[HostArray, "n_edges _"], points: Float[HostArray, "n_all 3"], owner: str
) -> list[Int[HostArray, " m"]]:
    """Link open edges to closed rings of corners, with mid nodes between them."""
    starts, count = np.unique(edges[:, 0], return_counts=True)
    crowded = starts[count > 1]
    if crowded.size:
        where = readable_values(points[crowded[0]].tolist(), "m")
        raise ValueError(
            f"{owner}: openings of the wall meet at {where}. Choose the faces of the "
            "wall so that they are apart."
        )
    following = {int(side[0]): side for side in edges}
    rings = []
    while following:
        node, ring = next(iter(following)), []
        while node in following:
            *part, node = following.pop(node).tolist()
            ring += part
        rings.append(np.array(ring, edges.dtype))
    return rings


class ChamberLids(AbstractDisplacedCliques):
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

    def contribution(self, x: Float[AnyArray, "*n m 3"]) -> Any:
        xp: Any = np if isinstance(x, np.ndarray) else jnp
        arm = x - self.centre[..., None, :]
        a = arm[..., :: 1 + self.quadratic, :]
        b = xp.roll(a, -1, axis=-2)
        mid = arm[..., 1::2, :] if self.quadratic else 0.5 * (a + b)
        # The integral of x cross dx along the parabola through a, mid and b.
        turns = 4.0 * (xp.cross(a, mid) + xp.cross(mid, b)) - xp.cross(a, b)
        mean = xp.sum(self.weights[..., None] * arm, axis=-2)
        return xp.sum(mean * xp.sum(turns, axis=-2), axis=-1) / 18.0

    def following(self, mesh: TetMesh, n_actuators: int) -> "ChamberLids":
        rims = jnp.asarray(mesh.points)[self.nodes]
        weights = jax.vmap(partial(_shares, quadratic=self.quadratic))(rims)
        return eqx.tree_at(lambda lids: lids.weights, self, weights)

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


def _shares(x: Float[AnyArray, "m 3"], quadratic: bool) -> Any:
    """Integrate the shape functions along a ring of straight edges; they sum to 1."""
    xp: Any = np if isinstance(x, np.ndarray) else jnp
    corners = x[:: 1 + quadratic]
    after = xp.linalg.norm(xp.roll(corners, -1, axis=0) - corners, axis=1)
    both = after + xp.roll(after, 1)
    if quadratic:
        shares = xp.stack([both / 6.0, after / 1.5], axis=1).ravel()
    else:
        shares = 0.5 * both
    return shares / after.sum()
