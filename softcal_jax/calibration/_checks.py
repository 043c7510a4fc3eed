"""Checks of a calibration: synthetic measurements, and a second optimiser."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._evaluation import effector_errors
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    as_guess,
    effectors_of,
    effectors_on_all_cores,
    equilibria,
)
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    configuration_lanes,
    measured_as,
    measured_at_rest,
)
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    Workers,
    check_converged,
    solve_equilibrium,
    solve_from_rest,
)
from softcal_jax.fields import ParameterSpace


def synthetic_measurements(
    model: Model,
    space: ParameterSpace,
    configurations: Sequence[Configuration],
    values: Mapping[str, float],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: NewtonSettings | None = None,
) -> tuple[Configuration, ...]:
    """Return configurations with the measurements that known parameters would give.

    Args:
        model: The body.
        space: The parameters.
        configurations: Poses with effectors; measured values are replaced.
        values: Value of every parameter, by name, in SI units.
        noise: Whether to add Gaussian noise with the stated standard deviations.
        seed: Seed of the noise.
        newton: Settings of the equilibrium.

    Raises:
        ValueError: If a value is missing or unknown, or a configuration has no
            effectors.
        RuntimeError: If a configuration has no equilibrium.
    """
    unknown = sorted(set(values) ^ set(space.names))
    if unknown:
        raise ValueError(
            f"values must name every parameter once; {unknown[0]!r} is "
            f"{'not given' if unknown[0] in space.names else 'no parameter'}. "
            f"Parameters: {', '.join(space.names)}."
        )
    z = space.to_scaled(jnp.asarray([values[name] for name in space.names]))
    return simulated_measurements(
        space.model_at(model, z),
        configurations,
        noise=noise,
        seed=seed,
        newton=newton,
        change=lambda c: space.apply(model, c, z)[1],
    )


def simulated_measurements(
    model: Model,
    configurations: Sequence[Configuration],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: NewtonSettings | None = None,
    first: Model | None = None,
    change: Callable[[ConfigurationArrays], ConfigurationArrays] | None = None,
) -> tuple[Configuration, ...]:
    """Return configurations with the measurements that a given model would give.

    Args:
        model: The model that stands for the real robot.
        configurations: Poses with effectors; measured values are replaced.
        noise: Whether to add Gaussian noise with the stated standard deviations.
        seed: Seed of the noise.
        newton: Settings of the equilibrium.
        first: A model of the same mesh and mechanism whose equilibria are easier to
            find and lie near: its states are the guesses.
        change: Changes each configuration when it is measured, like an offset of the
            recording; nothing by default.

    Raises:
        ValueError: If a configuration has no effectors.
        RuntimeError: If a configuration has no equilibrium.
    """
    mesh, mechanism = model.mesh, model.mechanism
    posed = [measured_at_rest(c, mesh, mechanism) for c in configurations]
    arrays, records = configuration_lanes(mesh, posed, mechanism)
    arrays = arrays if change is None else jax.vmap(change)(arrays)
    newton = newton or NewtonSettings()

    guess = None
    if first is not None:
        with Workers(first, len(configurations)) as workers:
            guess = as_guess(equilibria(workers, first, arrays, newton))
    with Workers(model, len(configurations)) as workers:
        solution = equilibria(workers, model, arrays, newton, guess=guess)
        effectors = effectors_on_all_cores(workers, model, arrays, solution)
    check_converged(solution, tuple(c.name for c in configurations))
    random = np.random.default_rng(seed)
    effectors, weights = np.asarray(effectors), np.asarray(arrays.effectors.inverse_std)
    measured = []
    for lane, (c, own) in enumerate(zip(configurations, records, strict=True)):
        rows = [record.index for record in own]
        e, weight = effectors[lane, rows], weights[lane, rows]
        if noise:
            std = np.where(weight > 0.0, 1.0 / np.maximum(weight, 1e-300), 0)
            e = e + std * random.standard_normal(e.shape)
        measured.append(measured_as(c, e, mesh, mechanism))
    return tuple(measured)


def with_measured(configuration: Configuration, measured) -> Configuration:
    """Return the configuration with other measured marker positions [m]."""
    return replace(configuration, measured=measured)


def levenberg_marquardt(
    problem: CalibrationProblem,
) -> tuple[Float[Array, " n_p"], bool]:
    """Fit by Levenberg-Marquardt of optimistix, without bounds, to check `calibrate`.

    The Jacobian is by autodiff through the implicit derivative of the equilibrium.

    Args:
        problem: The calibration.

    Returns:
        Scaled parameters, and whether it converged inside the bounds.
    """
    import optimistix as optx  # here, as it takes a fifth of the package's import time

    begin = problem.space.start()
    guess = as_guess(solve_from_rest(*problem.at(begin), problem.newton))

    def errors(z, problem: CalibrationProblem):
        model, configurations = problem.at(z)
        solve = lambda c, u: solve_equilibrium(
            model, c, guess=u, settings=problem.newton
        )
        solution = jax.vmap(solve)(configurations, guess)
        delta_e = effector_errors(
            problem, effectors_of(model, configurations, solution)
        )
        none = jnp.zeros((delta_e.size, z.shape[0]))
        error = problem.rows(z, delta_e, none).error
        # A step to parameters without equilibrium must be refused.
        return jnp.where(jnp.all(solution.converged), error, jnp.inf)

    solution = optx.least_squares(
        errors,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        begin,
        args=problem,
        options={"jac": "fwd"},
        max_steps=100,
        throw=False,
    )
    z = solution.value
    down, up = problem.space.room(z)
    inside = jnp.all((down <= 0.0) & (up >= 0.0))
    return z, bool(inside & (solution.result == optx.RESULTS.successful))
