"""What fits to other data have in common: the equilibria at the start."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from light_beam import MODEL, measured, unknowns

from softcal_jax.calibration import Evaluator, calibrate
from softcal_jax.fields import exactly_known, set_field

E, DENSITY = unknowns()
MODULI = count(300e3)


@pytest.fixture(autouse=True)
def solved(monkeypatch):
    """Solutions from rest."""
    solutions, really = [], Evaluator.equilibria

    def counted(self, z, *more, **options):
        solutions.append(really(self, z, *more, **options))
        return solutions[-1]

    monkeypatch.setattr(Evaluator, "equilibria", counted)
    return solutions


@pytest.fixture
def start():
    """One at which nothing has been solved yet."""
    return fresh()


def fresh():
    return [replace(E, start=next(MODULI)), DENSITY]


def fit(poses, start, model=MODEL):
    known = exactly_known()
    return calibrate(
        model, start, poses, noise="stated", intervals=None, uncertain=known
    )


def test_other_data_begin_with_the_same_equilibria(solved, start):
    fit(measured(), start)
    assert len(solved) == 1
    other = fit(measured(noise=-0.7, std=2e-7), start)
    assert len(solved) == 1
    # Few are kept: they are forgotten after some fits from elsewhere.
    for _ in range(4):
        fit(measured(), fresh())
    assert len(solved) == 5
    alone = fit(measured(noise=-0.7, std=2e-7), start)
    assert len(solved) == 6
    # Bit for bit, or rows of a sweep would depend on what their worker did before.
    assert [h.cost for h in other.history] == [h.cost for h in alone.history]
    np.testing.assert_array_equal(other.z, alone.z)


@pytest.mark.parametrize(
    "changed",
    [
        lambda _: {"poses": [replace(p, gravity=(0.0, 0.0, -9.7)) for p in measured()]},
        lambda _: {"model": set_field(MODEL, "nu", 0.31)},
        lambda start: {"start": [start[0], replace(DENSITY, start=1.1)]},
        lambda _: {"start": fresh()},
    ],
    ids=["gravity", "nu", "density", "start"],
)
def test_what_is_not_data_is_solved_anew(changed, solved, start):
    fit(measured(), start)
    fit(**{"poses": measured(), "start": start} | changed(start))
    assert len(solved) == 2
