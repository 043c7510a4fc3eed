"""Surfaces under pressure: orientation, closedness and vector areas."""

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.elements import shape_functions, shape_gradients, triangle_rule
from softcal_jax.mesh import TetMesh, boundary_faces


def outward_faces(
    mesh: TetMesh, surface: str, owner: str
) -> Int[HostArray, "n_faces n_fn"]:
    """Return the faces of a surface group, once each, with outward normals.

    The order of nodes in a group is arbitrary, so the tet behind each face decides.
    `owner` is what acts on it, for messages.

    Raises:
        ValueError: If the group is unknown, or a face is not on the boundary.
    """
    faces, boundary = mesh.faces(surface), boundary_faces(mesh)
    corners = np.sort(np.concatenate([boundary, faces])[:, :3], axis=1)
    _, first, inverse = np.unique(
        corners, axis=0, return_index=True, return_inverse=True
    )
    at = first[inverse.ravel()[len(boundary) :]]
    inner = np.flatnonzero(at >= len(boundary))
    if inner.size:
        where = mesh.points[faces[inner[0]][:3]].mean(axis=0)
        raise ValueError(
            f"{owner}: {inner.size} of {len(faces)} faces of surface {surface!r} are "
            f"not on the boundary of the body, one at {where.tolist()} m. A pressure "
            "needs faces with the body on one side only; `select_faces` gives such."
        )
    return boundary[np.unique(at)]


def check_closed(
    mesh: TetMesh, faces: Int[HostArray, "n_faces n_fn"], surface: str, owner: str
):
    """Raise ValueError unless a surface is closed, given its faces, oriented outward.

    It is if its faces traverse every edge equally often in both directions.
    """
    ways = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, inverse = np.unique(np.sort(ways, axis=1), axis=0, return_inverse=True)
    sense = np.where(ways[:, 0] < ways[:, 1], 1.0, -1.0)
    open_edges = edges[np.bincount(inverse.ravel(), sense) != 0.0]
    if len(open_edges):
        where = mesh.points[open_edges[0]].mean(axis=0)
        raise ValueError(
            f"{owner}: surface {surface!r} is not closed, it has {len(open_edges)} "
            f"open edges, one at {where.tolist()} m. Expected the whole wall of the "
            "cavity; a pressure on an open surface is a SurfacePressure."
        )


def vector_areas(
    x: Float[Array, "n_fn 3"],
) -> tuple[Float[Array, "n_q 3"], Float[Array, "n_q n_fn"]]:
    """Compute n dA [m2] and shape functions at the quadrature points of one face.

    n dA = 1/2 w_q dx/dxi x dx/deta. The rule is exact for the integral of N n dA: of
    degree 1 on linear faces, 4 on quadratic ones.
    """
    n_fn = x.shape[0]
    rule = triangle_rule(1 if n_fn == 3 else 4)
    N = jnp.asarray(shape_functions(rule.barycentric, n_fn), x.dtype)
    dN = jnp.asarray(shape_gradients(rule.barycentric, n_fn), x.dtype)
    weights = jnp.asarray(0.5 * rule.weights, x.dtype)
    tangents = jnp.einsum("qaj,ai->jqi", dN, x)
    return weights[:, None] * jnp.cross(tangents[0], tangents[1]), N
