"""Pressures: in a closed chamber, or following an open surface."""

from collections import defaultdict
from collections.abc import Iterable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators._actuator import (
    AbstractActuator,
    AbstractCliques,
    AbstractPotentialCliques,
    AbstractPressedFaces,
    Kind,
    RestState,
    owned,
)
from softcal_jax.actuators._lid import ChamberLids, lid, lid_cone, open_edges, rims
from softcal_jax.elements import shape_functions, shape_gradients, triangle_rule
from softcal_jax.mesh import TetMesh, boundary_faces, face_indices

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

    surface: str
    seal: bool = False
    kind: ClassVar[Kind] = Kind("chamber", "Pa", "m3")

    def cliques(
        self, rest: RestState, owner: int
    ) -> "tuple[ChamberFaces | ChamberLids, ...]":
        faces = _outward_faces(rest.mesh, self.surface, self.label)
        openings = self._openings(rest, faces)
        centre = np.mean(rest.points[np.unique(faces)], axis=0)
        centres = jax.device_put(np.tile(centre, (len(faces), 1)))
        wall = ChamberFaces(*owned(faces, owner), centres)
        lids = [lid(rim, rest, centre, owner) for rim in openings]
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
        if self.seal == bool(len(edges.ends)):
            return rims(edges, rest.points, self.label)
        what = f"{self.label}: surface {self.surface!r}"
        if self.seal:
            raise ValueError(f"{what} is closed. Leave seal out.")
        where = rest.points[edges.ends[0]].mean(axis=0)
        raise ValueError(
            f"{what} is not closed, it has {len(edges.ends)} open edges, one at "
            f"{where.tolist()} m. Add the faces of the wall that are missing, seal the "
            "opening if it is an inlet (seal = true), or take a SurfacePressure."
        )


class ChamberFaces(AbstractPressedFaces, AbstractPotentialCliques):
    """Faces of the walls of chambers; each adds a cone's volume to delta_a.

    V = -1/3 integral of (x - c) . n dA by the divergence theorem. The normal n points
    out of the body, hence into the cavity, which explains the minus sign.

    Attributes:
        centre: The point c. Any point gives a closed surface the same volume; one near
            the cavity avoids cancellation [m].
    """

    centre: Float[Array, "*cliques 3"]

    def contribution(self, x: Float[Array, "n_fn 3"]) -> Float[Array, ""]:
        return _cones(x - self.centre[None])


class SurfacePressure(AbstractActuator):
    """A pressure on a surface of the body that turns and grows with it.

    lambda_a is the pressure [Pa]; if positive it pushes against the outward normal. On
    an open surface there is in general no potential, hence no displacement delta_a, and
    the tangent is not symmetric.

    Attributes:
        surface: Name of a surface group on the boundary of the body.
    """

    surface: str
    kind: ClassVar[Kind] = Kind("surface pressure", "Pa", None)

    def cliques(self, rest: RestState, owner: int) -> "tuple[PressureFaces]":
        faces = _outward_faces(rest.mesh, self.surface, self.label)
        return (PressureFaces(*owned(faces, owner)),)


class PressureFaces(AbstractPressedFaces):
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
        if not isinstance(group, ChamberFaces | ChamberLids):
            continue
        arms = x[np.asarray(group.nodes)] - np.asarray(group.centre)[:, None]
        if isinstance(group, ChamberFaces):
            cones = np.asarray(_cones(arms))
        else:
            lids = zip(arms, np.asarray(group.weights), strict=True)
            cones = [lid_cone(*each, quadratic=group.quadratic) for each in lids]
        for owner, cone in zip(np.asarray(group.owner).tolist(), cones, strict=True):
            volumes[owner] += float(cone)
    return dict(volumes)


def _cones(arm: Float[AnyArray, "*n n_fn 3"]) -> Any:
    """Compute the volumes of cones from the origin to one face, or to many [m3]."""
    n_dA, N = _vector_areas(arm)
    return -(n_dA * (N @ arm)).sum(axis=(-2, -1)) / 3.0


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
