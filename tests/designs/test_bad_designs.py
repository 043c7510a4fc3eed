"""What cannot be designed is refused before anything is solved, by name."""

from dataclasses import replace

import numpy as np
import pytest
from test_design import HALF, MODEL, RANGE, TIP, TOLERANCE, moduli, pose
from wording import saying

from softcal_jax.configurations import ImposedForce, Markers
from softcal_jax.control import Limits
from softcal_jax.designs import (
    Change,
    PeakLimits,
    Printing,
    design,
    published_foam,
)
from softcal_jax.equilibrium import model_for_law
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import NeoHookean

GOAL = pose("bent", 0.5, [HALF, np.array(TIP) - [0.0, 0.0, 0.004]])


@pytest.fixture(autouse=True)
def nothing_is_solved(monkeypatch):
    def solved(*_, **__):
        raise AssertionError("it went on to solve")

    monkeypatch.setattr("softcal_jax.designs._design.fit_problem", solved)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, ("nothing may be designed", "limits of actuators")),
        ({"cabel": Limits(force=(0.0, 1.0))}, ("'cabel'", "mean 'cable'")),
        ({"cable": Limits()}, ("force of cable 'cable'", "0 to inf N", "finite ends")),
        ({"cable": Limits(force=(2.0, 1.0))}, ("clash", "lower 2 N", "upper 1 N")),
        ({"cable": Limits(force=(1.0, 2.0))}, ("starts outside", "0.5 N")),
        (
            {"cable": Limits(force=(0.0, 2.0), displacement=(0.0, 1e-3))},
            ("cable 'cable'", "what is imposed", "displacement"),
        ),
    ],
)
def test_limits(limits, message):
    with pytest.raises(ValueError, match=saying(*message)):
        design(MODEL, None, GOAL, limits=limits)


def goal(place, where=TIP):
    return replace(GOAL, markers=Markers(["end"], [where], TOLERANCE), measured=[place])


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (replace(GOAL, measured=None), ("'bent' has no goal", "measured values")),
        (goal((100.0, 0.01, 0.01)), ("'end' in 'bent'", "body is", "unit of length")),
        (goal((0, 0.01, 0.02), (0, 0.01, 0.01)), ("nothing can move 'end' in 'bent'",)),
    ],
)
def test_goals(goal, message):
    with pytest.raises(ValueError, match=saying(*message)):
        design(MODEL, moduli(), goal, limits=RANGE)


def test_a_foam_needs_both_moduli():
    only = ParameterSpace([moduli().entries[0]])
    with pytest.raises(ValueError, match=saying("E_l and E_t together", "E_t")):
        design(MODEL, only, GOAL, foam=published_foam())


def test_a_foam_without_any_of_the_moduli():
    """Isotropic Polyfoam of the published TPU ends at 1.5 MPa."""
    stiff = Parameter("E", "E", 3e6, 2e6, 4e6, unit="Pa")
    isotropic = model_for_law(MODEL, NeoHookean(3e6, 0.3))
    with pytest.raises(ValueError, match=saying("1.4928 MPa", "outside of", "bounds")):
        design(isotropic, stiff, GOAL, foam=published_foam())
    ratio = Parameter("nu", "nu", 0.3, 0.2, 0.4, scale="linear")
    with pytest.raises(ValueError, match=saying("E of an isotropic body", "nu")):
        design(isotropic, ratio, GOAL, foam=published_foam())


def test_a_robust_design_needs_errors():
    with pytest.raises(ValueError, match=saying("robust", "errors of printing")):
        design(MODEL, moduli(), GOAL, printing=Printing(moduli=0.0), robust=True)
    with pytest.raises(ValueError, match=saying("robust", "errors of printing")):
        design(MODEL, None, GOAL, limits=RANGE, robust=True)


def test_a_change_needs_neighbours():
    with pytest.raises(ValueError, match=saying("moduli", "positive", "got 0")):
        Change(moduli=0.0)
    # No modulus changes, and there is no angle.
    with pytest.raises(ValueError, match=saying("change", "two control points")):
        design(MODEL, moduli(), GOAL, change=Change(angle=0.5))


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"stretch": 1.0}, ("largest stretch", "above 1", "got 1")),
        ({"stress": -3e3}, ("largest stress", "above 0", "got -3000")),
    ],
)
def test_limits_of_peaks(limits, message):
    with pytest.raises(ValueError, match=saying(*message)):
        PeakLimits(**limits)


def test_errors_of_printing():
    with pytest.raises(ValueError, match=saying("moduli", "not negative", "-0.1")):
        Printing(moduli=-0.1)


def test_an_actuator_that_a_goal_lacks_has_no_limits_there():
    """Its limits are those of the goals that command it."""
    idle = replace(GOAL, name="idle", actuation={})
    pulled = replace(GOAL, actuation={"cable": ImposedForce(0.5)})
    with pytest.raises(AssertionError, match="went on to solve"):
        design(MODEL, moduli(), [idle, pulled], limits=RANGE)
