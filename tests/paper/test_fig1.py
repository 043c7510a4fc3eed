"""Fig. 1: the exponent of the weighting, against its closed form on the axis."""

import numpy as np
import pytest
from matplotlib.image import imread

from benchmarks import paper_fig1
from benchmarks._problem import Options
from softcal_jax.mesh import beam


@pytest.mark.parametrize(
    ("power", "quarter"), [(1.0, -17.5), (2.0, -28.0), (6.0, -70.0 / 730.0 * 364.0)]
)
def test_theta_on_the_axis(power, quarter):
    """Distances of 1 : 3 weigh 3^p : 1, so theta = -35 (3^p - 1) / (3^p + 1)."""
    length, height, width = paper_fig1.SIZE
    points = np.array([(s * length, height / 2, width / 2) for s in (0.0, 0.25, 0.5)])
    weights = paper_fig1.theta_field(power).control_points.weights(points)
    theta = np.rad2deg(np.asarray(weights) @ paper_fig1.ENDS)
    np.testing.assert_allclose(theta, [-35.0, quarter, 0.0], rtol=1e-12, atol=1e-12)


def test_a_larger_exponent_changes_more_abruptly():
    """Share of the body whose fibre is within a degree of one of the two ends."""
    mesh = beam(*paper_fig1.SIZE, (30, 3, 3))
    shares = []
    for power in paper_fig1.POWERS:
        theta = np.abs(
            np.rad2deg(paper_fig1.on_tets(paper_fig1.theta_field(power), mesh))
        )
        assert theta.max() <= 35.0
        shares.append(np.mean(theta > 34.0))
    assert shares[0] < 0.1
    assert shares[0] < shares[1] < shares[2]
    assert shares[2] > 0.6


def test_picture(tmp_path):
    outcome = paper_fig1.run(Options(tmp_path, lambda _: None))
    assert outcome.figures["theta_quarter_p2_deg"] == pytest.approx(-28.0)
    assert imread(tmp_path / "fig1.png").shape[1] == 1600
