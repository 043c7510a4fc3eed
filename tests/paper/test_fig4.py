"""Fig. 4: random starts reach p_target, and without the cures some do not."""

import numpy as np
import pytest

from benchmarks import paper_fig4

CELLS = (4, 1, 1)


@pytest.mark.slow  # paper_fig4 records it
def test_every_start_reaches_p_target():
    ends = paper_fig4.runs_from_random(paper_fig4.WAYS[""], "xy", CELLS, 6)
    assert ends.hits.all()
    # One optimum with all runs, at a cost of rounding.
    (optimum,) = [o for o in ends.result.optima if o.starts]
    assert len(optimum.starts) == 6
    assert optimum.cost < 1e-6


@pytest.mark.slow
def test_in_the_flat_print_plane_too():
    ends = paper_fig4.runs_from_random(paper_fig4.WAYS[""], "xz", CELLS, 12)
    assert ends.hits.all()


@pytest.mark.slow
def test_without_the_cures_runs_end_in_traps():
    cured, plain = (
        paper_fig4.runs_from_random(paper_fig4.WAYS[way], "xy", CELLS, 12)
        for way in ("", "_without")
    )
    # Both from the same p_init.
    np.testing.assert_allclose(cured.result.starts, plain.result.starts, rtol=1e-9)
    assert cured.hits.all()
    assert not plain.hits.all()
