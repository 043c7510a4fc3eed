"""Changes of gravity, loads, actuation and clamps, as they were stated.

They need simulations. Which forces are worth one is told by superposition: the motion
of a pose is about the sum of those by gravity, loads and actuation, each in proportion
to its size, and all in inverse proportion to the stiffness.
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace
from softcal_jax.mistakes._mistake import Kind
from softcal_jax.mistakes._readings import FACTORS, Readings, by, times
from softcal_jax.mistakes._refit import Refitter
from softcal_jax.mistakes._simulator import Simulated, Simulator, Stated, Variant

FORCES = "gravity", "loads", "actuation"

GRAVITIES = 1.0, 30.0
"""From the Moon's to Jupiter's [m/s2]."""

MOST_TRIED = 4
"""Most changes of forces that are simulated."""

BETTER = 0.5
"""Share of the squares that superposition must leave at most, of those now [-]."""

MOST_CLAMPS = 2
"""Most lengths of the clamps that are tried."""

STILL = 0.05
"""Largest motion of a marker in a clamp, over that of the one that moves most [-]."""


QUIET = 3.0
"""The same over the standard deviation of its readings [-]."""


class OtherForces(NamedTuple):
    """A change of forces, see `Statement`."""

    kind: Kind
    words: str
    rank: int
    variant: Variant


class Statement(NamedTuple):
    """What would have been stated without a mistake.

    Attributes:
        kind: The mistake.
        words: What would have to change.
        rank: Position among mistakes that explain the data as well.
        variant: How each pose would be held and loaded.
        z: Where to simulate it first, scaled [-].
        expected: Squares that it should leave, by superposition; nan if not known.
    """

    kind: Kind
    words: str
    rank: int
    variant: Variant
    z: Float[HostArray, " n_p"]
    expected: float = float("nan")


def acting(poses: Sequence[ConfigurationArrays]) -> dict[str, list[int]]:
    """Return the poses in which each of the `FORCES` acts."""
    some = {
        "gravity": lambda c: c.gravity,
        "loads": lambda c: c.loads.force,
        "actuation": lambda c: c.actuation.value,
    }
    act = {
        force: [
            c for c, pose in enumerate(poses) if np.any(np.asarray(some[force](pose)))
        ]
        for force in FORCES
    }
    return {force: where for force, where in act.items() if where}


def motions_by(
    simulator: Simulator, readings: Readings, start: Simulated
) -> dict[str, HostArray] | None:
    """Split the motion of points at the start by forces, taken off one after another.

    None where a pose has no equilibrium without some of its forces.
    """
    n, act = len(readings.poses), acting(simulator.poses)
    each = [
        [force for force in reversed(FORCES) if c in act.get(force, ())]
        for c in range(n)
    ]
    parts = {force: np.zeros(start.e.shape) for force in act}
    e, stated = start.e, [Stated()] * n
    for k in range(max(map(len, each)) - 1):
        for c, forces_of_pose in enumerate(each):
            for force in forces_of_pose[k : len(forces_of_pose) - 1][:1]:
                stated[c] = stated[c]._replace(**{force: 0.0})
        without = simulator(tuple(stated), start.z)
        if without is None:
            return None
        for c, forces_of_pose in enumerate(each):
            if k < len(forces_of_pose) - 1:
                parts[forces_of_pose[k]][c] = e[c] - without.e[c]
        e = without.e
    for c, forces_of_pose in enumerate(each):
        if forces_of_pose:
            parts[forces_of_pose[-1]][c] = e[c] - readings.at_rest[c]
    return {force: part * readings.of_points for force, part in parts.items()}


def forces(
    refitter: Refitter,
    *,
    every: Sequence[OtherForces],
    parts: dict[str, HostArray],
    start: Simulated,
) -> list[Statement]:
    """Return those of the changes of forces that are worth a simulation, best first."""
    readings, space = refitter.readings, refitter.space
    weight = readings.weight * readings.of_points
    in_noise = lambda motion: refitter.whiten(np.ravel(weight * motion)[:, None])[:, 0]
    measured = in_noise(readings.measured - readings.at_rest)
    by_force = {force: in_noise(part) for force, part in parts.items()}
    shares = _shares(space, start.z)
    in_pose = np.ravel(np.indices(weight.shape)[0])

    def left(variant: Variant) -> tuple[float, float]:
        """Return the squares that superposition leaves, and the share of the motion."""
        size = {f: np.array([getattr(s, f) for s in variant])[in_pose] for f in parts}
        motion = np.sum([size[f] * by_force[f] for f in parts], axis=0)
        share = float(
            np.clip(motion @ measured / max(motion @ motion, 1e-300), *shares)
        )
        return float(np.sum((measured - share * motion) ** 2)), share

    now, _ = left((Stated(),) * len(readings.poses))
    tried = []
    for kind, words, rank, variant in every:
        squares, share = left(variant)
        if squares < BETTER * now:
            z = _softer(space, start.z, share)
            tried.append(Statement(kind, words, rank, variant, z, squares))
    return sorted(tried, key=lambda one: (one.expected, one.rank))[:MOST_TRIED]


def other_forces(
    readings: Readings, poses: Sequence[ConfigurationArrays], model: Model
) -> Iterator[OtherForces]:
    """Yield all changes of forces: in all poses, and in one.

    Cables only pull, and gravity stays one of a planet.
    """
    n, act = len(poses), acting(poses)
    one_way = bool(np.any(model.mechanism.actuators.unilateral))
    size = [float(np.linalg.norm(np.asarray(pose.gravity))) for pose in poses]
    factors = [-1.0, *chain(*((f, 1.0 / f) for f in FACTORS))]
    each = (
        (force, scope, f)
        for force in act
        for scope in _scopes(act[force])
        for f in factors
    )
    for force, scope, factor in each:
        sign, everywhere = factor < 0.0, len(scope) == len(act[force])
        on_planet = all(GRAVITIES[0] <= factor * size[c] <= GRAVITIES[1] for c in scope)
        if sign and force == "actuation" and one_way:
            continue
        if not sign and force == "gravity" and not on_planet:
            continue
        what = force if force == "gravity" else f"the {force}"
        place = readings.in_words(range(n) if everywhere else scope)
        words = f"Reversing {what}{place}"
        if not sign:
            words = f"{times(factor)} {what}{by(factor)}{place}"
        # The weight of a mass is the commoner slip than a factor of ten.
        rank = 4 if sign else 6 + (factor in (10.0, 0.1))
        changed = Stated(**{force: factor})
        yield OtherForces(
            kind="wrong sign" if sign else "wrong factor",
            words=words,
            rank=rank + 2 * (not everywhere),
            variant=tuple(changed if c in scope else Stated() for c in range(n)),
        )


def _scopes(where: list[int]) -> list[list[int]]:
    """Return all poses in which a force acts, and each of several."""
    return [where, *([c] for c in where if len(where) > 1)]


def _moduli(space: ParameterSpace) -> HostArray:
    """Flag the parameters to which stiffness is in proportion: those on a log scale."""
    fields = np.array(space.sets_fields)
    return fields & np.array([q.scale == "log" for q in space.parameters])


def _shares(space: ParameterSpace, z: HostArray) -> tuple[float, float]:
    """Return limits of the motion over that at z, by the bounds of the moduli [-]."""
    moduli = _moduli(space)
    if not moduli.any():
        return 1.0, 1.0
    down = np.min((z - np.asarray(space.lower()))[moduli])
    up = np.min((np.asarray(space.upper()) - z)[moduli])
    return float(np.exp(-max(up, 0.0))), float(np.exp(max(down, 0.0)))


def _softer(space: ParameterSpace, z: HostArray, share: float) -> HostArray:
    """Return parameters at which the motion is about `share` of that at z."""
    return np.where(_moduli(space), z - np.log(max(share, 1e-300)), z)


def clamps(
    simulator: Simulator, readings: Readings, z: Float[HostArray, " n_p"]
) -> list[Statement]:
    """Return clamps that reach up to a marker that did not move."""
    moved, noise, depth = dict[str, float](), dict[str, float](), dict[str, float]()
    points = simulator.problem.model.mesh.points
    for c, of_pose in enumerate(readings.points):
        held = points[simulator.distance[c][: len(points)] == 0.0]
        for name, e in of_pose.items():
            off = float(np.linalg.norm(e.error(e.at_rest)))
            moved[name] = max(moved.get(name, 0.0), off)
            noise[name] = float(np.linalg.norm(e.std[e.seen]))
            if len(held):
                gap = float(np.linalg.norm(held - e.at_rest, axis=1).min())
                depth[name] = min(depth.get(name, np.inf), gap)
    farthest = max(moved.values(), default=0.0)
    markers = {
        gap: name
        for name, gap in depth.items()
        if 0.0 < gap < max(depth.values())
        and moved[name] <= max(STILL * farthest, QUIET * noise[name])
    }
    statements = []
    for gap in sorted(markers)[-MOST_CLAMPS:]:
        words = (
            f"Clamping the body {readable_values([gap], 'm', digits=3)} farther, up to "
            f"marker {markers[gap]},"
        )
        longer = (Stated(depth=(1.0 + 1e-6) * gap),) * len(readings.poses)
        statements.append(Statement("longer clamp", words, 10, longer, z))
    return statements
