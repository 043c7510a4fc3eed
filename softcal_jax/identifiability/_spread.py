"""Spread of parameters and directions by noise and errors, and the verdict on it."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import listed
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.inference import RANK, LinearModel

Verdict = Literal["identifiable", "weakly identifiable", "not identifiable"]

IDENTIFIABLE_UP_TO = 1.0
"""Standard error, over the asked one, up to which a parameter is identifiable [-]."""

WEAK_UP_TO = 3.0
"""The same up to which it is weakly identifiable [-].

With the default precision that is 30 % of a value, or 17 degrees of an axis: an order
of magnitude, which no part can be designed with.
"""

SHARE = 0.1
"""Squared component of a unit vector from which on its parameter is named [-]."""

MOST_NAMED = 4
"""Most parameters named for a direction, so that its text stays readable."""

LOST = 30.0
"""Standard error, over the asked one, above which a direction counts as unseen [-].

Three times a value or more is no knowledge of it, so such directions are
interchangeable and any basis of their span is as good as another.
"""


class Direction(Module):
    """A combination of parameters, and how well the data see it.

    Attributes:
        components: Its unit vector, parameters in units of their asked standard errors
            [-].
        ratio: Largest standard error, over the asked one, that it alone gives to a
            parameter; infinite where neither data nor prior see it [-].
        verdict: Verdict on the ratio.
        words: Its main parameters, in words.
    """

    components: Float[HostArray, " n_p"]
    ratio: float
    verdict: Verdict
    words: str


class Spread(Module):
    """Covariance of parameters in units of their asked standard errors.

    Attributes:
        factor: F of the covariance F F^T, which holds along what is seen [-].
        unseen: Orthonormal directions that neither data nor prior see, as rows [-].
        blind: Parameters with a component in one of these.
    """

    factor: Float[HostArray, "n_p n"]
    unseen: Float[HostArray, "n_unseen n_p"]
    blind: Bool[HostArray, " n_p"]

    def errors(self) -> Float[HostArray, " n_p"]:
        """Return standard errors of the parameters, infinite for blind ones [-]."""
        return np.where(self.blind, np.inf, np.linalg.norm(self.factor, axis=1))

    def covariance(self) -> Float[HostArray, "n_p n_p"]:
        """Return their covariance; of blind ones infinite, and nan with others [-]."""
        full = self.factor @ self.factor.T
        full[self.blind] = full[:, self.blind] = np.nan
        full[self.blind, self.blind] = np.inf
        return full

    def along(self, rows: Float[HostArray, "n n_p"]) -> Float[HostArray, " n"]:
        """Return standard errors of linear functions of the parameters [-].

        Args:
            rows: Their derivatives by the parameters, in units of the asked errors.
        """
        size = np.linalg.norm(rows, axis=1)
        astray = np.linalg.norm(rows @ self.unseen.T, axis=1) > RANK * size
        return np.where(astray, np.inf, np.linalg.norm(rows @ self.factor, axis=1))


def verdict(ratio: float) -> Verdict:
    """Judge a standard error over the asked one [-]."""
    if ratio <= IDENTIFIABLE_UP_TO:
        return "identifiable"
    return "weakly identifiable" if ratio <= WEAK_UP_TO else "not identifiable"


def spread_of(linear: LinearModel) -> Spread:
    """Compute the covariance of an estimate from data and priors.

    That of the noise and the priors, C, plus D D^T with D = -G W_c of the errors that
    are considered, as in `ErrorBudget`. Bounds are no measurement: what neither data
    nor prior see has no finite error.

    Args:
        linear: The fit, its unknowns in units of their asked standard errors, so that
            moduli and angles are comparable.
    """
    seen = linear.solution
    moved = -linear.pull() @ linear.considered.values
    factor = np.concatenate([linear.scale * seen.factor, moved], axis=1)
    return Spread(factor, seen.unseen, seen.blind)


def information(linear: LinearModel) -> Float[HostArray, "n_p n_p"]:
    """Compute the information of the data alone: the inverse of `spread_of`'s.

    W^T U (I + B B^T)^-1 U^T W with whitened W = U S V^T and B = U^T W_c, which exists
    where the covariance does not.

    Args:
        linear: The fit, in the units of `spread_of`.
    """
    fit = linear.of_fit()
    W, W_c = (fit.whiten(x) / fit.scale for x in (fit.W, fit.considered.values))
    U, singular, Vt = np.linalg.svd(W, full_matrices=False)
    B = U.T @ W_c
    A = singular[:, None] * Vt
    return A.T @ np.linalg.solve(np.eye(len(B)) + B @ B.T, A)


def count_informed(
    J: Float[HostArray, "n_p n_p"], weights: Float[HostArray, " n_p"]
) -> int:
    """Count the directions along which the data, J, tell more than the prior.

    Where there is none, they must tell enough for "weakly identifiable".
    """
    scale = np.where(weights > 0.0, weights, 1.0 / WEAK_UP_TO)
    return int(np.sum(np.linalg.eigvalsh(J / np.outer(scale, scale)) > 1.0))


def named_directions(spread: Spread, names: Sequence[str]) -> tuple[Direction, ...]:
    """Find the principal directions of a covariance, best seen first (Sec. V-C).

    They are the right singular vectors of G where nothing but the noise is uncertain.
    The unseen directions have an arbitrary basis; it is replaced by one whose vectors
    each follow few parameters.
    """
    *_, basis = np.linalg.svd(spread.unseen)
    within = basis[len(spread.unseen) :]
    V, std, _ = np.linalg.svd(within @ spread.factor, full_matrices=False)
    rows = V.T @ within
    far = std * np.max(np.abs(rows), axis=1, initial=0.0) > LOST
    lost = np.concatenate([rows[far], spread.unseen])
    rows = np.concatenate([rows[~far], _separated(lost) if len(lost) else lost])
    ratios = spread.along(rows) * np.max(np.abs(rows), axis=1, initial=0.0)
    directions = []
    for row in np.argsort(ratios, kind="stable"):
        v = rows[row] * np.sign(rows[row, np.argmax(np.round(np.abs(rows[row]), 6))])
        directions.append(
            Direction(
                components=v,
                ratio=float(ratios[row]),
                verdict=verdict(float(ratios[row])),
                words=direction_words(v, names),
            )
        )
    return tuple(directions)


def _separated(V: Float[HostArray, "n n_p"]) -> Float[HostArray, "n n_p"]:
    """Find orthonormal rows of the same span, each close to one parameter.

    With P the projector on the span, P e_i is its vector closest to parameter i. The
    longest is taken first and removed from P (a QR with column pivoting).
    """
    P = V.T @ V
    rows = []
    for _ in V:
        pivot = np.argmax(np.round(np.diag(P), 6))
        rows.append(P[pivot] / np.linalg.norm(P[pivot]))
        P = P - np.outer(rows[-1], rows[-1])
    return np.stack(rows)


def direction_words(v: Float[HostArray, " n_p"], names: Sequence[str]) -> str:
    """Describe a unit vector, as in "E_t of CP 1 up while theta of CP 2 down".

    Parameters with a squared component of at least `SHARE` are named, the largest
    first, or the largest few if there are none.
    """
    # Rounded, so that equal components keep the order of the parameters.
    order = sorted(range(len(v)), key=lambda i: -round(float(v[i] ** 2), 6))
    large = [i for i in order if v[i] ** 2 >= SHARE]
    named = (large or order)[:MOST_NAMED]
    more = len(large or order) - len(named)
    sign = np.sign(v[named[0]])
    up = [names[i] for i in named if v[i] * sign > 0]
    down = [names[i] for i in named if v[i] * sign < 0]
    rest = f" and {more} more" if more > 0 else ""
    if not down:
        together = " up together" if len(up) > 1 or rest else ""
        return f"{listed(up)}{rest}{together}"
    return f"{listed(up)} up while {listed(down)} down{rest}"
