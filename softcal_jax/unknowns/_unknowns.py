"""Every unknown of a calibration that is not fitted: considered, or part of the noise.

A considered error is held at its nominal value: fitted values move with it, and their
standard errors say by how much. An error that is part of the noise is marginalised: it
weighs the data, and takes the information along its direction out of the fit. Consider
what the data cannot tell from the parameters, like a load that is 1 % off in all poses;
marginalise what differs from one recording to the next, so that poses that disagree by
it do not pull at the values.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
)
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    InputRows,
    Linearisation,
    Model,
    Program,
    Workers,
    effector_values,
    linearise,
    sensitivity,
)
from softcal_jax.fields import (
    OFFSET,
    QUANTITIES,
    AbstractEntry,
    FieldError,
    ParameterSpace,
    Poses,
    Role,
    Scope,
    SetupError,
    SetupParameter,
    Uncertain,
    constants_of,
    find_field,
    grounded_bodies,
)
from softcal_jax.inference import ErrorColumns
from softcal_jax.mesh import TetMesh, boundary_faces
from softcal_jax.sensitivity import clamp_row, mesh_row, parameter_rows, stress_patches

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_row`."""


class Unknown(NamedTuple):
    """Something that is not known exactly.

    Attributes:
        cause: What it is called in the budget.
        name: Its name among those of the same cause.
        entry: What it sets, if that is an array of the model or of a configuration.
        prior: Its standard deviation, in SI units or relative.
        role: Whether it is considered or part of the noise.
        scope: For each configuration, a key that those with the same error have in
            common; None where the error cannot occur, or is fitted.
        row: Makes the row of one unit of it if no entry sets it, see `clamp_row`: from
            the linearised equilibrium and what `data` returns for the configuration.
    """

    cause: str
    name: str
    entry: AbstractEntry | None
    prior: float
    role: Role
    scope: Scope
    row: Callable[[Linearisation, Any], InputRows] | None = None
    data: Callable[[], tuple[Any, ...]] = tuple

    @property
    def happens(self) -> bool:
        """Whether any configuration has it."""
        return any(key is not None for key in self.scope)

    def groups(self, n_fitted: int) -> Iterator[tuple[str, Bool[HostArray, " n_c"]]]:
        """List its independent errors: name, and the configurations that share each.

        Names depend on the fitted configurations alone, which come first.
        """
        fitted = set(self.scope[:n_fitted]) - {None}
        keys = [key for key in dict.fromkeys(self.scope) if key is not None]
        for n, key in enumerate(keys, start=1):
            group = key if isinstance(key, str) else f"group {n}" * (len(fitted) > 1)
            name = f"{self.name} in {group}" if group else self.name
            yield name, np.array([other == key for other in self.scope])


class Setting(NamedTuple):
    """A model, its parameters, and configurations as described and as arrays."""

    model: Model
    space: ParameterSpace
    configurations: Sequence[Configuration]
    lanes: ConfigurationLanes
    uncertain: Uncertain

    @property
    def arrays(self) -> ConfigurationArrays:
        """The configurations as arrays."""
        return self.lanes.arrays


def unknowns(setting: Setting) -> tuple[Unknown, ...]:
    """List what may be wrong and has an entry or a row of its own.

    Creep and attachments, which are noise of the readings, are in `correlated_noise`.
    Errors that cannot occur in any configuration are listed, with no key in their
    scope: which entries are computed is part of a compiled program, so that one serves
    all poses.
    """
    return (
        *_of_fields(setting),
        *_of_setup(setting),
        _of_clamps(setting),
        _of_mesh(setting),
    )


def recording_names(configurations: Sequence[Configuration]) -> list[str]:
    """Return the name of the recording of each configuration."""
    return [c.recording or c.name for c in configurations]


def _of_setup(setting: Setting) -> Iterator[Unknown]:
    """List errors of the setup, the loads and the recordings that are not fitted."""
    on_host = jax.tree.map(np.asarray, setting.arrays)
    poses = Poses(setting.model, on_host, recording_names(setting.configurations))
    for kind, quantity in QUANTITIES.items():
        if quantity.role not in ("considered", "noise"):
            continue
        cause, role = quantity.uncertain, quantity.role
        is_estimated = cause in setting.uncertain.estimated
        std = OFFSET if is_estimated else getattr(setting.uncertain, cause)
        for of, scope in quantity.occurs(poses).items():
            for axis in quantity.components or ("",):
                name = " ".join(word for word in (kind, of, axis) if word)
                entry = SetupError(name=name, std=std, kind=kind, of=of, axis=axis)
                where = _where(scope, _not_fitted(setting, entry) & (std > 0.0))
                yield Unknown(cause, name, entry, std, role, where)


def _not_fitted(setting: Setting, error: SetupError) -> Bool[HostArray, " n_c"]:
    """Return in which configurations no parameter stands for this error."""
    free = np.ones(len(setting.configurations), bool)
    for entry in setting.space.entries:
        if not isinstance(entry, SetupParameter):
            continue
        if (entry.kind, entry.of, entry.axis) == (error.kind, error.of, error.axis):
            members = [entry.member(c) for c in setting.configurations]
            free &= [bool(entry.each) and name not in entry.each for name in members]
    return free


def _where(scope: Scope, flags: Bool[HostArray, " n_c"]) -> Scope:
    """Return keys where a flag of the configuration is set, None elsewhere."""
    return tuple(key if flag else None for key, flag in zip(scope, flags, strict=True))


def _of_fields(setting: Setting) -> Iterator[Unknown]:
    """List errors of constants that have one, see `ConstantKind`."""
    model, arrays = setting.model, setting.arrays
    for path, kind in constants_of(model):
        if not kind.uncertain:
            continue
        name = path.rpartition(".")[2]
        value = np.asarray(find_field(model, path)(model))
        share = _share_not_fitted(setting, name)
        room = 0.5 * (kind.most - float(np.max(value)))
        std = min(getattr(setting.uncertain, kind.uncertain), room)
        entry = FieldError(name, std, path, jax.device_put(share), kind.relative)
        matters = np.any(share * value if kind.relative else share) and std > 0.0
        acts = np.full(len(setting.configurations), matters)
        if kind.acts_by:
            acts &= np.any(np.asarray(getattr(arrays, kind.acts_by)), axis=1)
        scope = _where(("",) * len(acts), acts)
        yield Unknown(name, name, entry, std, "considered", scope)


def _share_not_fitted(setting: Setting, field: str) -> HostArray:
    """Return 1 for each tet in which no parameter sets a field, 0 for the others."""
    mesh = setting.model.mesh
    share = np.ones(setting.model.n_tets)
    for entry in setting.space.entries:
        if any(name.rpartition(".")[2] == field for name in entry.fields):
            group = entry.tet_group
            share[slice(None) if group is None else mesh.tets_of(group)] = 0
    return share


def _of_clamps(setting: Setting) -> Unknown:
    """Return the error of the depth of clamps, one for all that hold the same nodes."""
    model, std = setting.model, setting.uncertain.clamp
    held = held_nodes(model, setting.arrays)
    keys = tuple(nodes.tobytes() for nodes in held)
    groups = dict(zip(keys, held, strict=True))
    motion = {key: outward_motion(model.mesh, nodes) for key, nodes in groups.items()}
    motions = tuple(motion[key] for key in keys)
    scope = _where(keys, np.any(motions, axis=(1, 2)) & (std > 0.0))
    error = "clamp", "clamp", None, std, "considered", scope
    return Unknown(*error, clamp_row, lambda: motions)


def _of_mesh(setting: Setting) -> Unknown:
    """Return the error of the mesh; a mesh of which no tet deforms has none."""
    model, std = setting.model, setting.uncertain.mesh
    n, name = len(setting.configurations), "refinement"
    if model.mesh.order == 1:
        name = "locking"
    scope = _where(("",) * n, np.full(n, std > 0.0 and np.any(model.active)))
    error = MESH, name, None, std, "considered", scope
    return Unknown(*error, mesh_row, lambda: (stress_patches(model),) * n)


def held_nodes(
    model: Model, configurations: ConfigurationArrays
) -> Bool[HostArray, "n_c n_nodes"]:
    """Flag the nodes that cannot move, or only with a grounded body."""
    bodies, n_nodes = model.mechanism.bodies, model.mesh.n_nodes
    held = np.array(np.asarray(configurations.fixed)[:, :n_nodes].all(axis=2))
    poses = Poses(model, jax.tree.map(np.asarray, configurations), ())
    held[:, bodies.attached] |= grounded_bodies(poses)[:, bodies.body]
    return held


def outward_motion(
    mesh: TetMesh, held: Bool[HostArray, " n_nodes"]
) -> Float[HostArray, "n_nodes 3"]:
    """Compute unit normals of the faces at which the deforming part is held [-].

    They point out of it, into the clamp. Nodes in the middle of an edge get the mean of
    its ends, so that edges stay straight; all others get zero.
    """
    motion = np.zeros((mesh.n_nodes, 3))
    deforming = ~held[mesh.tets].all(axis=1)
    if not np.any(held) or not np.any(deforming):
        return motion
    part = TetMesh(mesh.points, mesh.tets[deforming])
    faces = boundary_faces(part)
    corners = faces[held[faces].all(axis=1)][:, :3]
    a, b, c = np.moveaxis(mesh.points[corners], 1, 0)
    np.add.at(motion, corners, np.cross(b - a, c - a)[:, None])
    size = np.linalg.norm(motion, axis=1, keepdims=True)
    motion = np.divide(motion, size, out=motion, where=size > 0.0)
    if mesh.order == 2:
        ends = mesh.tets[:, np.array(TET_EDGES)]
        motion[mesh.tets[:, 4:]] = motion[ends].mean(axis=2)
    return motion


def considered_errors(
    workers: Workers,
    setting: Setting,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
    n_fitted: int,
) -> ErrorColumns:
    """Compute W_c: change of the rows per standard deviation of each error.

    In stated standard deviations of the rows; the first `n_fitted` configurations were
    fitted.
    """
    weight = np.asarray(setting.arrays.effectors.inverse_std)
    work = _work(setting, z, equilibrium.displacement)
    columns = np.zeros((len(work.errors), len(weight), weight[0].size))
    for c, of_pose in enumerate(workers.map(work.program, work.lanes)):
        columns[:, c] = np.asarray(of_pose).T
    for column, error in zip(columns, work.errors, strict=True):
        column *= 1.0 if error.row is None else error.prior
    return where_shared(work.errors, columns, n_fitted, weight)


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
    workers: Workers, setting: Setting, z: Float[Array, " n_p"]
) -> None:
    """Compile what `considered_errors` runs, while what comes before it still runs."""
    rest = np.zeros((len(setting.configurations), setting.model.n_points, 3))
    workers.ahead(lambda: _work(setting, z, rest)[1:])


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
