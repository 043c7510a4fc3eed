"""The errors of a calibration that are considered, and what each does to its rows."""

from collections.abc import Hashable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._held_faces import grounded, held_nodes, outward_motion
from softcal_jax.calibration._lanes import lane_of
from softcal_jax.calibration._mesh_error import MeshErrors, mesh_errors
from softcal_jax.calibration._noise import not_calibrated
from softcal_jax.calibration._present import with_forces, with_gravity, with_loads
from softcal_jax.calibration._problem import CalibrationProblem, without_names
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    Program,
    Workers,
    effector_values,
    linearise,
    sensitivity,
)
from softcal_jax.fields import (
    QUANTITIES,
    AbstractError,
    FieldError,
    ParameterSpace,
    SetupError,
    Uncertain,
)
from softcal_jax.inference import ErrorColumns
from softcal_jax.materials import is_point_values
from softcal_jax.sensitivity import clamp_row, parameter_rows, stiffness_row

INCOMPRESSIBLE = 0.5
"""Largest Poisson's ratio [-]."""

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_errors`."""


class Considered(NamedTuple):
    """An error that is considered.

    Attributes:
        cause: What it is called in the budget.
        name: Its own name.
        entry: What it sets; None for the depth of clamps.
        shared: For each configuration, a key that those with the same error have in
            common; None where it is calibrated, or cannot occur.
        motions: For clamps, motion of the reference points in each configuration, see
            `clamp_row` [m]; empty for other errors.
    """

    cause: str
    name: str
    entry: AbstractError | None
    shared: tuple[Hashable, ...]
    motions: tuple[HostArray, ...] = ()

    @property
    def happens(self) -> bool:
        """Whether any configuration has it."""
        return any(key is not None for key in self.shared)

    def groups(self, n_fitted: int) -> Iterator[tuple[str, Bool[HostArray, " n_c"]]]:
        """List its independent errors: their names, and which configurations share.

        Args:
            n_fitted: Number of configurations that are fitted, which come first; names
                do not depend on the others.
        """
        fitted = set(self.shared[:n_fitted]) - {None}
        keys = [key for key in dict.fromkeys(self.shared) if key is not None]
        for n, key in enumerate(keys, start=1):
            group = key if isinstance(key, str) else f"group {n}" * (len(fitted) > 1)
            name = f"{self.name} in {group}" if group else self.name
            yield name, np.array([other == key for other in self.shared])


def considered(
    uncertain: Uncertain,
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
) -> tuple[Considered, ...]:
    """List the errors that a calibration may have and does not calibrate.

    Those that cannot occur in any configuration are among them, shared by none: which
    errors are computed is part of a compiled program, and so one serves all poses.

    Args:
        uncertain: Their standard deviations.
        problem: The calibration.
        configurations: Its configurations.
    """
    posed = _Posed(problem, configurations)
    found = [
        own._replace(shared=_uncalibrated(own, posed))
        for kind in (_fields, _loads, _supports, _mechanism, _clamps)
        for own in kind(uncertain, posed)
    ]
    return tuple(found)


class _Posed:
    """A calibration as the lists below ask for it."""

    def __init__(self, problem: CalibrationProblem, configurations):
        self.model, self.space = problem.model, problem.space
        self.arrays = jax.tree.map(np.asarray, problem.configurations)
        self.configurations = tuple(configurations)
        self.everywhere: tuple[Hashable, ...] = ("",) * len(self.configurations)

    def where(self, keys: Sequence[Hashable], there: Any) -> tuple[Hashable, ...]:
        """Return keys where a flag of the configuration is set, None elsewhere."""
        return tuple(k if t else None for k, t in zip(keys, there, strict=True))


def _fields(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of Poisson's ratios, and of the density where there is gravity."""
    model = posed.model
    for field, value in _ratios(model):
        name = field.rpartition(".")[2]
        share = _not_calibrated(posed, name)
        room = 0.5 * (INCOMPRESSIBLE - float(np.max(value)))
        entry = FieldError(name, min(uncertain.nu, room), field, jax.device_put(share))
        open_ = [bool(np.any(share))] * len(posed.configurations)
        yield _same(name, entry, posed.where(posed.everywhere, open_))
    share = _not_calibrated(posed, "density")
    heavy = bool(np.any(share * np.asarray(model.density) > 0.0))
    entry = FieldError(
        "density", uncertain.density, "density", jax.device_put(share), relative=True
    )
    falls = heavy & np.any(posed.arrays.gravity, axis=1)
    yield _same("density", entry, posed.where(posed.everywhere, falls))


def _ratios(model: Model) -> Iterator[tuple[str, HostArray]]:
    """List the Poisson's ratios of the law: path and values."""
    leaves = jax.tree_util.tree_leaves_with_path(model.law, is_leaf=is_point_values)
    for path, leaf in leaves:
        field = "law" + jax.tree_util.keystr(path)
        if (field.rpartition(".")[2] + "_").startswith("nu_"):
            yield field, np.asarray(leaf.values if is_point_values(leaf) else leaf)


def _not_calibrated(posed: _Posed, field: str) -> HostArray:
    """Return 1 for each tet in which no parameter sets a field, 0 for the others."""
    share = np.ones(posed.model.n_tets)
    for entry in posed.space.entries:
        if any(name.rpartition(".")[2] == field for name in entry.fields):
            group = entry.tet_group
            share[slice(None) if group is None else posed.model.mesh.tets_of(group)] = 0
    return share


def _loads(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of gravity, dead loads and imposed forces."""
    arrays = posed.arrays
    gravities = [tuple(g) for g in arrays.gravity]
    keys = posed.where(gravities, with_gravity(arrays))
    for axis in QUANTITIES["gravity_tilt"].components:
        yield _of_setup("gravity_tilt", uncertain, axis=axis, keys=keys)
    for name, there in zip(arrays.loads.names, with_loads(arrays).T, strict=True):
        keys = posed.where(posed.everywhere, there)
        yield _of_setup("load_factor", uncertain, name, keys=keys)
    for name, there in zip(arrays.actuation.names, with_forces(arrays).T, strict=True):
        keys = posed.where(posed.everywhere, there)
        yield _of_setup("actuator_factor", uncertain, name, keys=keys)


def _supports(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of elastic supports."""
    springs = posed.arrays.springs
    for name, stiffness in zip(springs.names, springs.stiffness.T, strict=True):
        keys = posed.where(posed.everywhere, stiffness > 0.0)
        yield _of_setup("clamp_stiffness", uncertain, name, keys=keys)


def _clamps(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List the error of the depth of clamps."""
    held = held_nodes(posed.model, posed.arrays)
    keys = [nodes.tobytes() for nodes in held]
    of_key = {
        key: uncertain.clamp * outward_motion(posed.model.mesh, nodes)
        for key, nodes in zip(keys, held, strict=True)
    }
    motions = tuple(of_key[key] for key in keys)
    shared = posed.where(keys, [bool(np.any(motion)) for motion in motions])
    yield Considered("clamp", "clamp", None, shared, motions)


def _mechanism(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of motors driven by their angle, and of mounted bodies."""
    mechanism, arrays = posed.model.mechanism, posed.arrays
    actuators, bodies = mechanism.actuators, mechanism.bodies
    by_angle = arrays.actuation.by_displacement.T
    for name, body, there in zip(
        actuators.names, actuators.motor_body, by_angle, strict=True
    ):
        if body >= 0:
            keys = posed.where(posed.everywhere, there)
            yield _of_setup("motor_zero", uncertain, name, keys=keys)
    held = grounded(posed.model, arrays).T
    for name, there in zip(bodies.names, held, strict=True):
        keys = posed.where(posed.everywhere, there)
        for axis in QUANTITIES["mounting"].components:
            yield _of_setup("mounting", uncertain, name, axis=axis, keys=keys)


def _same(cause: str, entry: AbstractError, shared: tuple[Hashable, ...]) -> Considered:
    """Return an error, with keys of the configurations where it is not zero."""
    none = (None,) * len(shared)
    return Considered(cause, entry.name, entry, shared if entry.std > 0.0 else none)


def _of_setup(
    kind: str,
    uncertain: Uncertain,
    of: str = "",
    *,
    axis: str = "",
    keys: tuple[Hashable, ...],
) -> Considered:
    """Return an error of the setup; its name says whose it is."""
    cause = QUANTITIES[kind].uncertain
    name = " ".join(word for word in (kind, of, axis) if word)
    entry = SetupError(name, getattr(uncertain, cause), kind, of, axis)
    return _same(cause, entry, keys)


def _uncalibrated(own: Considered, posed: _Posed) -> tuple[Hashable, ...]:
    """Return the keys of an error, None where a parameter of the fit is the same."""
    entry = own.entry
    if not isinstance(entry, SetupError):
        return own.shared
    free = not_calibrated(
        posed.space, posed.configurations, entry.kind, of=entry.of, axis=entry.axis
    )
    return posed.where(own.shared, free)


class ConsideredErrors(NamedTuple):
    """What is held fixed and may be wrong, and what it does to configurations.

    Attributes:
        errors: The errors, and which configurations share each.
        columns: Change of the effectors per standard deviation of each, as if each
            configuration had it.
        mesh: That by the mesh; None if this is right.
    """

    errors: tuple[Considered, ...]
    columns: Float[HostArray, "n_errors n_c n_e"]
    mesh: MeshErrors | None

    def in_std(
        self, n_fitted: int, weight: Float[HostArray, "n_c n_rows 3"]
    ) -> ErrorColumns:
        """Return W_c of all rows, in stated standard deviations.

        A change is zero in configurations that do not have the error. The error of the
        mesh is not among them where it is not known of a fitted configuration, and zero
        in one that was held out.

        Args:
            n_fitted: Number of configurations that are fitted, which come first.
            weight: 1 / stated standard deviations, 0 where nothing is measured.
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


def considered_errors(
    workers: Workers,
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    uncertain: Uncertain,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
) -> ConsideredErrors:
    """Compute W_c: change of the effectors per standard deviation of each error.

    Args:
        workers: Run the configurations.
        problem: The calibration.
        configurations: Its configurations.
        uncertain: What is uncertain.
        z: Scaled parameters [-].
        equilibrium: The equilibria, one lane per configuration.
    """
    found, of_mesh = considered(uncertain, problem, configurations), uncertain.mesh > 0
    problem = without_names(problem)
    if not of_mesh and not any(own.happens for own in found):
        found = ()
    columns = _all_columns(
        workers, problem, found, z, equilibrium.displacement, of_stiffness=of_mesh
    )
    if not of_mesh:
        return ConsideredErrors(found, columns, None)
    mesh = mesh_errors(
        problem,
        configurations,
        z,
        forces=equilibrium.multipliers,
        of_stiffness=columns[-1],
    )
    mesh = mesh._replace(changes=uncertain.mesh * mesh.changes)
    return ConsideredErrors(found, columns[:-1], mesh)


def _all_columns(
    workers: Workers,
    problem: CalibrationProblem,
    found: Sequence[Considered],
    z,
    displacement,
    *,
    of_stiffness: bool,
) -> Float[HostArray, "n_rows n_c n_e"]:
    """Compute W_c as if each configuration had each error, see `_columns`."""
    n_c, n_rows = len(displacement), len(found) + of_stiffness
    n_e = problem.configurations.effectors.measured.size // n_c
    if n_e * n_rows == 0:
        return np.zeros((n_rows, n_c, n_e))
    entries = tuple(own.entry for own in found if own.entry is not None)
    errors = ParameterSpace(entries) if entries else None
    motions = [own.motions for own in found if own.entry is None]
    lanes = [
        (
            tuple(jax.device_put(own[c]) for own in motions),
            z,
            lane_of(problem.configurations, c),
            lane_of(displacement, c),
        )
        for c in range(n_c)
    ]
    program = Program(_columns, problem.model, problem.space, errors, of_stiffness)
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
