"""Fig. 3: steps that the runs need, and what one configuration cannot tell."""

import numpy as np
import pytest

from benchmarks import paper_fig3
from benchmarks._paper import measured_beam, recovered

CELLS = (4, 1, 1)


@pytest.fixture(scope="module")
def measured():
    return measured_beam(CELLS, plane="xy")


@pytest.fixture(scope="module")
def curves(measured):
    return paper_fig3.descend(measured, counts=(1, 4))


@pytest.mark.slow  # paper_fig3 records it; another start reaches it in test_starts
def test_four_configurations_reach_p_target(curves):
    assert recovered(curves[4].errors)
    assert curves[4].steps <= 12


@pytest.mark.slow  # paper_fig3 records it
def test_one_configuration_fits_with_wrong_values_and_says_so(measured, curves):
    """3 data for 6 parameters."""
    assert curves[1].sizes[-1] < 1e-9
    assert not recovered(curves[1].errors)
    outlook = paper_fig3.verdict_at_end(measured, curves[1])
    assert outlook.verdict == "not identifiable"
    assert outlook.n_data == 3
    assert len(outlook.blind) >= 3
    named = " ".join(direction.words for direction in outlook.blind)
    assert "CP 1" in named
    assert "CP 2" in named


@pytest.mark.slow
def test_the_step_limits_of_the_paper_take_ten_times_the_steps(curves):
    """1 % of S and 0.005 rad: theta alone has 122 steps to go from 0 to -35 degrees."""
    limited, settings = paper_fig3.paper_run(CELLS)
    curve = paper_fig3.descend(limited, settings, counts=(4,))[4]
    assert recovered(curve.errors)
    assert curve.steps >= np.deg2rad(35.0) / 0.005
    assert curve.steps >= 10 * curves[4].steps
