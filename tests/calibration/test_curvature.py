"""The second part of the Hessian, from past steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.calibration._qp import convex_model
from softcal_jax.calibration._step import QUICK, Curvature, learned

RANDOM = np.random.default_rng(0)
N = 4
_learned = jax.jit(learned)
NONE = Curvature(jnp.zeros((N, N)), jnp.zeros((), bool))


def symmetric():
    A = RANDOM.normal(size=(N, N))
    return jnp.asarray(A + A.T)


def test_as_many_steps_as_parameters_tell_a_constant_curvature():
    """Conn, Gould and Toint (1991): whatever the steps, if they are independent."""
    true, known = symmetric(), NONE
    for step in jnp.asarray(RANDOM.normal(size=(N, N))):
        known = _learned(known, step, true @ step, 1.0, 0.9, jnp.array([0.8, 0.85]))
    np.testing.assert_allclose(known.matrix, true, rtol=1e-9, atol=1e-9)


def test_a_step_that_tells_nothing_new_changes_nothing():
    true, step = symmetric(), jnp.asarray(RANDOM.normal(size=N))
    args = (1.0, 0.9, jnp.array([0.8, 0.85]))
    once = _learned(NONE, step, true @ step, *args)
    again = _learned(once, step, true @ step, *args)
    np.testing.assert_allclose(again.matrix, once.matrix, rtol=0, atol=1e-9)
    # What lies across the step would make the update infinite.
    across = jnp.asarray(np.linalg.svd(step[None])[2][1])
    unbounded = _learned(once, step, once.matrix @ step + across, *args)
    np.testing.assert_array_equal(once.matrix, unbounded.matrix)


@pytest.mark.parametrize(
    ("after", "predicted", "used"),
    [
        (0.95, (0.90, 0.94), True),
        (0.95, (0.94, 0.90), False),  # the linear model was right
        (1.20, (0.90, 1.10), True),  # refused
        (1.0 - 1.01 * QUICK, (0.1, 0.8), False),  # quick without it
        (np.inf, (0.90, 0.94), False),
    ],
)
def test_it_is_used_where_the_cost_falls_slowly_and_it_told_better(
    after, predicted, used
):
    step = jnp.ones(N)
    known = _learned(NONE, step, step, 1.0, after, jnp.array(predicted))
    assert bool(known.used) == used
    assert bool(jnp.any(known.matrix != 0.0)) == np.isfinite(after)


def test_the_convex_model_has_the_gradient_and_the_sizes_of_the_curvatures():
    """Of the Hessian for columns of unit length, here with two negative ones."""
    W, error = RANDOM.normal(size=(7, N)), RANDOM.normal(size=7)
    size = np.linalg.norm(W, axis=0)
    unit = W / size
    axes = np.linalg.qr(RANDOM.normal(size=(N, N)))[0]
    curvatures = np.array([-3.0, -0.1, 0.2, 5.0])
    hessian = axes @ np.diag(curvatures) @ axes.T
    S = (hessian - unit.T @ unit) * np.outer(size, size)
    model, rest = convex_model(jnp.asarray(W), jnp.asarray(error), jnp.asarray(S))
    np.testing.assert_allclose(model.T @ rest, W.T @ error, rtol=1e-9, atol=1e-9)
    wanted = axes @ np.diag(np.abs(curvatures)) @ axes.T * np.outer(size, size)
    np.testing.assert_allclose(model.T @ model, wanted, rtol=1e-9, atol=1e-9)
