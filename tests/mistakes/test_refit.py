"""Changes of readings, and of orientations in another frame."""

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax.mistakes import _refit


def test_turns_in_another_frame_and_their_derivatives():
    """log(exp(w) U) against matrices; its derivative falls at second order."""
    random = np.random.default_rng(0)
    w, dw = random.standard_normal((2, 4, 3))
    U = Rotation.from_rotvec(random.standard_normal((4, 3))).as_matrix()
    of = lambda w: [np.array(x)[0] for x in _refit._turned(w[None], U[None])]
    turned, J = of(w)
    both = Rotation.from_rotvec(w).as_matrix() @ U
    np.testing.assert_allclose(
        Rotation.from_rotvec(turned).as_matrix(), both, atol=1e-14
    )
    change = np.einsum("kij,kj->ki", J, dw)
    difference = lambda h: (of(w + h * dw)[0] - of(w - h * dw)[0]) / (2 * h)
    errors = [np.max(np.abs(difference(h) - change)) for h in (1e-2, 1e-3)]
    np.testing.assert_allclose(errors[0] / errors[1], 100.0, rtol=0.02)


def test_a_bounded_refit_leaves_out_what_is_fitted_along():
    """Two unknowns in a box and one error beside them, against a fine grid."""
    random = np.random.default_rng(0)
    A, Y = random.standard_normal((9, 3)), random.standard_normal((9, 2))
    low, high = np.array([-0.05, -1.0]), np.array([0.05, 1.0])
    sides = [np.linspace(low[i], high[i], 401) for i in (0, 1)]
    z = np.stack(np.meshgrid(*sides)).reshape(2, -1)
    free = A[:, 2:] / np.linalg.norm(A[:, 2])
    beside = lambda x: x - free @ (free.T @ x)
    X = _refit._fitted(A, Y, (low, high), np.inf)
    squares = np.sum((Y + A @ X) ** 2, axis=0)
    assert np.all((X[:2] >= low[:, None]) & (X[:2] <= high[:, None]))
    np.testing.assert_allclose(_refit._beside(A[:, 2:], Y), beside(Y), atol=1e-14)
    for k in range(2):
        off = beside(Y[:, [k]] + A[:, :2] @ z)
        np.testing.assert_allclose(squares[k], np.min(np.sum(off**2, 0)), rtol=1e-4)
