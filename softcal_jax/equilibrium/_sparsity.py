"""Sparsity of the tangent: one pattern for every configuration of a mesh.

All degrees of freedom keep their rows. A support is a mask that turns rows and columns
into those of the identity, so configurations that are held at different places share
one symbolic analysis and one compiled program.
"""

import equinox as eqx
import numpy as np

from softcal_jax._typing import HostArray, Int


class Sparsity(eqx.Module):
    """A matrix with a symmetric pattern in compressed rows, diagonal included.

    A symmetric matrix is kept as its upper triangle, any other one in full.

    Attributes:
        indptr: Start of each row.
        indices: Column of each entry, ascending within a row.
        rows: Row of each entry.
        diagonal: Position of each diagonal entry.
        mirror: Position of the entry on the other side of the diagonal, so that
            `values[mirror]` is the transposed matrix; None for an upper triangle.
    """

    indptr: Int[HostArray, " n_dof_plus_1"]
    indices: Int[HostArray, " nnz"]
    rows: Int[HostArray, " nnz"]
    diagonal: Int[HostArray, " n_dof"]
    mirror: Int[HostArray, " nnz"] | None = None

    @property
    def symmetric(self) -> bool:
        """Whether the matrix is its own transpose, kept as its upper triangle."""
        return self.mirror is None

    @property
    def n_dof(self) -> int:
        """Rows of the matrix."""
        return self.diagonal.shape[0]

    @property
    def nnz(self) -> int:
        """Stored entries."""
        return self.indices.shape[0]


def element_entries(n_en: int, symmetric: bool) -> tuple[HostArray, HostArray]:
    """Local rows and columns of an element matrix: its upper triangle, or all."""
    if symmetric:
        return np.triu_indices(3 * n_en)
    p, q = np.indices((3 * n_en, 3 * n_en)).reshape(2, -1)
    return p, q


def _upward(symmetric: bool, row, col):
    """Places of the entries as they are kept: a symmetric matrix has i <= j only."""
    return (np.minimum(row, col), np.maximum(row, col)) if symmetric else (row, col)


def build_sparsity(
    tets: Int[HostArray, "n_tets n_en"], n_nodes: int, *, symmetric: bool = True
) -> tuple[Sparsity, Int[HostArray, "n_entries n_tets"]]:
    """Pattern of the tangent, and where each element entry goes in it.

    Args:
        tets: Nodes of each tet.
        n_nodes: Nodes of the mesh.
        symmetric: Whether the tangent is, so that the upper triangle is enough.

    Returns:
        The pattern, and for each tet the position of each entry of its element matrix,
        in the order of `element_entries`.
    """
    n_tets, n_en = tets.shape
    dof = (3 * tets[:, :, None] + np.arange(3)).reshape(n_tets, 3 * n_en)
    p, q = element_entries(n_en, symmetric)
    n_dof = 3 * n_nodes
    # Node pairs first: nine times fewer keys to sort than pairs of unknowns.
    a, b = np.triu_indices(n_en) if symmetric else np.indices((n_en, n_en))
    low, high = _upward(symmetric, tets[:, a], tets[:, b])
    pairs = np.unique(low.astype(np.int64) * n_nodes + high)
    row_node, col_node = pairs // n_nodes, pairs % n_nodes
    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    row = (3 * row_node[:, None] + i).ravel()
    col = (3 * col_node[:, None] + j).ravel()
    keys = row * n_dof + col
    keys = np.sort(keys[row <= col] if symmetric else keys)
    rows, indices = keys // n_dof, keys % n_dof
    indptr = np.searchsorted(rows, np.arange(n_dof + 1))
    r, c = _upward(symmetric, dof[:, p], dof[:, q])
    destination = np.searchsorted(keys, (r.astype(np.int64) * n_dof + c).T)
    sparsity = Sparsity(
        indptr.astype(np.int32),
        indices.astype(np.int32),
        rows.astype(np.int32),
        np.searchsorted(keys, np.arange(n_dof) * (n_dof + 1)).astype(np.int32),
        # Sorted by column, the entries stand in the order of the transpose.
        None if symmetric else np.lexsort((rows, indices)).astype(np.int32),
    )
    return sparsity, destination.astype(np.int32)
