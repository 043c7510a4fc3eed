"""Directions of the parameters, from the best to the worst seen, in words."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.identifiability._spread import Verdict, verdict

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


def named_directions(
    G: Float[HostArray, "n_e n_p"], names: Sequence[str]
) -> tuple[Direction, ...]:
    """Find the right singular vectors of G, best seen first (Sec. V-C).

    Parameters are in units of their prior standard deviation, so that moduli and angles
    are comparable. The SVD gives an arbitrary basis of the unseen directions; it is
    replaced by one whose vectors each follow few parameters.

    Args:
        G: Noise-weighted compliances per prior standard deviation [-].
        names: Names of the parameters.

    Returns:
        One direction per parameter.
    """
    _, singular, Vt = np.linalg.svd(G)
    signal = np.pad(singular, (0, len(Vt) - len(singular)))
    unseen = signal < UNSEEN
    if np.any(unseen):
        Vt[unseen] = _separated(Vt[unseen])
        signal[unseen] = np.linalg.norm(G @ Vt[unseen].T, axis=0)
    order = np.argsort(-signal, kind="stable")
    directions = []
    for row in order:
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
    """Describe a direction, as in "E_t of CP 1 up while theta of CP 2 down".

    Args:
        v: Unit vector.
        names: Names of the parameters.

    Returns:
        The parameters with a squared component of at least `SHARE`, largest first, or
        the largest few if there are none.
    """
    # Rounded, so that equal components keep the order of the parameters.
    order = sorted(range(len(v)), key=lambda i: -round(float(v[i] ** 2), 6))
    large = [i for i in order if v[i] ** 2 >= SHARE]
    named = (large or order)[:MOST_NAMED]
    more = len(large) - len(named) if large else len(v) - len(named)
    sign = np.sign(v[named[0]])
    up = [names[i] for i in named if v[i] * sign > 0]
    down = [names[i] for i in named if v[i] * sign < 0]
    rest = f" and {more} more" if more > 0 else ""
    if not down:
        together = " up together" if len(up) > 1 or rest else ""
        return f"{_listed(up)}{rest}{together}"
    return f"{_listed(up)} up while {_listed(down)} down{rest}"


def _listed(names: Sequence[str]) -> str:
    if len(names) == 1:
        return names[0]
    return f"{', '.join(names[:-1])} and {names[-1]}"
