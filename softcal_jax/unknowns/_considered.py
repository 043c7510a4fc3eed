"""What considered errors do to the rows of a calibration."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    InputRows,
    Linearisation,
    Program,
    Workers,
    effector_values,
    linearise,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import ErrorColumns
from softcal_jax.sensitivity import parameter_rows
from softcal_jax.unknowns._problem import Problem
from softcal_jax.unknowns._unknowns import MESH, Unknown, unknowns


def considered_errors(
    workers: Workers,
    problem: Problem,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
    without_forces: Sequence[tuple[list[int], Float[HostArray, "n_points 3"]]],
) -> ErrorColumns:
    """Compute W_c: change of the rows per standard deviation of each error.

    In stated standard deviations of the rows. A mesh can be too soft for weight and too
    stiff for pressure, and the sum would say that it is right. So what the forces of
    actuators add to its error is an error of its own, see `Evaluator.without_forces`.
    """
    arrays = problem.configurations
    weight = np.asarray(arrays.effectors.inverse_std)
    displacements = np.asarray(equilibrium.displacement)
    states = [*enumerate(zip(arrays, displacements, strict=True))]
    for (c, *_), u in without_forces:
        states.append((c, (arrays[c].without_forces(), u)))
    errors, (program, lanes) = _work(problem, z, states)
    columns = np.zeros((len(errors), len(states), weight[0].size))
    for k, of_state in enumerate(workers.map(program, lanes)):
        columns[:, k] = np.asarray(of_state).T
    columns, alone = np.split(columns, [len(weight)], axis=1)
    for k in [k for k, error in enumerate(errors) if error.cause == MESH]:
        added, scope = np.zeros(columns[k].shape), np.full(len(weight), None)
        for (poses, _), of_loads in zip(without_forces, alone[k], strict=True):
            if np.isfinite(of_loads).all():
                added[poses], scope[poses] = columns[k, poses] - of_loads, ""
        columns = np.concatenate([columns, added[None]])
        columns[k] -= added
        name = f"{errors[k].name} by actuation"
        errors = (*errors, errors[k]._replace(name=name, scope=tuple(scope)))
    for column, error in zip(columns, errors, strict=True):
        column *= 1.0 if error.row is None else error.prior
    return where_shared(errors, columns, problem.n_fitted, weight)


def where_shared(
    errors: Sequence[Unknown],
    columns: Float[HostArray, "n_columns n_c n_e"],
    n_fitted: int,
    weight: Float[HostArray, "n_c n_rows 3"],
) -> ErrorColumns:
    """Take columns as if every configuration had every error to where it occurs."""
    causes, names, changes = [], [], [np.zeros(weight.size)]
    for error, column in zip(errors, columns, strict=True):
        for name, sharing in error.groups(n_fitted):
            change = np.ravel(np.where(sharing[:, None], column, 0.0))
            changes.append(np.ravel(weight) * change)
            causes.append(error.cause)
            names.append(name)
    values = np.stack(changes, axis=1)[:, 1:]
    return ErrorColumns(values, tuple(causes), tuple(names))


def compile_considered(
    workers: Workers, problem: Problem, z: Float[Array, " n_p"]
) -> None:
    """Compile what `considered_errors` runs, while what comes before it still runs."""
    rest = np.zeros((problem.model.n_points, 3))
    workers.ahead(
        lambda: _work(problem, z, [(0, (problem.configurations[0], rest))])[1]
    )


def _work(
    problem: Problem,
    z: Float[Array, " n_p"],
    states: Sequence[
        tuple[int, tuple[ConfigurationArrays, Float[HostArray, "n_points 3"]]]
    ],
) -> tuple[tuple[Unknown, ...], tuple[Program, list[tuple]]]:
    """Return errors, and what runs as if the configuration of each state had all."""
    considered = [u for u in unknowns(problem) if u.role == "considered"]
    errors = tuple(u for u in considered if u.happens or u.row is None)
    if not any(error.happens for error in errors):
        errors = ()
    entries = tuple(error.entry for error in errors if error.entry is not None)
    space = ParameterSpace(entries) if entries else None
    rows = tuple(error.row for error in errors if error.row is not None)
    data = [error.data() for error in errors if error.row is not None]
    some = errors and problem.configurations.effectors.measured.size
    lanes = [
        (
            tuple(jax.device_put(of_pose[c]) for of_pose in data),
            z,
            lane,
            jax.device_put(u),
        )
        for c, (lane, u) in (states if some else ())
    ]
    shared = problem.model, problem.space.numbered, space, rows
    return errors, (Program(_of_pose, *shared), lanes)


@eqx.filter_jit
def _of_pose(
    model,
    space: ParameterSpace,
    errors: ParameterSpace | None,
    rows: tuple[Callable[[Linearisation, Any], InputRows], ...],
    data: tuple[Any, ...],
    z,
    c,
    u,
) -> Float[Array, "n_e n_rows"]:
    """Compute W_c of one configuration, in the units of its effectors; Eq. (9)."""
    lin = linearise(*space.apply(model, c, z), u)
    of_all = [] if errors is None else [parameter_rows(lin, errors, errors.start())]
    of_all += [row(lin, of_pose) for row, of_pose in zip(rows, data, strict=True)]
    stacked = jax.tree.map(lambda *parts: jnp.concatenate(parts), *of_all)
    fewer = len(stacked.force) > c.effectors.measured.size
    response = sensitivity(lin, stacked, effector_values, adjoint=fewer)
    return jnp.where(response.ok, response.W_ep, jnp.nan)
