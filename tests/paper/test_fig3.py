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
    found = paper_fig3.verdict_at_end(measured, curves[1])
    assert found.verdict == "not identifiable"
    assert found.n_data == 3
    assert len(found.blind) >= 3
    named = " ".join(direction.words for direction in found.blind)
    assert "CP 1" in named
    assert "CP 2" in named


@pytest.mark.slow
def test_the_step_limits_of_the_paper_take_ten_times_the_steps(curves):
    """1 % of S and 0.005 rad: theta alone has 122 steps to go from 0 to -35 degrees."""
    limited, settings = paper_fig3.paper_run(CELLS)
    found = paper_fig3.descend(limited, settings, counts=(4,))[4]
    assert recovered(found.errors)
    assert found.steps >= np.deg2rad(35.0) / 0.005
    assert found.steps >= 10 * curves[4].steps
