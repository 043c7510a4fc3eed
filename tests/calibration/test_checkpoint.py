"""A calibration that is stopped goes on where it was, or says why it cannot."""

import errno
import os
import signal
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from printed_beam import BEAM
from watching import only
from wording import says

from softcal_jax.calibration import (
    FROM_ANYWHERE,
    CalibrationResult,
    CalibrationSettings,
    CalibrationWarning,
    Evaluator,
    HistoryEntry,
    SearchProgress,
    calibrate,
)
from softcal_jax.fields import exactly_known
from softcal_jax.robots import anisotropic_beam, synthetic_measurements

SHORT = CalibrationSettings(max_steps=4)


@pytest.fixture(scope="module")
def beam():
    return anisotropic_beam(**BEAM)


@pytest.fixture(scope="module")
def data(beam):
    return synthetic_measurements(
        beam.model, beam.space, beam.configurations, beam.target, noise=True
    )


@pytest.fixture(scope="module")
def fit(beam, data):
    """Calibrate this beam, with other data, start or settings if given."""

    def run(path=None, data=data, space=beam.space, starts=1, **keywords):
        fixed = {"noise": "stated", "intervals": None, "uncertain": exactly_known()}
        keywords = {**fixed, "starts": starts, **keywords}
        return calibrate(beam.model, space, data, checkpoint=path, **keywords)

    return run


@pytest.fixture(scope="module")
def whole(fit):
    """Without any interruption."""
    return fit()


class Stopped(Exception):
    """Ctrl-C, or a power cut."""


def stop_after(n):
    def progress(entry):
        if entry.step == n:
            raise Stopped

    return only(HistoryEntry, progress)


def interrupted(fit, path, n, **keywords):
    with pytest.raises(Stopped):
        fit(path, watch=stop_after(n), **keywords)
    return path


def assert_same_history(ours, theirs):
    """On the way equilibria are left early, and those of a resumed step are not."""
    assert [entry.step for entry in ours] == list(range(len(theirs)))
    for a, b in zip(ours, theirs, strict=True):
        assert a.cost == pytest.approx(b.cost, rel=1e-3)
        assert a.accepted == b.accepted
        assert a.step_bound == pytest.approx(b.step_bound, rel=1e-3)
        assert list(a.values) == list(b.values)
        for name, value in b.values.items():
            assert a.values[name] == pytest.approx(value, rel=1e-3, abs=1e-5)
        assert type(a.lambda_p) is type(a.newton_steps) is tuple
    seconds = [entry.seconds for entry in ours]
    assert seconds == sorted(seconds)


@pytest.mark.parametrize("n", [0, 1, 4])
def test_stopped_and_resumed_it_ends_where_it_would_have(tmp_path, fit, whole, n):
    assert len(whole.history) > 6
    path = interrupted(fit, tmp_path / "fit.npz", n)
    entries = []
    resumed = fit(path, watch=only(HistoryEntry, entries.append))
    assert resumed.converged
    np.testing.assert_array_equal(resumed.z, whole.z)
    np.testing.assert_allclose(
        resumed.uncertainty.covariance, whole.uncertainty.covariance, rtol=1e-5
    )
    assert_same_history(resumed.history, whole.history)
    # Only what is new is told.
    assert [e.step for e in entries] == list(range(n + 1, len(whole.history)))
    for ours, theirs in zip(resumed.configurations, whole.configurations, strict=True):
        for a, b in zip(ours.points, theirs.points, strict=True):
            before = a.simulated_before, b.simulated_before
            np.testing.assert_allclose(*before, rtol=0, atol=1e-12)
            np.testing.assert_allclose(a.simulated, b.simulated, rtol=0, atol=1e-8)


def test_it_may_be_stopped_again_and_again(tmp_path, fit, whole):
    path = tmp_path / "fit.npz"
    for n in (1, 3, 5):
        interrupted(fit, path, n)
    resumed = fit(path)
    assert_same_history(resumed.history, whole.history)
    np.testing.assert_array_equal(resumed.z, whole.z)


def test_a_finished_calibration_is_only_read(tmp_path, fit):
    """No step more, and the file stays as it is."""
    path = tmp_path / "fit.npz"
    first = fit(path)
    before = path.read_bytes()
    entries = []
    again = fit(path, watch=only(HistoryEntry, entries.append))
    assert first.converged
    assert again.converged
    assert entries == []
    assert path.read_bytes() == before
    assert_same_history(again.history, first.history)
    np.testing.assert_allclose(again.z, first.z, rtol=0, atol=1e-12)
    assert again.notes == first.notes


def test_steps_of_both_parts_count_against_the_limit(tmp_path, fit):
    path = interrupted(fit, tmp_path / "fit.npz", 3, settings=SHORT)
    for _ in range(2):
        result = fit(path, settings=SHORT)
        assert len(result.history) == 5
        assert not result.converged
        (note,) = [n for n in result.notes if n.startswith("Not converged")]
        assert says(note, "4 steps", "lambda_p")
        assert "inf" not in note


def half_written(error):
    """A `np.savez` that fails on its way."""

    def fail(file, **arrays):
        file.write(b"half of it")
        raise error

    return fail


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "fit.npz.partial")


def test_on_a_full_disk_the_fit_goes_on_and_the_checkpoint_stays(
    tmp_path, fit, whole, monkeypatch
):
    """The disk is full from step 3 on: step 2 is still there."""
    path = interrupted(fit, tmp_path / "fit.npz", 2)
    assert [file.name for file in tmp_path.iterdir()] == ["fit.npz"]
    before = path.read_bytes()
    full = r"fit\.npz .*not be written.*No space left.*holds"
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", half_written(FULL))
        with pytest.warns(CalibrationWarning, match=full):
            result = fit(path)
    np.testing.assert_array_equal(result.z, whole.z)
    assert says(result.notes, "could not be written", "No space left")
    assert path.read_bytes() == before
    again = fit(path)
    np.testing.assert_array_equal(again.z, whole.z)
    assert not any("could not be written" in note for note in again.notes)
    assert [file.name for file in tmp_path.iterdir()] == ["fit.npz"]


def test_interrupted_while_it_writes_it_leaves_no_half_of_a_file(tmp_path, fit):
    path = interrupted(fit, tmp_path / "fit.npz", 2)
    before = path.read_bytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np, "savez", half_written(KeyboardInterrupt()))
        assert fit(path).interrupted
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["fit.npz"]


@pytest.mark.parametrize(
    ("name", "why"),
    [("no/fit.npz", r"no of fit\.npz .*make it"), ("n" * 250, "name too long")],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_first_equilibrium(
    tmp_path, fit, monkeypatch, name, why
):
    evaluations = Evaluations(monkeypatch)
    with pytest.raises(OSError, match=why):
        fit(tmp_path / name)
    assert evaluations.n == 0
    assert list(tmp_path.iterdir()) == []


def test_one_calibration_per_checkpoint(tmp_path, fit):
    """The second ends at once; when the first has ended, the file is free."""
    path = tmp_path / "fit.npz"

    def second(entry):
        with pytest.raises(BlockingIOError, match="another calibration is writing"):
            fit(path)
        raise Stopped

    with pytest.raises(Stopped):
        fit(path, watch=only(HistoryEntry, second))
    assert [file.name for file in tmp_path.iterdir()] == ["fit.npz"]
    assert fit(path, settings=CalibrationSettings()).converged


@pytest.mark.parametrize("what", ["measurement", "settings", "start", "noise"])
def test_checkpoint_of_another_calibration_is_refused(tmp_path, data, fit, what):
    path = interrupted(fit, tmp_path / "fit.npz", 1)
    before = path.read_bytes()
    changed = {}
    if what == "measurement":
        moved = data[1].measured.copy()
        moved[0, 2] += 1e-9
        changed = {"data": [data[0], replace(data[1], measured=moved)]}
    elif what == "noise":
        changed = {"noise": "estimated"}
    elif what == "settings":
        changed = {"settings": CalibrationSettings(tol=1.0000001e-6)}
    else:
        start = {"E_t": 7e5, "E_l": 4e5, "theta": 1e-9}
        changed = {"space": anisotropic_beam(**BEAM, start=start).space}
    with pytest.raises(ValueError, match=r"fit\.npz .*another calibration"):
        fit(path, **changed)
    assert path.read_bytes() == before


def test_without_a_path_nothing_is_written(tmp_path, fit, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fit(settings=SHORT)
    assert list(tmp_path.iterdir()) == []


STARTS = 3


class Evaluations:
    """Counts evaluations, and stops at one of them if told to."""

    def __init__(self, monkeypatch, stop_at=None):
        self.n, real = 0, Evaluator.__call__

        def counted(evaluate, *args, **keywords):
            self.n += 1
            if self.n == stop_at:
                raise Stopped
            return real(evaluate, *args, **keywords)

        monkeypatch.setattr(Evaluator, "__call__", counted)


class Searched(NamedTuple):
    """From several starts, without any interruption.

    `progress` is what was told of them, and `n` counts evaluations.
    """

    result: CalibrationResult
    progress: list[SearchProgress]
    n: int


@pytest.fixture(scope="module")
def searched(fit):
    progress = []
    with pytest.MonkeyPatch.context() as patch:
        every = Evaluations(patch)
        result = fit(starts=STARTS, watch=only(SearchProgress, progress.append))
    return Searched(result, progress, every.n)


def same_search(ours, theirs):
    for name in ("starts", "values", "z", "cost", "steps", "converged", "errors"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_a_search_says_how_far_it_is(searched):
    """Each step, counted from each image on; several starts take turns."""
    result, progress, _ = searched
    for start in range(STARTS):
        run = [p for p in progress if p.start == start]
        for before, now in pairwise(run):
            assert now.step == (before.step + 1 if now.image == before.image else 0)
        assert run[0].step == 0
        assert sum(p.step > 0 for p in run) == result.starts.steps[start]
    assert {p.starts for p in progress} == {STARTS}
    line = str(SearchProgress(1, 6, 2, 4, 1.5e-3))
    assert says(line, "start 2 of 6", "image 2", "step 4", "1.500 mm")
    line = str(SearchProgress(1, 6, 0, 0, np.nan))
    assert says(line, "start 2 of 6", "first equilibria")


@pytest.mark.parametrize(
    "share", [0.5, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.15, 0.9))]
)
def test_a_stopped_search_ends_as_if_nothing_had_stopped_it(
    tmp_path, fit, searched, monkeypatch, share
):
    """Wherever it stops; what had ended is not run again."""
    path, whole = tmp_path / "fit.npz", searched.result
    progress, resumed_progress = [], []
    with monkeypatch.context() as patch:
        before = Evaluations(patch, stop_at=int(share * searched.n))
        with pytest.raises(Stopped):
            fit(path, starts=STARTS, watch=only(SearchProgress, progress.append))
    with monkeypatch.context() as patch:
        after = Evaluations(patch)
        resumed = fit(
            path, starts=STARTS, watch=only(SearchProgress, resumed_progress.append)
        )
    same_search(resumed.starts, whole.starts)
    np.testing.assert_array_equal(resumed.z, whole.z)
    assert_same_history(resumed.history, whole.history)
    # Only images that were under way are repeated: the first start runs alone.
    twice = {p[:3] for p in progress} & {p[:3] for p in resumed_progress}
    under_way = 1 if {p.start for p in progress} == {0} else STARTS - 1
    assert len(twice) <= under_way
    most = under_way * (FROM_ANYWHERE.max_steps + 1) + 1  # and the first of all
    assert before.n + after.n <= searched.n + most


def test_a_search_that_has_ended_is_not_forgotten(tmp_path, fit, searched, monkeypatch):
    """Stopped after a step of the fit; another number of starts is another search."""
    path = interrupted(fit, tmp_path / "fit.npz", 0, starts=STARTS)
    with pytest.raises(ValueError, match=r"fit\.npz .*another calibration"):
        fit(path)
    evaluations = Evaluations(monkeypatch)
    resumed = fit(path, starts=STARTS)
    assert evaluations.n <= len(resumed.history) + 3
    same_search(resumed.starts, searched.result.starts)
    np.testing.assert_array_equal(resumed.z, searched.result.z)


def test_an_interrupted_search_goes_on_as_if_nothing_had_stopped_it(
    tmp_path, fit, searched
):
    """The best end so far is returned, but it is no part of the whole search."""
    path = tmp_path / "fit.npz"

    def ctrl_c(step):
        if step.start > 0:
            signal.raise_signal(signal.SIGINT)

    stopped = fit(path, starts=STARTS, watch=only(SearchProgress, ctrl_c))
    assert stopped.interrupted
    assert says(stopped.notes, f"checkpoint {path}", "same call")
    with np.load(path) as file:
        assert {name.partition("_")[0] for name in file.files} >= {"run0", "mark"}
        assert not any(name.startswith("state") for name in file.files)
    resumed = fit(path, starts=STARTS)
    assert not resumed.interrupted
    same_search(resumed.starts, searched.result.starts)
    np.testing.assert_array_equal(resumed.z, searched.result.z)
