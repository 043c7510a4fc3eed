"""A linear fit to changed readings, about a simulation.

The errors r + W dz are weighed as stated, offsets of recordings and attachments
included, and dz stays within the bounds of the parameters: what a calibration to the
changed readings would do in its next step (Eq. 10).
"""

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CorrelatedNoise
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import RANK, span, whitened
from softcal_jax.mistakes._readings import Change, Readings
from softcal_jax.mistakes._simulator import Simulated

TINY = 1e-9
"""Width of the box of a parameter on a bound: `lsq_linear` needs one [-]."""

TRUST = 1.0
"""Largest step of lambda_p about a simulation: a factor e of a modulus [-]."""


class Refit(NamedTuple):
    """The best fit to changed readings about a simulation.

    Attributes:
        squares: Sum of squared errors, in stated standard deviations, and of distances
            from priors.
        now: The same without the step of the parameters.
        step: The step dz [-], then the errors that are fitted along.
    """

    squares: float
    now: float
    step: Float[HostArray, " n_unknowns"]


class Refitter:
    """Fits changed readings about simulations.

    Attributes:
        space: The parameters.
        readings: What was measured.
    """

    def __init__(
        self, space: ParameterSpace, noise: CorrelatedNoise, readings: Readings
    ):
        """Weigh errors as stated: by the noise of a fit, its jitter aside."""
        self.space, self.readings, self._noise = space, readings, noise
        self._bounds = np.asarray(space.lower()), np.asarray(space.upper())
        self._periodic = np.array([q.periodic for q in space.parameters])
        self._prior_weights = np.asarray(space.prior_weights())
        columns = noise.on_host(readings.effectors) * float(np.asarray(noise.jitter))
        self._columns = columns[:, np.any(columns != 0.0, axis=0)]

    def __len__(self) -> int:
        """Return the number of measured coordinates."""
        return int(np.sum(self.readings.weight > 0.0))

    def whiten(self, x: Float[HostArray, "n k"]) -> Float[HostArray, "n k"]:
        """Make the errors of all rows independent."""
        return whitened(self._columns, x)

    def errors(
        self, simulated: Simulated, change: Change
    ) -> Float[HostArray, "n_c n_rows 3"]:
        """Return simulated minus changed values; 0 where nothing was measured."""
        off = simulated.e - change.measured
        if change.turned is not None:
            rows = self.readings.turn_rows
            off[:, rows] = _turned(off[:, rows], change.turned)
        return np.where(self.readings.weight > 0.0, off, 0.0)

    def rms(self, simulated: Simulated, change: Change, step: HostArray) -> float:
        """Return the root mean square distance of points after a step [m]."""
        off = self.errors(simulated, change) + simulated.W @ step[: len(simulated.z)]
        weight = self.readings.weight * self.readings.of_points
        if change.free is not None:
            free = change.free @ step[len(simulated.z) :]
            off += free.reshape(off.shape) / np.where(weight > 0.0, weight, 1.0)
        off = self._noise.without_attachments(self.readings.effectors, off)
        points = np.any(weight > 0.0, axis=2)
        if not points.any():
            return float("nan")
        return float(
            np.sqrt(np.sum(np.where(weight > 0.0, off, 0.0) ** 2) / points.sum())
        )

    def fit(
        self,
        simulated: Simulated,
        changes: Sequence[Change],
        trust: float = TRUST,
        limit: float = np.inf,
    ) -> list[Refit]:
        """Fit each of the changed readings, with steps of at most `trust` [-].

        Where a step would leave its bounds, and even so would leave more than the
        `limit` of the squares, it is only estimated.
        """
        box = self._box(simulated.z, trust)
        prior = np.asarray(self.space.from_prior(jnp.asarray(simulated.z)))
        groups: dict[Hashable, list[int]] = {}
        for k, change in enumerate(changes):  # those with the same unknowns together
            alone = None if change.turned is None else k
            groups.setdefault((id(change.free), alone), []).append(k)
        fits: dict[int, Refit] = {}
        for group in groups.values():
            A = self._columns_of(simulated, changes[group[0]])
            Y = self._rows_of(simulated, [changes[k] for k in group], prior)
            for k, one in zip(group, _fitted(A, Y, box, limit), strict=True):
                fits[k] = one
        return [fits[k] for k in range(len(changes))]

    def _box(self, z: HostArray, trust: float) -> tuple[HostArray, HostArray]:
        """Return the limits of a step."""
        low, high = (end - z for end in self._bounds)
        low = np.where(self._periodic, -np.inf, low)
        high = np.where(self._periodic, np.inf, high)
        return np.clip(low, -trust, 0.0), np.clip(high, 0.0, trust)

    def _columns_of(self, simulated: Simulated, change: Change) -> HostArray:
        """Return the change of whitened rows and of priors per unit of each unknown."""
        W = self.readings.weight[..., None] * simulated.W
        if change.turned is not None:
            rows = self.readings.turn_rows
            off = simulated.e[:, rows] - change.measured[:, rows]
            J = _change_of_turns(off, _turned(off, change.turned))
            W[:, rows] = self.readings.weight[:, rows, :, None] * (
                J @ simulated.W[:, rows]
            )
        n_p = len(simulated.z)
        parts = [W.reshape(-1, n_p), *([] if change.free is None else [change.free])]
        of_data = self.whiten(np.concatenate(parts, axis=1))
        of_prior = np.zeros((n_p, of_data.shape[1]))
        of_prior[:, :n_p] = np.diag(self._prior_weights)
        return np.concatenate([of_data, of_prior])

    def _rows_of(
        self, simulated: Simulated, changes: Sequence[Change], prior: HostArray
    ) -> HostArray:
        """Return whitened errors and distances from priors, one column per change."""
        weight = self.readings.weight
        r = [np.ravel(weight * self.errors(simulated, change)) for change in changes]
        of_prior = np.repeat(prior[:, None], len(changes), axis=1)
        return np.concatenate([self.whiten(np.stack(r, axis=1)), of_prior])


def _fitted(
    A: Float[HostArray, "n k"],
    Y: Float[HostArray, "n m"],
    box: tuple[HostArray, HostArray],
    limit: float,
) -> list[Refit]:
    """Minimise |y + A x| for each column y, the first entries of x within the box."""
    n_p = len(box[0])
    free = span(A[:, n_p:])
    beside = lambda x: x - free @ (free.T @ x)
    W, off = beside(A[:, :n_p]), beside(Y)
    Z = -np.linalg.lstsq(W, off, rcond=RANK)[0]
    left = np.sum((off + W @ Z) ** 2, axis=0)
    low, high = (end[:, None] for end in box)
    for k in np.flatnonzero(np.any((Z < low) | (Z > high), axis=0)):
        if n_p > 1 and left[k] <= limit:
            Z[:, k] = lsq_linear(W, -off[:, k], (box[0] - TINY, box[1] + TINY)).x
    Z = np.clip(Z, low, high)
    squares, now = np.sum((off + W @ Z) ** 2, axis=0), np.sum(off**2, axis=0)
    along = -np.linalg.lstsq(A[:, n_p:], Y + A[:, :n_p] @ Z, rcond=RANK)[0]
    each = zip(squares, now, np.concatenate([Z, along]).T, strict=True)
    return [Refit(float(after), float(before), x) for after, before, x in each]


def _turned(w: Float[HostArray, "*n 3"], U: Float[HostArray, "*n 3 3"]) -> HostArray:
    """Compute log(exp(w) U)."""
    turns = Rotation.from_rotvec(w.reshape(-1, 3)) * Rotation.from_matrix(
        U.reshape(-1, 3, 3)
    )
    return turns.as_rotvec().reshape(w.shape)


def _change_of_turns(
    before: Float[HostArray, "*n 3"], after: Float[HostArray, "*n 3"]
) -> Float[HostArray, "*n 3 3"]:
    """Compute d after / d before for after = log(exp(before) U): J(after)^-1 J(before).

    J(w) is the left Jacobian of the exponential (Sola et al., arXiv:1812.01537, 145).
    """
    return np.linalg.solve(_left_jacobian(after), _left_jacobian(before))


def _left_jacobian(w: Float[HostArray, "*n 3"]) -> Float[HostArray, "*n 3 3"]:
    angle = np.maximum(np.linalg.norm(w, axis=-1), 1e-6)[..., None, None]
    K = np.cross(w[..., None, :], -np.eye(3))
    first = (1.0 - np.cos(angle)) / angle**2
    return np.eye(3) + first * K + (angle - np.sin(angle)) / angle**3 * K @ K
