"""What a fit minimises, for other optimisers and samplers: its errors as JAX sees them.

The noise of all kinds weighs them as it does in `calibrate`, and priors are errors like
any other, so that half their sum of squares is the cost. What is considered and not
fitted is held at its nominal value there, and moves the fitted values afterwards. A
density has no such afterwards: its errors dc are integrated out, to first order about
the fit. With their columns W_c and the covariance V of the noise that of the residuals
becomes V + W_c W_c^T (Bridle et al., Mon. Not. R. Astron. Soc. 335, 2002).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration._evaluation import effector_errors, evaluate
from softcal_jax.calibration._result import CalibrationResult
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    check_converged,
    effector_values,
    map_lanes,
    solve_equilibrium,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.unknowns import Problem


def errors(
    problem: Problem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> Float[Array, " n"]:
    """Compute the whitened errors that `calibrate` squares; Eq. (10).

    Half the sum of their squares is its cost. Errors of the data in units of the noise
    come first, then differences of neighbours where these count, then distances from
    the priors. Works under `jit`, `vmap` and autodiff, forward and reverse; the
    derivatives are W_ep in the same units. Bounds do not count here.

    Args:
        problem: The calibration, by `build_problem`; its held-out poses do not count.
        z: Scaled parameters [-].
        guess: Displacements to start the equilibria from [m]; by default rest.

    Returns:
        The errors [-]; all of them infinite, without a derivative, where a pose has no
        equilibrium.
    """
    return _errors(problem.fitted.numbered, z, guess)


@eqx.filter_jit
def _errors(
    problem: Problem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"] | None,
    considered: Float[Array, "n_e k"] | None = None,
) -> Float[Array, " n"]:
    lanes, off = problem.configurations, problem.deviations
    if guess is None:
        guess = jnp.zeros((len(lanes), problem.model.n_points, 3))
    of_each = (lanes, guess) if off is None else (lanes, guess, off)
    shared = problem.space, problem.newton, z
    e, ok = map_lanes(_readings, problem.model, of_each, *shared)
    delta_e = effector_errors(problem, e)
    no_slopes = jnp.zeros((delta_e.size, z.shape[0]))
    rows = problem.rows(z, delta_e, no_slopes, considered)
    return jnp.where(jnp.all(ok), jnp.asarray(rows.error), jnp.inf)


def _readings(
    model: Model,
    lane: tuple[ConfigurationArrays, Array, *tuple[Array, ...]],
    space: ParameterSpace,
    newton: NewtonSettings,
    z: Float[Array, " n_p"],
) -> tuple[Float[Array, "n_rows 3"], Bool[Array, ""]]:
    """Read the effectors of a pose; zero, and False, if it has no equilibrium."""
    configuration, guess, *off = lane
    model, configuration = space.apply(model, configuration, sum(off, z))
    solution = solve_equilibrium(model, configuration, guess=guess, settings=newton)
    state, ok = (solution.displacement, solution.multipliers), solution.converged
    e = effector_values(model, configuration, *state)
    return jnp.where(ok, e, 0.0), jnp.asarray(ok)


class LogDensity(Module):
    """Log density of the parameters, up to a constant: a function of coordinates x.

    It is a pytree: passed as an argument to a compiled function, it does not compile
    that anew for other data.

    Attributes:
        problem: The calibration, its arrays alone.
        centre: Scaled parameters at x = 0 [-].
        factor: Their change per unit of x [-].
        scale: Standard deviation of independent errors over the stated one [-].
        guess: Displacements to start the equilibria from [m].
        considered: Change of the errors per standard deviation of each considered
            error, in units of the noise [-].
    """

    problem: Problem
    centre: Float[Array, " n_p"]
    factor: Float[Array, "n_p n_p"]
    scale: Float[Array, ""]
    guess: Float[Array, "n_c n_points 3"]
    considered: Float[Array, "n_e k"]

    def z(self, x: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Compute the scaled parameters of coordinates."""
        return self.centre + self.factor @ x

    def __call__(self, x: Float[Array, " n_p"]) -> Float[Array, ""]:
        """Compute the log density of coordinates x; see `log_density`."""
        z, space = self.z(x), self.problem.space
        down, up = space.room(z)
        A, b = space.in_plain_steps().rows()
        inside = jnp.all(down <= 0.0) & jnp.all(up >= 0.0) & jnp.all(A @ z <= b)
        at = jnp.where(inside, z, space.start())
        rows = _errors(self.problem, at, self.guess, self.considered)
        n = self.considered.shape[0]
        of_data, of_priors = rows[:n] / self.scale, rows[n:] / self.problem.level
        squares = jnp.sum(of_data**2) + jnp.sum(of_priors**2)
        return jnp.where(inside & jnp.isfinite(squares), -0.5 * squares, -jnp.inf)


def log_density(
    problem: Problem, around: CalibrationResult | None = None
) -> LogDensity:
    """Make the log density of the parameters given the data, for samplers.

    The prior is normal where a parameter has one, and otherwise flat in scaled
    parameters, like ln E, within bounds and orders. Outside of these, and where a pose
    has no equilibrium, the density is -inf with a gradient of zero.

    Args:
        problem: The calibration, by `build_problem`; its held-out poses do not count.
        around: Its result. Coordinates x then are whitened by its covariance by all
            causes: x = 0 is the fit, and a standard deviation is about 1. The noise is
            that of the result, taken as known, and its considered errors count, see
            this module; calibrate with `exactly_known` for none. Without a result,
            x are the scaled parameters and the noise is as stated.

    Returns:
        The function of x, differentiable in both modes; its `z(x)` are the scaled
        parameters, and `problem.space.from_scaled(z)` the values.

    Raises:
        ValueError: If the result is of another calibration, or a parameter has no
            standard error.
        RuntimeError: If a pose has no equilibrium at the fit, or else at the start.
    """
    problem = problem.fitted
    weight = np.ravel(problem.configurations.effectors.inverse_std)
    z, considered = problem.space.start(), np.zeros((weight.size, 0))
    centre, factor, scale = jnp.zeros_like(z), np.eye(len(z)), problem.level
    if around is not None:
        fit = around.linear.of_fit()
        _check_same(problem, around)
        problem, scale = problem.with_noise(around.noise), fit.scale
        z = centre = around.z
        factor = np.linalg.cholesky(around.budget.covariance)
        columns = fit.considered.values
        considered = np.zeros((weight.size, columns.shape[1]))
        considered[weight > 0.0] = columns / scale
    now = evaluate(problem, z)
    check_converged(now.equilibrium, problem.names)
    return LogDensity(
        problem=problem.numbered,
        centre=centre,
        factor=jax.device_put(factor),
        scale=jax.device_put(np.asarray(scale, float)),
        guess=now.equilibrium.displacement,
        considered=jax.device_put(considered),
    )


def _check_same(problem: Problem, result: CalibrationResult) -> None:
    """Raise ValueError unless a result is of a problem, with all standard errors."""
    fit = result.linear.of_fit()
    poses = tuple(c.name for c in result.configurations if c.role == "calibration")
    n = int(np.sum(np.asarray(problem.configurations.effectors.inverse_std) > 0.0))
    ours, theirs = [*problem.space.names], [*result.space.names]
    if (ours, problem.names, n) != (theirs, poses, len(fit.r)):
        raise ValueError(
            f"the result is of {listed(theirs)} with {len(fit.r)} readings of "
            f"{listed(poses)}, and the problem of {listed(ours)} with {n} readings of "
            f"{listed(problem.names)}: give both the same parameters and poses."
        )
    unknown = np.flatnonzero(np.isnan(np.diag(result.budget.covariance)))
    if unknown.size:
        raise ValueError(
            f"{listed([theirs[k] for k in unknown])} has no standard error, as it is "
            "on a bound or not determined, and so no whitened coordinate: give it a "
            "prior, or leave it out."
        )
