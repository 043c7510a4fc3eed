"""Sparsity of the tangent: one pattern for every configuration of a mesh.

All degrees of freedom keep their rows. A support is a mask that turns rows and columns
into those of the identity, so configurations that are held at different places share
one symbolic analysis and one compiled program.
"""

import equinox as eqx
import numpy as np

from softcal_jax._typing import HostArray, Int


class Sparsity(eqx.Module):
    """Upper triangle of a symmetric matrix in compressed rows, diagonal included.

    Attributes:
        indptr: Start of each row.
        indices: Column of each entry, ascending within a row.
        rows: Row of each entry.
        diagonal: Position of each diagonal entry.
    """

    indptr: Int[HostArray, " n_dof_plus_1"]
    indices: Int[HostArray, " nnz"]
    rows: Int[HostArray, " nnz"]
    diagonal: Int[HostArray, " n_dof"]

    @property
    def n_dof(self) -> int:
        """Rows of the matrix."""
        return self.diagonal.shape[0]

    @property
    def nnz(self) -> int:
        """Stored entries."""
        return self.indices.shape[0]


def upper_entries(n_en: int) -> tuple[HostArray, HostArray]:
    """Local rows and columns of the upper triangle of an element matrix."""
    return np.triu_indices(3 * n_en)


def build_sparsity(
    tets: Int[HostArray, "n_tets n_en"], n_nodes: int
) -> tuple[Sparsity, Int[HostArray, "n_entries n_tets"]]:
    """Pattern of the tangent, and where each element entry goes in it.

    Args:
        tets: Nodes of each tet.
        n_nodes: Nodes of the mesh.

    Returns:
        The pattern, and for each tet the position of each entry of the upper triangle
        of its element matrix, in the order of `upper_entries`.
    """
    n_tets, n_en = tets.shape
    dof = (3 * tets[:, :, None] + np.arange(3)).reshape(n_tets, 3 * n_en)
    p, q = upper_entries(n_en)
    n_dof = 3 * n_nodes
    # Node pairs first: nine times fewer keys to sort than pairs of unknowns.
    a, b = np.triu_indices(n_en)
    low, high = np.minimum(tets[:, a], tets[:, b]), np.maximum(tets[:, a], tets[:, b])
    pairs = np.unique(low.astype(np.int64) * n_nodes + high)
    row_node, col_node = pairs // n_nodes, pairs % n_nodes
    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    row = (3 * row_node[:, None] + i).ravel()
    col = (3 * col_node[:, None] + j).ravel()
    keep = row <= col
    keys = np.sort(row[keep] * n_dof + col[keep])
    rows, indices = keys // n_dof, keys % n_dof
    indptr = np.searchsorted(rows, np.arange(n_dof + 1))
    r, c = np.minimum(dof[:, p], dof[:, q]), np.maximum(dof[:, p], dof[:, q])
    destination = np.searchsorted(keys, (r.astype(np.int64) * n_dof + c).T)
    sparsity = Sparsity(
        indptr.astype(np.int32),
        indices.astype(np.int32),
        rows.astype(np.int32),
        indptr[:-1].astype(np.int32),
    )
    return sparsity, destination.astype(np.int32)
