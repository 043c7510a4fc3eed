"""What the benchmarks of the paper's figures share."""

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import _paper
from benchmarks._paper import CLOSE, measured_beam, parameter_errors, recovered


@pytest.fixture(scope="module")
def measured():
    return measured_beam((2, 1, 1), order=1, plane="xy")


def test_steps_until_an_error_stays_small():
    curve = np.array([1.0, 0.1, 1e-3, 0.5, 1e-3, 1e-4])
    assert _paper.steps_until(curve, 2e-3) == 4
    assert _paper.steps_until(curve, 1e-5) is None
    assert _paper.steps_until(curve, 2.0) == 0


def test_errors_are_relative_for_moduli_and_modulo_half_a_turn_for_angles(measured):
    space, target = measured.space, measured.target
    p = np.array(space.from_scaled(target))
    p[0] *= 1.01
    p[5] += np.pi + 0.02  # the same axis but for 0.02 rad
    errors = parameter_errors(space, space.to_scaled(jnp.asarray(p)), target)
    np.testing.assert_allclose(errors, [0.01, 0, 0, 0, 0, 0.02], atol=1e-12)
    assert not recovered(errors)
    assert recovered(np.full(6, CLOSE))


def test_a_subset_keeps_the_shapes_and_drops_the_weights(measured):
    problem = measured.problem
    kept = _paper.subset(problem, [2, 3])
    assert jnp.shape(kept.configurations.gravity) == (4, 3)
    np.testing.assert_array_equal(
        kept.configurations.gravity,
        np.asarray(problem.configurations.gravity)[[2, 3, 2, 2]],
    )
    weight = np.asarray(kept.configurations.effectors.inverse_std)
    np.testing.assert_allclose(weight[:2], 1.0 / _paper.STD)
    np.testing.assert_array_equal(weight[2:], 0.0)


def test_a_subset_of_markers():
    measured = measured_beam((2, 1, 1), order=1, plane="xy", n_effectors=4)
    kept = _paper.subset(measured.problem, range(4), [0, 2])
    weight = np.asarray(kept.configurations.effectors.inverse_std)
    np.testing.assert_array_equal((weight > 0).all(axis=(0, 2)), [1, 0, 1, 0])
