"""Changes of gravity, loads, actuation and clamps, as they were stated.

They need simulations. Which forces are worth one is told by superposition: the motion
of a pose is about the sum of those by gravity, loads and actuation, each in proportion
to its size, and all in inverse proportion to the stiffness.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, product
from typing import Any

import equinox as eqx
import jax
import numpy as np
from scipy.spatial import KDTree

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.calibration import Evaluator
from softcal_jax.configurations import ConfigurationArrays, ConfigurationLanes
from softcal_jax.equilibrium import Workers
from softcal_jax.mesh import box_faces, volumes
from softcal_jax.mistakes._readings import FACTORS, scaling
from softcal_jax.mistakes._refit import Change, Readings, Simulated, Stated, Variant
from softcal_jax.sensitivity import Response
from softcal_jax.unknowns import Problem

FORCES: Mapping[str, Callable[[ConfigurationArrays], Any]] = {
    "gravity": lambda pose: pose.gravity,
    "loads": lambda pose: pose.loads.force,
    "actuation": lambda pose: pose.actuation.value,
}
"""What deforms a pose."""

GRAVITIES = 9.7, 9.9  # on the Earth, as far as people round it [m/s2]

MOST_TRIED, MOST_CLAMPS = 4, 2
"""Most changes of forces, and most lengths of the clamps, that are simulated."""

BEARABLE = 1e-4, 1.0  # what actuators do over what moduli resist [-]

STILL, QUIET = 0.05, 3.0
"""Largest motion of a marker in a clamp, over that of the one that moves most, or over
the standard deviation of its readings [-]."""


class Simulator:
    """Simulates variants of the poses of a calibration; it keeps what it has solved.

    `acts` flags the poses in which each of the forces acts that act in any.
    """

    def __init__(
        self,
        problem: Problem,
        workers: Workers,
        displacement: Sequence[Float[HostArray, "n_nodes 3"]],
    ):
        """Begin with the displacement of each pose, as it was stated [m]."""
        self.problem, self.workers = problem, workers
        self.poses = list(problem.configurations)
        self.faces = box_faces(problem.model.mesh)
        acting = lambda of: [bool(np.any(np.asarray(of(pose)))) for pose in self.poses]
        acts = {force: np.array(acting(of)) for force, of in FORCES.items()}
        self.acts = {force: where for force, where in acts.items() if where.any()}
        self._done: dict[Hashable, Response] = {}
        self._near: dict[Hashable, HostArray] = {}
        if problem.model.n_points == problem.model.mesh.n_nodes:
            self._near = {(c, Stated()): u for c, u in enumerate(displacement)}

    def held(self, c: int) -> Float[HostArray, "n_held 3"]:
        """Return the nodes of a pose that are held in place [m]."""
        points = self.problem.model.mesh.points
        return points[np.asarray(self.poses[c].fixed)[: len(points)].all(axis=1)]

    def __call__(self, variant: Variant, z: HostArray) -> Simulated | None:
        """Simulate all poses at scaled parameters; None if one has no equilibrium."""
        lanes = list(enumerate(variant or (Stated(),) * len(self.poses)))
        todo = [lane for lane in lanes if (lane, z.tobytes()) not in self._done]
        for is_near in (True, False):
            self._solve([k for k in todo if (k in self._near) == is_near], z)
        every = stacked([self._done[lane, z.tobytes()] for lane in lanes])
        if not np.all(np.asarray(every.ok) & np.asarray(every.equilibrium.converged)):
            return None
        e = np.asarray(every.effectors)
        return Simulated(z, e, np.asarray(every.W_ep).reshape(*e.shape, -1))

    def _solve(self, lanes: Sequence[tuple[int, Stated]], z: HostArray) -> None:
        """Solve poses, all from a state of the same variant or all from rest."""
        if not lanes:
            return
        posed = stacked([self._posed(*lane) for lane in lanes])
        alone = ConfigurationLanes(posed, ())
        problem = replace(self.problem.bare, lanes=alone, noise=None)
        evaluate, on_device = Evaluator(problem, self.workers), jax.device_put(z)
        if lanes[0] in self._near:
            near = jax.device_put(np.stack([self._near[lane] for lane in lanes]))
            response = evaluate(on_device, near).response
        else:
            response = evaluate.from_rest(on_device).response
        for k, lane in enumerate(lanes):
            one = self._done[lane, z.tobytes()] = lane_of(response, k)
            if bool(one.equilibrium.converged):
                self._near[lane] = np.asarray(one.equilibrium.displacement)

    def _posed(self, c: int, stated: Stated) -> ConfigurationArrays:
        """Change the arrays of a pose."""
        pose, points = self.poses[c], self.problem.model.mesh.points
        fixed = np.array(pose.fixed)
        if stated.face:
            fixed[: len(points)] = False
            fixed[self.faces[stated.face]] = True
        if stated.depth > 0.0:
            distance, _ = KDTree(self.held(c)).query(points)
            fixed[: len(points)] |= (distance <= stated.depth)[:, None]
        values = [getattr(stated, f) * np.asarray(of(pose)) for f, of in FORCES.items()]
        where = lambda pose: (pose.fixed, *(of(pose) for of in FORCES.values()))
        return eqx.tree_at(where, pose, jax.device_put((fixed, *values)))


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
