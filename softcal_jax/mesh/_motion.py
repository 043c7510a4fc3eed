"""How nodes move where a surface of the body is elsewhere, and the rest stays."""

import numpy as np
from scipy.sparse import bsr_array, coo_array, diags_array, eye_array, kron
from scipy.sparse.linalg import cg

from softcal_jax._module import key, keys
from softcal_jax._typing import Float, HostArray, Int, Vector
from softcal_jax.elements import TET_EDGES
from softcal_jax.mesh._surfaces import SHARP
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import (
    area_normals,
    boundary_faces,
    corner_volumes,
    face_indices,
)


@keys(surface=key(words='a surface group that is offset: "z_max"'), direction=key(""))
def surface_motion(
    mesh: TetMesh, surface: str, direction: Vector | None = None
) -> Float[HostArray, "n_nodes 3"]:
    """Return how all nodes move per metre by which a surface is offset [-].

    It is one of the `shapes` of `build_model`. The surface moves along its outward
    normals, so that the body is thicker there, or along a direction, as a hole does
    that is elsewhere. At an edge within it, both faces move by the offset. Nodes on all
    other faces stay in their planes, and slide there; beside a surface that they meet
    at a slant they tilt. The inside follows by Laplace's equation, and mid nodes stay
    in the middle of straight edges.

    Args:
        mesh: The mesh.
        surface: A surface group, on the boundary of the body.
        direction: Where all of the surface moves; its length does not count.

    Raises:
        ValueError: If there is no such group, it has faces inside the body, or the
            direction is no vector or zero.
        RuntimeError: If the motion of the inside is not found.
    """
    faces = boundary_faces(mesh)[:, :3]
    which = face_indices(mesh.faces(surface)[:, :3], faces)
    if np.any(which < 0):
        raise ValueError(
            f"surface group {surface!r} has {np.sum(which < 0)} faces inside the body; "
            "expected faces of its boundary."
        )
    normals = area_normals(mesh.points[faces])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moves = np.isin(np.arange(len(faces)), which)
    moved = np.isin(np.arange(mesh.n_nodes), faces[moves])
    _, motion, _ = _across(mesh.n_nodes, faces[moves], normals[moves])
    if direction is not None:
        along = np.asarray(direction, float)
        if along.shape != (3,) or not 0.0 < np.linalg.norm(along) < np.inf:
            raise ValueError(f"direction must be a vector, not zero; got {direction}.")
        motion[moved] = along / np.linalg.norm(along)

    # What is not known: the motion inside, and slides on the other faces.
    vectors, _, held = _across(mesh.n_nodes, faces[~moves], normals[~moves])
    held |= (moved | ~np.isin(np.arange(mesh.n_nodes), mesh.tets[:, :4]))[:, None]
    rows = np.arange(mesh.n_nodes)
    blocks = bsr_array((vectors, rows, np.append(rows, mesh.n_nodes)))
    free = blocks.tocsc()[:, np.flatnonzero(~held)]
    K = kron(_laplacian(mesh), eye_array(3), format="csr")
    A, b = (free.T @ K @ free).tocsr(), -(free.T @ (K @ motion.ravel()))
    if b.size:
        slides, failed = cg(A, b, rtol=1e-12, M=diags_array(1.0 / A.diagonal()))
        if failed:
            raise RuntimeError(
                f"no motion of the inside was found for surface group {surface!r}: its "
                "tets may be too flat. Mesh it anew, or give a motion of your own."
            )
        motion += (free @ slides).reshape(-1, 3)
    return straightened(mesh, motion)


def straightened(
    mesh: TetMesh, motion: Float[HostArray, "n_nodes 3"]
) -> Float[HostArray, "n_nodes 3"]:
    """Return a motion with mid nodes that stay in the middle of their edges."""
    motion = motion.copy()
    if mesh.order == 2:
        ends = mesh.tets[:, np.array(TET_EDGES)]
        motion[mesh.tets[:, 4:]] = motion[ends].mean(axis=2)
    return motion


def _across(
    n_nodes: int, faces: Int[HostArray, "n 3"], normals: Float[HostArray, "n 3"]
) -> tuple[HostArray, HostArray, HostArray]:
    """Return axes at each node, the motion by which its faces move by 1, and its axes.

    Columns are the axes; those along which the faces do not turn are not across them.
    """
    M, total = np.zeros((n_nodes, 3, 3)), np.zeros((n_nodes, 3))
    np.add.at(M, faces, (normals[:, :, None] * normals[:, None])[:, None])
    np.add.at(total, faces, normals[:, None])
    size, axes = np.linalg.eigh(M)
    across = size > np.sin(0.5 * SHARP) ** 2 * size.sum(axis=1, keepdims=True)
    along = np.einsum("nij,ni->nj", axes, total)
    along = np.divide(along, size, out=np.zeros_like(along), where=across)
    return axes, np.einsum("nij,nj->ni", axes, along), across


def _laplacian(mesh: TetMesh) -> coo_array:
    """Assemble the integrals of grad N_a . grad N_b over the tets [m]."""
    corners = mesh.tets[:, :4]
    X = mesh.points[corners]
    # Inverse of the values of 1, x, y and z at the corners: dN/dx below the first row.
    dN = np.linalg.inv(np.insert(X, 0, 1.0, axis=2))[:, 1:]
    of_tets = np.einsum("t,tia,tib->tab", corner_volumes(X), dN, dN)
    at = np.broadcast_to(corners[:, :, None], of_tets.shape)
    ends = at.ravel(), at.swapaxes(1, 2).ravel()
    return coo_array((of_tets.ravel(), ends), (mesh.n_nodes, mesh.n_nodes))
