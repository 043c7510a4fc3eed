"""Measurements made by the model itself, to test a calibration before any are taken."""

from collections.abc import Mapping, Sequence
from typing import cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax.calibration._problem import CalibrationProblem, at_rest, simulate
from softcal_jax.configurations import (
    Configuration,
    Markers,
    configuration_arrays,
)
from softcal_jax.equilibrium import Model, NewtonSettings, check_converged
from softcal_jax.fields import ParameterSpace

_simulate = eqx.filter_jit(simulate)


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
    """Configurations with the marker positions that known parameters would give.

    Args:
        model: The body.
        space: The parameters.
        configurations: Poses with markers; measured positions are replaced.
        values: Value of every parameter, by name, in SI units.
        noise: Whether to add normal errors with the standard deviation of the markers.
        seed: Seed of these errors.
        newton: Settings of the equilibrium.

    Returns:
        The configurations, measured.

    Raises:
        ValueError: If a value is missing or unknown, or a configuration has no markers.
        RuntimeError: If a configuration has no equilibrium.
    """
    unknown = sorted(set(values) ^ set(space.names))
    if unknown:
        raise ValueError(
            f"values must name every parameter once; {unknown[0]!r} is "
            f"{'not given' if unknown[0] in space.names else 'no parameter'}. "
            f"Parameters: {', '.join(space.names)}."
        )
    for configuration in configurations:
        if configuration.markers is None:
            raise ValueError(f"configuration {configuration.name!r} has no markers.")
    arrays = configuration_arrays(model.mesh, configurations, model.mechanism)
    problem = CalibrationProblem(model, space, arrays, newton or NewtonSettings())
    z = space.to_scaled(jnp.asarray([values[name] for name in space.names]))
    solution, positions = _simulate(problem, z, at_rest(problem))
    check_converged(solution, tuple(c.name for c in configurations))
    random = np.random.default_rng(seed)
    measured = []
    for c, x in zip(configurations, np.asarray(positions), strict=True):
        markers = cast(Markers, c.markers)
        x = x[: len(markers.names)]
        if noise:
            std = np.asarray(markers.std, float)
            std = std[:, None] if std.ndim == 1 else std
            x = x + std * random.standard_normal(x.shape)
        measured.append(with_measured(c, x))
    return tuple(measured)


def with_measured(configuration: Configuration, measured) -> Configuration:
    """A configuration with other measured marker positions [m]."""
    return Configuration(
        configuration.name,
        configuration.supports,
        configuration.gravity,
        configuration.loads,
        configuration.markers,
        measured,
    )
