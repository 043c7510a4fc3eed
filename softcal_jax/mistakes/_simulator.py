"""Simulations with other forces or a longer clamp, each pose only once."""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from scipy.spatial import KDTree

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationProblem, Evaluator
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Workers
from softcal_jax.sensitivity import Response


class Stated(NamedTuple):
    """How one pose would have been held and loaded.

    Attributes:
        gravity: Factor on gravity [-].
        loads: Factor on all loads [-].
        actuation: Factor on what is imposed on actuators [-].
        depth: How far the clamp reaches beyond what is held [m].
    """

    gravity: float = 1.0
    loads: float = 1.0
    actuation: float = 1.0
    depth: float = 0.0


Variant = tuple[Stated, ...]
"""One for each pose."""


class Simulated(NamedTuple):
    """Simulated values of all rows at some z, and their change per unit of lambda_p.

    Attributes:
        z: The parameters, scaled [-].
        e: The values.
        W: Compliances W_ep.
    """

    z: Float[HostArray, " n_p"]
    e: Float[HostArray, "n_c n_rows 3"]
    W: Float[HostArray, "n_c n_rows 3 n_p"]


class Simulator:
    """Simulates variants of the poses of a calibration; it keeps what it has solved.

    Attributes:
        problem: The calibration.
        workers: Run the poses.
        poses: The poses as they were stated.
    """

    def __init__(
        self,
        problem: CalibrationProblem,
        workers: Workers,
        displacement: Sequence[Float[HostArray, "n_nodes 3"]],
    ):
        """Begin with the displacement of each pose, as it was stated [m]."""
        self.problem, self.workers = problem, workers
        self.poses = list(problem.configurations)
        self._done: dict[Hashable, Response] = {}
        self._near: dict[Hashable, HostArray] = {}
        if problem.model.n_points == problem.model.mesh.n_nodes:
            self._near = {(c, Stated()): u for c, u in enumerate(displacement)}

    @cached_property
    def distance(self) -> Float[HostArray, "n_c n_points"]:
        """Of each node from the clamps of each pose [m].

        Infinite without any, and for frames of rigid bodies.
        """
        points = self.problem.model.mesh.points
        return np.array([_from_clamps(points, pose) for pose in self.poses])

    def __call__(
        self, variant: Variant, z: Float[HostArray, " n_p"]
    ) -> Simulated | None:
        """Simulate all poses; None if one has no equilibrium."""
        todo = [
            c
            for c, stated in enumerate(variant)
            if self._key(c, stated, z) not in self._done
        ]
        known = [c for c in todo if (c, variant[c]) in self._near]
        for lanes in (known, [c for c in todo if c not in known]):
            if lanes:
                self._solve(lanes, variant, z)
        every = [self._done[self._key(c, s, z)] for c, s in enumerate(variant)]
        if not all(bool(r.ok) and bool(r.equilibrium.converged) for r in every):
            return None
        e = np.stack([np.asarray(r.effectors) for r in every])
        W = np.stack([np.asarray(r.W_ep) for r in every])
        return Simulated(z, e, W.reshape(*e.shape, -1))

    def _key(self, c: int, stated: Stated, z: HostArray) -> Hashable:
        return c, stated, z.tobytes()

    def _solve(self, lanes: Sequence[int], variant: Variant, z: HostArray) -> None:
        """Solve poses, all from a state of the same variant or all from rest."""
        posed = stacked([self._posed(c, variant[c]) for c in lanes])
        problem = replace(self.problem, configurations=posed, noise=None)
        evaluate, on_device = Evaluator(problem, self.workers), jax.device_put(z)
        if (lanes[0], variant[lanes[0]]) in self._near:
            near = np.stack([self._near[c, variant[c]] for c in lanes])
            response = evaluate(on_device, jax.device_put(near)).response
            each = [lane_of(response, k) for k in range(len(lanes))]
        else:
            solution = evaluate.equilibria(on_device)
            each = evaluate.closed(range(len(lanes)), on_device, solution)
        for c, response in zip(lanes, each, strict=True):
            self._done[self._key(c, variant[c], z)] = response
            if bool(response.equilibrium.converged):
                u = np.asarray(response.equilibrium.displacement)
                self._near[c, variant[c]] = u

    def _posed(self, c: int, stated: Stated) -> ConfigurationArrays:
        """Change the arrays of a pose."""
        lane = self.poses[c]
        fixed = np.asarray(lane.fixed)
        if stated.depth > 0.0:
            fixed = fixed | (self.distance[c] <= stated.depth)[:, None]
        values = (
            stated.gravity * np.asarray(lane.gravity),
            stated.loads * np.asarray(lane.loads.force),
            stated.actuation * np.asarray(lane.actuation.value),
            fixed,
        )
        where = lambda c: (c.gravity, c.loads.force, c.actuation.value, c.fixed)
        return eqx.tree_at(where, lane, jax.device_put(values))


def _from_clamps(points: HostArray, lane: ConfigurationArrays) -> HostArray:
    """Compute the distance of each node from those that are held in place [m]."""
    fixed = np.asarray(lane.fixed)
    distance = np.full(len(fixed), np.inf)
    clamped = points[fixed[: len(points)].all(axis=1)]
    if len(clamped):
        distance[: len(points)] = KDTree(clamped).query(points)[0]
    return distance
