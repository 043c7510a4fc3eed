"""What is not known exactly and not fitted, once: considered, or part of the noise.

A considered error is held at its nominal value: fitted values move with it, and their
standard errors say by how much. An error that is part of the noise is marginalised: it
weighs the data, and takes the information along its direction out of the fit. Consider
what the data cannot tell from the parameters, like a load that is 1 % off in all poses;
marginalise what differs from one recording to the next, so that poses that disagree by
it do not pull at the values.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.configurations import (
    ConfigurationArrays,
    earlier_lanes,
    following_each_other,
    in_order,
)
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
    KINDS,
    AbstractEntry,
    FieldError,
    ParameterSpace,
    Scope,
    SetupError,
    SetupParameter,
    constants_of,
    find_field,
    grounded_bodies,
    region_tets,
)
from softcal_jax.inference import ErrorColumns
from softcal_jax.materials import UNREMARKABLE
from softcal_jax.mesh import TetMesh, boundary_faces, straightened
from softcal_jax.sensitivity import (
    clamp_row,
    following_rows,
    mesh_row,
    parameter_rows,
    stress_patches,
)
from softcal_jax.unknowns._noise import (
    CorrelatedNoise,
    attachments,
    recording_names,
)
from softcal_jax.unknowns._problem import Problem

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_row`."""

FIRST_SHARE = 0.02
"""Share of the motion to begin with, where it is to be estimated [-]."""


class Unknown(NamedTuple):
    """Something that is not known exactly, and not fitted.

    Attributes:
        cause: What it is called in the budget.
        name: Its name among those of the same cause.
        entry: What it sets, if that is an array of the model or of a configuration.
        prior: Its standard deviation, in SI units or relative.
        role: Whether it is considered or part of the noise.
        scope: For each configuration, a key that those with the same error have in
            common; None where the error cannot occur, or a parameter stands for it.
        row: Makes the row of one unit of it if no entry sets it, see `clamp_row`: from
            the linearised equilibrium and what `data` returns for the configuration.
    """

    cause: str
    name: str
    entry: AbstractEntry | None
    prior: float
    role: Literal["considered", "noise"]
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


def unknowns(problem: Problem) -> tuple[Unknown, ...]:
    """List all unknowns of a calibration that are not fitted.

    They include errors that cannot occur in any configuration, with no key in their
    scope: which entries are computed is part of a compiled program, so that one serves
    all poses.
    """
    return (
        *_of_fields(problem),
        *_of_setup(problem),
        _of_clamps(problem),
        _of_mesh(problem),
    )


def _of_setup(problem: Problem) -> Iterator[Unknown]:
    """List errors of the setup, the loads and the recordings that are not fitted."""
    on_host = jax.tree.map(np.asarray, problem.configurations)
    recordings = recording_names(problem.poses)
    for name, kind in KINDS.items():
        cause, role = kind.uncertain, "noise" if kind.is_noise else "considered"
        stated = vars(problem.uncertain).get(cause, 0.0)
        std = kind.std if stated == "estimated" else stated
        for of, scope in kind.occurs(problem.model, on_host, recordings).items():
            for axis in kind.components or ("",):
                label = " ".join(word for word in (name, of, axis) if word)
                entry = SetupError(label, std, name, of, axis)
                where = _where(scope, _not_fitted(problem, entry) & (std > 0.0))
                yield Unknown(cause, label, entry, std, role, where)


def _not_fitted(problem: Problem, error: SetupError) -> Bool[HostArray, " n_c"]:
    """Return in which configurations no parameter stands for this error."""
    free = np.ones(len(problem.poses), bool)
    for entry in problem.space.entries:
        if not isinstance(entry, SetupParameter):
            continue
        if (entry.kind, entry.of, entry.axis) == (error.kind, error.of, error.axis):
            members = [entry.member(c) for c in problem.poses]
            free &= [bool(entry.each) and name not in entry.each for name in members]
    return free


def _where(scope: Scope, flags: Bool[HostArray, " n_c"]) -> Scope:
    """Return keys where a flag of the configuration is set, None elsewhere."""
    return tuple(key if flag else None for key, flag in zip(scope, flags, strict=True))


def _of_fields(problem: Problem) -> Iterator[Unknown]:
    """List errors of constants that have one, see `ConstantKind`."""
    model, arrays = problem.model, problem.configurations
    for path, leaf, declared in constants_of(model):
        kind = declared.get("kind", UNREMARKABLE)
        if not kind.uncertain:
            continue
        name, value = path.rpartition(".")[2], np.asarray(leaf)
        share = _share_not_fitted(problem, path)
        room = 0.5 * (kind.most - float(np.max(value)))
        std = min(getattr(problem.uncertain, kind.uncertain), room)
        entry = FieldError(name, std, path, jax.device_put(share), kind.relative)
        matters = np.any(share * value if kind.relative else share) and std > 0.0
        acts = np.full(len(problem.poses), matters)
        if kind.acts_by:
            acts &= np.any(np.asarray(getattr(arrays, kind.acts_by)), axis=1)
        scope = _where(("",) * len(acts), acts)
        yield Unknown(name, name, entry, std, "considered", scope)


def _share_not_fitted(problem: Problem, path: str) -> HostArray:
    """Return 1 for each tet in which no parameter sets a field, 0 for the others."""
    model, share = problem.model, np.ones(problem.model.n_tets)
    for entry in problem.space.entries:
        if any(find_field(model, name).path == path for name in entry.fields):
            share[region_tets(model.mesh, entry.tet_group)] = 0
    return share


def _of_clamps(problem: Problem) -> Unknown:
    """Return the error of the depth of clamps, one for all that hold the same nodes."""
    model, std = problem.model, problem.uncertain.clamp
    held = held_nodes(model, problem.configurations)
    keys = tuple(nodes.tobytes() for nodes in held)
    groups = dict(zip(keys, held, strict=True))
    motion = {key: outward_motion(model.mesh, nodes) for key, nodes in groups.items()}
    motions = tuple(motion[key] for key in keys)
    scope = _where(keys, np.any(motions, axis=(1, 2)) & (std > 0.0))
    error = "clamp", "clamp", None, std, "considered", scope
    return Unknown(*error, clamp_row, lambda: motions)


def _of_mesh(problem: Problem) -> Unknown:
    """Return the error of the mesh; a mesh of which no tet deforms has none."""
    model, std = problem.model, problem.uncertain.mesh
    n = len(problem.poses)
    name = "locking" if model.mesh.order == 1 else "refinement"
    scope = _where(
        ("",) * n, np.full(n, std > 0.0 and np.any(np.asarray(model.active)))
    )
    error = MESH, name, None, std, "considered", scope
    return Unknown(*error, mesh_row, lambda: (stress_patches(model),) * n)


def held_nodes(
    model: Model, configurations: ConfigurationArrays
) -> Bool[HostArray, "n_c n_nodes"]:
    """Flag the nodes that cannot move, or only with a grounded body."""
    bodies, n_nodes = model.mechanism.bodies, model.mesh.n_nodes
    held = np.array(np.asarray(configurations.fixed)[:, :n_nodes].all(axis=2))
    on_host = jax.tree.map(np.asarray, configurations)
    held[:, bodies.attached] |= grounded_bodies(model, on_host)[:, bodies.body]
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
    return straightened(mesh, motion)


def correlated_noise(problem: Problem) -> CorrelatedNoise:
    """Collect what is part of the noise of the poses, as arrays.

    What is to be estimated has its first value.
    """
    effectors, records = problem.configurations.effectors, problem.records
    names = recording_names(problem.poses)
    offset = [
        [0.0 if key is None else unknown.prior for key in unknown.scope]
        for unknown in _of_setup(problem)
        if unknown.role == "noise"
    ]
    shares = [pose.relative_std for pose in problem.poses]
    shares = [FIRST_SHARE if share == "estimated" else share for share in shares]
    dtype = np.asarray(effectors.inverse_std).dtype
    n_rows = np.shape(effectors.measured)[1]
    attached = attachments(problem.poses, records, n_rows)
    # Minus the error of a point at rest: 0 for coordinates that were not measured.
    motion = np.zeros((len(names), n_rows, 3), dtype)
    for lane, of_pose in enumerate(records):
        for e in of_pose:
            if e.quantity == "point":
                motion[lane, e.index] = -np.nan_to_num(e.error(e.at_rest))
    noise = CorrelatedNoise(
        recording=np.array([names.index(name) for name in names], np.int32),
        offset=np.asarray(np.transpose(offset), dtype),
        motion=motion,
        share=np.asarray(shares, dtype),
        jitter=np.ones((), dtype),
        attached=attached._replace(
            axes=np.asarray(attached.axes, dtype), std=np.asarray(attached.std, dtype)
        ),
    )
    return jax.device_put(noise)


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
    The errors of a pose that follows another count as if they occurred there, too.
    """
    arrays = problem.configurations
    weight = np.asarray(arrays.effectors.inverse_std)
    displacements = np.asarray(equilibrium.displacement)
    each = following_each_other([*arrays], displacements)
    states = [*enumerate(zip(each, displacements, strict=True))]
    for (c, *_), u in without_forces:
        states.append((c, (each[c].without_forces(), u)))
    errors, (program, lanes) = _work(problem, z, states)
    columns = np.zeros((len(errors), len(states), weight[0].size))
    of_poses = earlier_lanes([*arrays])
    earlier = [of_poses[c] for c, _ in states]
    for k, of_state in _run(workers, program, lanes, earlier).items():
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


def _run(
    workers: Workers,
    program: Program,
    lanes: Sequence[tuple],
    earlier: Sequence[int | None],
) -> dict[int, Float[Array, "n_e n_rows"]]:
    """Run lanes, each with the changes of those that it follows."""
    if not lanes:
        return {}
    compliances, moved, slopes = {}, {}, {}
    for group in in_order(earlier):
        for k in group:
            p, slopes[k] = earlier[k], lanes[k][-1]
            if p is not None and slopes[k] is not None:
                new = slopes[p], np.asarray(moved[p])[:, None]
                slopes[k] = jax.device_put(np.concatenate(new, axis=1)[:, 1:])
        calls = [(*lanes[k][:-1], slopes[k]) for k in group]
        for k, (W, u) in zip(group, workers.map(program, calls), strict=True):
            compliances[k], moved[k] = W, u
    return compliances


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
    still, slopes = problem.configurations.stages.shape[1:], None
    if still[0] > 0:
        n = len(rows) + (0 if space is None else len(space.names))
        slopes = jax.device_put(np.zeros((n, *still)))
    lanes = [
        (
            tuple(jax.device_put(of_pose[c]) for of_pose in data),
            z,
            lane,
            jax.device_put(u),
            slopes,
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
    slopes: Float[Array, "n_rows n_stages n_points 3"] | None,
) -> tuple[Float[Array, "n_e n_rows"], Float[Array, "n_rows n_points 3"] | None]:
    """Compute W_c of one configuration, in the units of its effectors; Eq. (9).

    Given `slopes`, see `following_rows`, return the change of the displacement, too.
    """
    lin = linearise(*space.apply(model, c, z), u)
    of_all = [] if errors is None else [parameter_rows(lin, errors, errors.start())]
    of_all += [row(lin, of_pose) for row, of_pose in zip(rows, data, strict=True)]
    stacked = jax.tree.map(lambda *parts: jnp.concatenate(parts), *of_all)
    stacked = following_rows(lin, stacked, slopes)
    fewer = slopes is None and len(stacked.force) > c.effectors.measured.size
    response = sensitivity(lin, stacked, effector_values, adjoint=fewer)
    moved = None if slopes is None else response.displacement
    return jnp.where(response.ok, response.W_ep, jnp.nan), moved
