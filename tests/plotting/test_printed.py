"""Pictures for paper: their size, their words, what is true and what is on a bound."""

import json
import re
from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from wording import says

from softcal_jax.mesh import beam
from softcal_jax.plotting import (
    COLUMN,
    PictureStyle,
    choose_view,
    draw_trials,
    plot_groups,
    plot_panels,
)
from softcal_jax.sweeps import Outcome, grid, plot_sweep, read_sweep, run_sweep

SIZES = [COLUMN, PictureStyle(width_mm=120.0, font_size=10.0, dpi=200.0)]
MESH = beam(0.1, 0.04, 0.02, (5, 2, 1))
WORDS = "a $1$"


def chart(path, style):
    draw = partial(draw_trials, where=[1.0, 2.0], values=np.array([1.0, 3.0]))
    plot_panels(path, [draw], style=style, title=WORDS)


def body(path, style):
    plot_groups(MESH, path, style=style, title=WORDS)


@pytest.mark.parametrize("style", SIZES)
@pytest.mark.parametrize("plot", [chart, body])
def test_a_picture_is_as_wide_as_stated_with_words_of_that_size(tmp_path, plot, style):
    """In each format; words are text, in fonts that a journal takes."""
    plot(tmp_path / "a.pdf", style)
    text = (tmp_path / "a.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", text)
    assert float(box[1]) / 72.0 * 25.4 == pytest.approx(style.width_mm, abs=1e-3)
    assert b"/Type3" not in text
    plot(tmp_path / "b.pdf", style)
    assert (tmp_path / "b.pdf").read_bytes() == text
    plot(tmp_path / "a.svg", style)
    words = (tmp_path / "a.svg").read_text()
    assert f">{WORDS}</text>" in words
    width = re.search(r'<svg [^>]*width="([\d.]+)pt"', words)
    assert float(width[1]) / 72.0 * 25.4 == pytest.approx(style.width_mm, abs=1e-3)
    sizes = {float(size) for size in re.findall(r"font-size: ([\d.]+)px", words)}
    assert style.font_size in sizes
    assert min(sizes) > 0.5 * style.font_size
    plot(tmp_path / "a.png", style)
    pixels = style.width_mm / 25.4 * style.dpi
    assert imread(tmp_path / "a.png").shape[1] == pytest.approx(pixels, abs=1.0)


def test_other_endings_and_sizes_are_refused(tmp_path, unchecked):
    with pytest.raises(ValueError, match=r"a.jpg ends in '.jpg'; .*\.pdf"):
        chart(tmp_path / "a.jpg", COLUMN)
    for wrong in ({"width_mm": 30.0}, {"font_size": 0.0}, {"dpi": -1.0}):
        with pytest.raises(ValueError, match="at least 5 times") as error:
            PictureStyle(**wrong)
        ((name, value),) = wrong.items()
        assert f"{name}={value}" in str(error.value)
    for direction in ((0.0, 0.0, 0.0), (np.nan, 1.0, 0.0), (1.0, 1.0)):
        with pytest.raises(ValueError, match="seen_from must be a direction"):
            PictureStyle(seen_from=direction)


@pytest.mark.parametrize(
    "towards", [(1.0, 0.0, 0.0), (0.0, 0.0, 2.0), (1.0, -1.0, 1.0)]
)
def test_a_body_is_seen_from_where_it_is_said(towards):
    view = choose_view(MESH.points, seen_from=towards)
    np.testing.assert_allclose(view.towards, towards / np.linalg.norm(towards))
    frame = np.stack([view.right, view.up, view.towards])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    assert towards == (0.0, 0.0, 2.0) or view.up[2] > 0.5


def labelled(axes):
    return dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))


def test_what_is_true_and_what_is_on_a_bound():
    """Each group has its truth; in the unit of the axis."""
    where = ["a", "a", "b", "b"]
    values = np.array([1e5, 3e5, 2e5, 4e5])
    truth, on_bound = np.array([2e5, 2e5, 3e5, np.nan]), values == 4e5
    about = {"name": "E", "unit": "Pa", "truth": truth, "on_bound": on_bound}
    axes = draw_trials(Figure().subplots(), where, values, **about)
    assert axes.get_ylabel() == "E [kPa]"
    shown = labelled(axes)
    means = [ends[0, 1] for ends in shown["mean"].get_segments()]
    np.testing.assert_allclose(means, [200.0, 300.0])
    ((left, right),) = shown["true value"].get_segments()
    np.testing.assert_allclose([left, right], [[-0.4, 200.0], [0.4, 200.0]])
    np.testing.assert_allclose(shown["on a bound"].get_ydata(), [400.0])
    axes = draw_trials(Figure().subplots(), [1.0, 2.0], values[:2], truth=truth[:2])
    ((left, right),) = labelled(axes)["true value"].get_segments()
    assert left[0] < 1.0 < 2.0 < right[0]
    axes = draw_trials(Figure().subplots(), [1.0, 2.0], values[2:], truth=truth[2:])
    assert labelled(axes) == {}


def fit(trial):
    figures = {"E [Pa]": 1e5 * trial["n"], "theta [rad]": 0.1 * trial["n"]}
    if trial["layout"] == "own":
        figures["distance to truth [-]"] = 0.1
    if trial["n"] == 3:
        figures["on a bound"] = "nu; E"
    return Outcome(figures, trial["n"] < 4)


def test_a_sweep_shows_its_truth(tmp_path):
    """Where the truth applies: not for control points that lie elsewhere."""
    points = grid({"layout": ["own", "other"], "n": [1, 2, 3, 4]})
    truth = {"E": "200 kPa", "theta": "10 deg"}
    about = {"definitions": {"truth": json.dumps(truth)}, "workers": 0}
    run_sweep(fit, points, tmp_path / "s", repeats=["n"], **about)
    result = read_sweep(tmp_path / "s")
    own = np.array([row["layout"] == "own" for row in result.rows])
    true = result.true_values("E [Pa]")
    np.testing.assert_array_equal(true, np.where(own, 2e5, np.nan))
    np.testing.assert_allclose(result.true_values("theta [rad]")[own], np.deg2rad(10.0))
    assert plot_sweep(result, tmp_path / "a.svg") == 2
    words = (tmp_path / "a.svg").read_text()
    assert all(f">{word}<" in words for word in ("true value", "on a bound", "E [kPa]"))
    plot_sweep(result, tmp_path / "b.svg", figures=["theta"])
    words = (tmp_path / "b.svg").read_text()
    assert says(words, "theta [deg]")
    assert "true value" in words
    assert "on a bound" not in words
