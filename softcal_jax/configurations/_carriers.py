"""The nodes that carry each marker, and their weights."""

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations._markers import Markers
from softcal_jax.mesh import TetMesh, locate, volumes


def carriers(
    mesh: TetMesh, markers: Markers
) -> list[tuple[Int[HostArray, " n"], Float[HostArray, " n"]]]:
    """Find the nodes and weights with which each marker follows the mesh.

    Args:
        mesh: The mesh at rest.
        markers: The markers.

    Returns:
        One pair per marker; its position is the weighted sum of node positions.

    Raises:
        ValueError: If a marker is too far from the mesh, or its base holds too few
            nodes.
    """
    at = locate(mesh, markers.positions, max_distance=markers.max_distance)
    if markers.base_radius == 0.0:
        return list(zip(at.nodes, at.weights, strict=True))
    volume = _nodal_volumes(mesh)
    return [
        _patch(mesh, volume, foot, position, radius=markers.base_radius, name=name)
        for foot, position, name in zip(
            at.foot, markers.positions, markers.names, strict=True
        )
    ]


def _patch(mesh, volume, foot, position, *, radius, name):
    """Return nodes within a radius of the foot, and weights of their affine motion."""
    nodes = np.flatnonzero(np.linalg.norm(mesh.points - foot, axis=1) <= radius)
    share = np.sqrt(volume[nodes])
    centre = mesh.points[nodes].mean(axis=0) if nodes.size else foot
    # Affine functions at the nodes, in units of the radius for good conditioning.
    A = np.column_stack([np.ones(nodes.size), (mesh.points[nodes] - centre) / radius])
    singular = np.linalg.svd(share[:, None] * A, compute_uv=False)
    if nodes.size < 4 or singular[-1] < 1e-3 * singular[0]:
        raise ValueError(
            f"marker {name!r}: only {nodes.size} nodes lie within base_radius "
            f"{radius:g} m of its foot, too few to carry a post. Refine the mesh "
            "there, or raise base_radius above the edge length."
        )
    at_marker = np.concatenate([[1.0], (position - centre) / radius])
    return nodes, at_marker @ np.linalg.pinv(share[:, None] * A) * share


def _nodal_volumes(mesh: TetMesh) -> Float[HostArray, " n_nodes"]:
    """Share the volume of each tet evenly among its nodes [m3].

    Integrals of quadratic shape functions would give corners a negative share.
    """
    share = volumes(mesh) / mesh.tets.shape[1]
    out = np.zeros(mesh.n_nodes)
    np.add.at(out, mesh.tets, share[:, None])
    return out
