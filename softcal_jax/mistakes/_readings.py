"""Changes of the readings that would undo a mistake."""

from collections.abc import Iterator
from heapq import nlargest
from itertools import combinations, product

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.mistakes._refit import Change, Readings

FACTORS = {
    "m": (10.0, 25.4, 1000.0),
    "N": (4.448, 9.81, 10.0, 1000.0),
    "Pa": (6.895, 10.0, 100.0, 1000.0),
}
"""Between units that are mixed up: cm and inch; lbf and kgf; psi, mbar and bar [-]."""

MOST_SWAPS = 100
"""Most exchanges that are tried: of markers everywhere, in one pose, and of poses."""

ORIGIN = 1e-6  # distance from the origin within which a reading is (0, 0, 0) [m]


def changes(readings: Readings) -> Iterator[Change]:
    """Yield all changes of readings."""
    kinds = (_lost, _misplaced, _swapped_markers, _swapped_poses, _turned, _scaled)
    for kind in kinds:
        yield from kind(readings)


def _lost(readings: Readings) -> Iterator[Change]:
    """Leave out a marker that was read at the origin."""
    measured = readings.measured
    of_row = np.eye(measured.size).reshape(*measured.shape, -1)
    for c, points in enumerate(readings.points):
        for e in points.values():
            seen = readings.of_points[c, e.index]
            if np.max(np.abs(measured[c, e.index][seen])) > ORIGIN:
                continue
            words = f"Leaving out marker {e.name}{readings.in_words([c])}, which was "
            words += "read at (0, 0, 0),"
            free = of_row[c, e.index][seen].T
            yield Change("lost marker", words, 0, measured, free=free)


def _misplaced(readings: Readings) -> Iterator[Change]:
    """Move a marker on the body: its readings are off alike in all configurations."""
    poses: dict[str, list[int]] = {}
    for c, points in enumerate(readings.points):
        for name in points:
            poses.setdefault(name, []).append(c)
    for name, among in poses.items():
        if len(among) > 1:
            free = np.zeros((*readings.measured.shape, 3))
            for c in among:
                row = c, readings.points[c][name].index
                free[row] = np.diag(readings.weight[row])
            words = f"Moving marker {name}{readings.in_words(among)}"
            free = free.reshape(-1, 3)
            yield Change("misplaced marker", words, 4, readings.measured, free=free)


def _swapped_markers(readings: Readings) -> Iterator[Change]:
    """Exchange two markers, in all configurations that have both, or in one.

    Where they were read, or how far they moved.
    """
    gains: dict[tuple[str, str], dict[int, float]] = {}
    for c, points in enumerate(readings.points):
        for a, b in combinations(points.values(), 2):
            rows, others = [a.index, b.index], [b.index, a.index]
            off = readings.simulated[c, rows] - readings.measured[c, [rows, others]]
            as_read, swapped = np.sum((readings.weight[c, rows] * off) ** 2, (1, 2))
            gains.setdefault((a.name, b.name), {})[c] = float(as_read - swapped)
    several = [(sum(of.values()), p, (*of,)) for p, of in gains.items() if len(of) > 1]
    single = [(gain, p, (c,)) for p, of in gains.items() for c, gain in of.items()]
    for exchanges in (several, single):
        for _, pair, poses in nlargest(MOST_SWAPS, exchanges, key=lambda one: one[0]):
            words = f"Swapping markers {' and '.join(pair)}{readings.in_words(poses)}"
            for k in (0, 1):
                rest, measured = k * readings.at_rest, readings.measured.copy()
                for c in poses:
                    a, b = (readings.points[c][name].index for name in pair)
                    moved = readings.measured[c, [b, a]] - rest[c, [b, a]]
                    measured[c, [a, b]] = rest[c, [a, b]] + moved
                rank = 1 + (len(poses) == 1) + 20 * k
                yield Change("swapped markers", words, rank, measured)


def _swapped_poses(readings: Readings) -> Iterator[Change]:
    """Exchange the readings of two configurations with the same effectors.

    Turns are counted from the references of the other one.
    """
    poses, weight, measured = readings.poses, readings.weight, readings.measured
    off = lambda i, j: np.sum((weight[i] * (readings.simulated[i] - measured[j])) ** 2)
    gains = {
        (a, b): off(a, a) + off(b, b) - off(a, b) - off(b, a)
        for a, b in combinations(range(len(poses)), 2)
        if np.array_equal(weight[a] > 0.0, weight[b] > 0.0)
    }
    reference = np.asarray(readings.effectors.turn_reference)
    for a, b in nlargest(MOST_SWAPS, gains, key=gains.__getitem__):
        order = np.arange(len(poses))
        order[[a, b]] = b, a
        words = f"Exchanging the readings of {poses[a]} and {poses[b]}"
        turned = reference @ np.swapaxes(reference[order], -1, -2)
        turned = turned if turned.size else None
        yield Change("swapped poses", words, 3, measured[order], turned)


def _frames() -> Iterator[tuple[str, Float[HostArray, "3 3"]]]:
    """Yield what undoes turns about the axes, mirrored frames and exchanged axes."""
    for axis, angle in product("xyz", (180, 90, -90)):
        turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix().round()
        yield f"Turning {{}} by {angle} degrees about {axis}", turn
    for axis, unit in zip("xyz", np.eye(3), strict=True):
        yield f"Mirroring {{}} in {axis}", np.diag(1.0 - 2.0 * unit)
    for i, j in combinations(range(3), 2):
        exchange = np.eye(3)
        exchange[[i, j]] = exchange[[j, i]]
        yield f"Exchanging {'xyz'[i]} and {'xyz'[j]} of {{}}", exchange


def _turned(readings: Readings) -> Iterator[Change]:
    """Turn or mirror the frame of the recording.

    About the origin of the mesh; about an origin of its own, so that all points may be
    shifted alike; or only the motion, where readings are nominal positions plus motion.
    With an orientation U Q_ref, log(Q Q_ref^T) becomes log(Q Q_ref^T U^T).
    """
    seen, n_turns = readings.of_points, readings.effectors.turn_body.shape
    shifts = ((readings.weight * seen)[..., None] * np.eye(3)).reshape(-1, 3)
    for words, undo in _frames():
        mirrored = np.linalg.det(undo) < 0.0
        if np.any((seen @ np.abs(undo).T > 0.5) != seen):
            continue  # a coordinate that was not measured would take part
        if mirrored and np.any(readings.weight[:, readings.turn_rows] > 0.0):
            continue  # no orientation has a mirror image
        kind = "mirrored frame" if mirrored else "turned frame"
        turned = np.tile(undo.T, (*n_turns, 1, 1)) if n_turns[1] else None
        for k, what in enumerate(("the measured points", "the measured motion")):
            measured = _mapped(readings, undo, k * readings.at_rest)
            yield Change(kind, words.format(what), 5 + 20 * k, measured, turned)
            if k == 0:
                along = f"{words.format(what)}, and moving them along,"
                yield Change(kind, along, 9, measured, turned, shifts)


def _mapped(readings: Readings, by: HostArray, rest: HostArray) -> HostArray:
    """Map the readings of points about their places `rest`."""
    mapped = rest + (readings.measured - rest) @ by.T
    return np.where(readings.of_points, mapped, readings.measured)


def _scaled(readings: Readings) -> Iterator[Change]:
    """Read lengths in another unit: positions, or how far points moved."""
    scales = [f for factor in FACTORS["m"] for f in (factor, 1.0 / factor)]
    for scale, (k, what) in product(scales, enumerate(("positions", "motion"))):
        measured = _mapped(readings, scale * np.eye(3), k * readings.at_rest)
        words = scaling(scale, f"the measured {what}")
        yield Change("wrong factor", words, 7 + 20 * k, measured, scale=scale)


def scaling(factor: float, what: str) -> str:
    """Write "Multiplying ... by 25.4", or "Dividing" for its inverse."""
    verb = "Multiplying" if factor > 1.0 else "Dividing"
    return f"{verb} {what} by {readable(max(factor, 1.0 / factor), '')}"
