"""Changes of readings, and of orientations in another frame."""

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax.mistakes import _refit


def test_turns_in_another_frame_and_their_derivatives():
    """log(exp(w) U) against matrices; its derivative falls at second order."""
    random = np.random.default_rng(0)
    w, dw = random.standard_normal((2, 4, 3))
    U = Rotation.from_rotvec(random.standard_normal((4, 3))).as_matrix()
    turned = _refit._turned(w, U)
    both = Rotation.from_rotvec(w).as_matrix() @ U
    np.testing.assert_allclose(
        Rotation.from_rotvec(turned).as_matrix(), both, atol=1e-14
    )
    J = _refit._change_of_turns(w, turned)
    change = np.einsum("kij,kj->ki", J, dw)
    errors = [
        np.max(
            np.abs(
                (_refit._turned(w + h * dw, U) - _refit._turned(w - h * dw, U))
                / (2 * h)
                - change
            )
        )
        for h in (1e-2, 1e-3)
    ]
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
    for k, fit in enumerate(_refit._fitted(A, Y, (low, high), np.inf)):
        off = beside(Y[:, [k]] + A[:, :2] @ z)
        np.testing.assert_allclose(fit.squares, np.min(np.sum(off**2, 0)), rtol=1e-4)
        np.testing.assert_allclose(np.sum((Y[:, k] + A @ fit.step) ** 2), fit.squares)
        np.testing.assert_allclose(fit.now, np.sum(beside(Y[:, k]) ** 2))
