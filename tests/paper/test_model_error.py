"""Model error: a law or an element that is wrong is flagged, the right one is not."""

import pytest

from benchmarks.model_error import CASES, measured, try_case

CELLS = (6, 1, 1)


@pytest.fixture(scope="module")
def data():
    return measured(CELLS, seeds=(0,))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_flag(case, data):
    (trial,) = try_case(case, CELLS, data)
    assert trial.flagged == case.wrong
    assert trial.warned == case.wrong
    if not case.wrong:
        assert trial.result.converged
        assert 0.5 < trial.excess < 1.6
