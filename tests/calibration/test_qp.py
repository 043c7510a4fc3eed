import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from softcal_jax.calibration import bounded_step

step = jax.jit(bounded_step)


def random_qp(n, condition, seed):
    rng = np.random.default_rng(seed)
    m = 3 * n + 4
    U, _ = np.linalg.qr(rng.normal(size=(m, n)))
    V, _ = np.linalg.qr(rng.normal(size=(n, n)))
    W = U * np.logspace(0, -np.log10(condition), n) @ V.T
    bound = np.abs(rng.normal(size=(2, n)))
    return W, rng.normal(size=m), -bound[0], bound[1]


@pytest.mark.parametrize(("n", "condition"), [(1, 1), (3, 10), (6, 1e3), (12, 1e5)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_step_is_that_of_an_exact_bounded_solver(n, condition, scale):
    """Against SciPy's bounded least squares; the errors may be in any unit."""
    W, error, low, high = random_qp(n, condition, seed=n)
    W, error = scale * W, scale * error
    ours = step(W, error, low, high)
    exact = lsq_linear(W / scale, -error / scale, (low, high), tol=1e-14)
    cost = 0.5 * np.sum(((W @ ours.lambda_p + error) / scale) ** 2)
    # Both are minima; along a flat valley only the cost compares.
    np.testing.assert_allclose(cost, exact.cost, rtol=1e-8)
    assert ours.kkt_residual < 1e-12  # polished: the iteration alone ends at 1e-10
    assert np.all((ours.lambda_p >= low) & (ours.lambda_p <= high))


def test_step_stops_at_an_active_bound():
    lambda_p, kkt = step(jnp.eye(2), jnp.array([-3.0, 0.5]), -jnp.ones(2), jnp.ones(2))
    np.testing.assert_allclose(lambda_p, [1.0, -0.5], atol=1e-9)
    assert kkt < 1e-9


def test_rank_deficient_compliance_gives_a_finite_bounded_step():
    W = jnp.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]])
    lambda_p, _ = step(W, jnp.array([-1.0, -2.0]), -jnp.ones(3), jnp.ones(3))
    np.testing.assert_allclose(W @ lambda_p, [1.0, 2.0], atol=1e-8)
    assert lambda_p[2] == 0.0  # a parameter without effect does not move
    assert np.all(np.abs(lambda_p) <= 1.0)


def test_no_error_means_no_step():
    lambda_p, _ = step(jnp.eye(2), jnp.zeros(2), -jnp.ones(2), jnp.ones(2))
    np.testing.assert_array_equal(lambda_p, 0.0)
