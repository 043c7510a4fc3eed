"""Estimates and fits of a calibration, from its last state."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._result import (
    ConfigurationFit,
    EffectorFit,
    ParameterEstimate,
)
from softcal_jax.calibration._uncertainty import Uncertainty
from softcal_jax.configurations import (
    Configuration,
    NamedRow,
    configuration_arrays,
    effector_rows,
    row_numbers,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    effector_positions,
    robot_states,
)
from softcal_jax.fields import ParameterSpace


def parameter_estimates(
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    spread: Uncertainty,
    start: Float[Array, " n_p"] | None = None,
) -> tuple[ParameterEstimate, ...]:
    """Values and standard errors of the parameters, in SI units.

    Args:
        space: The parameters.
        z: Scaled values [-].
        spread: Their uncertainty.
        start: Scaled values before, if not the start of the parameters [-].
    """
    values = np.asarray(space.from_scaled(z))
    before = [parameter.start for parameter in space.parameters]
    if start is not None:
        before = list(np.asarray(space.from_scaled(start)))
    std = np.sqrt(np.diag(spread.covariance))
    estimates = []
    for i, parameter in enumerate(space.parameters):
        # dp = p dz on a log scale, S dz on a linear one.
        log = parameter.scale == "log"
        slope = values[i] if log else float(parameter.unit_step)
        estimates.append(
            ParameterEstimate(
                parameter.name,
                float(values[i]),
                float(slope * std[i]),
                float(before[i]),
                float(parameter.lower),
                float(parameter.upper),
                parameter.unit,
                bool(spread.at_bound[i]),
            )
        )
    return tuple(estimates)


def configuration_fits(
    model: Model,
    configurations: Sequence[Configuration],
    role: Literal["calibration", "validation"],
    before: Float[Array, "n_c n_rows 3"],
    after: Float[Array, "n_c n_rows 3"],
    solution: EquilibriumSolution,
    lanes: Sequence[int] | None = None,
) -> tuple[ConfigurationFit, ...]:
    """Measured and simulated effectors of configurations, with both sets of parameters.

    Args:
        model: The model with the calibrated parameters.
        configurations: The configurations of a batch.
        role: Fitted, or only predicted.
        before: Simulated effector coordinates with the start parameters.
        after: The same with the calibrated parameters.
        solution: Equilibria with the calibrated parameters.
        lanes: Which of them to report; all by default.

    Returns:
        One entry per configuration.
    """
    mesh, mechanism = model.mesh, model.mechanism
    rows = [effector_rows(mesh, c, mechanism) for c in configurations]
    rest = jnp.zeros((model.n_points, 3))
    arrays = configuration_arrays(mesh, configurations, mechanism)
    at_rest = _effectors_at(model, arrays.effectors, rest)
    states = robot_states(model, configurations, solution)
    fits = []
    for lane, (c, numbers) in enumerate(
        zip(configurations, row_numbers(rows), strict=True)
    ):
        if lanes is not None and lane not in lanes:
            continue
        named = rows[lane]
        points = [i for i, (_, row) in enumerate(named) if row.quantity == "point"]
        take = lambda e, which, lane=lane, n=numbers: np.asarray(e[lane])[
            [n[i] for i in which]
        ].reshape(-1, 3)
        own = [named[i].row for i in points]
        measured = np.array([row.measured for row in own]).reshape(-1, 3)
        seen = np.array([row.inverse_std > 0.0 for row in own]).reshape(-1, 3)
        first, last = take(before, points), take(after, points)
        others = tuple(
            _effector_fit(named[i], take(before, [i])[0], take(after, [i])[0])
            for i in range(len(named))
            if i not in points
        )
        fits.append(
            ConfigurationFit(
                c.name,
                role,
                tuple(named[i].name for i in points),
                measured,
                seen,
                take(at_rest, points),
                first,
                last,
                np.where(seen, first - measured, 0.0),
                np.where(seen, last - measured, 0.0),
                np.asarray(solution.displacement[lane])[: mesh.n_nodes],
                int(solution.steps[lane]),
                float(solution.residual[lane]),
                float(solution.min_det_F[lane]),
                others,
                states[lane],
            )
        )
    return tuple(fits)


@eqx.filter_jit
def _effectors_at(model: Model, effectors, u):
    """Effectors of all configurations at one displacement."""
    return jax.vmap(lambda e: effector_positions(model, e, u))(effectors)


def _effector_fit(named: NamedRow, before, after) -> EffectorFit:
    name, row = named
    seen = row.inverse_std > 0.0
    width = 3 if row.quantity in ("turn", "reaction") else 1
    cut = lambda value: np.asarray(value)[:width]
    return EffectorFit(
        name,
        row.unit,
        cut(row.measured),
        cut(before),
        cut(after),
        cut(np.where(seen, before - row.measured, 0.0)),
        cut(np.where(seen, after - row.measured, 0.0)),
        row.quantity == "turn",
        row.reference if row.quantity == "turn" else None,
    )
