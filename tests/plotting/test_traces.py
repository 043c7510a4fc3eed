"""The picture of a recording: lines, gaps, windows and events are where they belong."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from softcal_jax.plotting import draw_traces, plot_traces
from softcal_jax.readings import Recording, Traces


def traces(*, names=("tip", "base"), windows=None):
    """A marker that rises by 1 mm/s, and is not seen in two frames."""
    t = np.arange(100) / 10.0
    positions = np.zeros((100, 3, 3))
    positions[:, 0, 2] = 1e-3 * t
    positions[40:42, 0] = np.nan
    recording = Recording(
        ("tip", "other", "base"), t, positions, "folder/run.c3d", (("valve", 5.0),)
    )
    windows = {"select": (6.0, 8.0)} if windows is None else windows
    return Traces(recording, windows, names)


def drawn(shown, window=None):
    return draw_traces(Figure().subplots(), shown, window=window)


def line(axes, label):
    (curve,) = [entry for entry in axes.lines if entry.get_label() == label]
    return curve.get_xydata()


def test_distances_and_gaps():
    whole, close = drawn(traces()), drawn(traces(), (6.0, 8.0))
    rising = line(whole, "tip")
    seen = np.isfinite(rising[:, 1])
    assert np.flatnonzero(~seen).tolist() == [40, 41]
    np.testing.assert_allclose(rising[seen, 1], rising[seen, 0], atol=1e-12)
    np.testing.assert_array_equal(line(whole, "base")[:, 1], 0.0)
    assert all(entry.get_label() != "other" for entry in whole.lines)
    # Close up: from the mean between 6 and 8 s.
    rising = line(close, "tip")[60:81]
    np.testing.assert_allclose(rising[:, 1], np.abs(rising[:, 0] - 7.0), atol=1e-12)


def test_windows_and_events(tmp_path):
    windows = {
        "select": (6.0, 8.0),
        "displacement_from": (0.0, 1.0),
        "registration.select": (0.0, 1.0),
    }
    whole = drawn(traces(windows=windows))
    spans = {p.get_label(): p.get_extents() for p in whole.patches}
    assert set(spans) == {"select", "displacement_from, registration.select"}
    ends = whole.transData.inverted().transform(whole.patches[0].get_extents())
    np.testing.assert_allclose(ends[:, 0], [6.0, 8.0], atol=1e-6)
    assert any(text.get_text() == "valve" for text in whole.texts)
    path = tmp_path / "a.svg"
    plot_traces(traces(windows=windows), path, name="pose 1")
    words = path.read_text()
    assert "pose 1: windows taken from run.c3d" in words
    # The whole, and each of two windows close up.
    assert (words.count(">first frame [mm]<"), words.count(">mean [mm]<")) == (1, 2)


@pytest.mark.parametrize("windows", [{"select": (3.0, 3.0)}, {"select": (4.0, 4.1)}])
def test_a_single_frame_and_one_that_sees_nothing(tmp_path, windows):
    plot_traces(traces(windows=windows), tmp_path / "a.png", name="a $ b")
    assert imread(tmp_path / "a.png").shape[1] == 1600
