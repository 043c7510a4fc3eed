"""The tangent in the unknowns of free nodes and rigid bodies.

Nodes of a body move with it, du = G d, so its tangent is G^T K G plus a geometric part
(`Posed.reduce`). K is assembled over all nodes first, then its entries are
redistributed here. Nodes that belong to bodies keep empty rows, so that node i always
has the unknowns 3 i to 3 i + 2.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.equilibrium._sparsity import Sparsity, from_entries


class Reduction(eqx.Module):
    """Where entries of the tangent over all nodes go in that of the unknowns.

    Attributes:
        full: Pattern over all nodes.
        reduced: Pattern over the unknowns: three per node, then six per body.
        rigid: Nodes that belong to bodies, frame nodes included.
        owner: Index of the body whose unknowns move each.
        kept: Entries between free nodes.
        kept_at: Where they go.
        mixed: Blocks between a free and a rigid node.
        mixed_rigid: Index in `rigid` of the rigid node.
        mixed_at: Where they go.
        mixed_below_at: Where their transposes go, if the matrix is not symmetric.
        mixed_below: Blocks between a rigid and a free node, likewise.
        inner: Blocks between two rigid nodes.
        inner_first: Index in `rigid` of the first node.
        inner_second: Index in `rigid` of the second node.
        bodies: Entries of the matrix between bodies that the pattern stores.
        bodies_at: Where they go.
    """

    full: Sparsity
    reduced: Sparsity
    rigid: Int[HostArray, " n_rigid"]
    owner: Int[HostArray, " n_rigid"]
    kept: Int[HostArray, " n_kept"]
    kept_at: Int[HostArray, " n_kept"]
    mixed: Int[HostArray, "n_mixed 3 3"]
    mixed_rigid: Int[HostArray, " n_mixed"]
    mixed_at: Int[HostArray, "n_mixed 3 6"]
    mixed_below: Int[HostArray, "n_below 3 3"]
    mixed_below_at: Int[HostArray, "n_below 6 3"]
    inner: Int[HostArray, "n_inner 3 3"]
    inner_first: Int[HostArray, " n_inner"]
    inner_second: Int[HostArray, " n_inner"]
    bodies: Int[HostArray, " n_body_entries"]
    bodies_at: Int[HostArray, " n_body_entries"]


def build_reduction(
    full: Sparsity,
    cliques: Sequence[Int[HostArray, "_ _"]],
    rigid: Int[HostArray, " n_rigid"],
    owner: Int[HostArray, " n_rigid"],
    n_bodies: int,
) -> Reduction:
    """Plan the reduction once, on the host.

    Args:
        full: Pattern over all nodes.
        cliques: Sets of nodes that the tangent couples, except within one body.
        rigid: Nodes that belong to bodies.
        owner: Index of the body that moves each.
        n_bodies: Number of bodies.
    """
    n_nodes = full.n_dof // 3
    index = np.full(n_nodes, -1)
    index[rigid] = np.arange(rigid.size)
    a, b = _ordered_pairs(cliques, n_nodes)
    mixed = (index[a] < 0) & (index[b] >= 0)
    inner = (index[a] >= 0) & (index[b] >= 0)
    first, second = index[a[inner]], index[b[inner]]
    free_row, body_column = a[mixed], owner[index[b[mixed]]]
    body_rows = lambda k: 3 * n_nodes + 6 * k[:, None] + np.arange(6)
    rows = np.broadcast_to(_node_rows(free_row)[:, :, None], (mixed.sum(), 3, 6))
    columns = np.broadcast_to(body_rows(body_column)[:, None, :], rows.shape)
    coupled = np.unique(
        np.concatenate(
            [
                owner[first] * n_bodies + owner[second],
                np.arange(n_bodies) * (n_bodies + 1),
            ]
        )
    )
    k, m = coupled // n_bodies, coupled % n_bodies
    body_row = np.broadcast_to(body_rows(k)[:, :, None], (k.size, 6, 6))
    body_col = np.broadcast_to(body_rows(m)[:, None, :], body_row.shape)
    free = (index[full.rows // 3] < 0) & (index[full.indices // 3] < 0)
    kept = np.flatnonzero(free)
    n_dof = 3 * n_nodes + 6 * n_bodies
    all_rows = [full.rows[kept], rows.ravel(), columns.ravel(), body_row.ravel()]
    all_columns = [full.indices[kept], columns.ravel(), rows.ravel(), body_col.ravel()]
    diagonal = np.arange(n_dof)
    reduced = from_entries(
        np.concatenate([*all_rows, diagonal]),
        np.concatenate([*all_columns, diagonal]),
        n_dof,
        symmetric=full.symmetric,
    )
    below = mixed if not full.symmetric else np.zeros_like(mixed)
    in_pattern = (
        (body_row <= body_col) if full.symmetric else np.full(body_row.shape, True)
    )
    flat = np.ravel_multi_index(
        (body_row - 3 * n_nodes, body_col - 3 * n_nodes), (6 * n_bodies, 6 * n_bodies)
    )
    transposed = lambda block: np.swapaxes(block[below[mixed]], 1, 2)
    return Reduction(
        full=full,
        reduced=reduced,
        rigid=rigid.astype(np.int32),
        owner=owner.astype(np.int32),
        kept=kept.astype(np.int32),
        kept_at=reduced.positions(full.rows[kept], full.indices[kept]),
        mixed=_blocks(full, a[mixed], b[mixed]),
        mixed_rigid=index[b[mixed]].astype(np.int32),
        mixed_at=reduced.positions(rows, columns),
        mixed_below=_blocks(full, b[below], a[below]),
        mixed_below_at=reduced.positions(transposed(columns), transposed(rows)),
        inner=_blocks(full, a[inner], b[inner]),
        inner_first=first.astype(np.int32),
        inner_second=second.astype(np.int32),
        bodies=flat[in_pattern].astype(np.int32),
        bodies_at=reduced.positions(body_row[in_pattern], body_col[in_pattern]),
    )


def _ordered_pairs(cliques, n_nodes: int) -> tuple[HostArray, HostArray]:
    """List every ordered pair of coupled nodes once."""
    keys = [
        np.unique(nodes[:, :, None].astype(np.int64) * n_nodes + nodes[:, None, :])
        for nodes in cliques
    ]
    found = np.unique(np.concatenate(keys))
    return found // n_nodes, found % n_nodes


def _node_rows(nodes: HostArray) -> HostArray:
    return 3 * nodes[:, None] + np.arange(3)


def _blocks(full: Sparsity, a: HostArray, b: HostArray) -> HostArray:
    """Find the positions of the 3 x 3 blocks of pairs of nodes."""
    rows = np.broadcast_to(_node_rows(a)[:, :, None], (a.size, 3, 3))
    columns = np.broadcast_to(_node_rows(b)[:, None, :], rows.shape)
    return full.positions(rows, columns)


def reduce_values(
    plan: Reduction,
    values: Float[Array, " nnz"],
    G: Float[Array, "n_rigid 3 6"],
    extra: Float[Array, "n_b 6 6"],
) -> Float[Array, " nnz_reduced"]:
    """Compute the tangent of the unknowns, G^T K G plus a block for each body.

    Args:
        plan: Where entries go.
        values: Tangent over all nodes.
        G: Motion of the rigid nodes per unit of their bodies' unknowns.
        extra: Added to the diagonal blocks of the bodies.
    """
    n_b = extra.shape[0]
    out = jnp.zeros(plan.reduced.nnz, values.dtype)
    out = out.at[plan.kept_at].set(values[plan.kept])
    product = lambda A, B: jnp.sum(A[..., :, :, None] * B[..., None, :, :], axis=-2)
    mixed = product(values[plan.mixed], G[plan.mixed_rigid])
    out = out.at[plan.mixed_at].add(mixed)
    if not plan.reduced.symmetric:
        G_T = jnp.swapaxes(G[plan.mixed_rigid], 1, 2)
        out = out.at[plan.mixed_below_at].add(product(G_T, values[plan.mixed_below]))
    right = product(values[plan.inner], G[plan.inner_second])
    inner = product(jnp.swapaxes(G[plan.inner_first], 1, 2), right)
    owner = jnp.asarray(plan.owner)
    pair = owner[plan.inner_first] * n_b + owner[plan.inner_second]
    blocks = jax.ops.segment_sum(inner, pair, n_b * n_b).reshape(n_b, n_b, 6, 6)
    blocks = blocks.at[jnp.arange(n_b), jnp.arange(n_b)].add(extra)
    whole = jnp.swapaxes(blocks, 1, 2).reshape(-1)
    return out.at[plan.bodies_at].add(whole[plan.bodies])
