"""What a candidate configuration adds to what is known."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from softcal_jax._units import readable_unit
from softcal_jax.identifiability._display import number, table

HARDLY = 1.05
"""Factor on a standard error below which a candidate hardly helps [-]."""


class Gain(eqx.Module):
    """What one candidate would add if it were measured as well.

    Attributes:
        name: Name of the candidate.
        d_gain: Twice the decrease of the log volume of the parameters' uncertainty,
            log det(M + J) - log det M [nat].
        e_gain: Increase of the smallest eigenvalue of M, in units of the prior's [-].
        blind_left: Number of directions that it leaves unidentifiable.
        parameter: Parameter whose standard error falls most, relative to its prior.
        before: Its standard error without the candidate, in SI.
        after: Its standard error with it, in SI.
        value: Its value, in SI.
        unit: Its SI unit.
    """

    name: str
    d_gain: float
    e_gain: float
    blind_left: int
    parameter: str
    before: float
    after: float
    value: float
    unit: str

    @property
    def volume(self) -> float:
        """Factor on the volume of the uncertainty ellipsoid, exp(-d_gain / 2) [-]."""
        return float(np.exp(-0.5 * self.d_gain))

    @property
    def effect(self) -> str:
        """The standard error that falls most, like "E of tip: 101 to 4.1 kPa"."""
        factor, unit = readable_unit([self.value], self.unit)
        before, after = number(factor * self.before), number(factor * self.after)
        return f"{self.parameter}: {before} to {after} {unit}".rstrip()

    @property
    def words(self) -> str:
        """What the candidate does, as the end of a sentence."""
        ratio = self.before / self.after
        if ratio < HARDLY:
            return "hardly changes any standard error"
        return f"divides a standard error by {number(ratio, 2)}, of {self.effect}"


class Unranked(eqx.Module):
    """A candidate that cannot be ranked.

    Attributes:
        name: Its name.
        reason: Why it cannot be ranked.
    """

    name: str
    reason: str

    def __str__(self) -> str:
        """Format the name and the reason in one line."""
        return f"Not ranked: {self.name!r}: {self.reason}."


def gain_table(gains: Sequence[Gain], n_parameters: int) -> list[str]:
    """Format a table with one row per gain."""
    words = "candidate, D gain [nat], volume, E gain, blind left, standard error"
    rows = [
        (
            gain.name,
            number(gain.d_gain),
            number(gain.volume),
            number(gain.e_gain),
            f"{gain.blind_left} of {n_parameters}",
            gain.effect,
        )
        for gain in gains
    ]
    return table(tuple(words.split(", ")), rows)
