"""Where the entries of elements and cables go in the stored tangent."""

import numpy as np
import pytest

from softcal_jax.equilibrium import _sparsity
from softcal_jax.equilibrium._sparsity import (
    build_sparsity,
    destinations,
    element_entries,
)

N_NODES = 40


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize(("n", "size"), [(1, 30), (25, 10), (60, 4), (0, 4)])
@pytest.mark.parametrize("at_once", [1, 77, 100_000])
def test_entries_add_up_to_the_dense_sum(monkeypatch, symmetric, n, size, at_once):
    """One clique of many nodes, as of a cable, or many of few, as of tets."""
    monkeypatch.setattr(_sparsity, "_AT_ONCE", at_once)
    rng = np.random.default_rng(0)
    nodes = [rng.choice(N_NODES, size, replace=False) for _ in range(n)]
    nodes = np.array(nodes, int).reshape(n, size)
    p, q = element_entries(size, symmetric)
    values = rng.normal(size=(len(p), n))
    sparsity = build_sparsity((nodes,), N_NODES, symmetric=symmetric)
    stored = np.zeros(sparsity.nnz)
    np.add.at(stored, destinations(sparsity, nodes), values)

    dense = np.zeros((3 * N_NODES,) * 2)
    unknowns = (3 * nodes[:, :, None] + np.arange(3)).reshape(n, 3 * size)
    for e in range(n):
        i, j = unknowns[e][p], unknowns[e][q]
        rows, columns = (np.minimum(i, j), np.maximum(i, j)) if symmetric else (i, j)
        np.add.at(dense, (rows, columns), values[:, e])
    np.testing.assert_allclose(stored, dense[sparsity.rows, sparsity.indices])
