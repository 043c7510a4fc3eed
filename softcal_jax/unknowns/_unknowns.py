"""Every unknown of a calibration, once: fitted, considered, or part of the noise.

A considered error is held at its nominal value: fitted values move with it, and their
standard errors say by how much. An error that is part of the noise is marginalised: it
weighs the data, and takes the information along its direction out of the fit. Consider
what the data cannot tell from the parameters, like a load that is 1 % off in all poses;
marginalise what differs from one recording to the next, so that poses that disagree by
it do not pull at the values.

Attachments: where a marker was glued is known to a millimetre or so, and its motion
between two poses to a tenth of that. A configuration that names another one as its
reference is compared by differences of poses on both sides, measured and simulated.
Every point then has an unknown offset, and every 6-D sensor an unknown mounting, that
both poses share. As columns of the covariance, with a standard deviation far beyond any
offset, they take out what the errors have in common and nothing else. This is
generalised least squares on the differences, all of which contain the noise of the
reference.

A point keeps its offset along the axes of the mesh. A sensor that is mounted with an
offset d and a turn r is at T M on a body at T, and T_c T_r^-1, the rigid motion from
the reference r to a configuration c, is the same for every mounting M. To first order
the errors of its position and orientation are R d and R r, with the rotation R of the
body in each pose. Sensitivities are those of the nominal point and axes, but half the
unknown turn tilts the axes: know the mounting to millimetres and some degrees.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
    EffectorRecord,
)
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import InputRows, Linearisation, Model
from softcal_jax.fields import (
    KINDS,
    AbstractEntry,
    FieldError,
    ParameterSpace,
    Scope,
    SetupError,
    SetupParameter,
    Uncertain,
    constants_of,
    find_field,
    grounded_bodies,
    region_tets,
)
from softcal_jax.inference import ATTACHMENTS, RANK
from softcal_jax.mesh import TetMesh, boundary_faces
from softcal_jax.sensitivity import clamp_row, mesh_row, stress_patches

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_row`."""

Role = Literal["fitted", "considered", "noise"]

CREEP = "creep"
"""Name of the share of the motion in the budget."""

FIRST_SHARE = 0.02
"""Share of the motion to begin with, where it is to be estimated [-]."""


class Unknown(NamedTuple):
    """Something that is not known exactly.

    Attributes:
        cause: What it is called in the budget.
        name: Its name among those of the same cause.
        entry: What it sets, if that is an array of the model or of a configuration.
        prior: Its standard deviation, in SI units or relative; nan where it is fitted,
            as each of its parameters has a prior of its own.
        role: Whether it is fitted, considered or part of the noise.
        scope: For each configuration, a key that those with the same error have in
            common; None where the error cannot occur, or has another role.
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

    def in_each(self) -> Float[HostArray, " n_c"]:
        """Return its standard deviation in each configuration, 0 where it has none."""
        return np.array([0.0 if key is None else self.prior for key in self.scope])

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
    """List all unknowns of a calibration.

    They include errors that cannot occur in any configuration, with no key in their
    scope: which entries are computed is part of a compiled program, so that one serves
    all poses.
    """
    on_host = jax.tree.map(np.asarray, setting.arrays)
    recordings = recording_names(setting.configurations)
    scopes = {
        name: kind.occurs(setting.model, on_host, recordings)
        for name, kind in KINDS.items()
    }
    return (
        *_fitted(setting, scopes),
        *_of_fields(setting),
        *_of_setup(setting, scopes),
        _of_clamps(setting),
        _of_mesh(setting),
        *_of_creep(setting),
        *_of_attachments(setting),
    )


def recording_names(configurations: Sequence[Configuration]) -> list[str]:
    """Return the name of the recording of each configuration."""
    return [c.recording or c.name for c in configurations]


Scopes = Mapping[str, Mapping[str, Scope]]
"""Where errors can occur, by their kind in `KINDS` and by what they belong to."""


def _fitted(setting: Setting, scopes: Scopes) -> Iterator[Unknown]:
    """List what is fitted, and where it occurs."""
    everywhere: Scope = ("",) * len(setting.configurations)
    for entry in setting.space.entries:
        scope = everywhere
        if isinstance(entry, SetupParameter):
            scope = scopes[entry.kind].get(entry.of, everywhere)
        yield Unknown(entry.label, entry.label, entry, np.nan, "fitted", scope)


def _of_setup(setting: Setting, scopes: Scopes) -> Iterator[Unknown]:
    """List errors of the setup, the loads and the recordings that are not fitted."""
    for name, kind in KINDS.items():
        cause, role = kind.uncertain, "noise" if kind.is_noise else "considered"
        stated = vars(setting.uncertain).get(cause, 0.0)
        std = kind.std if stated == "estimated" else stated
        for of, scope in scopes[name].items():
            for axis in kind.components or ("",):
                label = " ".join(word for word in (name, of, axis) if word)
                entry = SetupError(label, std, name, of, axis)
                where = _where(scope, _not_fitted(setting, entry) & (std > 0.0))
                yield Unknown(cause, label, entry, std, role, where)


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
        share = _share_not_fitted(setting, path)
        room = 0.5 * (kind.most - float(np.max(value)))
        std = min(getattr(setting.uncertain, kind.uncertain), room)
        entry = FieldError(name, std, path, jax.device_put(share), kind.relative)
        matters = np.any(share * value if kind.relative else share) and std > 0.0
        acts = np.full(len(setting.configurations), matters)
        if kind.acts_by:
            acts &= np.any(np.asarray(getattr(arrays, kind.acts_by)), axis=1)
        scope = _where(("",) * len(acts), acts)
        yield Unknown(name, name, entry, std, "considered", scope)


def _share_not_fitted(setting: Setting, path: str) -> HostArray:
    """Return 1 for each tet in which no parameter sets a field, 0 for the others."""
    model, share = setting.model, np.ones(setting.model.n_tets)
    for entry in setting.space.entries:
        if any(find_field(model, name).path == path for name in entry.fields):
            share[region_tets(model.mesh, entry.tet_group)] = 0
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
    n = len(setting.configurations)
    name = "locking" if model.mesh.order == 1 else "refinement"
    scope = _where(("",) * n, np.full(n, std > 0.0 and np.any(model.active)))
    error = MESH, name, None, std, "considered", scope
    return Unknown(*error, mesh_row, lambda: (stress_patches(model),) * n)


def _of_creep(setting: Setting) -> Iterator[Unknown]:
    """List the share of the motion of each configuration that is noise."""
    n_c = len(setting.configurations)
    for c, configuration in enumerate(setting.configurations):
        std = configuration.relative_std
        share = FIRST_SHARE if std == "estimated" else std
        scope = _where(("",) * n_c, (np.arange(n_c) == c) & (share > 0.0))
        yield Unknown(CREEP, creep_of(configuration), None, share, "noise", scope)


def creep_of(configuration: Configuration) -> str:
    """Name the share of the motion of a configuration that is noise."""
    return f"creep in {configuration.name}"


def _of_attachments(setting: Setting) -> Iterator[Unknown]:
    """List the offsets of points and frames whose displacement counts."""
    lanes, n_rows = setting.lanes, setting.arrays.effectors.measured.shape[1]
    attached = attachments(setting.configurations, lanes.effectors, n_rows)
    for k, key in enumerate(attached.keys):
        has_it = np.any(attached.of_row == k, axis=1)
        scope, far = _where(("",) * len(has_it), has_it), FAR_BEYOND[key[-1]]
        yield Unknown(ATTACHMENTS, " ".join(key), None, far, "noise", scope)


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
    if mesh.order == 2:
        ends = mesh.tets[:, np.array(TET_EDGES)]
        motion[mesh.tets[:, 4:]] = motion[ends].mean(axis=2)
    return motion


FAR_BEYOND: Mapping[str, float] = {"point": 1.0, "turn": 100.0}
"""Standard deviation of an unknown offset, far beyond any real offset [m, rad]."""

Attachment = tuple[str, str, str]
"""Names of the reference and of an effector, and its quantity."""


class Attachments(NamedTuple):
    """Attachments of the effectors whose displacement counts, not their position.

    Attributes:
        of_row: Index of the attachment of each row, -1 for rows without.
        axes: Axes of its offset, as a matrix for each row [-].
        keys: What each attachment is, by this index.
    """

    of_row: Int[HostArray, "n_c n_rows"]
    axes: Float[HostArray, "n_c n_rows 3 3"]
    keys: tuple[Attachment, ...]

    def shifts(
        self,
        weight: Float[HostArray, "n n_rows 3"],
        delta_e: Float[HostArray, "n n_rows 3"],
    ) -> Float[HostArray, "n_c n_rows 3"]:
        """Return what the offset of its attachment adds to each row [m, rad].

        Offsets fit the weighted errors of the first configurations, by least squares.
        """
        shifts, n = np.zeros((*self.of_row.shape, 3)), len(weight)
        for k in range(int(self.of_row.max(initial=-1)) + 1):
            mine = self.of_row == k
            w = weight[mine[:n]]
            A, b = w[:, :, None] * self.axes[:n][mine[:n]], w * delta_e[mine[:n]]
            offset, *_ = np.linalg.lstsq(A.reshape(-1, 3), b.ravel(), rcond=RANK)
            shifts[mine] = self.axes[mine] @ offset
        return shifts


def attachments(
    configurations: Sequence[Configuration],
    effectors: Sequence[Sequence[EffectorRecord]],
    n_rows: int,
) -> Attachments:
    """Number the points and frames whose displacement counts.

    Effectors of the same name share their offset in all configurations with the same
    reference, and in the reference itself.
    """
    references = {c.displacement_from for c in configurations} - {None}
    index = np.full((len(configurations), n_rows), -1, np.int32)
    axes = np.tile(np.eye(3), (*index.shape, 1, 1))
    keys: dict[Attachment, int] = {}
    for lane, (c, records) in enumerate(zip(configurations, effectors, strict=True)):
        reference = c.displacement_from or (c.name if c.name in references else None)
        if reference is None:
            continue
        measured = lambda e: Rotation.from_rotvec(np.nan_to_num(e.measured)).as_matrix()
        turned = {e.name: measured(e) @ e.reference for e in records if e.is_turn}
        for e in records:
            if e.quantity in FAR_BEYOND:
                key = (reference, e.name, e.quantity)
                index[lane, e.index] = keys.setdefault(key, len(keys))
                axes[lane, e.index] = turned.get(e.name, np.eye(3))
    return Attachments(index, axes, tuple(keys))
