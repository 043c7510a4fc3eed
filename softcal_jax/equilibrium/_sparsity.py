"""Sparsity of the tangent: one pattern for every configuration of a mesh.

All degrees of freedom keep their rows. A support is a mask that replaces rows and
columns by those of a scaled identity, so configurations with different supports share
one symbolic analysis and one compiled program.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int


class Sparsity(eqx.Module):
    """A matrix with a symmetric pattern in compressed rows, diagonal included.

    Symmetric matrices are stored as their upper triangle, all others in full.

    Attributes:
        indptr: Start of each row.
        indices: Column of each entry, ascending within a row.
        rows: Row of each entry.
        diagonal: Position of each diagonal entry.
        mirror: Position of the transposed entry, so that `values[mirror]` is the
            transposed matrix; None for an upper triangle.
    """

    indptr: Int[HostArray, " n_dof_plus_1"]
    indices: Int[HostArray, " nnz"]
    rows: Int[HostArray, " nnz"]
    diagonal: Int[HostArray, " n_dof"]
    mirror: Int[HostArray, " nnz"] | None = None

    @property
    def symmetric(self) -> bool:
        """Whether the matrix is symmetric and stored as its upper triangle."""
        return self.mirror is None

    @property
    def n_dof(self) -> int:
        """Number of rows."""
        return self.diagonal.shape[0]

    @property
    def nnz(self) -> int:
        """Number of stored entries."""
        return self.indices.shape[0]

    def positions(
        self, rows: Int[HostArray, "..."], columns: Int[HostArray, "..."]
    ) -> Int[HostArray, "..."]:
        """Find the positions of entries, or of their mirror images if only those exist.

        Args:
            rows: Their rows.
            columns: Their columns; every entry must be in the pattern.
        """
        keys = self.rows.astype(np.int64) * self.n_dof + self.indices
        row, column = _upward(self.symmetric, np.asarray(rows), np.asarray(columns))
        found = np.searchsorted(keys, row.astype(np.int64) * self.n_dof + column)
        return found.astype(np.int32)


def element_entries(n_en: int, symmetric: bool) -> tuple[HostArray, HostArray]:
    """List local rows and columns of an element matrix: upper triangle, or all."""
    if symmetric:
        return np.triu_indices(3 * n_en)
    p, q = np.indices((3 * n_en, 3 * n_en)).reshape(2, -1)
    return p, q


def _upward(symmetric: bool, row, col):
    """Map entries to the stored ones: a symmetric matrix only stores i <= j."""
    return (np.minimum(row, col), np.maximum(row, col)) if symmetric else (row, col)


def build_sparsity(
    cliques: Sequence[Int[HostArray, "_ _"]], n_nodes: int, *, symmetric: bool = True
) -> Sparsity:
    """Build the pattern of a matrix that couples the nodes of each clique, like a tet.

    Args:
        cliques: Sets of coupled nodes; each array holds sets of equal size.
        n_nodes: Number of nodes, with three unknowns each.
        symmetric: Whether the matrix is symmetric.

    Returns:
        The pattern.
    """
    # Sort pairs of nodes first: nine times fewer keys than pairs of unknowns.
    own = np.arange(n_nodes, dtype=np.int64)
    found = [own * n_nodes + own]
    for nodes in cliques:
        m = nodes.shape[1]
        a, b = np.triu_indices(m) if symmetric else np.indices((m, m))
        low, high = _upward(symmetric, nodes[:, a], nodes[:, b])
        found.append(np.unique(low.astype(np.int64) * n_nodes + high))
    pairs = np.unique(np.concatenate(found))
    row_node, col_node = pairs // n_nodes, pairs % n_nodes
    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    rows = (3 * row_node[:, None] + i).ravel()
    columns = (3 * col_node[:, None] + j).ravel()
    return from_entries(rows, columns, 3 * n_nodes, symmetric=symmetric)


def from_entries(
    rows: Int[HostArray, " n"],
    columns: Int[HostArray, " n"],
    n_dof: int,
    *,
    symmetric: bool,
) -> Sparsity:
    """Build a pattern from entries in any order, duplicates allowed.

    Args:
        rows: Their rows.
        columns: Their columns.
        n_dof: Number of rows; every diagonal entry must be given.
        symmetric: Whether to leave out entries below the diagonal.
    """
    keys = rows.astype(np.int64) * n_dof + columns
    keys = np.unique(keys[rows <= columns] if symmetric else keys)
    rows, indices = keys // n_dof, keys % n_dof
    # Sorting by column gives the order of the transpose.
    mirror = None if symmetric else np.lexsort((rows, indices)).astype(np.int32)
    return Sparsity(
        indptr=np.searchsorted(rows, np.arange(n_dof + 1)).astype(np.int32),
        indices=indices.astype(np.int32),
        rows=rows.astype(np.int32),
        diagonal=np.searchsorted(keys, np.arange(n_dof) * (n_dof + 1)).astype(np.int32),
        mirror=mirror,
    )


def destinations(
    sparsity: Sparsity, nodes: Int[HostArray, "n m"]
) -> Int[HostArray, "n_entries n"]:
    """Find the positions of each clique's entries, ordered as in `element_entries`.

    Args:
        sparsity: A pattern that contains the cliques.
        nodes: Their nodes.
    """
    n, m = nodes.shape
    dof = (3 * nodes[:, :, None] + np.arange(3)).reshape(n, 3 * m)
    p, q = element_entries(m, sparsity.symmetric)
    return sparsity.positions(dof[:, p].T, dof[:, q].T)


def product(
    sparsity: Sparsity, values: Float[Array, " nnz"], v: Float[Array, " n_dof"]
) -> Float[Array, " n_dof"]:
    """Compute K v from the stored entries of K."""
    rows, cols = sparsity.rows, sparsity.indices
    if not sparsity.symmetric:
        return jnp.zeros_like(v).at[rows].add(values * v[cols])
    lower = jnp.where(rows == cols, 0.0, values)
    upper = jnp.zeros_like(v).at[rows].add(values * v[cols])
    return upper.at[cols].add(lower * v[rows])


def mask_supports(
    sparsity: Sparsity, values: Float[Array, " nnz"], fixed: Bool[Array, " n_dof"]
) -> tuple[Float[Array, " nnz"], Float[Array, ""]]:
    """Replace rows and columns of held unknowns by those of a scaled identity.

    Returns:
        The entries, and the scale: the mean stiffness of an unknown [N/m].
    """
    held = fixed[sparsity.rows] | fixed[sparsity.indices]
    diagonal = values[sparsity.diagonal]
    # Unlike 1, the mean stiffness keeps the matrix well scaled in any unit.
    scale = jnp.mean(jnp.abs(diagonal))
    on_diagonal = jnp.where(fixed, scale, diagonal)
    return jnp.where(held, 0.0, values).at[sparsity.diagonal].set(on_diagonal), scale
