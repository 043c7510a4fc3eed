"""What errors that are considered do to the rows of a calibration."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import one_line
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Program,
    Workers,
    effector_values,
    linearise,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace, unnamed
from softcal_jax.inference import ErrorColumns
from softcal_jax.sensitivity import clamp_row, parameter_rows, stiffness_row
from softcal_jax.unknowns._mesh_error import MeshErrors, mesh_errors
from softcal_jax.unknowns._unknowns import Setting, Unknown, unknowns

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_errors`."""


class ConsideredErrors(NamedTuple):
    """What is held fixed and may be wrong, and what it does to configurations.

    Attributes:
        errors: The errors, and which configurations share each.
        columns: Change of the effectors per standard deviation of each, as if each
            configuration had it.
        mesh: That by the mesh; None if this is right.
    """

    errors: tuple[Unknown, ...]
    columns: Float[HostArray, "n_errors n_c n_e"]
    mesh: MeshErrors | None

    __repr__ = one_line

    def in_std(
        self, n_fitted: int, weight: Float[HostArray, "n_c n_rows 3"]
    ) -> ErrorColumns:
        """Return W_c of all rows, in stated standard deviations.

        A change is zero in configurations that do not have the error. That of the mesh
        is left out where it is not known of a fitted configuration, which come first,
        and zero where it is not known of one that was held out.
        """
        parts: list[tuple[str, str, HostArray]] = []
        for error, column in zip(self.errors, self.columns, strict=True):
            for name, sharing in error.groups(n_fitted):
                shared = np.where(sharing[:, None], column, 0.0)
                parts.append((error.cause, name, shared))
        if self.mesh is not None and np.all(self.mesh.known[:n_fitted]):
            changes = np.where(self.mesh.known[:, None], self.mesh.changes, 0.0)
            parts.append((MESH, self.mesh.name, changes))
        changes = [np.ravel(weight) * np.ravel(change) for *_, change in parts]
        values = np.stack([np.zeros(weight.size), *changes], axis=1)[:, 1:]
        causes = tuple(cause for cause, *_ in parts)
        return ErrorColumns(values, causes, tuple(name for _, name, _ in parts))

    def unknown(self, n_fitted: int) -> tuple[str, ...]:
        """Return causes that count, but of unknown size: that of the mesh, or none."""
        missing = self.mesh is not None and not np.all(self.mesh.known[:n_fitted])
        return (MESH,) if missing else ()


def nothing_considered(setting: Setting) -> ConsideredErrors:
    """Count everything that is held fixed as right."""
    n_c = len(setting.configurations)
    n_e = setting.arrays.effectors.measured.size // n_c
    return ConsideredErrors((), np.zeros((0, n_c, n_e)), None)


def considered_errors(
    workers: Workers,
    setting: Setting,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
) -> ConsideredErrors:
    """Compute W_c: change of the effectors per standard deviation of each error."""
    of_mesh = setting.uncertain.mesh > 0
    errors = tuple(u for u in unknowns(setting) if u.role == "considered")
    if not of_mesh and not any(error.happens for error in errors):
        errors = ()
    u, forces = equilibrium.displacement, equilibrium.multipliers
    setting = setting._replace(space=unnamed(setting.space))
    columns = _all_columns(workers, setting, errors, z, u, of_stiffness=of_mesh)
    if not of_mesh:
        return ConsideredErrors(errors, columns, None)
    mesh = mesh_errors(setting, z, forces=forces, of_stiffness=columns[-1])
    mesh = mesh._replace(changes=setting.uncertain.mesh * mesh.changes)
    return ConsideredErrors(errors, columns[:-1], mesh)


def _all_columns(
    workers: Workers,
    setting: Setting,
    errors: Sequence[Unknown],
    z,
    displacement,
    *,
    of_stiffness: bool,
) -> Float[HostArray, "n_rows n_c n_e"]:
    """Compute W_c as if each configuration had each error, see `_columns`."""
    n_c, n_rows = len(displacement), len(errors) + of_stiffness
    n_e = setting.arrays.effectors.measured.size // n_c
    if n_e * n_rows == 0:
        return np.zeros((n_rows, n_c, n_e))
    entries = tuple(error.entry for error in errors if error.entry is not None)
    space = ParameterSpace(entries) if entries else None
    motions = [error.motions for error in errors if error.entry is None]
    lanes = [
        (
            tuple(jax.device_put(of_pose[c]) for of_pose in motions),
            z,
            lane_of(setting.arrays, c),
            lane_of(displacement, c),
        )
        for c in range(n_c)
    ]
    program = Program(_columns, setting.model, setting.space, space, of_stiffness)
    of_lanes = workers.map(program, lanes)
    return np.stack([np.asarray(own).T for own in of_lanes], axis=1)


@eqx.filter_jit
def _columns(
    model,
    space: ParameterSpace,
    errors: ParameterSpace | None,
    of_stiffness: bool,
    motions: tuple[Float[Array, "n_nodes 3"], ...],
    z,
    c,
    u,
) -> Float[Array, "n_e n_rows"]:
    """Compute W_c of one configuration, in the units of its effectors; Eq. (9).

    The last column is that of the stiffness where it is asked for, see `mesh_errors`.
    """
    lin = linearise(*space.apply(model, c, z), u)
    rows = [] if errors is None else [parameter_rows(lin, errors, errors.start())]
    rows += [clamp_row(lin, motion) for motion in motions]
    rows += [stiffness_row(lin)] if of_stiffness else []
    stacked = jax.tree.map(lambda *own: jnp.concatenate(own), *rows)
    fewer = len(stacked.force) > c.effectors.measured.size
    found = sensitivity(lin, stacked, effector_values, adjoint=fewer)
    return jnp.where(found.ok, found.W_ep, jnp.nan)
