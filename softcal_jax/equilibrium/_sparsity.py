"""Sparsity of the tangent: one pattern for every configuration of a mesh.

A support is a mask that replaces rows and columns by those of a scaled identity, so
configurations with different supports share one analysis and one compiled program.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import BodyArrays


class Sparsity(Module):
    """A matrix with a symmetric pattern in compressed rows, diagonal included.

    Symmetric matrices are stored as their upper triangle, all others in full, with the
    position of each transposed entry: `values[mirror]` is the transposed matrix.
    Columns ascend within a row.
    """

    indptr: Int[HostArray, " n_dof_plus_1"]
    indices: Int[HostArray, " nnz"]
    rows: Int[HostArray, " nnz"]
    diagonal: Int[HostArray, " n_dof"]
    mirror: Int[HostArray, " nnz"] | None = None

    @property
    def symmetric(self) -> bool:
        return self.mirror is None

    @property
    def n_dof(self) -> int:
        return self.diagonal.shape[0]

    @property
    def nnz(self) -> int:
        return self.indices.shape[0]

    def identity(self) -> Float[Array, " nnz"]:
        """Return the stored entries of the identity."""
        return jnp.asarray(self.rows == self.indices, float)

    def positions(
        self, rows: Int[HostArray, "..."], columns: Int[HostArray, "..."]
    ) -> Int[HostArray, "..."]:
        """Find entries in the pattern, or their mirror images, whichever is stored."""
        keys = self.rows.astype(np.int64) * self.n_dof + self.indices
        row, column = _upward(self.symmetric, np.asarray(rows), np.asarray(columns))
        places = np.searchsorted(keys, row.astype(np.int64) * self.n_dof + column)
        return places.astype(np.int32)


def element_entries(n_en: int, symmetric: bool) -> tuple[HostArray, HostArray]:
    """List local rows and columns of an element matrix: upper triangle, or all."""
    if symmetric:
        return np.triu_indices(3 * n_en)
    p, q = np.indices((3 * n_en, 3 * n_en)).reshape(2, -1)
    return p, q


def _upward(symmetric: bool, row, col):
    """Map entries to the stored ones: a symmetric matrix only stores i <= j."""
    return (np.minimum(row, col), np.maximum(row, col)) if symmetric else (row, col)


def _distinct(keys: Int[HostArray, "..."]) -> Int[HostArray, " n"]:
    """Return distinct keys in order; faster than the hash table of `np.unique`."""
    ordered = np.sort(keys, axis=None)
    return ordered[np.diff(ordered, prepend=ordered[:1] - 1) > 0]


def build_sparsity(
    cliques: Sequence[Int[HostArray, "_ _"]], n_nodes: int, *, symmetric: bool = True
) -> Sparsity:
    """Build the pattern of a matrix that couples the nodes of cliques, like tets."""
    # Sort pairs of nodes first: nine times fewer keys than pairs of unknowns.
    with_itself = np.arange(n_nodes)[:, None]
    row_node, col_node = _pairs((with_itself, *cliques), n_nodes, symmetric)
    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    rows = (3 * row_node[:, None] + i).ravel()
    columns = (3 * col_node[:, None] + j).ravel()
    return from_entries(rows, columns, 3 * n_nodes, symmetric=symmetric)


def _pairs(cliques, n_nodes: int, upward: bool) -> tuple[HostArray, HostArray]:
    """List the distinct pairs of nodes of one clique; `upward`: low, high only."""
    keys = []
    for nodes in cliques:
        m = nodes.shape[1]
        a, b = np.triu_indices(m) if upward else np.indices((m, m))
        row, column = _upward(upward, nodes[:, a], nodes[:, b])
        keys.append(_distinct(row.astype(np.int64) * n_nodes + column))
    return np.divmod(_distinct(np.concatenate(keys)), n_nodes)


def from_entries(
    rows: Int[HostArray, " n"],
    columns: Int[HostArray, " n"],
    n_dof: int,
    *,
    symmetric: bool,
) -> Sparsity:
    """Build a pattern from entries in any order, all diagonal ones among them."""
    keys = rows.astype(np.int64) * n_dof + columns
    keys = _distinct(keys[rows <= columns] if symmetric else keys)
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


_AT_ONCE = 100_000  # entries of all cliques that are looked up at once


def destinations(
    sparsity: Sparsity, nodes: Int[HostArray, "n m"]
) -> Int[HostArray, "n_entries n"]:
    """Find the positions of each clique's entries, ordered as in `element_entries`."""
    # Only blocks of 3 x 3 are searched for: nine times fewer than entries. Blocks of a
    # row of nodes follow each other, and row i of an upper triangle begins i later.
    first = sparsity.positions(3 * nodes[:, :, None], 3 * nodes[:, None])
    entries = np.transpose(element_entries(nodes.shape[1], sparsity.symmetric))
    positions = np.empty((len(entries), len(nodes)), np.int32)
    # Some entries at a time: all would take a gigabyte for 25 000 quadratic tets.
    some = max(1, _AT_ONCE // max(1, len(nodes)))
    for start in range(0, len(entries), some):
        p, q = entries[start : start + some].T
        ends = (3 * nodes[:, k // 3] + k % 3 for k in (p, q))
        row, column = _upward(sparsity.symmetric, *ends)
        i, j = row % 3, column % 3
        within = sparsity.indptr[row] - sparsity.indptr[row - i]
        place = first[:, p // 3, q // 3] + within - i * sparsity.symmetric + j
        positions[start : start + some] = place.T
    return positions


def product(
    sparsity: Sparsity, values: Float[Array, " nnz"], v: Float[Array, " n_dof"]
) -> Float[Array, " n_dof"]:
    """Compute K v from the stored entries of K."""
    rows, cols = sparsity.rows, sparsity.indices
    if not sparsity.symmetric:
        return jnp.zeros_like(v).at[rows].add(values * v[cols])
    lower = jnp.where(rows == cols, 0.0, values)
    both = jnp.concatenate([values * v[cols], lower * v[rows]])
    return jnp.zeros_like(v).at[jnp.concatenate([rows, cols])].add(both)


def mask_supports(
    sparsity: Sparsity, values: Float[Array, " nnz"], fixed: Bool[Array, " n_dof"]
) -> tuple[Float[Array, " nnz"], Float[Array, ""]]:
    """Replace rows and columns of held unknowns by those of a scaled identity.

    The scale, returned too, is the mean stiffness of an unknown [N/m].
    """
    held = fixed[sparsity.rows] | fixed[sparsity.indices]
    # Unlike 1, the mean stiffness keeps the matrix well scaled in any unit.
    scale = jnp.mean(jnp.abs(values[sparsity.diagonal]))
    return jnp.where(held, scale * sparsity.identity(), values), scale


class Reduction(Module):
    """Where entries of the tangent over all nodes go in that of the unknowns.

    Nodes of a body move with it, du = G d, so its tangent is G^T K G plus a geometric
    part (`Posed.reduce`). K is assembled over all nodes first. Nodes of bodies keep
    empty rows, so that node i always has the unknowns 3 i to 3 i + 2.

    Attributes:
        reduced: Pattern over the unknowns: three per node, then six per body.
        rigid: Nodes that belong to bodies, frame nodes included, each with its `owner`,
            the body whose unknowns move it.
        kept: Entries between free nodes; they go to `kept_at`, `mixed` to `mixed_at`.
        mixed: Blocks between a free and a rigid node; of a matrix that is not
            symmetric, those between a rigid and a free node too, transposed.
        mixed_rigid: Index in `rigid` of the rigid node.
        inner: Blocks between two rigid nodes, with their indices in `rigid`.
        bodies: Entries of the matrix between bodies that the pattern stores.
    """

    reduced: Sparsity
    rigid: Int[HostArray, " n_rigid"]
    owner: Int[HostArray, " n_rigid"]
    kept: Int[HostArray, " n_kept"]
    kept_at: Int[HostArray, " n_kept"]
    mixed: Int[HostArray, "n_mixed 3 3"]
    mixed_rigid: Int[HostArray, " n_mixed"]
    mixed_at: Int[HostArray, "n_mixed 3 6"]
    inner: Int[HostArray, "n_inner 3 3"]
    inner_first: Int[HostArray, " n_inner"]
    inner_second: Int[HostArray, " n_inner"]
    bodies: Int[HostArray, " n_body_entries"]
    bodies_at: Int[HostArray, " n_body_entries"]


def build_reduction(
    full: Sparsity, cliques: Sequence[Int[HostArray, "_ _"]], bodies: BodyArrays
) -> Reduction:
    """Plan the reduction once, on the host; no clique may lie within one body."""
    n_nodes, n_bodies = full.n_dof // 3, bodies.n_bodies
    frames = np.arange(n_nodes - 4 * n_bodies, n_nodes)
    rigid = np.concatenate([bodies.attached, frames])
    of_frames = np.repeat(np.arange(n_bodies), 4)
    owner = bodies.owner[np.concatenate([bodies.body, of_frames])]
    index = np.full(n_nodes, -1)
    index[rigid] = np.arange(rigid.size)
    a, b = _pairs(cliques, n_nodes, upward=False)
    mixed = (index[a] < 0) & (index[b] >= 0)
    inner = (index[a] >= 0) & (index[b] >= 0)
    first, second = index[a[inner]], index[b[inner]]
    body_rows = lambda k: 3 * n_nodes + 6 * k[:, None] + np.arange(6)
    of_body = body_rows(owner[index[b[mixed]]])
    rows, columns = _entries(_node_rows(a[mixed]), of_body)
    self_coupled = np.arange(n_bodies) * (n_bodies + 1)
    coupled = np.union1d(owner[first] * n_bodies + owner[second], self_coupled)
    k, m = coupled // n_bodies, coupled % n_bodies
    body_row, body_col = _entries(body_rows(k), body_rows(m))
    kept = np.flatnonzero((index[full.rows // 3] < 0) & (index[full.indices // 3] < 0))
    n_dof = 3 * n_nodes + 6 * n_bodies
    diagonal = np.arange(n_dof)
    entries = (
        (full.rows[kept], rows, columns, body_row, diagonal),
        (full.indices[kept], columns, rows, body_col, diagonal),
    )
    row, column = (np.concatenate([a.ravel() for a in part]) for part in entries)
    reduced = from_entries(row, column, n_dof, symmetric=full.symmetric)
    in_pattern = (body_row <= body_col) | (not full.symmetric)
    flat = np.ravel_multi_index(
        (body_row - 3 * n_nodes, body_col - 3 * n_nodes), (6 * n_bodies, 6 * n_bodies)
    )
    blocks = _blocks(full, a[mixed], b[mixed])
    mixed_at = reduced.positions(rows, columns)
    mixed_rigid = index[b[mixed]]
    if not full.symmetric:
        below = np.swapaxes(_blocks(full, b[mixed], a[mixed]), 1, 2)
        blocks = np.concatenate([blocks, below])
        mixed_at = np.concatenate([mixed_at, reduced.positions(columns, rows)])
        mixed_rigid = np.tile(mixed_rigid, 2)
    return Reduction(
        reduced=reduced,
        rigid=rigid.astype(np.int32),
        owner=owner.astype(np.int32),
        kept=kept.astype(np.int32),
        kept_at=reduced.positions(full.rows[kept], full.indices[kept]),
        mixed=blocks,
        mixed_rigid=mixed_rigid.astype(np.int32),
        mixed_at=mixed_at,
        inner=_blocks(full, a[inner], b[inner]),
        inner_first=first.astype(np.int32),
        inner_second=second.astype(np.int32),
        bodies=flat[in_pattern].astype(np.int32),
        bodies_at=reduced.positions(body_row[in_pattern], body_col[in_pattern]),
    )


def _node_rows(nodes: HostArray) -> HostArray:
    return 3 * nodes[:, None] + np.arange(3)


def _entries(rows: HostArray, columns: HostArray) -> list[HostArray]:
    return list(np.broadcast_arrays(rows[:, :, None], columns[:, None, :]))


def _blocks(full: Sparsity, a: HostArray, b: HostArray) -> HostArray:
    """Find the positions of the 3 x 3 blocks of pairs of nodes."""
    return full.positions(*_entries(_node_rows(a), _node_rows(b)))


def reduce_values(
    plan: Reduction,
    values: Float[Array, " nnz"],
    G: Float[Array, "n_rigid 3 6"],
    extra: Float[Array, "n_b 6 6"],
) -> Float[Array, " nnz_reduced"]:
    """Compute G^T K G, plus a block `extra` for each body."""
    n_b = extra.shape[0]
    out = jnp.zeros(plan.reduced.nnz, values.dtype)
    out = out.at[plan.kept_at].set(values[plan.kept])
    product = lambda A, B: jnp.sum(A[..., :, :, None] * B[..., None, :, :], axis=-2)
    mixed = product(values[plan.mixed], G[plan.mixed_rigid])
    out = out.at[plan.mixed_at].add(mixed)
    right = product(values[plan.inner], G[plan.inner_second])
    inner = product(jnp.swapaxes(G[plan.inner_first], 1, 2), right)
    owner = jnp.asarray(plan.owner)
    pair = owner[plan.inner_first] * n_b + owner[plan.inner_second]
    blocks = jax.ops.segment_sum(inner, pair, n_b * n_b).reshape(n_b, n_b, 6, 6)
    blocks = blocks.at[jnp.arange(n_b), jnp.arange(n_b)].add(extra)
    whole = jnp.swapaxes(blocks, 1, 2).reshape(-1)
    return out.at[plan.bodies_at].add(whole[plan.bodies])
