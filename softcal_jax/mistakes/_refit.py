"""Readings, simulations of them, and linear fits to changed readings about these.

The errors r + W dz are weighed as stated, offsets of recordings and attachments
included, and dz stays within the bounds of the parameters: what a calibration to the
changed readings would do in its next step (Eq. 10).
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.bodies import rotation_matrix, rotation_vector
from softcal_jax.calibration import CalibrationResult, ConfigurationResult, Evaluator
from softcal_jax.configurations import ConfigurationArrays, ConfigurationLanes
from softcal_jax.equilibrium import Workers
from softcal_jax.inference import RANK, span, whitened
from softcal_jax.mesh import box_faces
from softcal_jax.sensitivity import Response
from softcal_jax.unknowns import Problem

TRUST = 1.0  # largest step of lambda_p about a simulation: a factor e of a modulus [-]

NEAR = 0.1
"""Step up to which a linear fit holds; its error is about half its square [-]."""

FORCES: Mapping[str, Callable[[ConfigurationArrays], Any]] = {
    "gravity": lambda pose: pose.gravity,
    "loads": lambda pose: pose.loads.force,
    "actuation": lambda pose: pose.actuation.value,
}
"""What deforms a pose."""


Kind = Literal[
    "lost marker",
    "swapped markers",
    "swapped poses",
    "wrong sign",
    "turned frame",
    "mirrored frame",
    "wrong factor",
    "longer clamp",
    "wrong clamp",
    "misplaced marker",
]
"""What people do."""


class Stated(NamedTuple):
    """How one pose would have been held and loaded.

    Factors on gravity, on loads and on what is imposed on actuators [-], how far the
    clamp reaches beyond what is held [m], and the face that is held instead, if any.
    """

    gravity: float = 1.0
    loads: float = 1.0
    actuation: float = 1.0
    depth: float = 0.0
    face: str = ""


Variant = tuple[Stated, ...]
"""One for each pose; none where all are as they were stated."""


class Change(NamedTuple):
    """What would be different without a mistake: readings, or what was stated.

    Attributes:
        kind: The mistake.
        words: What would have to change.
        rank: Position among mistakes that explain the data as well: the simplest first.
        measured: Values of all rows.
        turned: Factor on the right of the orientation from which each turn counts [-];
            None where orientations stay.
        free: Errors that are fitted along, one column each; None without.
        scale: Factor on what was measured: what it leaves must be small beside it [-].
        variant: How each pose would be held and loaded.
        z: Where to simulate that first, scaled [-].
        expected: Squares that it should leave, by superposition; nan if not known.
    """

    kind: Kind
    words: str
    rank: int
    measured: Float[HostArray, "n_c n_rows 3"]
    turned: Float[HostArray, "n_c n_turns 3 3"] | None = None
    free: Float[HostArray, "n n_free"] | None = None
    scale: float = 1.0
    variant: Variant = ()
    z: Float[HostArray, " n_p"] = np.zeros(0)
    expected: float = np.nan

    @property
    def subject(self) -> tuple[str, ...]:
        """What it is about: its kind, and what would be stated otherwise."""
        fields = Stated._fields
        differ = lambda field: any(
            getattr(stated, field) != getattr(Stated(), field)
            for stated in self.variant
        )
        return (self.kind, *filter(differ, fields))


@dataclass(eq=False)
class Simulated:
    """Simulated values e of all rows at some z, and their compliances W_ep.

    Fits of changes about them, by the `id` of the change, take steps of lambda_p of at
    most `trust` [-].
    """

    z: Float[HostArray, " n_p"]
    e: Float[HostArray, "n_c n_rows 3"]
    W: Float[HostArray, "n_c n_rows 3 n_p"]
    trust: float = TRUST
    fits: "dict[int, Refit]" = field(default_factory=dict)


class Refit(NamedTuple):
    """The best fit to changed readings about a simulation.

    Attributes:
        change: The change.
        about: The simulation.
        step: The step of lambda_p [-].
        along: The errors that are fitted along.
        squares: Sum of squared errors, in stated standard deviations, and of distances
            from priors. Where readings shrink, those of readings of the old size.
        now: The same without the step of the parameters.
    """

    change: Change
    about: Simulated
    step: Float[HostArray, " n_p"]
    along: Float[HostArray, " n_free"]
    squares: float
    now: float

    @property
    def near(self) -> bool:
        """Whether the fit is so near to its simulation that it holds."""
        return bool(np.max(np.abs(self.step), initial=0.0) <= NEAR)


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


class Readings:
    """What was measured in the fitted configurations, and refits to it once changed.

    Attributes:
        space: The parameters.
        poses: Names of the configurations.
        points: Records of the measured points of each, by name.
        effectors: Arrays of the effectors, on the host.
        measured: All measured values.
        weight: 1 / standard deviations, 0 where nothing was measured.
        simulated: Values at the end of the fit.
        at_rest: Positions of the points on the undeformed robot; 0 for other rows [m].
        of_points: Which coordinates of points were measured.
        turn_rows: Rows of orientations.
    """

    def __init__(
        self,
        result: CalibrationResult,
        fits: Sequence[ConfigurationResult],
        problem: Problem,
    ):
        """Collect them, and weigh errors by the noise of the fit, its jitter aside."""
        assert result.noise is not None
        effectors = jax.tree.map(np.asarray, problem.configurations.effectors)
        self.space, self._noise, self.effectors = result.space, result.noise, effectors
        self.poses = problem.names
        self.points = [{e.name: e for e in f.points if e.seen.any()} for f in fits]
        self.measured, self.weight = effectors.measured, effectors.inverse_std
        self.at_rest, self.simulated = 0.0 * self.measured, 0.0 * self.measured
        self.of_points = np.zeros(self.measured.shape, bool)
        for c, fit in enumerate(fits):
            for e in fit.effectors:
                self.simulated[c, e.index, : len(e.std)] = e.simulated
            for e in self.points[c].values():
                self.at_rest[c, e.index] = e.at_rest
                self.of_points[c, e.index] = self.weight[c, e.index] > 0.0
        n_points, n_turns = effectors.nodes.shape[-2], effectors.turn_body.shape[-1]
        self.turn_rows = slice(n_points, n_points + n_turns)
        columns = self._noise.on_host(effectors) * float(np.asarray(self._noise.jitter))
        self._columns = columns[:, np.any(columns != 0.0, axis=0)]
        considered = result.linear.of_fit().considered.values
        known = np.zeros((self.weight.size, considered.shape[1]))
        known[np.ravel(self.weight > 0.0)] = considered
        self._all_stated = np.hstack([self._columns, known])

    def in_words(self, poses: Sequence[int]) -> str:
        """Write "all poses", "pose 2", or nothing where there is only one."""
        if len(poses) == len(self.poses):
            return " in all poses" if len(poses) > 1 else ""
        return f" in {self.poses[poses[0]]}"

    def whiten(self, x: Float[HostArray, "n k"]) -> Float[HostArray, "n k"]:
        """Make the errors of all rows independent."""
        return whitened(self._columns, x)

    def _off(self, fit: Refit) -> Float[HostArray, "n_c n_rows 3"]:
        """Return simulated minus changed values after a fit."""
        off, W = self._linear(fit.about, fit.change)
        off = off + W @ fit.step
        if fit.change.free is not None:
            along = (fit.change.free @ fit.along).reshape(off.shape)
            off += along / np.where(self.of_points, self.weight, 1.0)
        return off

    def level(self, fit: Refit) -> float:
        """Return the errors after a fit over those that were stated, all causes [-]."""
        errors = np.ravel(self.weight * self._off(fit))[:, None]
        squares = np.sum(whitened(self._all_stated, errors) ** 2)
        return float(np.sqrt(squares / np.sum(self.weight > 0.0)))

    def rms(self, fit: Refit) -> float:
        """Return the root mean square distance of points after a fit [m]."""
        seen = self.of_points
        effectors = self.effectors
        off = self._noise.without_attachments(effectors, self._off(fit))
        squares = np.sum(np.where(seen, off, 0.0) ** 2, axis=2)[np.any(seen, axis=2)]
        return float(np.sqrt(np.mean(squares))) if squares.size else float("nan")

    def fit(self, about: Simulated, changes: Sequence[Change], limit: float) -> None:
        """Fit changes about a simulation, where that is not done yet.

        Where a step would leave its bounds, and even so would leave more than the
        `limit` of the squares, it is only estimated.
        """
        groups: dict[Hashable, list[Change]] = {}
        for change in changes:  # those with the same unknowns together
            if id(change) not in about.fits:
                alone = None if change.turned is None else id(change)
                groups.setdefault((id(change.free), alone), []).append(change)
        if not groups:
            return
        weight, n_p, z = self.weight, len(about.z), jnp.asarray(about.z)
        low, high = map(np.asarray, self.space.room(z))
        box = np.clip(low, -about.trust, 0.0), np.clip(high, 0.0, about.trust)
        off_prior = np.asarray(self.space.from_prior(z))[:, None]
        prior_rows = np.diag(self.space.prior_weights())
        for group in groups.values():
            linear, m = [self._linear(about, change) for change in group], len(group)
            parts = [(weight[..., None] * linear[0][1]).reshape(-1, n_p)]
            parts += [] if group[0].free is None else [group[0].free]
            parts += [np.ravel(weight * off)[:, None] for off, _ in linear]
            of_data = self.whiten(np.hstack(parts))
            of_prior = np.zeros((n_p, of_data.shape[1]))
            of_prior[:, :n_p], of_prior[:, -m:] = prior_rows, off_prior
            A, Y = np.split(np.concatenate([of_data, of_prior]), [-m], axis=1)
            X = _fitted(A, Y, box, limit)
            squares = np.sum((Y + A @ X) ** 2, axis=0)
            now = np.sum(_beside(A[:, n_p:], Y) ** 2, axis=0)
            for change, x, *sums in zip(group, X.T, squares, now, strict=True):
                after, before = map(float, sums)
                after *= max(1.0, 1.0 / change.scale) ** 2
                fit = Refit(change, about, x[:n_p], x[n_p:], after, before)
                about.fits[id(change)] = fit

    def _linear(self, about: Simulated, change: Change) -> tuple[HostArray, HostArray]:
        """Return simulated minus changed values, 0 where not measured, and their W."""
        off, W, rows = about.e - change.measured, about.W, self.turn_rows
        if change.turned is not None:
            turned, J = _turned(off[:, rows], change.turned)
            off[:, rows], W = turned, W.copy()
            W[:, rows] = np.asarray(J) @ W[:, rows]
        return np.where(self.weight > 0.0, off, 0.0), W


def _beside(columns: HostArray, x: HostArray) -> HostArray:
    """Return what columns leave of others."""
    basis = span(columns)
    return x - basis @ (basis.T @ x)


def _fitted(
    A: Float[HostArray, "n k"],
    Y: Float[HostArray, "n m"],
    box: tuple[HostArray, HostArray],
    limit: float,
) -> Float[HostArray, "k m"]:
    """Minimise |y + A x| for each column y, the first entries of x within the box."""
    n_p = len(box[0])
    W, off = _beside(A[:, n_p:], A[:, :n_p]), _beside(A[:, n_p:], Y)
    Z = -np.linalg.lstsq(W, off, rcond=RANK)[0]
    left = np.sum((off + W @ Z) ** 2, axis=0)
    low, high = (end[:, None] for end in box)
    for k in np.flatnonzero(np.any((Z < low) | (Z > high), axis=0)):
        if n_p > 1 and left[k] <= limit:
            Z[:, k] = lsq_linear(W, -off[:, k], box).x
    Z = np.clip(Z, low, high)
    along = -np.linalg.lstsq(A[:, n_p:], Y + A[:, :n_p] @ Z, rcond=RANK)[0]
    return np.concatenate([Z, along])


@jax.jit
@jax.vmap
@jax.vmap
def _turned(w: Float[Array, "3"], U: Float[Array, "3 3"]) -> tuple[Array, Array]:
    """Compute log(exp(w) U), and its change per change of w."""
    turned = lambda w: rotation_vector(rotation_matrix(w) @ U)
    return turned(w), jax.jacfwd(turned)(w)
