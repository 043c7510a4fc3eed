"""SOFA's linear tets in NumPy, and static equilibria of what they carry.

Nothing here calls the package. The forces are those of `TetrahedronFEMForceField`
(methods "polar" and "large") and of `CorotationalFEMForceField` ("polar") in the
sources of SOFA v25.12.00 and v26.06.00, with the polar factor by a singular value
decomposition. Tangents are central differences of the forces, so they cannot be wrong
in the same way as those of the package.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve


class Piece(NamedTuple):
    """Elements of one kind: their nodes, and forces on these by their positions."""

    nodes: np.ndarray
    force: Callable[[np.ndarray], np.ndarray]


def _polar(A):
    U, _, V_t = np.linalg.svd(A)
    return U @ V_t


def _edges(x):
    """Edges from the first node as columns."""
    return np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)


def _frame(x):
    """Axes along the first edge, and across the plane of the first two."""
    unit = lambda v: v / np.linalg.norm(v, axis=1, keepdims=True)
    a, b, _ = np.moveaxis(_edges(x), 2, 0)
    a, c = unit(a), unit(np.cross(a, b))
    return np.stack([a, np.cross(c, a), c], axis=2)


def rotations(kind: str, x: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Rotation of each tet with the nodes x, and X at rest."""
    if kind == "procrustes":
        away = [p - p.mean(axis=1, keepdims=True) for p in (x, X)]
        return _polar(np.einsum("eai,eaj->eij", *away))
    factor = {"edge": lambda p: _polar(_edges(p)), "large": _frame}[kind]
    return factor(x) @ np.swapaxes(factor(X), 1, 2)


def hooke(
    E: np.ndarray | float, nu: np.ndarray | float
) -> Callable[[np.ndarray], np.ndarray]:
    """Stress by strain; modulus and ratio are one for all tets, or one for each."""
    E, nu = (np.asarray(a, float).reshape(-1, 1, 1) for a in (E, nu))
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

    def stress(strain):
        trace = np.einsum("eii->e", strain)[:, None, None]
        return lam * trace * np.eye(3) + 2 * mu * strain

    return stress


def tets(
    X: np.ndarray,
    nodes: np.ndarray,
    stress: Callable[[np.ndarray], np.ndarray],
    kind: str,
) -> Piece:
    """Linear tets of SOFA with this rotation; `stress` maps strains to stresses."""
    rest = X[nodes]
    inner = np.linalg.inv(_edges(rest))
    dN = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    volume = np.linalg.det(_edges(rest)) / 6
    if volume.min() <= 0:
        raise ValueError("a tet has no volume, or its nodes stand the wrong way round.")

    def force(x):
        R = rotations(kind, x, rest)
        U = np.swapaxes(R, 1, 2) @ np.einsum("eai,eaj->eij", x, dN)
        sigma = stress(0.5 * (U + np.swapaxes(U, 1, 2)) - np.eye(3))
        return np.einsum("e,eij,eaj->eai", volume, R @ sigma, dN)

    return Piece(nodes, force)


def lumped_volumes(X: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """A quarter of the volume of each tet at each of its nodes."""
    volume = np.linalg.det(_edges(X[nodes])) / 6
    return np.bincount(nodes.ravel(), np.repeat(volume / 4, 4), len(X))


def assembled(pieces: Sequence[Piece], x: np.ndarray) -> np.ndarray:
    """Sum of the forces of all pieces on the nodes."""
    total = np.zeros_like(x)
    for piece in pieces:
        np.add.at(total, piece.nodes, piece.force(x[piece.nodes]))
    return total


def _tangent(pieces: Sequence[Piece], x, step):
    rows, columns, values = [], [], []
    for piece in pieces:
        x_e, (n, m) = x[piece.nodes], piece.nodes.shape
        dof = (3 * piece.nodes[:, :, None] + np.arange(3)).reshape(n, 3 * m)
        for k in range(3 * m):
            change = np.zeros((m, 3))
            change.flat[k] = step
            slope = (piece.force(x_e + change) - piece.force(x_e - change)) / (2 * step)
            rows.append(dof.ravel())
            columns.append(np.repeat(dof[:, k], 3 * m))
            values.append(slope.ravel())
    entries = (np.concatenate(part) for part in (values, rows, columns))
    v, i, j = entries
    return coo_matrix((v, (i, j)), (x.size, x.size)).tocsr()


def equilibrium(
    X: np.ndarray,
    pieces: Sequence[Piece],
    load: np.ndarray,
    free: np.ndarray,
    *,
    start: np.ndarray | None = None,
    load_steps: int = 4,
) -> np.ndarray:
    """Positions at which the forces of the pieces balance the load on free coordinates.

    Newton's method to a residual of 1e-9 of what loads and supports cause, from X or
    from a start that moves the supports; the load rises in steps. Rounding of long
    beams leaves some 1e-11.

    Args:
        X: Positions at rest.
        pieces: What carries the load.
        load: Forces on the nodes.
        free: Which coordinates may move, like X.
        start: Positions to begin at; X if left out.
        load_steps: In how many steps the load rises.

    Raises:
        RuntimeError: If Newton's method does not end.
    """
    x, scale = (X if start is None else start).copy(), np.ptp(X, axis=0).max()
    size = np.linalg.norm((load - assembled(pieces, x))[free])
    for part in np.linspace(0, 1, load_steps + 1)[1:]:
        for _ in range(30):
            residual = (part * load - assembled(pieces, x))[free]
            if np.linalg.norm(residual) < 1e-9 * size:
                break
            K = _tangent(pieces, x, 1e-6 * scale)[free.ravel()][:, free.ravel()]
            x[free] += spsolve(K.tocsc(), residual)
        else:
            raise RuntimeError(f"no equilibrium at {part:.0%} of the load")
    return x
