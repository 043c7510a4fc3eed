import numpy as np
from export.handmade import make_result
from matplotlib.image import imread

from softcal_jax.plotting import plot_budget
from softcal_jax.plotting._budget import budget_figure


def test_figure_is_1200_pixels_wide(tmp_path):
    plot_budget(make_result(), tmp_path / "b.png")
    assert imread(tmp_path / "b.png").shape[1] == 1200


def test_what_is_drawn():
    """Of the variance of E 64 % are noise and 36 % clamp; nu has no standard error."""
    figure = budget_figure(make_result(), "beam $1$")
    (axes,) = figure.axes
    widths = [[bar.get_width() for bar in own] for own in axes.containers]
    np.testing.assert_allclose(widths, [[64.0, 0.0], [36.0, 0.0]], atol=1e-9)
    assert [own.get_label() for own in axes.containers] == ["noise", "clamp"]
    assert [t.get_text() for t in axes.texts] == ["no standard error"]
    labels = [t.get_text() for t in axes.get_yticklabels()]
    assert labels == ["E\n240.0 ± 6.0 kPa", "nu\n0.44"]
    assert figure.get_suptitle() == "beam $1$: what the errors come from"
