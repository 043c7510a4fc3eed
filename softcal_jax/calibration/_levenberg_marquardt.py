"""A second, independent optimiser on the same stacked errors."""

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    effector_errors,
    first_guess,
    simulate,
)


def levenberg_marquardt(
    problem: CalibrationProblem,
    *,
    rtol: float = 1e-10,
    atol: float = 1e-10,
    max_steps: int = 100,
) -> tuple[Float[Array, " n_p"], bool]:
    """Fit by Levenberg-Marquardt of optimistix, without bounds, to check `calibrate`.

    It minimises the same stacked errors, with the Jacobian by autodiff through the
    implicit derivative of the equilibrium.

    Args:
        problem: The calibration.
        rtol: Relative tolerance of optimistix.
        atol: Absolute tolerance of optimistix.
        max_steps: Steps after which it gives up.

    Returns:
        Scaled parameters, and whether it converged inside the bounds.
    """
    import optimistix as optx  # here, as it takes a fifth of the package's import time

    guess = first_guess(problem, problem.space.start())
    weight = problem.configurations.effectors.inverse_std

    def errors(z, problem):
        solution, positions = simulate(problem, z, guess)
        delta_e = effector_errors(problem, positions)
        # A step to parameters without equilibrium must be refused.
        ok = solution.converged[:, None, None]
        of_data = jnp.where(ok, weight * delta_e, jnp.inf).ravel()
        return jnp.concatenate([of_data, problem.space.from_prior(z)])

    solution = optx.least_squares(
        errors,
        optx.LevenbergMarquardt(rtol=rtol, atol=atol),
        problem.space.start(),
        args=problem,
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    z = solution.value
    down, up = problem.space.room(z)
    inside = jnp.all((down <= 0.0) & (up >= 0.0))
    return z, bool(inside & (solution.result == optx.RESULTS.successful))
