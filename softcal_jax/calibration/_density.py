"""What a fit minimises, for other optimisers and samplers, as functions of JAX.

The fit holds considered errors at their nominal values, which moves what it finds. A
density integrates them out, to first order about the fit: with their columns W_c, the
covariance V of the noise becomes V + W_c W_c^T (Bridle et al., Mon. Not. R. Astron.
Soc. 335, 2002).
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Float, check_untraced, is_traced
from softcal_jax.calibration._evaluation import effector_errors, evaluate
from softcal_jax.calibration._result import CalibrationResult
from softcal_jax.configurations import earlier_lanes, in_order
from softcal_jax.equilibrium import (
    check_converged,
    effector_values,
    map_lanes,
    solve_equilibrium,
)
from softcal_jax.unknowns import Problem


def errors(
    problem: Problem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> Float[Array, " n"]:
    """Compute the whitened errors that `calibrate` squares; Eq. (10).

    Half the sum of their squares is its cost. Those of the data come first, then
    differences of neighbours where these count, then distances from the priors. Works
    under `jit`, `vmap` and autodiff. Bounds do not count.

    Args:
        problem: The calibration, by `build_problem`; its held-out poses do not count.
        z: Scaled parameters [-].
        guess: Displacements to start the equilibria from [m]; by default rest, or that
            of the pose that one follows.

    Returns:
        The errors [-]; all infinite, with derivatives of zero, where a pose has no
        equilibrium.
    """
    problem = problem.fitted.bare
    traced = any(map(is_traced, jax.tree.leaves(problem)))
    problem = problem if traced else problem.numbered
    return _errors(problem, z, guess, _earlier(problem))


def _earlier(problem: Problem) -> tuple[int | None, ...]:
    """Return the pose that each follows, see `Configuration.after`."""
    poses = problem.configurations
    if poses.is_stage.shape[-1] == 0:
        return (None,) * len(poses)
    check_untraced("the problem, of which poses follow others,", poses.after, "")
    return tuple(earlier_lanes([*poses]))


@eqx.filter_jit
def _errors(
    problem: Problem, z, guess, earlier: tuple[int | None, ...], considered=None
) -> Float[Array, " n"]:
    lanes, off = problem.configurations, problem.deviations
    at_rest = guess is None
    if guess is None:
        guess = jnp.zeros((len(lanes), problem.model.n_points, 3))
    shared, measured = (problem.space, problem.newton, z), lanes.effectors.measured
    u, e, ok = guess, jnp.zeros(measured.shape), jnp.zeros(len(lanes), bool)
    for group in in_order(earlier):
        of_each = (lanes, guess) if off is None else (lanes, guess, off)
        at = slice(None) if len(group) == len(lanes) else np.array(group)
        of_group = jax.tree.map(lambda leaf, at=at: leaf[at], of_each)
        ended = map_lanes(_readings, problem.model, of_group, *shared)
        each = zip((u, e, ok), ended, strict=True)
        u, e, ok = (old.at[at].set(new) for old, new in each)
        for c, p in enumerate(earlier):
            if p in group:
                after = lanes[c].following(lanes[p], u[p])
                put = lambda every, one, c=c: every.at[c].set(one)
                lanes = jax.tree.map(put, lanes, after)
                guess = guess.at[c].set(u[p]) if at_rest else guess
    delta_e = effector_errors(problem, e)
    no_slopes = jnp.zeros((delta_e.size, z.shape[0]))
    rows = problem.rows(z, delta_e, no_slopes, considered)
    return jnp.where(jnp.all(ok), jnp.asarray(rows.error), jnp.inf)


def _readings(model, lane, space, newton, z):
    """Solve a pose: displacement, effectors, and whether it has an equilibrium.

    Without one they are zero.
    """
    configuration, guess, *off = lane
    model, configuration = space.apply(model, configuration, sum(off, z))
    solution = solve_equilibrium(model, configuration, guess=guess, settings=newton)
    state = solution.displacement, solution.multipliers
    e = effector_values(model, configuration, *state)
    or_zero = lambda a: jnp.where(solution.converged, a, 0.0)
    return or_zero(solution.displacement), or_zero(e), solution.converged


class LogDensity(Module):
    """Log density of the parameters, up to a constant: a pytree, called with x.

    Attributes:
        problem: The calibration, its arrays alone.
        centre: Scaled parameters at x = 0 [-].
        guess: Displacements to start the equilibria from [m].
        factor: Change of scaled parameters per unit of x [-].
        scale: Standard deviation of independent errors over the stated one [-].
        considered: Change of the errors per standard deviation of each considered
            error, in units of the noise [-].
        earlier: Index of the pose that each follows, None for none.
    """

    problem: Problem
    centre: Float[Array, " n_p"]
    guess: Float[Array, "n_c n_points 3"]
    factor: Float[Array, "n_p n_p"]
    scale: Float[Array, ""]
    considered: Float[Array, "n_e k"]
    earlier: tuple[int | None, ...] = eqx.field(static=True)

    def z(self, x: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Compute the scaled parameters of coordinates."""
        return self.centre + self.factor @ x

    def __call__(self, x: Float[Array, " n_p"]) -> Float[Array, ""]:
        """Compute the log density of coordinates x; see `log_density`."""
        z, space = self.z(x), self.problem.space
        down, up = space.room(z)
        A, b = space.rows()
        inside = jnp.all(down <= 0.0) & jnp.all(up >= 0.0) & jnp.all(A @ z <= b)
        at = jnp.where(inside, z, space.start())
        of_all = self.guess, self.earlier, self.considered
        rows = _errors(self.problem, at, *of_all)
        n = self.considered.shape[0]
        of_data, of_priors = rows[:n] / self.scale, rows[n:] / self.problem.level
        squares = jnp.sum(of_data**2) + jnp.sum(of_priors**2)
        return jnp.where(inside & jnp.isfinite(squares), -0.5 * squares, -jnp.inf)


def log_density(
    problem: Problem, around: CalibrationResult | None = None
) -> LogDensity:
    """Make the log density of the parameters given the data, for samplers.

    Without a prior it is flat in scaled parameters, like ln E. Beyond bounds and
    orders, and without an equilibrium, it is -inf with a gradient of zero.

    Args:
        problem: The calibration, by `build_problem`; its held-out poses do not count.
        around: Its result. x = 0 then is the fit, and 1 a standard error by all causes,
            in every direction. The noise is that of the result, taken as known, and its
            considered errors are integrated out. Without a result, x are the scaled
            parameters, and the noise is that of the problem.

    Returns:
        The function of x; its `z(x)` are the scaled parameters, of which
        `problem.space.from_scaled` makes values.

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
        problem, fit = problem.with_noise(around.noise), around.linear.of_fit()
        _check(problem, around)
        z, scale, W_c = around.z, fit.scale, fit.considered.values
        centre, factor = z, np.linalg.cholesky(around.budget.covariance)
        considered = np.zeros((weight.size, W_c.shape[1]))
        considered[weight > 0.0] = W_c / scale
    now = evaluate(problem, z)
    check_converged(now.equilibrium, problem.names)
    factor, scale, considered = jax.device_put(
        (factor, np.asarray(scale, float), considered)
    )
    problem = replace(problem, space=problem.space.in_plain_steps()).numbered
    return LogDensity(
        problem=problem,
        centre=centre,
        guess=now.equilibrium.displacement,
        factor=factor,
        scale=scale,
        considered=considered,
        earlier=_earlier(problem),
    )


def _check(problem: Problem, result: CalibrationResult) -> None:
    fit, names = result.linear.of_fit(), problem.space.names
    n = int(np.sum(np.asarray(problem.configurations.effectors.inverse_std) > 0.0))
    of_result = result.space.names, fit.poses[: len(problem.poses)], len(fit.r)
    if (names, problem.names, n) != of_result:
        raise ValueError(
            f"the result is of {listed(of_result[0])} and {len(fit.r)} readings, and "
            f"the problem of {listed(names)} and {n}, or of other poses."
        )
    if unknown := [k for k, known in zip(names, fit.known, strict=True) if not known]:
        raise ValueError(
            f"{listed(unknown)} has no standard error, as it is on a bound or nothing "
            "determines it: give it a prior, or leave it out."
        )
