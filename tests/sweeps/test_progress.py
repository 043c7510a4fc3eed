"""Rate and time left, and how they are told."""

from dataclasses import replace
from datetime import datetime, timedelta

import pytest
from wording import says

from softcal_jax.sweeps import Progress, _row as row_module
from softcal_jax.sweeps._row import progress_of


def row(state="converged", worker="a"):
    return {"state": state, "worker": worker}


def test_the_rate_leaves_out_the_first_trial_which_compiles(monkeypatch):
    clock = iter([62.0, 63.0, 64.0, 65.0])
    monkeypatch.setattr(row_module.time, "monotonic", lambda: next(clock))
    rows = [row(), row(), row(), row("not converged")]
    begin, first, _, _, now = progress_of(14, ["converged", "failed"], rows)
    assert (begin.ended, begin.rate) == (2, None)
    assert str(begin) == "2 of 14 trials (1 failed)"
    assert first.rate is None
    assert now.rate == pytest.approx(1.0)
    assert says(now, "6 of 14", "1 failed, 1 not converged", "3600.0", "ends about")
    early = replace(now, total=15)  # not yet a third of this run
    assert "ends about" not in str(early)


def test_workers_that_end_together_are_no_hurry(monkeypatch):
    """Two of them, a trial each in 10 s."""
    clock = iter([60.0, 60.001, 70.0, 70.001])
    monkeypatch.setattr(row_module.time, "monotonic", lambda: next(clock))
    rows = [row(worker=worker) for worker in "abab"]
    _, *first, third, fourth = progress_of(100, [], rows)
    assert [now.rate for now in first] == [None, None]
    assert third.rate == pytest.approx(0.1)
    assert fourth.rate == pytest.approx(0.2, rel=1e-3)


def test_words():
    done = Progress(4, 4, 0, 0, 0, 0.5, None)
    assert str(done) == "4 of 4 trials, 1800.0 per hour"
    slow = Progress(100, 40, 0, 0, 0, 0.0005, None)
    ends = datetime.now() + timedelta(seconds=60 / 0.0005)  # more than a day
    assert says(slow, "40 of 100", "1.8 per hour", f"ends about {ends:%d %b}, ")
