"""A linear fit to changed readings, about a simulation.

The errors r + W dz are weighed as stated, offsets of recordings and attachments
included, and dz stays within the bounds of the parameters: what a calibration to the
changed readings would do in its next step (Eq. 10).
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.bodies import rotation_matrix, rotation_vector
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import RANK, span, whitened
from softcal_jax.mistakes._readings import Change, Readings
from softcal_jax.unknowns import CorrelatedNoise

TRUST = 1.0  # largest step of lambda_p about a simulation: a factor e of a modulus [-]

NEAR = 0.1
"""Step up to which a linear fit holds; its error is about half its square [-]."""


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


class Refitter:
    """Fits changed readings about simulations."""

    def __init__(
        self,
        space: ParameterSpace,
        noise: CorrelatedNoise,
        readings: Readings,
        considered: Float[HostArray, "n_measured n_errors"],
    ):
        """Weigh errors as stated: by the noise of a fit, its jitter aside."""
        self.space, self.readings, self._noise = space, readings, noise
        columns = noise.on_host(readings.effectors) * float(np.asarray(noise.jitter))
        self._columns = columns[:, np.any(columns != 0.0, axis=0)]
        known = np.zeros((columns.shape[0], considered.shape[1]))
        known[np.ravel(readings.weight > 0.0)] = considered
        self._all_stated = np.hstack([self._columns, known])

    def whiten(self, x: Float[HostArray, "n k"]) -> Float[HostArray, "n k"]:
        """Make the errors of all rows independent."""
        return whitened(self._columns, x)

    def _off(self, fit: Refit) -> Float[HostArray, "n_c n_rows 3"]:
        """Return simulated minus changed values after a fit."""
        off, W = self._linear(fit.about, fit.change)
        off = off + W @ fit.step
        if fit.change.free is not None:
            along = (fit.change.free @ fit.along).reshape(off.shape)
            off += along / np.where(self.readings.of_points, self.readings.weight, 1.0)
        return off

    def level(self, fit: Refit) -> float:
        """Return the errors after a fit over those that were stated, all causes [-]."""
        errors = np.ravel(self.readings.weight * self._off(fit))[:, None]
        squares = np.sum(whitened(self._all_stated, errors) ** 2)
        return float(np.sqrt(squares / np.sum(self.readings.weight > 0.0)))

    def rms(self, fit: Refit) -> float:
        """Return the root mean square distance of points after a fit [m]."""
        seen = self.readings.of_points
        effectors = self.readings.effectors
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
        weight, n_p, z = self.readings.weight, len(about.z), jnp.asarray(about.z)
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
        off, W, rows = about.e - change.measured, about.W, self.readings.turn_rows
        if change.turned is not None:
            turned, J = _turned(off[:, rows], change.turned)
            off[:, rows], W = turned, W.copy()
            W[:, rows] = np.asarray(J) @ W[:, rows]
        return np.where(self.readings.weight > 0.0, off, 0.0), W


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
