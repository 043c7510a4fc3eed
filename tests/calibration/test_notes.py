"""Notes on moduli that ended equal."""

import jax.numpy as jnp
import numpy as np
import pytest
from wording import says

from softcal_jax.calibration import LeftOut, ResidualChecks
from softcal_jax.calibration._notes import order_notes
from softcal_jax.robots import anisotropic_beam


def space(**choices):
    return anisotropic_beam(cells=(1, 1, 1), order=1, **choices).space


def at(parameters, ratios):
    """Scaled values with E_l / E_t of the two control points."""
    E_t = np.array([8e5, 4e5])
    p = np.concatenate([E_t, E_t * ratios, [0.3, -0.2]])
    return parameters.to_scaled(jnp.asarray(p))


@pytest.mark.parametrize("tensor_steps", [True, False])
def test_equal_moduli_of_an_axis_are_named(tensor_steps):
    """With tensor steps they end a little apart, without by the constraint itself."""
    parameters = space(tensor_steps=tensor_steps)
    z = at(parameters, np.array([0.5, 1.0]))
    (note,) = order_notes(parameters, parameters.admissible(z))
    assert says(note, "E_l of CP 2", "E_t of CP 2", "equal", "several starts")
    both = parameters.admissible(at(parameters, np.array([1.0, 1.0])))
    assert len(order_notes(parameters, both)) == 2


@pytest.mark.parametrize("tensor_steps", [True, False])
def test_moduli_that_differ_are_not(tensor_steps):
    """By a hundred thousandth, too: only rounding counts as equal."""
    parameters = space(tensor_steps=tensor_steps)
    z = at(parameters, np.array([0.5, 1.0 - 1e-5]))
    assert order_notes(parameters, z) == []


NAN = float("nan")


@pytest.mark.parametrize(
    ("rms", "motion", "words"),
    [
        (2e-3, 1e-2, "bx 2.49 is 2.00 mm off, 20 % of its motion; ... 0.1 mm"),
        (NAN, NAN, "contradict bx 2.49 ... no markers ... (p = 1e-06)"),
        (
            NAN,
            1e-2,
            "contradict bx 2.49 ... alone determines ... no distance ... (p = 1e-06)",
        ),
    ],
)
def test_a_pose_that_the_others_do_not_predict(rms, motion, words):
    """A pose of forces alone, and one that depends on what it alone determines."""
    expected = 1e-4 if np.isfinite(rms) else NAN
    pose = LeftOut("bx 2.49", rms, expected, motion, 1e-6, NAN)
    (reason,) = ResidualChecks(("bx 2.49",), None, (pose,)).reasons
    assert says(reason, words)
    assert "nan" not in reason


def test_without_an_order_nothing_is_said():
    parameters = space(tensor_steps=False, ordered=False)
    assert order_notes(parameters, at(parameters, np.array([1.0, 1.2]))) == []
