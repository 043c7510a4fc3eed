"""Compliances of configurations before any measurement."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import (
    CalibrationProblem,
    Evaluator,
    considered_errors,
    first_guess,
    simulate,
    without_names,
)
from softcal_jax.configurations import (
    Configuration,
    configuration_arrays,
    measured_at_rest,
)
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    Model,
    NewtonSettings,
    Workers,
    check_converged,
)
from softcal_jax.fields import (
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_parameters,
)
from softcal_jax.sensitivity import EnergyCompliance, energy_compliance

Parameters = ParameterSpace | Entry | Sequence[Entry]
AnyVector = Array | HostArray


class Sensed(eqx.Module):
    """Compliances of one configuration, as host arrays.

    Attributes:
        name: Name of the configuration.
        W_ep: Compliances of its measured coordinates [m].
        W: The same in units of the noise [-].
        W_c: Their change per standard deviation of each error that is considered,
            likewise; see `considered_errors` [-].
        W_pp: H_p K^-1 H_p^T [J].
        failure: Why there is no equilibrium; empty if there is one.
    """

    name: str
    W_ep: Float[HostArray, "n_e n_p"]
    W: Float[HostArray, "n_e n_p"]
    W_c: Float[HostArray, "n_e n_errors"]
    W_pp: Float[HostArray, "n_p n_p"]
    failure: str


class Survey(eqx.Module):
    """Compliances of configurations at one value of the parameters.

    Attributes:
        space: The parameters.
        z: Their scaled values [-].
        sensed: One entry per configuration.
    """

    space: ParameterSpace
    z: Float[Array, " n_p"]
    sensed: tuple[Sensed, ...]


@eqx.filter_jit
def _solve(
    problem: CalibrationProblem, z: Float[Array, " n_p"]
) -> tuple[EquilibriumSolution, EnergyCompliance]:
    solution, _ = simulate(problem, z, first_guess(problem, z))
    lane = lambda c, u: energy_compliance(problem.model, c, u, problem.space, z)
    return solution, jax.vmap(lane)(problem.configurations, solution.displacement)


def survey(
    model: Model,
    parameters: Parameters,
    configurations: Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
    required: int | None = None,
) -> Survey:
    """Solve configurations at one value of the parameters and differentiate them.

    Args:
        model: The model.
        parameters: The parameters.
        configurations: Configurations with markers; `measured` is ignored.
        at: Scaled values z; the start by default [-].
        noise: Standard deviation of every measured coordinate; by default that of the
            markers [m].
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated; the defaults of
            `Uncertain` by default.
        required: Number of leading configurations that must have an equilibrium; all by
            default.

    Returns:
        One entry per configuration.

    Raises:
        ValueError: If an input is wrong.
        RuntimeError: If a required configuration has no equilibrium.
    """
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise must be positive and finite [m], got {noise:g}.")
    space = as_space(parameters)
    z = _scaled_values(space, at)
    if not configurations:
        check_parameters(model, space)
        return Survey(space, z, ())
    mesh, mechanism = model.mesh, model.mechanism
    # A configuration without effectors is no error: the verdict says it sees nothing.
    posed = [
        measured_at_rest(c, mesh, mechanism) if c.markers or c.effectors else c
        for c in configurations
    ]
    arrays = configuration_arrays(mesh, posed, mechanism)
    check_parameters(model, space, jax.tree.map(lambda leaf: leaf[0], arrays))
    problem = CalibrationProblem(model, space, arrays, newton or NewtonSettings())
    solution, compliance = _solve(without_names(problem), z)
    names = tuple(c.name for c in configurations)
    required = len(names) if required is None else required
    if required:
        first = jax.tree.map(lambda leaf: leaf[:required], solution)
        check_converged(first, names)
    weights = np.asarray(arrays.effectors.inverse_std).reshape(len(names), -1)
    if noise is not None:
        weights = np.where(weights > 0.0, 1.0 / noise, 0.0)
    failures = [_failure(solution, compliance, i) for i in range(len(names))]
    for name, failure in zip(names[:required], failures, strict=False):
        if failure:
            raise RuntimeError(f"configuration {name!r}: {failure}.")
    evaluate = Evaluator(problem)
    with Workers(model, len(names)) as workers:
        causes = workers.end_of(
            considered_errors(
                evaluate,
                configurations,
                uncertain or Uncertain(),
                z=z,
                displacement=solution.displacement,
            )
        )
    errors = [error for own in causes.values() for error in own.values()]
    W_c = np.stack([np.zeros_like(weights), *errors], axis=2)[:, :, 1:]
    sensed = []
    W_ep, W_pp = np.asarray(compliance.W_ep), np.asarray(compliance.W_pp)
    for i, name in enumerate(names):
        seen = weights[i] > 0.0
        sensed.append(
            Sensed(
                name=name,
                W_ep=W_ep[i, seen],
                W=weights[i, seen, None] * W_ep[i, seen],
                W_c=weights[i, seen, None] * W_c[i, seen],
                W_pp=W_pp[i],
                failure=failures[i],
            )
        )
    return Survey(space, z, tuple(sensed))


def _scaled_values(
    space: ParameterSpace, at: Float[AnyVector, " n_p"] | None
) -> Float[Array, " n_p"]:
    z = space.start() if at is None else jnp.asarray(at, float)
    n_p = len(space.names)
    if z.shape != (n_p,) or not bool(jnp.all(jnp.isfinite(z))):
        raise ValueError(
            f"`at` must be {n_p} finite scaled values, one per parameter "
            f"({', '.join(space.names)}), got {np.asarray(z)}; "
            "`space.to_scaled` makes them of SI values."
        )
    return z


def _failure(
    solution: EquilibriumSolution, compliance: EnergyCompliance, lane: int
) -> str:
    one = jax.tree.map(lambda leaf: leaf[lane], solution)
    if not bool(one.converged):
        return str(RESULTS[one.result])
    return "" if bool(compliance.ok[lane]) else str(RESULTS[RESULTS.singular])


def as_sequence(
    configurations: Configuration | Sequence[Configuration],
) -> tuple[Configuration, ...]:
    """Return one or several configurations as a tuple."""
    if isinstance(configurations, Configuration):
        return (configurations,)
    return tuple(configurations)
