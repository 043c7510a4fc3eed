"""What considered errors do to the rows of a calibration."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._typing import Array, Float, HostArray
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
from softcal_jax.unknowns._unknowns import Setting, Unknown, unknowns


class ConsideredErrors(NamedTuple):
    """What is held fixed and may be wrong, and what it does to configurations.

    Attributes:
        errors: The errors, and which configurations share each.
        columns: Change of the effectors per standard deviation of each error, as if
            every configuration had it.
    """

    errors: tuple[Unknown, ...]
    columns: Float[HostArray, "n_columns n_c n_e"]

    def in_std(
        self, n_fitted: int, weight: Float[HostArray, "n_c n_rows 3"]
    ) -> ErrorColumns:
        """Return W_c of all rows, in stated standard deviations.

        A change is zero in configurations that do not have the error. The first
        `n_fitted` configurations were fitted.
        """
        parts: list[tuple[str, str, HostArray]] = []
        for error, column in zip(self.errors, self.columns, strict=True):
            for name, sharing in error.groups(n_fitted):
                shared = np.where(sharing[:, None], column, 0.0)
                parts.append((error.cause, name, shared))
        changes = [np.ravel(weight) * np.ravel(change) for *_, change in parts]
        values = np.stack([np.zeros(weight.size), *changes], axis=1)[:, 1:]
        causes = tuple(cause for cause, *_ in parts)
        return ErrorColumns(values, causes, tuple(name for _, name, _ in parts))


def nothing_considered(setting: Setting) -> ConsideredErrors:
    """Return no errors: everything that is held fixed counts as right."""
    n_c = len(setting.configurations)
    n_e = setting.arrays.effectors.measured.size // n_c
    return ConsideredErrors((), np.zeros((0, n_c, n_e)))


def considered_errors(
    workers: Workers,
    setting: Setting,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
) -> ConsideredErrors:
    """Compute W_c: change of the effectors per standard deviation of each error."""
    work = _work(setting, z, equilibrium.displacement)
    n_c = len(setting.configurations)
    n_e = setting.arrays.effectors.measured.size // n_c
    columns = np.zeros((len(work.errors), n_c, n_e))
    for c, of_pose in enumerate(workers.map(work.program, work.lanes)):
        columns[:, c] = np.asarray(of_pose).T
    for column, error in zip(columns, work.errors, strict=True):
        column *= 1.0 if error.row is None else error.prior
    return ConsideredErrors(work.errors, columns)


def compile_considered(
    workers: Workers, setting: Setting, z: Float[Array, " n_p"]
) -> None:
    """Compile what `considered_errors` runs, while what comes before it still runs."""

    def program() -> tuple[Program, list[tuple]]:
        n_c, n_points = len(setting.configurations), setting.model.n_points
        work = _work(setting, z, jnp.zeros((n_c, n_points, 3)))
        return work.program, work.lanes

    workers.ahead(program)


class _Work(NamedTuple):
    """A program that runs for each configuration, as if it had every error."""

    errors: tuple[Unknown, ...]
    program: Program
    lanes: list[tuple]


def _work(setting: Setting, z, displacement) -> _Work:
    considered = [u for u in unknowns(setting) if u.role == "considered"]
    errors = tuple(u for u in considered if u.happens or u.row is None)
    if not any(error.happens for error in errors):
        errors = ()
    entries = tuple(error.entry for error in errors if error.entry is not None)
    space = ParameterSpace(entries) if entries else None
    rows = tuple(error.row for error in errors if error.row is not None)
    data = [error.data() for error in errors if error.row is not None]
    some = errors and setting.arrays.effectors.measured.size
    lanes = [
        (
            tuple(jax.device_put(of_pose[c]) for of_pose in data),
            z,
            lane_of(setting.arrays, c),
            lane_of(displacement, c),
        )
        for c in range(len(displacement) if some else 0)
    ]
    shared = setting.model, setting.space.numbered, space, rows
    return _Work(errors, Program(_of_pose, *shared), lanes)


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
