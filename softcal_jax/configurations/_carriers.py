"""The nodes that carry each marker, and their weights."""

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations._effector import EffectorRow
from softcal_jax.configurations._markers import Markers
from softcal_jax.mesh import TetMesh, locate, volumes


def marker_rows(
    mesh: TetMesh, markers: Markers, measured: Float[HostArray, "n_markers 3"] | None
) -> list[EffectorRow]:
    """Return markers as rows of effectors, with their measured values if given."""
    inverse_std, known = markers.inverse_std(), measured is not None
    values = np.full((len(markers.names), 3), np.nan) if measured is None else measured
    return [
        EffectorRow(
            name=name,
            quantity="point",
            unit="m",
            measured=values[i],
            inverse_std=inverse_std[i] * known,
            nodes=nodes,
            weights=weights,
        )
        for i, (name, (nodes, weights)) in enumerate(
            zip(markers.names, _carriers(mesh, markers), strict=True)
        )
    ]


def _carriers(
    mesh: TetMesh, markers: Markers
) -> list[tuple[Int[HostArray, " n"], Float[HostArray, " n"]]]:
    """Find nodes whose positions, summed with weights, are those of each marker."""
    at = locate(mesh, markers.positions, max_distance=markers.max_distance)
    if markers.base_radius == 0.0:
        return list(zip(at.nodes, at.weights, strict=True))
    # The volume of each tet is shared evenly among its nodes: integrals of quadratic
    # shape functions would give corners a negative share.
    volume = np.zeros(mesh.n_nodes)
    np.add.at(volume, mesh.tets, volumes(mesh)[:, None] / mesh.tets.shape[1])
    feet = zip(at.foot, markers.positions, markers.names, strict=True)
    return [_patch(mesh, volume, *foot, radius=markers.base_radius) for foot in feet]


def _patch(mesh, volume, foot, position, name, *, radius):
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
