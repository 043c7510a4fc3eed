"""Recordings of motion capture, against files that ezc3d writes."""

import re

import numpy as np
import pytest
from recordings import NAMES, RATE, motion, write_recording
from wording import says

from softcal_jax.readings import Recording, TrackerWarning, read_recording

pytest.importorskip("ezc3d")


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0)])
def test_positions_come_in_metres(tmp_path, unit, metres):
    recording = read_recording(write_recording(tmp_path / "a.c3d", motion(), unit=unit))
    assert recording.names == NAMES
    np.testing.assert_allclose(recording.times, np.arange(40) / RATE, atol=1e-12)
    np.testing.assert_allclose(recording.positions, metres * motion(), rtol=1e-6)


def test_windows_count_from_the_step(tmp_path):
    recording = read_recording(write_recording(tmp_path / "a.c3d", motion()))
    assert recording.step_of("tip") == pytest.approx(0.21)  # 6 of 60 mm: above 5 %
    both = recording.between(0.1, 0.12, after_step_of="tip")
    expected = [1e-3 * np.mean([36.0, 39.0, 42.0]), 3e-3]
    heights = both.positions_of(["tip", "base"])[:, 2]
    np.testing.assert_allclose(heights, expected, rtol=1e-6)
    before = recording.between(-0.2, -0.1, after_step_of="tip")
    np.testing.assert_allclose(before.positions_of(["tip"]), [[4e-3, 0.0, 0.0]])
    absolute = recording.between(0.31, 0.33)
    np.testing.assert_array_equal(absolute.positions, both.positions)


def test_frames_that_do_not_see_a_marker_are_left_out(tmp_path):
    residuals = np.full((40, 2), 2.0)  # mm, of markers that were seen
    residuals[30, 1] = residuals[:, 0] = -1.0
    path = write_recording(tmp_path / "a.c3d", motion(), residuals=residuals)
    recording = read_recording(path)
    assert np.isnan(recording.positions[30, 1]).all()
    table = recording.between(0.29, 0.31)
    np.testing.assert_allclose(table.positions_of(["tip"])[0, 2], 33e-3, rtol=1e-6)
    with pytest.raises(ValueError, match=r"0\.29 and 0\.31 s: .*'base' .*Leave"):
        table.positions_of(["base"])


def test_windows_outside_of_the_recording_are_refused():
    recording = Recording(NAMES, np.arange(40) / RATE, motion(), "run")
    with pytest.raises(ValueError, match=r"0\.3 and 0\.5 s; .* 0 and 0\.39 s"):
        recording.between(0.3, 0.5)
    with pytest.raises(ValueError, match=r"-0\.3 .*'tip'; .* -0\.21 and 0\.18 s"):
        recording.between(-0.3, 0.0, after_step_of="tip")
    with pytest.raises(ValueError, match=r"0\.201 and 0\.202 s; .* 0 and 0\.39 s"):
        recording.between(0.201, 0.202)
    with pytest.raises(ValueError, match=r"marker 'Tip'.* mean 'tip'"):
        recording.step_of("Tip")
    with pytest.raises(ValueError, match="'base' does not move"):
        recording.step_of("base")


def test_a_damaged_file_does_not_end_the_process(tmp_path):
    """Its library ends with a segmentation fault on some of them."""
    whole = write_recording(tmp_path / "a.c3d", motion()).read_bytes()
    rng, refused = np.random.default_rng(0), []
    for k in range(4):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 20):
            damaged[place] = rng.integers(256)
        (tmp_path / f"{k}.c3d").write_bytes(damaged)
        try:
            read_recording(tmp_path / f"{k}.c3d")
        except ValueError as error:
            refused.append(str(error))
    assert refused
    assert all(".c3d" in text for text in refused), refused


def test_files_that_are_no_recordings_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.c3d .*exist"):
        read_recording(tmp_path / "none.c3d")
    text = tmp_path / "text.c3d"
    text.write_text("marker,x,y,z\n")
    with pytest.raises(ValueError, match=r"text\.c3d cannot"):
        read_recording(text)
    path = write_recording(tmp_path / "a.c3d", motion(), unit="furlong")
    with pytest.raises(ValueError, match=r"unit .*'furlong'; .* mm"):
        read_recording(path)
    path = write_recording(tmp_path / "b.c3d", motion(), rate=-100.0)
    with pytest.raises(ValueError, match=r"rate .* -100, not positive"):
        read_recording(path)


def test_events_count_from_the_first_frame(tmp_path):
    path = tmp_path / "a.c3d"
    events = (("valve opens", 0.15), ("valve closes", 61.5), ("valve closes", 62.0))
    recording = read_recording(write_recording(path, motion(), events=events))
    assert [name for name, _ in recording.events] == [name for name, _ in events]
    assert recording.time_of("valve opens") == pytest.approx(0.15)
    assert [t for _, t in recording.events] == pytest.approx([t for _, t in events])
    after = recording.between(0.06, 0.08, after_event="valve opens")
    np.testing.assert_allclose(
        after.positions, recording.between(0.21, 0.23).positions, atol=1e-12
    )
    with pytest.raises(ValueError, match=r"0 times.*'valve opens'"):
        recording.between(0.0, 0.1, after_event="valve open")
    with pytest.raises(ValueError, match=r"closes' .* 2 times.* 61\.5 s"):
        recording.time_of("valve closes")
    both = {"after_event": "valve opens", "after_step_of": "tip"}
    with pytest.raises(ValueError, match="not both"):
        recording.between(0.0, 0.1, **both)


def test_events_of_a_part_of_a_trial(tmp_path):
    """They count from the first frame of the trial, of which half a second is gone."""
    path, events = tmp_path / "a.c3d", (("valve opens", 0.65),)
    write_recording(path, motion(), events=events, first_frame=50)
    assert read_recording(path).time_of("valve opens") == pytest.approx(0.15)


def test_all_labels_and_events_are_read(tmp_path):
    """A key of the format holds 255; more stand under names with a number."""
    labels = [f"m{k}" for k in range(600)]
    positions = np.arange(3 * 600 * 2.0).reshape(2, 600, 3) + 1.0
    events = [(f"e{k}", 0.01 * k) for k in range(7)]
    path = tmp_path / "many.c3d"
    write_recording(path, positions, labels=labels, events=events, per_key=3)
    recording = read_recording(path)
    assert recording.names == tuple(labels)
    np.testing.assert_allclose(recording.positions, 1e-3 * positions, rtol=1e-6)
    assert [name for name, _ in recording.events] == [name for name, _ in events]
    assert recording.time_of("e6") == pytest.approx(0.06)


def test_points_without_a_label_are_left_out(tmp_path):
    path, positions = tmp_path / "a.c3d", np.tile(motion(), (1, 2, 1))
    write_recording(path, positions, labels=("base", "", "tip", " "))
    with pytest.warns(TrackerWarning, match=r"a\.c3d: 2 of 4 markers have no label"):
        recording = read_recording(path)
    assert recording.names == ("base", "tip")
    np.testing.assert_allclose(recording.positions, 1e-3 * positions[:, ::2], rtol=1e-6)


def test_zeros_are_gaps(tmp_path):
    """A marker at the origin to the last digit was not seen, whoever wrote that."""
    positions = motion()
    positions[25:30, 1] = 0.0
    recording = read_recording(write_recording(tmp_path / "a.c3d", positions))
    assert np.isnan(recording.positions[25:30, 1]).all()
    height = recording.between(0.24, 0.30).positions_of(["tip"])[0, 2]
    assert height == pytest.approx(1e-3 * np.mean([15.0, 33.0]))


def noisy(seed=0, *, std=0.05e-3):
    """A marker that rests, moves by 20 mm, creeps by 1 %, and is let go again."""
    rng = np.random.default_rng(seed)
    t = np.arange(800) / RATE
    held = (t >= 2.0) & (t < 6.0)
    path = np.where(held, 20e-3 * (1.0 - np.exp(-(t - 2.0) / 0.2)), 0.0)
    path = path + np.where(held, 0.2e-3 * np.minimum(t - 2.0, 2.0) / 2.0, 0.0)
    positions = np.zeros((800, 2, 3))
    positions[:, 1, 2] = path
    return Recording(NAMES, t, positions + std * rng.normal(size=(800, 2, 3)), "run")


def test_a_window_around_a_time():
    recording = noisy()
    around = recording.at(3.0, width=0.5)
    np.testing.assert_array_equal(
        around.positions, recording.between(2.75, 3.25).positions
    )
    usual = recording.at(1.0, after_step_of="tip")
    expected = recording.between(0.95, 1.05, after_step_of="tip")
    np.testing.assert_array_equal(usual.positions, expected.positions)
    single = recording.at(3.002, width=0.0)  # of the nearest frame
    np.testing.assert_array_equal(single.positions, recording.positions[300])
    with pytest.raises(ValueError, match=r"width .*\[s\], got -0\.1"):
        recording.at(3.0, width=-0.1)


def test_scatter_over_a_window():
    """Against NumPy, with frames that do not see a marker."""
    recording = noisy()
    positions = recording.positions.copy()
    positions[300:340:3, 1] = np.nan
    positions[300:340, 0] = np.nan
    positions[307, 0] = 0.0
    recording = Recording(NAMES, recording.times, positions, "run")
    table = recording.between(3.0, 3.39)
    window = positions[300:340, 1]
    window = window[np.isfinite(window).all(axis=1)]
    np.testing.assert_allclose(
        table.covariances_of(["tip"])[0], np.cov(window.T), rtol=1e-9
    )
    assert table.window == pytest.approx((3.0, 3.39))
    with pytest.raises(ValueError, match=r"scatter .*'base' .*longer window"):
        table.covariances_of(["base"])


@pytest.mark.parametrize("share", [0.04, 0.3, 0.5])
@pytest.mark.parametrize("std", [0.0, 0.05e-3, 0.5e-3])
def test_exchanged_labels_in_a_part_of_a_window(std, share):
    """The mean is between two places, which the scatter of either tells apart."""
    positions = np.zeros((400, 2, 3)) + 0.1
    positions[:, 1, 0] += 12e-3
    positions += std * np.random.default_rng(1).normal(size=positions.shape)
    changed = slice(200, 200 + round(100 * share))
    positions[changed] = positions[changed, ::-1]
    recording = Recording(NAMES, np.arange(400) / RATE, positions, "run")
    table = recording.between(2.0, 2.99)
    scatter = 12.0 * np.sqrt(share * (1.0 - share))  # mm, without noise
    with pytest.warns(TrackerWarning, match="2 and 2.99 s: .*'tip' .*two") as caught:
        table.positions_of(["tip"])
    stated = float(re.search(r"by (\S+) mm", str(caught[0].message))[1])
    assert stated == pytest.approx(scatter, rel=0.1)
    recording.between(1.0, 1.99).positions_of(NAMES)  # no warning


@pytest.mark.parametrize("n", [3, 5, 100])
def test_noise_drift_and_vibration_are_one_place(n):
    rng, t = np.random.default_rng(2), np.arange(100) / RATE
    smooth = (t, np.sin(30.0 * t), np.exp(-t)) if n > 5 else ()
    paths = [path[:, None] * [1.0, 0.3, 0.0] for path in smooth]
    for path in (*paths, *rng.normal(size=(50, 100, 3))):
        whole = Recording(("tip",), t, path[:, None], "run")
        whole.between(0.0, t[n - 1]).positions_of(["tip"])


@pytest.mark.parametrize("seed", range(5))
def test_the_plateau_is_found(seed):
    """Between the rise, the slow creep and the release, and nowhere at rest."""
    recording = noisy(seed)
    start, stop = recording.plateau(0.5).window
    assert 2.6 < start < 4.2
    assert 5.9 < stop < 6.0
    table = recording.plateau(0.5, after_step_of="tip")
    assert table.window == (start, stop)
    since = recording.step_of("tip")
    words = f"plateau ... {start - since:g} and {stop - since:g} s"
    assert says(table.places[0], words)
    # Creep has ended at 4 s, so that the mean is within what it was before.
    height = table.positions_of(["tip"])[0, 2]
    assert 20.0e-3 < height < 20.25e-3


def test_a_recording_at_rest_is_one_plateau():
    recording = noisy()
    rest = Recording(NAMES, recording.times[:150], recording.positions[:150], "run")
    assert rest.plateau(1.0).window == pytest.approx((0.0, 1.49))


def test_a_plateau_goes_on_while_something_that_moves_is_seen():
    recording = noisy()
    positions = recording.positions.copy()
    positions[450:470, 1] = np.nan
    gap = Recording(NAMES, recording.times, positions, "run")
    start, stop = gap.plateau(0.5).window
    assert stop < 4.5 or start >= 4.69
    positions[:, 0] = recording.positions[:, 1]
    start, stop = gap.plateau(0.5).window
    assert start < 4.5
    assert stop > 4.7


def test_a_single_frame_that_is_off_does_not_end_a_plateau():
    recording = noisy()
    positions = recording.positions.copy()
    positions[500, 1] += 1e-3
    off = Recording(NAMES, recording.times, positions, "run")
    start, stop = off.plateau(0.5).window
    assert start < 4.5
    assert stop > 5.9


def test_no_plateau():
    """A marker that never stands still, and one that is held for too short a time."""
    t = np.arange(400) / RATE
    positions = np.zeros((400, 2, 3))
    positions[:, 1, 0] = 0.05 * np.sin(3.0 * t)
    moving = Recording(NAMES, t, positions, "run")
    with pytest.raises(ValueError, match=r"plateau of 0\.3 s: .* 2 % .*`between`"):
        moving.plateau(0.3)
    with pytest.raises(ValueError, match=r"held .*less than 5 s"):
        noisy().plateau(5.0)
    with pytest.raises(ValueError, match=r"plateau .*positive .*\[s\], got 0"):
        moving.plateau(0.0)


def test_labels_are_renamed():
    recording = Recording(
        ("arm:1", "arm:2"), np.arange(2.0), np.zeros((2, 2, 3)), "run"
    )
    assert recording.renamed({"tip": "arm:2"}).names == ("arm:1", "tip")
    with pytest.raises(ValueError, match=r"'arm:3'.*`labels` .* maps"):
        recording.renamed({"tip": "arm:3"})
    with pytest.raises(ValueError, match=r"\{'arm:1': .*one name"):
        recording.renamed({"arm:1": "arm:2"})
    with pytest.raises(ValueError, match=r"'end': .*two names"):
        recording.renamed({"tip": "arm:2", "end": "arm:2"})
