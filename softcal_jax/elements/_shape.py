"""Lagrange shape functions of simplices, linear and quadratic, in barycentric form.

One formula serves lines, triangles and tets: with barycentric coordinates L the
linear functions are L_i; the quadratic ones L_i (2 L_i - 1) at corners and
4 L_i L_j on edges (Zienkiewicz and Taylor, The Finite Element Method, ch. 8).
Node order is VTK's: corners first, then the edges of `TET_EDGES`.
"""

import numpy as np

from softcal_jax._typing import Float, HostArray

TET_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
"""Corner pairs of the edge nodes 4 to 9 of a quadratic tet."""

TET_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Corners of the four faces, ordered so that the normal points outwards."""

_EDGES = {2: ((0, 1),), 3: ((0, 1), (1, 2), (2, 0)), 4: TET_EDGES}


def _corners_and_edges(n_nodes: int, n_corners: int):
    edges = _EDGES[n_corners]
    if n_nodes not in (n_corners, n_corners + len(edges)):
        raise ValueError(
            f"a simplex with {n_corners} corners has {n_corners} (linear) or "
            f"{n_corners + len(edges)} (quadratic) nodes, got {n_nodes}."
        )
    return edges if n_nodes > n_corners else ()


def shape_functions(
    barycentric: Float[HostArray, "*points n_corners"], n_nodes: int
) -> Float[HostArray, "*points n_nodes"]:
    """Evaluate the shape functions at points of a simplex [-].

    Args:
        barycentric: Barycentric coordinates; rows sum to one. Coordinates outside
            [0, 1] extrapolate.
        n_nodes: Nodes of the element (3 or 6, 4 or 10; 2 or 3 for an edge).

    Returns:
        Shape-function values, corners first; rows sum to one.

    Raises:
        ValueError: If no simplex of that dimension has `n_nodes` nodes.
    """
    n_corners = barycentric.shape[-1]
    edges = _corners_and_edges(n_nodes, n_corners)
    if not edges:
        return np.array(barycentric, dtype=float)
    corner = barycentric * (2.0 * barycentric - 1.0)
    mid = [4.0 * barycentric[..., i] * barycentric[..., j] for i, j in edges]
    return np.concatenate([corner, np.stack(mid, axis=-1)], axis=-1)


def shape_gradients(
    barycentric: Float[HostArray, "*points n_corners"], n_nodes: int
) -> Float[HostArray, "*points n_nodes n_dim"]:
    """Differentiate the shape functions in the reference coordinates [-].

    The reference coordinates are L_1, ..., L_d, with L_0 = 1 - sum(L_1..L_d).

    Args:
        barycentric: Barycentric coordinates of the points.
        n_nodes: Nodes of the element.

    Returns:
        dN_a / d xi_j.

    Raises:
        ValueError: If no simplex of that dimension has `n_nodes` nodes.
    """
    n_corners = barycentric.shape[-1]
    edges = _corners_and_edges(n_nodes, n_corners)
    dL = np.vstack([-np.ones(n_corners - 1), np.eye(n_corners - 1)])
    if not edges:
        return np.broadcast_to(dL, (*barycentric.shape[:-1], *dL.shape)).copy()
    corner = (4.0 * barycentric[..., None] - 1.0) * dL
    mid = [
        4.0 * (barycentric[..., i, None] * dL[j] + barycentric[..., j, None] * dL[i])
        for i, j in edges
    ]
    return np.concatenate([corner, np.stack(mid, axis=-2)], axis=-2)
