"""What errors that are considered do to the rows of a calibration."""

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
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import ErrorColumns
from softcal_jax.mesh import Recovery
from softcal_jax.sensitivity import clamp_row, mesh_row, parameter_rows, stress_patches
from softcal_jax.unknowns._unknowns import Setting, Unknown, unknowns

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_row`."""


class ConsideredErrors(NamedTuple):
    """What is held fixed and may be wrong, and what it does to configurations.

    Attributes:
        errors: The errors, and which configurations share each.
        columns: Change of the effectors per standard deviation of each, as if each
            configuration had it; last that by the mesh, if this may be wrong.
        mesh: Name of the error of the mesh, see `REMEDIES`; None if this is right.
    """

    errors: tuple[Unknown, ...]
    columns: Float[HostArray, "n_columns n_c n_e"]
    mesh: str | None

    __repr__ = one_line

    def in_std(
        self, n_fitted: int, weight: Float[HostArray, "n_c n_rows 3"]
    ) -> ErrorColumns:
        """Return W_c of all rows, in stated standard deviations.

        A change is zero in configurations that do not have the error; fitted ones come
        first.
        """
        parts: list[tuple[str, str, HostArray]] = []
        of_errors = self.columns[: len(self.errors)]
        for error, column in zip(self.errors, of_errors, strict=True):
            for name, sharing in error.groups(n_fitted):
                shared = np.where(sharing[:, None], column, 0.0)
                parts.append((error.cause, name, shared))
        if self.mesh is not None:
            parts.append((MESH, self.mesh, self.columns[-1]))
        changes = [np.ravel(weight) * np.ravel(change) for *_, change in parts]
        values = np.stack([np.zeros(weight.size), *changes], axis=1)[:, 1:]
        causes = tuple(cause for cause, *_ in parts)
        return ErrorColumns(values, causes, tuple(name for _, name, _ in parts))


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
    work = _work(setting, z, equilibrium.displacement)
    n_c, n_rows = len(setting.configurations), len(work.errors) + work.of_mesh
    columns = np.zeros((n_rows, n_c, setting.arrays.effectors.measured.size // n_c))
    for c, of_pose in enumerate(workers.map(work.program, work.lanes)):
        columns[:, c] = np.asarray(of_pose).T
    if not work.of_mesh:
        return ConsideredErrors(work.errors, columns, None)
    columns[-1] *= setting.uncertain.mesh
    name = "locking" if setting.model.mesh.order == 1 else "refinement"
    return ConsideredErrors(work.errors, columns, name)


def compile_considered(
    workers: Workers, setting: Setting, z: Float[Array, " n_p"]
) -> None:
    """Compile what `considered_errors` runs, beside what runs before it."""

    def program() -> tuple[Program, list[tuple]]:
        n_c, n_points = len(setting.configurations), setting.model.n_points
        work = _work(setting, z, jnp.zeros((n_c, n_points, 3)))
        return work.program, work.lanes

    workers.ahead(program)


class _Work(NamedTuple):
    """What is computed of each configuration, as if it had each error."""

    errors: tuple[Unknown, ...]
    of_mesh: bool
    program: Program
    lanes: list[tuple]


def _work(setting: Setting, z, displacement) -> _Work:
    # Nothing is wrong with a mesh of which no tet deforms.
    of_mesh = setting.uncertain.mesh > 0 and bool(np.any(setting.model.active))
    errors = tuple(u for u in unknowns(setting) if u.role == "considered")
    if not of_mesh and not any(error.happens for error in errors):
        errors = ()
    patches = stress_patches(setting.model) if of_mesh else None
    entries = tuple(error.entry for error in errors if error.entry is not None)
    space = ParameterSpace(entries) if entries else None
    motions = [error.motions for error in errors if error.entry is None]
    some = (errors or of_mesh) and setting.arrays.effectors.measured.size
    lanes = [
        (
            tuple(jax.device_put(of_pose[c]) for of_pose in motions),
            z,
            lane_of(setting.arrays, c),
            lane_of(displacement, c),
        )
        for c in range(len(displacement) if some else 0)
    ]
    shared = setting.model, setting.space.numbered, space, patches
    return _Work(errors, of_mesh, Program(_of_pose, *shared), lanes)


@eqx.filter_jit
def _of_pose(
    model,
    space: ParameterSpace,
    errors: ParameterSpace | None,
    patches: Recovery | None,
    motions: tuple[Float[Array, "n_nodes 3"], ...],
    z,
    c,
    u,
) -> Float[Array, "n_e n_rows"]:
    """Compute W_c of one configuration, in the units of its effectors; Eq. (9)."""
    lin = linearise(*space.apply(model, c, z), u)
    rows = [] if errors is None else [parameter_rows(lin, errors, errors.start())]
    rows += [clamp_row(lin, motion) for motion in motions]
    rows += [mesh_row(lin, patches)] if patches is not None else []
    stacked = jax.tree.map(lambda *own: jnp.concatenate(own), *rows)
    fewer = len(stacked.force) > c.effectors.measured.size
    found = sensitivity(lin, stacked, effector_values, adjoint=fewer)
    return jnp.where(found.ok, found.W_ep, jnp.nan)
