"""Noise: the intervals of the standard errors hold p_target as often as they say."""

import numpy as np
import pytest

from benchmarks import noise_coverage


@pytest.mark.slow
def test_coverage_at_the_lowest_noise():
    problem, target = noise_coverage.clean_problem((4, 1, 1), ("E_l", "theta"))
    draws = noise_coverage.draw(problem, target, 0.1e-3, 60)
    assert draws.usable.all()
    # 240 intervals, four to a draw: one standard deviation of the share is about 2 %.
    assert 0.90 <= np.mean(draws.inside) <= 0.99
    size = np.sqrt(np.mean(draws.error**2, axis=0)) / draws.predicted
    np.testing.assert_allclose(size, 1.0, atol=0.3)
