"""Noise whose coordinates are not independent: offsets of recordings, and creep.

The covariance of the stacked measured coordinates is

    V = s^2 diag(std^2) + U Sigma U^T

with jitter of each coordinate, and few known columns U: a rigid offset of the points of
each recording along each axis; a share of the motion of each configuration; and an
offset of each point or frame whose displacement from a reference is what counts. In
units of the jitter this is I + A A^T with A = diag(std)^-1 U Sigma^1/2 / s, and the
errors and compliances of a fit are multiplied by (I + A A^T)^-1/2, after which they are
independent with the variance s^2 in units of `std` (generalised least squares; Seber
and Wild, Nonlinear Regression, 1989, sec. 2.1.4).

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

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    EffectorArrays,
    EffectorRecord,
)
from softcal_jax.fields import KINDS
from softcal_jax.inference import ATTACHMENTS, RANK, ErrorColumns, no_errors

CREEP = "creep"
"""Name of the share of the motion in the budget."""

(OFFSETS,) = (kind for kind in KINDS.values() if kind.is_noise)
"""The kind of unknown that is part of the noise: an offset of each recording."""

RECORDINGS = OFFSETS.uncertain  # name of the offsets of recordings in the budget

AT_REST = 1e-12
"""Difference of a reading from rest that is rounding, over its largest number [-]."""

AnyArray = Array | HostArray


def recording_names(configurations: Sequence[Configuration]) -> list[str]:
    """Return the name of the recording of each configuration."""
    return [c.recording or c.name for c in configurations]


def creep_of(configuration: Configuration) -> str:
    """Name the share of the motion of a configuration that is noise."""
    return f"creep in {configuration.name}"


FAR_BEYOND: Mapping[str, float] = {"point": 1.0, "turn": 100.0}
"""Standard deviation of an unknown offset, far beyond any real offset [m, rad]."""


class Attachments(NamedTuple):
    """Attachments of the effectors whose displacement counts, not their position.

    Attributes:
        of_row: Index of the attachment of each row, -1 for rows without.
        axes: Axes of its offset, as a matrix for each row [-].
        std: Standard deviation of each offset, by this index [m, rad].
    """

    of_row: Int[AnyArray, "n_c n_rows"]
    axes: Float[AnyArray, "n_c n_rows 3 3"]
    std: Float[AnyArray, " n_attachments"]

    def shifts(
        self,
        weight: Float[HostArray, "n n_rows 3"],
        delta_e: Float[HostArray, "n n_rows 3"],
    ) -> Float[HostArray, "n_c n_rows 3"]:
        """Return what the offset of its attachment adds to each row [m, rad].

        Offsets fit the weighted errors of the first configurations, by least squares.
        All arrays must be on the host.
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
    keys: dict[tuple[str, str, str], int] = {}
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
    far = np.array([FAR_BEYOND[quantity] for *_, quantity in keys])
    return Attachments(index, axes, far)


def check_references(
    configurations: Sequence[Configuration],
    effectors: Sequence[Sequence[EffectorRecord]],
    *,
    fitted: Sequence[Configuration] | None = None,
) -> None:
    """Raise ValueError unless references are fitted, with the same effectors.

    By default all configurations are `fitted`.
    """
    known = {c.name: c for c in (configurations if fitted is None else fitted)}
    read = {
        c.name: {(e.name, e.quantity): bool(np.any(e.seen)) for e in records}
        for c, records in zip(configurations, effectors, strict=True)
    }
    for c in configurations:
        name = c.displacement_from
        if name is None:
            continue
        what = f"displacement_from of configuration {c.name!r}"
        check_known(f"configuration in {what}", known, name)
        if name == c.name or known[name].displacement_from is not None:
            raise ValueError(
                f"{what} is {name!r}, which has a reference itself: name a "
                "configuration that has none, such as the robot at rest."
            )
        compared = {k: seen for k, seen in read[c.name].items() if k[1] in FAR_BEYOND}
        if not compared:
            raise ValueError(
                f"{what} is {name!r}, but it has no points or frames, whose "
                "displacement could count: add markers or a `BodyFrame`."
            )
        for key, seen in compared.items():
            if seen and not read[name].get(key, False):
                raise ValueError(
                    f"{what} is {name!r}, where {key[0]!r} was not measured: only "
                    "points and frames that both have can be compared by their "
                    "displacement."
                )


def read_once(
    configurations: Sequence[Configuration], lanes: ConfigurationLanes
) -> tuple[ConfigurationLanes, dict[str, str]]:
    """Leave a reading out where it stands a second time: it has one error.

    Readings are the same if all effectors that two configurations measured agree to the
    last digit, in more than one number away from rest, up to rounding: one alone may
    agree by chance.
    References of displacements keep theirs; of other configurations the first does.

    Returns:
        The lanes; and the configurations that repeat another one, by name, with that.
    """
    references = {c.displacement_from for c in configurations}
    names, records = [c.name for c in configurations], [*lanes.effectors]
    weight, repeats = np.array(lanes.arrays.effectors.inverse_std), dict[str, str]()
    kept: dict[str, dict[tuple[str, str], HostArray]] = {}
    for c in sorted(range(len(names)), key=lambda c: names[c] not in references):
        key = lambda e: (e.name, e.quantity)
        # Of a turn, the orientation from which it counts is what was measured.
        numbers = lambda e: np.append(e.measured, e.reference)
        rest = lambda e: np.append(np.nan_to_num(e.at_rest), np.eye(3))
        near = lambda a, b: ~(np.abs(a - b) > AT_REST * np.nanmax(np.abs(a)))
        read = {key(e): numbers(e) for e in records[c] if e.seen.any()}
        for first, other in {} if names[c] in references else kept.items():
            same = [e for e in records[c] if key(e) in read.keys() & other.keys()]
            moved = sum(np.sum(~near(numbers(e), rest(e))) for e in same)
            alike = [np.array_equal(read[key(e)], other[key(e)], True) for e in same]
            if moved < 2 or not all(alike):
                continue
            repeats[names[c]] = first
            weight[c, [e.index for e in same]] = 0.0
            unread = lambda e: replace(e, measured=np.nan * e.std, std=np.inf * e.std)
            records[c] = tuple(unread(e) if key(e) in other else e for e in records[c])
            read = {k: read[k] for k in read.keys() - other.keys()}
        kept[names[c]] = read
    lanes = lanes._replace(effectors=tuple(records))
    weights = lambda lanes: lanes.arrays.effectors.inverse_std
    return eqx.tree_at(weights, lanes, weight) if repeats else lanes, repeats


def independent_recordings(configurations: Sequence[Configuration]) -> list[str]:
    """Return the recording of each configuration, one for all that share a reference.

    The noise of the reference is in all of them, so they are no independent witnesses.
    """
    recording = {c.name: c.recording or c.name for c in configurations}
    origins = [c.displacement_from or c.name for c in configurations]
    return [recording.get(name, name) for name in origins]


class CorrelatedNoise(Module):
    """Covariance of the stacked errors, for a batch of configurations.

    Attributes:
        recording: Index of the first configuration of the same recording.
        offset: Standard deviation of the offset of its points, along each axis [m].
        motion: Motion of the points, as measured or simulated; 0 for other rows [m].
        share: Standard deviation of the share of this motion that is noise [-].
        jitter: Factor on the stated standard deviations of the coordinates [-].
        attached: Attachments of the rows.
    """

    recording: Int[AnyArray, " n_c"]
    offset: Float[AnyArray, "n_c 3"]
    motion: Float[AnyArray, "n_c n_rows 3"]
    share: Float[AnyArray, " n_c"]
    jitter: Float[AnyArray, ""]
    attached: Attachments

    @property
    def n_common(self) -> int:
        """Number of columns that are not of attachments; they come first."""
        return 4 * self.share.shape[-1]

    def columns(self, effectors: EffectorArrays) -> Float[AnyArray, "n_e n_columns"]:
        """Return A: offsets of configurations, shares of their motion, attachments.

        Each configuration has three columns for offsets, one along each axis. All of a
        recording share the columns of its first configuration; those of its others are
        zero, so that the shape depends on the batch alone.
        """
        weight = effectors.inverse_std
        xp: Any = jnp if isinstance(weight, jax.Array) else np
        noise, dtype = jax.tree.map(xp.asarray, self), weight.dtype
        n_e, n_c, n_rows = weight.size, *weight.shape[:2]
        is_point = xp.arange(n_rows) < effectors.nodes.shape[-2]
        of_points = weight * is_point.astype(dtype)[None, :, None]
        first = xp.arange(n_c, dtype=noise.recording.dtype)
        same = (noise.recording[:, None] == first[None, :]).astype(dtype)
        each, axes = xp.eye(n_c, dtype=dtype), xp.eye(3, dtype=dtype)
        shifts = xp.einsum("crx,cx,cg,xy->crxgy", of_points, noise.offset, same, axes)
        shares = xp.einsum("crx,c,cd->crxd", weight * noise.motion, noise.share, each)
        parts = [shifts.reshape(n_e, 3 * n_c), shares.reshape(n_e, n_c)]
        index, turned, std = noise.attached
        n = std.shape[-1]
        if n > 0:
            number = xp.arange(n, dtype=index.dtype)
            of_row = (index[:, :, None] == number[None, None]).astype(dtype)
            of_row = of_row * std[None, None]
            attached = xp.einsum("crx,crm,crxy->crxmy", weight, of_row, turned)
            parts.append(attached.reshape(n_e, 3 * n))
        return xp.concatenate(parts, axis=1) / noise.jitter

    def without_attachments(
        self,
        effectors: EffectorArrays,
        delta_e: Float[AnyArray, "n_c n_rows 3"],
        fitted: Bool[HostArray, " n_c"] | None = None,
    ) -> Float[HostArray, "n_c n_rows 3"]:
        """Subtract the offsets of attachments from the errors of their effectors.

        Only errors of configurations that are `fitted` tell them, by default all.
        """
        attached = jax.tree.map(np.asarray, self.attached)
        errors, weight = np.asarray(delta_e), np.asarray(effectors.inverse_std)
        rows = np.ones(len(weight), bool) if fitted is None else fitted
        counted = np.where(rows[:, None, None], weight, 0.0)
        shifts = attached.shifts(counted, errors)
        return np.where(weight > 0.0, errors - shifts, 0.0)

    def on_host(self, effectors: EffectorArrays) -> Float[HostArray, "n_e n_columns"]:
        """Compute `columns` on the host, without a program for each shape."""
        noise, effectors = jax.tree.map(np.asarray, (self, effectors))
        return np.asarray(noise.columns(effectors))

    def moving(self, motion: Float[AnyArray, "n n_rows 3"]) -> "CorrelatedNoise":
        """Return the noise with another motion of the first few configurations [m]."""
        moved = np.array(self.motion)
        moved[: len(motion)] = motion
        return replace(self, motion=_on_device(moved, like=self.motion))

    def of_first(self, n: int) -> "CorrelatedNoise":
        """Return the noise of the first few configurations of the batch."""
        per_lane = lambda x: (x.recording, x.offset, x.motion, x.share, *x.attached[:2])
        return eqx.tree_at(per_lane, self, lane_of(per_lane(self), slice(n)))

    def scaled(
        self, *, jitter: float, offset: float, share: float, of: Bool[HostArray, " n_c"]
    ) -> "CorrelatedNoise":
        """Return the noise with another jitter, and factors on offsets and shares.

        `of` flags the configurations whose share changes.
        """
        shares = np.where(of, share, 1.0) * np.asarray(self.share)
        return replace(
            self,
            offset=_on_device(offset * np.asarray(self.offset), like=self.offset),
            share=_on_device(shares, like=self.share),
            jitter=_on_device(jitter, like=self.jitter),
        )


def _on_device(new: Any, *, like: Float[AnyArray, "..."]) -> Float[Array, "..."]:
    """Put values on the device, typed like others, without compiling a program."""
    return jax.device_put(np.asarray(new, like.dtype))


def noise_columns(
    noise: CorrelatedNoise | None,
    effectors: EffectorArrays,
    configurations: Sequence[Configuration],
) -> ErrorColumns:
    """Return the columns A of a noise on the host, by cause and name, without zeros."""
    if noise is None:
        return no_errors(np.size(effectors.inverse_std))
    A = noise.on_host(effectors)
    recordings = recording_names(configurations)
    several = len(set(recordings)) > 1
    labels = [
        (RECORDINGS, f"{OFFSETS.name} {axis}" + f" in {name}" * several)
        for name in recordings
        for axis in OFFSETS.components
    ]
    labels += [(CREEP, creep_of(c)) for c in configurations]
    labels += [(ATTACHMENTS, "")] * (A.shape[1] - len(labels))
    causes, names = zip(*labels, strict=True)
    return ErrorColumns(A, causes, names).only(np.ones(len(A), bool))
