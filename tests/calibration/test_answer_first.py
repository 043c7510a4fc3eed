"""The answer comes before the error budget and the intervals."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from light_beam import MODEL, measured, unknowns
from watching import only
from wording import says

from softcal_jax.calibration import (
    CalibrationResult,
    _calibrate,
    _evaluation,
    calibrate,
)
from softcal_jax.calibration._checked_intervals import Fitted
from softcal_jax.equilibrium import Program, Workers, _workers
from softcal_jax.fields import exactly_known
from softcal_jax.identifiability import assess, identify

SCALES_UNKNOWN = replace(exactly_known(), loads=0.1)


@pytest.fixture(scope="module")
def full():
    """What a calibration says, in order, and its result at the end."""
    said = []
    result = calibrate(
        MODEL,
        unknowns(),
        measured(),
        noise="stated",
        uncertain=SCALES_UNKNOWN,
        watch=only((str, CalibrationResult), said.append),
    )
    return said, result


def test_the_answer_is_by_the_noise_alone(full):
    (start, answer, budget, *intervals), result = full
    assert says(start, "depend on the parameters")
    assert says(budget, "error budget ... fit took")
    assert any("intervals" in text for text in intervals)
    assert answer.left_out == ("the error budget", "the intervals")
    assert says(assess(answer).reasons[-1], "noise alone", "error budget", "intervals")
    assert result.left_out == ()
    assert not any("left out" in reason for reason in assess(result).reasons)
    by_noise = np.sqrt(np.diag(result.uncertainty.covariance))
    np.testing.assert_allclose(
        [p.value for p in answer.parameters], [p.value for p in result.parameters]
    )
    scaled = np.array([p.standard_error / p.value for p in answer.parameters])
    np.testing.assert_allclose(scaled, by_noise, rtol=1e-6)
    whole = np.array([p.standard_error / p.value for p in result.parameters])
    assert np.all(whole > 1.05 * scaled)


@pytest.mark.parametrize(
    ("task", "programs"),
    [
        (partial(calibrate, noise="stated"), {"equilibrium_response", "_of_pose"}),
        (identify, {"_of_pose"}),
    ],
    ids=["calibrate", "identify"],
)
def test_what_is_compiled_ahead_is_what_is_run(monkeypatch, task, programs):
    """With other shapes or types it would be compiled for nothing, and then again."""
    key = lambda program, lane: _workers._key(program._function, program._shared, lane)
    ahead, ran, run = [], [], Program.run

    def compiled(workers, program):
        due, lanes = program()
        ahead.append(key(due, lanes[0]))

    def noted(program, solver, lane):
        ran.append(key(program, lane))
        return run(program, solver, lane)

    monkeypatch.setattr(_evaluation, "_FROM_REST", {})
    monkeypatch.setattr(Workers, "ahead", compiled)
    monkeypatch.setattr(Program, "run", noted)
    task(MODEL, unknowns(), measured(), uncertain=SCALES_UNKNOWN)
    assert {name for _, name, *_ in ahead} == programs
    assert set(ahead) <= set(ran)


@pytest.mark.parametrize("watch", [None, False, print])
def test_a_line_says_what_nobody_listens_to(monkeypatch, full, watch):
    """By default; it is switched off, or replaced by a callback."""
    watches, shown = [], []

    @contextmanager
    def line(*, wanted):
        yield shown.append if wanted else None

    def fit(problem, options, watch, **more):
        watches.append((watch, more["answers"]))
        return Fitted(replace(full[1], interrupted=True), problem, None)

    monkeypatch.setattr(_calibrate, "progress_line", line)
    monkeypatch.setattr(_calibrate, "fit", fit)
    calibrate(MODEL, unknowns(), measured(), watch=watch)
    ((told, answers),) = watches
    assert answers == (watch is print)  # a line has no room for a result
    assert (told is print) == (watch is print)
    if watch is False:
        assert told is None
    if watch is None:
        told("predicting")
        assert shown == ["predicting"]
