"""The random problems of the benchmark of the QP."""

import numpy as np
import pytest

from benchmarks import qp


@pytest.mark.parametrize("kind", qp.KINDS)
@pytest.mark.parametrize("n", [1, 6])
def test_only_the_kind_away_excludes_no_step(kind, n):
    random = np.random.default_rng(0)
    drawn = [qp.random_qp(random, n, kind) for _ in range(50)]
    for W, error, low, high, A, b in drawn:
        assert W.shape == (len(error), n)
        assert A.shape == (len(b), n)
        assert np.all((low <= 0.0) & (high >= 0.0))
    excluded = sum(np.any(b < 0.0) for *_, b in drawn)
    assert (excluded > 0) == (kind == "away" and n > 1)
