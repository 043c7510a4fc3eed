"""Changes that would undo a mistake: of readings, and of how poses were stated.

Those of gravity, loads, actuation and clamps need simulations. Which forces are worth
one is told by superposition: the motion of a pose is about the sum of those by gravity,
loads and actuation, each in proportion to its size, and all in inverse proportion to
the stiffness.
"""

from collections.abc import Iterator
from heapq import nlargest
from itertools import chain, combinations, product

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.mesh import volumes
from softcal_jax.mistakes._refit import Change, Readings, Simulated, Simulator, Stated

FACTORS = {
    "m": (10.0, 25.4, 1000.0),
    "N": (4.448, 9.81, 10.0, 1000.0),
    "Pa": (6.895, 10.0, 100.0, 1000.0),
}
"""Between units that are mixed up: cm and inch; lbf and kgf; psi, mbar and bar [-]."""

MOST_SWAPS = 100
"""Most exchanges that are tried: of markers everywhere, in one pose, and of poses."""

ORIGIN = 1e-6  # distance from the origin within which a reading is (0, 0, 0) [m]

GRAVITIES = 9.7, 9.9  # on the Earth, as far as people round it [m/s2]

MOST_TRIED, MOST_CLAMPS = 4, 2
"""Most changes of forces, and most lengths of the clamps, that are simulated."""

BEARABLE = 1e-4, 1.0  # what actuators do over what moduli resist [-]

STILL, QUIET = 0.05, 3.0
"""Largest motion of a marker in a clamp, over that of the one that moves most, or over
the standard deviation of its readings [-]."""


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


def forces(
    simulator: Simulator, readings: Readings, start: Simulated
) -> tuple[list[Change], int]:
    """Return the changes of forces that are worth a simulation, the best first.

    With the number of all that were considered; none where superposition fails.
    """
    space = readings.space
    parts = _motions(simulator, readings, start)
    if parts is None:
        return [], 0
    weight = readings.weight * readings.of_points
    in_noise = lambda motion: readings.whiten(np.ravel(weight * motion)[:, None])[:, 0]
    measured = in_noise(readings.measured - readings.at_rest)
    by_force = {force: in_noise(part) for force, part in parts.items()}
    pose_of = np.ravel(np.indices(weight.shape)[0])
    # Stiffness is in proportion to what is on a log scale, within its bounds.
    logarithmic = [q.scale == "log" for q in space.parameters]
    moduli = np.array(space.sets_fields) & np.array(logarithmic)
    down, up = (np.abs(room)[moduli] for room in space.room(start.z))
    shares = np.exp(-np.min(up, initial=np.inf)), np.exp(np.min(down, initial=np.inf))
    shares = shares if moduli.any() else (1.0, 1.0)

    def expected(change: Change) -> Change:
        """Tell where to simulate a change, and the squares that it should leave."""
        motion = np.zeros(len(pose_of))
        for force, part in by_force.items():
            size = np.array([getattr(stated, force) for stated in change.variant])
            motion += size[pose_of] * part
        share = np.clip(motion @ measured / max(motion @ motion, 1e-300), *shares)
        z = np.where(moduli, start.z - np.log(max(share, 1e-300)), start.z)
        squares = float(np.sum((measured - share * motion) ** 2))
        return change._replace(z=z, expected=squares)

    every = list(map(expected, _other_forces(simulator, readings)))
    every.sort(key=lambda change: (change.expected, change.rank))
    return every[:MOST_TRIED], len(every)


def commands(
    simulator: Simulator, readings: Readings, start: Simulated
) -> tuple[list[Change], int]:
    """Return factors on the actuation of all poses, which `forces` has counted.

    What a pressure does when it is ten times as large, no state near rest tells: each
    is simulated that is neither too large for the moduli nor far too small.
    """
    model, acts = simulator.problem.model, simulator.acts.get("actuation")
    value = np.abs(np.asarray(simulator.problem.configurations.actuation.value))
    moduli = [float(q.start) for q in readings.space.parameters if q.unit == "Pa"]
    if acts is None or not moduli:
        return [], 0
    area = float(volumes(model.mesh).sum()) / model.mesh.size
    kinds = model.mechanism.actuators.kinds
    areas = np.array([1.0 if kind.force_unit == "Pa" else area for kind in kinds])
    share = float(np.max(value / (max(moduli) * areas)))
    tried = []
    for change in _other_forces(simulator, readings):
        factors = {change.variant[c].actuation for c in np.flatnonzero(acts)}
        if change.kind == "wrong factor" and len(factors) == 1 and factors != {1.0}:
            if BEARABLE[0] <= share * max(factors) <= BEARABLE[1]:
                tried.append(change._replace(z=start.z, expected=np.inf))
    return tried, 0


def _motions(
    simulator: Simulator, readings: Readings, start: Simulated
) -> dict[str, Float[HostArray, "n_c n_rows 3"]] | None:
    """Split the motion of points at the start by forces, taken off one after another.

    None where a pose has no equilibrium without some of its forces.
    """
    acts, parts, e = simulator.acts, {}, start.e
    left, variant = sum(acts.values()), [Stated()] * len(readings.poses)
    for force, on in reversed(acts.items()):
        off = on & (left > 1)  # the last one left takes the robot to rest
        for c in np.flatnonzero(off):
            variant[c] = variant[c]._replace(**{force: 0.0})
        without = simulator(tuple(variant), start.z)
        if without is None:
            return None
        rest = np.where(off[:, None, None], without.e, readings.at_rest)
        parts[force] = (e - rest) * (on[:, None, None] & readings.of_points)
        e, left = without.e, left - on
    return parts


def _other_forces(simulator: Simulator, readings: Readings) -> Iterator[Change]:
    """Yield all changes of forces: in all poses, and in one.

    Cables only pull, and gravity is that of the Earth.
    """
    poses = range(len(readings.poses))
    actuators = simulator.problem.model.mechanism.actuators
    one_way = np.any(actuators.unilateral)
    units = {kind.force_unit for kind in actuators.kinds}
    size = np.linalg.norm(simulator.problem.configurations.gravity, axis=1)
    for force, acts in simulator.acts.items():
        unit = "Pa" if force == "actuation" and units == {"Pa"} else "N"
        factors = [-1.0, *chain(*((f, 1.0 / f) for f in FACTORS[unit]))]
        where = np.flatnonzero(acts).tolist()
        scopes = [where, *([c] for c in where if len(where) > 1)]
        for scope, factor in product(scopes, factors):
            sign, everywhere = factor < 0.0, scope is where
            what = force if force == "gravity" else f"the {force}"
            place = readings.in_words(poses if everywhere else scope)
            if sign and force == "actuation" and one_way:
                continue
            g = factor * size[scope]
            if not sign and force == "gravity" and np.any(g != np.clip(g, *GRAVITIES)):
                continue
            words = f"Reversing {what}" if sign else scaling(factor, what)
            # The weight of a mass is the commoner slip than a factor of ten.
            rank = 4 if sign else 6 + (unit == "N" and factor in (10.0, 0.1))
            stated = Stated(**{force: factor})
            yield Change(
                kind="wrong sign" if sign else "wrong factor",
                words=words + place,
                rank=rank + 2 * (not everywhere),
                measured=readings.measured,
                variant=tuple(stated if c in scope else Stated() for c in poses),
            )


def _other_face(simulator: Simulator, readings: Readings) -> Iterator[Change]:
    """Yield the clamp of another face, if points moved less near it than elsewhere.

    By the largest motion over the distance from what is held, a strain.
    """
    moved = [e for of_pose in readings.points for e in of_pose.values()]
    held, points = simulator.held(0), simulator.problem.model.mesh.points
    if not (moved and len(held)):
        return

    def strain(places: Float[HostArray, "n 3"]) -> float:
        apart, _ = KDTree(places).query([e.at_rest for e in moved])
        return np.max([e.distance(e.at_rest) for e in moved] / np.maximum(apart, 1e-12))

    strains = {face: strain(points[n]) for face, n in simulator.faces.items()}
    face = min(strains, key=strains.__getitem__)
    if strains[face] < strain(held):
        words = f"Holding the body by {face}, and not where it is,"
        change = Change("wrong clamp", words, 10, readings.measured)
        yield change._replace(variant=(Stated(face=face),) * len(readings.poses))


def clamps(
    simulator: Simulator, readings: Readings, start: Simulated
) -> tuple[list[Change], int]:
    """Return clamps of another face, or up to a marker that did not move."""
    moved, noise, depth = dict[str, float](), dict[str, float](), dict[str, float]()
    for c, of_pose in enumerate(readings.points):
        held = simulator.held(c)
        for name, e in of_pose.items():
            moved[name] = max(moved.get(name, 0.0), e.distance(e.at_rest))
            noise[name] = float(np.linalg.norm(e.std[e.seen]))
            if len(held):
                gap = float(np.linalg.norm(held - e.at_rest, axis=1).min())
                depth[name] = min(depth.get(name, np.inf), gap)
    still = STILL * max(moved.values(), default=0.0)
    markers = {
        gap: name
        for name, gap in depth.items()
        if 0.0 < gap < max(depth.values())
        and moved[name] <= max(still, QUIET * noise[name])
    }
    tried = [c._replace(z=start.z) for c in _other_face(simulator, readings)]
    for gap in sorted(markers)[-MOST_CLAMPS:]:
        farther = readable_values([gap], "m", digits=3)
        words = f"Clamping the body {farther} farther, up to marker {markers[gap]},"
        change = Change("longer clamp", words, 10, readings.measured, z=start.z)
        stated = Stated(depth=(1.0 + 1e-6) * gap)
        tried.append(change._replace(variant=(stated,) * len(readings.poses)))
    return tried, len(tried)
