"""Ctrl-C ends a calibration with what has been fitted."""

import signal
from dataclasses import replace

import numpy as np
import pytest
from light_beam import MODEL, measured, unknowns
from watching import only
from wording import says

from softcal_jax.calibration import HistoryEntry, SearchProgress, calibrate
from softcal_jax.equilibrium import EquilibriumProgress
from softcal_jax.fields import exactly_known


def fitted(**more):
    options = {"noise": "stated", "uncertain": exactly_known(), "intervals": None}
    return calibrate(MODEL, unknowns(), measured(), **(options | more))


def ctrl_c_at(step):
    """A callback that is interrupted as a user would do it."""

    def interrupt(entry):
        if entry.step == step:
            signal.raise_signal(signal.SIGINT)

    return only(HistoryEntry, interrupt)


@pytest.fixture(scope="module")
def whole():
    return fitted()


def test_the_last_step_is_returned(whole):
    result = fitted(watch=ctrl_c_at(2))
    assert result.interrupted
    assert not result.converged
    assert len(result.history) == 3
    same = whole.history[2]
    assert result.history[-1].values == same.values
    values = {p.name: p.value for p in result.parameters}
    np.testing.assert_allclose(
        list(values.values()), list(same.values.values()), rtol=1e-12
    )
    assert says(result.notes[0], "Interrupted", "step 2")
    assert not any("Not converged" in note for note in result.notes)
    assert [fit.name for fit in result.configurations] == ["hanging", "pushed"]
    assert not whole.interrupted


def test_before_the_first_step_there_is_nothing_to_return():
    with pytest.raises(KeyboardInterrupt):
        fitted(watch=ctrl_c_at(0))


def test_a_search_leaves_the_best_end_so_far(whole):
    """Two runs of three have ended, or one; all of them find the same optimum."""

    def interrupt(search):
        if search.step > 0:
            signal.raise_signal(signal.SIGINT)

    result = fitted(starts=3, watch=only(SearchProgress, interrupt))
    assert result.interrupted
    assert not result.converged
    assert len(result.history) == 1
    assert result.value("E") == pytest.approx(whole.value("E"), rel=1e-4)
    assert np.isfinite(result.starts.cost).any()


def interrupted_in(part):
    """A fit that a user ends who does not wait for a later stage."""

    def interrupt(text):
        if part in text:
            signal.raise_signal(signal.SIGINT)

    result = fitted(intervals=0.95, watch=only(str, interrupt))
    assert result.interrupted
    assert result.converged
    assert says(result.notes[-1], "Interrupted")
    return result


SHIFT = np.array([1e-5, 0.0, 0.0])


def test_an_interrupted_prediction_leaves_those_before(whole, monkeypatch):
    """On one core, where poses are predicted one after the other."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    # Readings of their own: the same ones again would not be held out.
    held_out = [
        replace(pose, name=f"{pose.name} again", measured=pose.measured + SHIFT)
        for pose in measured()
    ]

    def interrupt(now):
        if now.configuration == held_out[1].name:
            signal.raise_signal(signal.SIGINT)

    watch = only(EquilibriumProgress, interrupt)
    result = fitted(validation=held_out, watch=watch)
    assert result.interrupted
    assert result.converged
    assert result.value("E") == pytest.approx(whole.value("E"), rel=1e-9)
    *_, again = result.configurations
    assert (again.name, again.role) == ("hanging again", "validation")
    assert again.rms_after == pytest.approx(1e-5, rel=0.01)
    assert np.isnan(again.rms_before)
    assert says(result.notes, "pushed again", "not predicted", "interrupted")
    assert not any("hanging again" in note for note in result.notes)


def test_an_interruption_after_the_fit_leaves_it(whole):
    result = interrupted_in("error budget")
    assert result.value("E") == whole.value("E")
    assert result.intervals == ()


def test_an_interruption_of_the_profiles_leaves_those_that_are_known():
    """So little data that both need one; the density is the less certain."""
    density, E = interrupted_in("after that of density").intervals[::-1]
    assert density.kind != "none"
    assert (E.kind, E.name) == ("none", "E")
    assert says(E.why, "interrupted")
