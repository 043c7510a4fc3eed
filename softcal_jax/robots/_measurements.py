"""Measurements that a robot with known parameters would give."""

from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax import equilibrium
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    configuration_lanes,
    measured_as,
    measured_at_rest,
)
from softcal_jax.fields import ParameterSpace


def synthetic_measurements(
    model: equilibrium.Model,
    space: ParameterSpace,
    configurations: Sequence[Configuration],
    values: Mapping[str, float],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: equilibrium.NewtonSettings | None = None,
) -> tuple[Configuration, ...]:
    """Return configurations with the measurements that known parameters would give.

    `values` has one for every parameter of the `space`, by name, in SI units. Other
    arguments and errors are those of `simulated_measurements`.

    Raises:
        ValueError: If a value is missing or unknown.
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
    model: equilibrium.Model,
    configurations: Sequence[Configuration],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: equilibrium.NewtonSettings | None = None,
    first: equilibrium.Model | None = None,
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
    newton = newton or equilibrium.NewtonSettings()

    guess = None
    if first is not None:
        with equilibrium.Workers(first, len(configurations)) as workers:
            guess = equilibrium.equilibria(workers, first, arrays, newton).displacement
    with equilibrium.Workers(model, len(configurations)) as workers:
        solution = equilibrium.equilibria(workers, model, arrays, newton, guess=guess)
        effectors = equilibrium.effectors_on_all_cores(workers, model, arrays, solution)
    equilibrium.check_converged(solution, tuple(c.name for c in configurations))
    random = np.random.default_rng(seed)
    effectors, weights = np.asarray(effectors), np.asarray(arrays.effectors.inverse_std)
    measured = []
    for lane, (c, of_pose) in enumerate(zip(configurations, records, strict=True)):
        rows = [record.index for record in of_pose]
        e, weight = effectors[lane, rows], weights[lane, rows]
        if noise:
            std = np.where(weight > 0.0, 1.0 / np.maximum(weight, 1e-300), 0)
            e = e + std * random.standard_normal(e.shape)
        measured.append(measured_as(c, e, mesh, mechanism))
    return tuple(measured)
