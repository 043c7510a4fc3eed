"""Recordings of motion capture, against files that ezc3d writes."""

import numpy as np
import pytest
from recordings import NAMES, RATE, motion, write_recording

from softcal_jax.configurations import Recording, read_c3d

pytest.importorskip("ezc3d")


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0)])
def test_positions_come_in_metres(tmp_path, unit, metres):
    recording = read_c3d(write_recording(tmp_path / "a.c3d", motion(), unit=unit))
    assert recording.names == NAMES
    np.testing.assert_allclose(recording.times, np.arange(40) / RATE, atol=1e-12)
    np.testing.assert_allclose(recording.positions, metres * motion(), rtol=1e-6)


def test_windows_count_from_the_step(tmp_path):
    recording = read_c3d(write_recording(tmp_path / "a.c3d", motion()))
    assert recording.step_of("tip") == pytest.approx(0.21)  # 6 of 60 mm: above 5 %
    both = recording.between(0.1, 0.12, after_step_of="tip")
    expected = [1e-3 * np.mean([36.0, 39.0, 42.0]), 3e-3]
    found = both.positions_of(["tip", "base"])[:, 2]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    before = recording.between(-0.2, -0.1, after_step_of="tip")
    np.testing.assert_allclose(before.positions_of(["tip"]), np.zeros((1, 3)))
    absolute = recording.between(0.31, 0.33)
    np.testing.assert_array_equal(absolute.positions, both.positions)


def test_frames_that_do_not_see_a_marker_are_left_out(tmp_path):
    residuals = np.zeros((40, 2))
    residuals[30, 1] = residuals[:, 0] = -1.0
    path = write_recording(tmp_path / "a.c3d", motion(), residuals=residuals)
    recording = read_c3d(path)
    assert np.isnan(recording.positions[30, 1]).all()
    table = recording.between(0.29, 0.31)
    np.testing.assert_allclose(table.positions_of(["tip"])[0, 2], 33e-3, rtol=1e-6)
    with pytest.raises(ValueError, match=r"between 0.29 and 0.31 s: the position of"):
        table.positions_of(["base"])


def test_windows_outside_of_the_recording_are_refused():
    recording = Recording(NAMES, np.arange(40) / RATE, motion(), "run")
    with pytest.raises(ValueError, match=r"it has those between 0 and 0.39 s"):
        recording.between(0.3, 0.5)
    with pytest.raises(ValueError, match=r"it has those between -0.21 and 0.18 s"):
        recording.between(-0.3, 0.0, after_step_of="tip")
    with pytest.raises(ValueError, match=r"not all frames between 0.201 and 0.202 s"):
        recording.between(0.201, 0.202)
    with pytest.raises(ValueError, match=r"has no marker 'Tip'. Did you mean 'tip'"):
        recording.step_of("Tip")
    with pytest.raises(ValueError, match="'base' does not move"):
        recording.step_of("base")


def test_files_that_are_no_recordings_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none.c3d does not exist"):
        read_c3d(tmp_path / "none.c3d")
    text = tmp_path / "text.c3d"
    text.write_text("marker,x,y,z\n")
    with pytest.raises(ValueError, match=r"text.c3d cannot be read"):
        read_c3d(text)
    path = write_recording(tmp_path / "a.c3d", motion(), unit="furlong")
    with pytest.raises(ValueError, match="the unit of length 'furlong'; expected"):
        read_c3d(path)
