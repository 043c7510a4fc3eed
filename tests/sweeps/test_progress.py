"""Rate and time left, and how they are told."""

import pytest
from wording import says

from softcal_jax.sweeps import Progress, TrialRow, _progress as progress_module
from softcal_jax.sweeps._progress import Tally, duration, rate_text


def row(state="converged", worker="a"):
    return TrialRow("key", {}, state, worker=worker)


def test_the_rate_leaves_out_the_first_trial_which_compiles(monkeypatch):
    clock = iter([62.0, 63.0, 64.0, 65.0])
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: next(clock))
    tally = Tally(20, ["converged", "failed"])
    begin = tally.now()
    assert (begin.ended, begin.rate, begin.seconds_left) == (2, None, None)
    assert str(begin) == "2 of 20 trials (1 failed)"
    assert tally.now(row()).rate is None
    for _ in range(2):
        tally.now(row())
    now = tally.now(row("not converged"))
    assert now.rate == pytest.approx(1.0)
    assert now.seconds_left == pytest.approx(14.0)
    assert says(
        now, "6 of 20 ... 1 failed, 1 not converged ... 1 per second, 14 s left"
    )


def test_workers_that_end_together_are_no_hurry(monkeypatch):
    """Two of them, a trial each in 10 s."""
    clock = iter([60.0, 60.001, 70.0, 70.001])
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: next(clock))
    tally = Tally(100, [])
    assert [tally.now(row(worker=w)).rate for w in "ab"] == [None, None]
    assert tally.now(row(worker="a")).rate == pytest.approx(0.1)
    assert tally.now(row(worker="b")).rate == pytest.approx(0.2, rel=1e-3)


def test_words():
    assert [rate_text(r) for r in (2.0, 0.1, 0.001)] == [
        "2 per second", "6 per minute", "3.6 per hour",
    ]  # fmt: skip
    assert [duration(t) for t in (12.0, 600.0, 9000.0, 2e6)] == [
        "12 s", "10 min", "2.5 h", "23.1 days",
    ]  # fmt: skip
    done = Progress(4, 4, 0, 0, 0, 0.5, None)
    assert str(done) == "4 of 4 trials, 30 per minute"
