"""Results of a calibration or a simulation, from the last state of the solver."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._budget import ErrorBudget
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    SimulationResult,
)
from softcal_jax.calibration._result import ParameterEstimate
from softcal_jax.calibration._uncertainty import Uncertainty
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
    EffectorRecord,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    Model,
    effector_values,
    robot_states,
)
from softcal_jax.fields import ParameterSpace


def parameter_estimates(
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    spread: Uncertainty,
    budget: ErrorBudget,
    start: Float[Array, " n_p"] | None = None,
) -> tuple[ParameterEstimate, ...]:
    """Return values and standard errors of the parameters, in SI units.

    Args:
        space: The parameters.
        z: Scaled values [-].
        spread: Their uncertainty by the noise.
        budget: That by all causes.
        start: Scaled values at the start, if not that of the parameters [-].
    """
    values = np.asarray(space.from_scaled(z))
    before = [parameter.start for parameter in space.parameters]
    if start is not None:
        before = list(np.asarray(space.from_scaled(start)))
    std = budget.standard_errors
    estimates = []
    for i, parameter in enumerate(space.parameters):
        estimates.append(
            ParameterEstimate(
                name=parameter.name,
                value=float(values[i]),
                standard_error=float(std[i]),
                start=float(before[i]),
                lower=float(parameter.lower),
                upper=float(parameter.upper),
                unit=parameter.unit,
                at_bound=bool(spread.at_bound[i]),
            )
        )
    return tuple(estimates)


def configuration_results(
    model: Model,
    configurations: Sequence[Configuration],
    lanes: ConfigurationLanes,
    *,
    role: Literal["calibration", "validation"],
    before: Float[Array, "n_c n_rows 3"],
    after: Float[Array, "n_c n_rows 3"],
    solution: EquilibriumSolution,
) -> tuple[ConfigurationResult, ...]:
    """Describe configurations that were fitted or predicted.

    Args:
        model: The model with the calibrated parameters.
        configurations: The configurations of a batch.
        lanes: The batch.
        role: Fitted, or only predicted.
        before: Simulated effector coordinates with the start parameters.
        after: The same with the calibrated parameters.
        solution: Equilibria with the calibrated parameters.

    Returns:
        One entry per configuration that has an equilibrium.
    """
    effectors = [
        tuple(
            replace(e, simulated_before=e.among(first), simulated=e.among(last))
            for e in own
        )
        for own, first, last in zip(
            lanes.effectors, np.asarray(before), np.asarray(after), strict=True
        )
    ]
    found = _results(
        model, configurations, lanes.arrays, solution, role=role, effectors=effectors
    )
    return tuple(result for result in found if result.converged)


def simulation_result(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
) -> SimulationResult:
    """Describe a forward simulation.

    Args:
        model: The model.
        configurations: What was simulated; measured values are ignored, and turns are
            counted from rest.
        solution: Their equilibria, one lane per configuration.

    Returns:
        The result; configurations without an equilibrium say why.
    """
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    reference = lambda arrays: arrays.effectors.turn_reference
    from_rest = jnp.broadcast_to(jnp.eye(3), reference(lanes.arrays).shape)
    arrays = eqx.tree_at(reference, lanes.arrays, from_rest)

    effectors = [
        _simulated(own, model, _lane(arrays, i), _lane(solution, i))
        for i, own in enumerate(lanes.effectors)
    ]
    found = _results(
        model, configurations, arrays, solution, role="simulation", effectors=effectors
    )
    return SimulationResult(model, found)


_effector_values = eqx.filter_jit(effector_values)


def _simulated(
    records: Sequence[EffectorRecord],
    model: Model,
    lane: ConfigurationArrays,
    solution: EquilibriumSolution,
) -> tuple[EffectorRecord, ...]:
    """Fill in the values at one equilibrium, as if nothing had been measured."""
    records = tuple(
        replace(
            record,
            measured=np.full_like(record.measured, np.nan),
            std=np.full_like(record.std, np.inf),
            reference=np.eye(3),
        )
        for record in records
    )
    if not (records and solution.converged):
        return records
    # Positions are cheap enough to compute without compiling.
    compute = _effector_values if lane.effectors.has_forces else effector_values
    values = np.asarray(
        compute(model, lane, solution.displacement, solution.multipliers)
    )
    return tuple(replace(e, simulated=e.among(values)) for e in records)


def _results(
    model: Model,
    configurations: Sequence[Configuration],
    arrays: ConfigurationArrays,
    solution: EquilibriumSolution,
    *,
    role: Literal["calibration", "validation", "simulation"],
    effectors: Sequence[tuple[EffectorRecord, ...]],
) -> tuple[ConfigurationResult, ...]:
    """Describe every configuration of a batch."""
    states = robot_states(model, configurations, solution, arrays)
    return tuple(
        ConfigurationResult(
            name=configuration.name,
            role=role,
            converged=bool(solution.converged[i]),
            outcome=RESULTS[_lane(solution.result, i)],
            effectors=effectors[i],
            displacement=np.asarray(solution.displacement[i])[: model.mesh.n_nodes],
            newton_steps=int(solution.steps[i]),
            load_steps=int(solution.load_steps[i]),
            residual=float(solution.residual[i]),
            min_det_F=float(solution.min_det_F[i]),
            robot=states[i],
        )
        for i, configuration in enumerate(configurations)
    )


def _lane(batch, i: int):
    """Pick one configuration of a batch."""
    return jax.tree.map(lambda leaf: leaf[i], batch)
