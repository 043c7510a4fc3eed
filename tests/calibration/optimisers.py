"""Another optimiser on the errors of a calibration."""

import jax.numpy as jnp
import optimistix as optx

from softcal_jax.calibration import errors, evaluate


def levenberg_marquardt(problem):
    """Scaled parameters by optimistix, without bounds, and if they are within these."""
    start, room = problem.space.start(), problem.space.room
    guess = evaluate(problem, start).equilibrium.displacement
    solution = optx.least_squares(
        lambda z, problem: errors(problem, z, guess),
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        start,
        args=problem.bare,
        options={"jac": "fwd"},
        max_steps=100,
        throw=False,
    )
    down, up = room(solution.value)
    inside = jnp.all(down <= 0.0) & jnp.all(up >= 0.0)
    good = inside & (solution.result == optx.RESULTS.successful)
    return solution.value, bool(good)
