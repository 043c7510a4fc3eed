"""Changes of the readings that would undo a mistake."""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import EffectorArrays, EffectorRecord
from softcal_jax.mistakes._mistake import Kind

FACTORS = (9.81, 10.0, 25.4, 1000.0)
"""Kilograms, of forces only, centimetres, inches and milli [-]."""

MOST_SWAPS = 100
"""Most exchanges that are tried: of markers everywhere, in one pose, and of poses."""

ORIGIN = 1e-6
"""Distance from the origin within which a reading is (0, 0, 0) [m]."""


Exchange = TypeVar("Exchange", bound=tuple)


class Change(NamedTuple):
    """Readings as they would be without a mistake.

    Attributes:
        kind: The mistake.
        words: What would have to change.
        rank: Position among mistakes that explain the data as well: the simplest first.
        measured: Changed values of all rows.
        turned: Factor on the right of the orientation from which each turn counts [-];
            None where orientations stay.
        free: Errors that are fitted along, one column each; None without.
        scale: Factor on what was measured: what it leaves must be small beside it [-].
    """

    kind: Kind
    words: str
    rank: int
    measured: Float[HostArray, "n_c n_rows 3"]
    turned: Float[HostArray, "n_c n_turns 3 3"] | None = None
    free: Float[HostArray, "n n_free"] | None = None
    scale: float = 1.0

    @property
    def n_free(self) -> int:
        """Number of the errors that are fitted along."""
        return 0 if self.free is None else self.free.shape[1]


class Readings(NamedTuple):
    """What was measured in the fitted configurations.

    Attributes:
        poses: Their names.
        points: Records of the measured points of each, by name.
        effectors: Their arrays on the host.
        at_rest: Positions of the points on the undeformed robot; 0 for other rows [m].
    """

    poses: tuple[str, ...]
    points: tuple[dict[str, EffectorRecord], ...]
    effectors: EffectorArrays
    at_rest: Float[HostArray, "n_c n_rows 3"]

    @property
    def measured(self) -> Float[HostArray, "n_c n_rows 3"]:
        """All measured values."""
        return self.effectors.measured  # pyright: ignore

    @property
    def weight(self) -> Float[HostArray, "n_c n_rows 3"]:
        """1 / standard deviations, 0 where nothing was measured."""
        return self.effectors.inverse_std  # pyright: ignore

    @property
    def of_points(self) -> Float[HostArray, "n_c n_rows 3"]:
        """1 where a coordinate of a point was measured, else 0."""
        measured = np.zeros(self.weight.shape)
        for c, points in enumerate(self.points):
            for e in points.values():
                measured[c, e.index] = self.weight[c, e.index] > 0.0
        return measured

    @property
    def turn_rows(self) -> slice:
        """Rows of orientations."""
        n_points = self.effectors.nodes.shape[-2]
        return slice(n_points, n_points + self.effectors.turn_body.shape[-1])

    def in_words(self, poses: Sequence[int]) -> str:
        """Write "all poses", "pose 2", or nothing where there is only one."""
        if len(self.poses) == 1:
            return ""
        if len(poses) == len(self.poses):
            return " in all poses"
        return f" in {self.poses[poses[0]]}"


def readings_of(
    fits: Sequence[ConfigurationResult], effectors: EffectorArrays
) -> Readings:
    """Collect the readings of fitted configurations; `effectors` are on the host."""
    points, at_rest = [], np.zeros(np.shape(effectors.measured))
    for c, fit in enumerate(fits):
        points.append({e.name: e for e in fit.points if e.seen.any()})
        for e in points[-1].values():
            at_rest[c, e.index] = e.at_rest
    names = tuple(fit.name for fit in fits)
    return Readings(names, tuple(points), effectors, at_rest)


def as_read(readings: Readings) -> Change:
    """Return the readings without a change."""
    return Change("swapped markers", "", 0, readings.measured)


def changes(
    readings: Readings, simulated: Float[HostArray, "n_c n_rows 3"]
) -> Iterator[Change]:
    """Yield all changes of readings; `simulated` values tell the likelier exchanges."""
    yield from _lost(readings)
    yield from _swapped_markers(readings, simulated)
    yield from _swapped_poses(readings, simulated)
    yield from _turned(readings)
    yield from _scaled(readings)


def _lost(readings: Readings) -> Iterator[Change]:
    """Leave out a marker that was read at the origin."""
    n = readings.measured.size
    rows = np.arange(n).reshape(readings.measured.shape)
    for c, points in enumerate(readings.points):
        for e in points.values():
            seen = readings.weight[c, e.index] > 0.0
            if np.max(np.abs(readings.measured[c, e.index][seen])) > ORIGIN:
                continue
            yield Change(
                "lost marker",
                f"Leaving out marker {e.name}{readings.in_words([c])}, which was read "
                "at (0, 0, 0),",
                rank=0,
                measured=readings.measured,
                free=np.eye(n)[:, rows[c, e.index][seen]],
            )


def _swapped_markers(
    readings: Readings, simulated: Float[HostArray, "n_c n_rows 3"]
) -> Iterator[Change]:
    """Exchange two markers, in all configurations that have both, or in one."""
    gains: dict[tuple[str, str], dict[int, float]] = {}
    for c, points in enumerate(readings.points):
        for a, b in combinations(points.values(), 2):
            rows, others = [a.index, b.index], [b.index, a.index]
            off = simulated[c, rows] - readings.measured[c, rows]
            swapped = simulated[c, rows] - readings.measured[c, others]
            weight = readings.weight[c, rows]
            gain = np.sum((weight * off) ** 2) - np.sum((weight * swapped) ** 2)
            gains.setdefault((a.name, b.name), {})[c] = float(gain)
    every = [(sum(of.values()), pair, tuple(of)) for pair, of in gains.items()]
    several = [one for one in every if len(one[2]) > 1]
    single = [(g, pair, (c,)) for pair, of in gains.items() for c, g in of.items()]
    for _, pair, poses in [*_likeliest(several), *_likeliest(single)]:
        yield from _swap(readings, pair, poses)


def _likeliest(exchanges: Sequence[Exchange]) -> Sequence[Exchange]:
    """Return the exchanges with the largest gains, which come first in each."""
    return sorted(exchanges, key=lambda one: -one[0])[:MOST_SWAPS]


def _swap(
    readings: Readings, pair: tuple[str, str], poses: Sequence[int]
) -> Iterator[Change]:
    """Exchange two markers: where they were read, or how far they moved."""
    words = f"Swapping markers {pair[0]} and {pair[1]}{readings.in_words(poses)}"
    for k, rest in enumerate((0.0 * readings.at_rest, readings.at_rest)):
        moved, measured = readings.measured - rest, readings.measured.copy()
        for c in poses:
            a, b = (readings.points[c][name].index for name in pair)
            measured[c, [a, b]] = moved[c, [b, a]] + rest[c, [a, b]]
        yield Change("swapped markers", words, 1 + (len(poses) == 1) + 20 * k, measured)


def _swapped_poses(
    readings: Readings, simulated: Float[HostArray, "n_c n_rows 3"]
) -> Iterator[Change]:
    """Exchange the readings of two configurations with the same effectors."""
    weight, measured = readings.weight, readings.measured
    pairs: list[tuple[float, int, int]] = []
    for a, b in combinations(range(len(readings.poses)), 2):
        if np.any((weight[a] > 0.0) != (weight[b] > 0.0)):
            continue
        off = lambda i, j: np.sum((weight[i] * (simulated[i] - measured[j])) ** 2)
        gain = off(a, a) + off(b, b) - off(a, b) - off(b, a)
        pairs.append((float(gain), a, b))
    for _, a, b in _likeliest(pairs):
        exchanged = measured.copy()
        exchanged[[a, b]] = measured[[b, a]]
        words = (
            f"Exchanging the readings of {readings.poses[a]} and {readings.poses[b]}"
        )
        turned = _exchanged_turns(readings, a, b)
        yield Change("swapped poses", words, 3, exchanged, turned)


def _exchanged_turns(readings: Readings, a: int, b: int) -> HostArray | None:
    """Return the factors by which turns count from the references of the other pose."""
    reference = np.asarray(readings.effectors.turn_reference)
    if not reference.shape[1]:
        return None
    turned = np.tile(np.eye(3), (*reference.shape[:2], 1, 1))
    turned[a] = reference[a] @ np.swapaxes(reference[b], -1, -2)
    turned[b] = reference[b] @ np.swapaxes(reference[a], -1, -2)
    return turned


class _Frame(NamedTuple):
    """A wrong frame: its axes in the right one, and the change that undoes it."""

    kind: Kind
    words: str
    undo: Float[HostArray, "3 3"]


def _frames() -> Iterator[_Frame]:
    """Yield turns about the axes, mirrored frames and pairs of exchanged axes."""
    for axis, angle in product("xyz", (180, 90, -90)):
        R = Rotation.from_euler(axis, angle, degrees=True).as_matrix().round()
        yield _Frame("turned frame", f"turning {{}} by {angle} degrees about {axis}", R)
    for k, axis in enumerate("xyz"):
        flip = np.eye(3)
        flip[k, k] = -1.0
        yield _Frame("mirrored frame", f"mirroring {{}} in {axis}", flip)
    for i, j in combinations(range(3), 2):
        exchange = np.eye(3)
        exchange[[i, j]] = exchange[[j, i]]
        words = f"exchanging {'xyz'[i]} and {'xyz'[j]} of {{}}"
        yield _Frame("mirrored frame", words, exchange)


def _turned(readings: Readings) -> Iterator[Change]:
    """Turn or mirror the frame of the recording.

    About the origin of the mesh; about an origin of its own, so that all points may be
    shifted alike; or only the motion, where readings are nominal positions plus motion.
    """
    used = readings.weight > 0.0
    shifts = _shifts(readings)
    for frame in _frames():
        mixed = np.abs(frame.undo) > 0.5
        seen = readings.of_points > 0.5
        if np.any((seen @ mixed.T) != seen):
            continue  # a coordinate that was not measured would take part
        if frame.kind == "mirrored frame" and np.any(used[:, readings.turn_rows]):
            continue  # no orientation has a mirror image
        turned = _all_turned(readings, frame.undo)
        for k, what in enumerate(("the measured points", "the measured motion")):
            measured = _mapped(readings, frame.undo, readings.at_rest * k)
            words = frame.words.format(what)
            words = words[0].upper() + words[1:]
            yield Change(frame.kind, words, 5 + 20 * k, measured, turned)
            if k == 0:
                words += ", and moving them along,"
                yield Change(frame.kind, words, 9, measured, turned, shifts)


def _all_turned(readings: Readings, undo: Float[HostArray, "3 3"]) -> HostArray | None:
    """Return the factor on the references: log(Q Q_ref^T) becomes log(Q Q_ref^T U^T).

    With the right orientation U Q_ref.
    """
    shape = readings.effectors.turn_body.shape
    return np.tile(undo.T, (*shape, 1, 1)) if shape[-1] else None


def _mapped(readings: Readings, undo: HostArray, rest: HostArray) -> HostArray:
    """Map the readings of points about their places `rest`."""
    mapped = rest + (readings.measured - rest) @ undo.T
    return np.where(readings.of_points > 0.5, mapped, readings.measured)


def _shifts(readings: Readings) -> Float[HostArray, "n 3"]:
    """Return a shift of all points along each axis, in standard deviations per m."""
    weight = readings.weight * readings.of_points
    return (weight[..., None] * np.eye(3)).reshape(-1, 3)


def _scaled(readings: Readings) -> Iterator[Change]:
    """Read lengths in another unit: positions, or how far points moved."""
    scales = [f for factor in FACTORS[1:] for f in (factor, 1.0 / factor)]
    for scale, (k, what) in product(scales, enumerate(("positions", "motion"))):
        rest = readings.at_rest * k
        measured = _mapped(readings, scale * np.eye(3), rest)
        words = f"{times(scale)} the measured {what}{by(scale)}"
        yield Change("wrong factor", words, 7 + 20 * k, measured, scale=scale)


def times(factor: float) -> str:
    """Write "Multiplying" or "Dividing"."""
    return "Multiplying" if factor > 1.0 else "Dividing"


def by(factor: float) -> str:
    """Write " by 25.4" for 25.4 and for its inverse."""
    return f" by {readable(max(factor, 1.0 / factor), '')}"
