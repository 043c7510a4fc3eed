"""What fits to other data have in common: the equilibria at the start."""

from dataclasses import replace

import numpy as np
import pytest
from light_beam import MODEL, measured, unknowns

from softcal_jax.calibration import _evaluation as evaluation, calibrate
from softcal_jax.fields import exactly_known, set_field

E, DENSITY = START = unknowns()


@pytest.fixture(autouse=True)
def solved(monkeypatch):
    """Solutions from rest, with nothing kept from other tests."""
    solutions, really = [], evaluation.Evaluator.equilibria

    def counted(self, z, *more, **options):
        solutions.append(really(self, z, *more, **options))
        return solutions[-1]

    monkeypatch.setattr(evaluation.Evaluator, "equilibria", counted)
    monkeypatch.setattr(evaluation, "_FROM_REST", {})
    return solutions


def fit(poses, model=MODEL, start=START, **options):
    return calibrate(
        model, start, poses, intervals=None, uncertain=exactly_known(), **options
    )


def test_other_data_begin_with_the_same_equilibria(solved):
    fit(measured())
    assert len(solved) == 1
    other = fit(measured(noise=-0.7, std=2e-7), noise="stated")
    assert len(solved) == 1
    evaluation._FROM_REST.clear()
    alone = fit(measured(noise=-0.7, std=2e-7), noise="stated")
    assert len(solved) == 2
    # Bit for bit, or rows of a sweep would depend on what their worker did before.
    assert [h.cost for h in other.history] == [h.cost for h in alone.history]
    np.testing.assert_array_equal(other.z, alone.z)


@pytest.mark.parametrize(
    "changed",
    [
        lambda: {"poses": [replace(p, gravity=(0.0, 0.0, -9.7)) for p in measured()]},
        lambda: {"model": set_field(MODEL, "nu", 0.31)},
        lambda: {"start": [E, replace(DENSITY, start=1.1)]},
        lambda: {"start": [replace(E, start=310e3), DENSITY]},
    ],
    ids=["gravity", "nu", "density", "start"],
)
def test_what_is_not_data_is_solved_anew(changed, solved):
    fit(measured())
    options = {"poses": measured()} | changed()
    after = fit(**options)
    assert len(solved) == 2
    evaluation._FROM_REST.clear()
    assert after.history[0].cost == fit(**options).history[0].cost


def test_few_are_kept(solved):
    for value in np.linspace(300e3, 310e3, evaluation.MOST_KEPT + 2):
        fit(measured(), start=[replace(E, start=value), DENSITY])
    assert len(evaluation._FROM_REST) == evaluation.MOST_KEPT
