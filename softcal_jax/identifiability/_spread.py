"""Spread of parameters and directions given noise and prior, and the verdict on it."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields import ParameterSpace

Verdict = Literal["identifiable", "weakly identifiable", "not identifiable"]

IDENTIFIABLE_BELOW = 0.1
"""Spread below which a parameter is identifiable [-].

The spread is the predicted standard deviation over the prior one. At 0.1 the data hold
99 % of the information, and the standard deviation is 2.9 % of the range.
"""

WEAK_BELOW = 0.5
"""Spread above which a parameter is not identifiable [-].

At 0.5 the data hold three quarters of the information; above it, the value depends too
much on the bounds that the user chose.
"""

BLIND = 1e-6
"""Singular value below which a direction is only rounding, for unit columns [-]."""

VANISHED = 1e-12
"""Relative sensitivity below which a parameter has no effect [-]."""

SHARE = 0.1
"""Squared component of a unit vector from which on its parameter is named [-]."""

MOST_NAMED = 4
"""Most parameters named for a direction, so that its text stays readable."""

UNSEEN = 0.1
"""Signal to noise below which a direction counts as unseen [-].

The data reduce its prior standard deviation by less than 0.5 %, so such directions are
interchangeable and any basis of their span is as good as another.
"""


class Direction(eqx.Module):
    """A combination of parameters, and how well the data see it.

    Attributes:
        signal: Change of the data per prior standard deviation along it, in units of
            the noise [-].
        components: Its unit vector, parameters in prior standard deviations [-].
        spread: Predicted over prior standard deviation [-].
        verdict: Verdict on the spread.
        words: Its main parameters, in words.
    """

    signal: float
    components: Float[HostArray, " n_p"]
    spread: float
    verdict: Verdict
    words: str


def verdict(spread: float) -> Verdict:
    """Judge a spread, the predicted over the prior standard deviation [-]."""
    if spread < IDENTIFIABLE_BELOW:
        return "identifiable"
    return "weakly identifiable" if spread <= WEAK_BELOW else "not identifiable"


def prior_std(space: ParameterSpace) -> Float[HostArray, " n_p"]:
    """Compute the standard deviation of the scaled parameters before any data [-].

    It is that of a uniform density between the bounds, or the `prior_std` of the
    parameter if that is smaller.
    """
    bounds = np.asarray(space.upper() - space.lower()) / np.sqrt(12.0)
    return 1.0 / np.maximum(1.0 / bounds, np.asarray(space.prior_weights()))


def si_slope(
    space: ParameterSpace, z: Float[Array | HostArray, " n_p"]
) -> Float[HostArray, " n_p"]:
    """Compute |dp/dz| of each parameter, in its SI unit per unit of z."""
    z = jnp.asarray(z)
    _, slope = jax.jvp(space.from_scaled, (z,), (jnp.ones_like(z),))
    return np.abs(np.asarray(slope))


# Below, G is the signal to noise: noise-weighted compliances per prior standard
# deviation, so that moduli and angles are comparable [-].


def posterior(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, "n_p n_p"]:
    """Compute the covariance (I + G^T G)^-1 in units of the prior standard deviations.

    Linear-Gaussian Bayes (Tarantola, Inverse Problem Theory, 2005, ch. 3): the Fisher
    information of the data plus that of the prior, so the inverse always exists; a
    blind direction keeps a variance of one.
    """
    _, singular, Vt = np.linalg.svd(G)
    variance = np.ones(G.shape[1])
    variance[: len(singular)] = np.hypot(1.0, singular) ** -2.0
    return (Vt.T * variance) @ Vt


def marginalised(
    G: Float[HostArray, "n_e n_p"], W_c: Float[HostArray, "n_e n_errors"]
) -> Float[HostArray, "n n_p"]:
    """Find compliances that would tell as much if the noise were the only error.

    With C = (I + G^T G)^-1 the errors W_c move the parameters by D = C G^T W_c, so that
    their covariance is T = C + D D^T. The result R has the same, (I + R^T R)^-1 = T,
    where T is not larger than that of the prior.

    Args:
        G: Noise-weighted compliances per prior standard deviation [-].
        W_c: Noise-weighted change of the data per standard deviation of each error that
            is considered, see `ErrorBudget` [-].
    """
    if W_c.shape[1] == 0:
        return G
    C = posterior(G)
    D = C @ G.T @ W_c
    variance, V = np.linalg.eigh(C + D @ D.T)
    variance = np.clip(variance, np.finfo(float).eps, 1.0)  # rounding, or the prior
    return np.sqrt(1.0 / variance - 1.0)[:, None] * V.T


def data_only_std(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, " n_p"]:
    """Compute standard deviations from the data alone, roots of diag((G^T G)^-1).

    They are in units of the prior's, and infinite for parameters with a component in a
    blind direction [-].
    """
    std = np.full(G.shape[1], np.inf)
    size = np.linalg.norm(G, axis=0)
    seen = size > VANISHED * np.max(size, initial=0.0)
    if not np.any(seen):
        return std
    _, singular, Vt = np.linalg.svd(G[:, seen] / size[seen])
    known = np.zeros(len(Vt), bool)
    known[: len(singular)] = singular > BLIND * singular[0]
    variance = np.sum((Vt[known].T / singular[known[: len(singular)]]) ** 2, axis=1)
    # Any component above rounding in a blind direction makes a parameter uncertain.
    drifts = np.max(np.abs(Vt[~known]), axis=0, initial=0.0) > BLIND
    std[seen] = np.where(drifts, np.inf, np.sqrt(variance) / size[seen])
    return std


def named_directions(
    G: Float[HostArray, "n_e n_p"], names: Sequence[str]
) -> tuple[Direction, ...]:
    """Find the right singular vectors of G, best seen first (Sec. V-C).

    The SVD gives an arbitrary basis of the unseen directions; it is replaced by one
    whose vectors each follow few parameters.
    """
    _, singular, Vt = np.linalg.svd(G)
    signal = np.pad(singular, (0, len(Vt) - len(singular)))
    unseen = signal < UNSEEN
    if np.any(unseen):
        Vt[unseen] = _separated(Vt[unseen])
        signal[unseen] = np.linalg.norm(G @ Vt[unseen].T, axis=0)
    directions = []
    for row in np.argsort(-signal, kind="stable"):
        v = Vt[row] * np.sign(Vt[row, np.argmax(np.round(np.abs(Vt[row]), 6))])
        spread = float(1.0 / np.hypot(1.0, signal[row]))
        directions.append(
            Direction(
                signal=float(signal[row]),
                components=v,
                spread=spread,
                verdict=verdict(spread),
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
        return f"{_listed(up)}{rest}{together}"
    return f"{_listed(up)} up while {_listed(down)} down{rest}"


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
