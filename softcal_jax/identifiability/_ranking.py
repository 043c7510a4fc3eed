"""Rank configurations that might be measured next."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import Uncertain
from softcal_jax.identifiability._identify import (
    AnyVector,
    Parameters,
    Sensed,
    Survey,
    in_noise_units,
    survey,
)
from softcal_jax.identifiability._result import number, table
from softcal_jax.identifiability._spread import (
    WEAK_BELOW,
    marginalised,
    posterior,
    prior_std,
    si_slope,
)

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


class Ranking(eqx.Module):
    """Candidates, the most informative first.

    Attributes:
        gains: One entry per candidate that can be ranked.
        unranked: The others, with the reason.
        n_parameters: Number of parameters.
        blind_before: Number of directions that no measured configuration identifies.
    """

    gains: tuple[Gain, ...]
    unranked: tuple[Unranked, ...]
    n_parameters: int
    blind_before: int

    def __str__(self) -> str:
        """Describe the best candidate, and tabulate all."""
        if not self.gains:
            return "\n".join(["No candidate can be ranked.", *map(str, self.unranked)])
        best, n_p = self.gains[0], self.n_parameters
        head = "candidate, D gain [nat], volume, E gain, blind left, standard error"
        rows = [
            (
                gain.name,
                *map(number, (gain.d_gain, gain.volume, gain.e_gain)),
                f"{gain.blind_left} of {n_p}",
                gain.effect,
            )
            for gain in self.gains
        ]
        return "\n".join(
            [
                f"Candidate {best.name!r} adds most: it {best.words}.",
                *table(tuple(head.split(", ")), rows),
                f"Without a candidate {self.blind_before} of {n_p} directions are "
                "blind. Volume: factor on that of the uncertainty, exp(-D gain / 2). E "
                "gain: information added where there is least, in units of what bounds "
                "and priors know.",
                *map(str, self.unranked),
            ]
        )


def rank_configurations(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    candidates: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
) -> Ranking:
    """Rank candidate configurations by what they would tell, before measuring.

    Let G be the compliances in units of the noise per prior standard deviation,
    M = I + G^T G the information of prior and configurations, and J = G_c^T G_c that of
    a candidate. Candidates are ordered by log det(M + J) - log det M (D-optimality;
    Chaloner and Verdinelli, Statistical Science 10, 1995). The increase of the smallest
    eigenvalue of M (E-optimality) is given too: D rewards shrinking any direction of
    the uncertainty, E only the worst one.

    Args:
        model: The model.
        parameters: Parameters that are, or would be, calibrated.
        configurations: Configurations measured already; may be empty.
        candidates: Configurations that might be measured, with any loads, orientation,
            supports and markers, and with names of their own.
        at: Scaled values z to linearise at, such as `CalibrationResult.z`; the start
            by default [-].
        noise: Standard deviation of every measured coordinate; by default that of the
            markers [m].
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated; the defaults of
            `Uncertain` by default.

    Returns:
        The candidates, the best first. Those without an equilibrium at these values or
        without markers are listed with the reason.

    Raises:
        ValueError: If an input is wrong, there is no candidate, or a name repeats.
        RuntimeError: If an already measured configuration has no equilibrium.
    """
    known, tried = as_sequence(configurations), as_sequence(candidates)
    if not tried:
        raise ValueError("at least one candidate is needed, got none.")
    found = survey(
        model,
        parameters,
        (*known, *tried),
        at=at,
        noise=noise,
        newton=newton,
        uncertain=uncertain,
        required=len(known),
    )
    prior = prior_std(found.space)
    measured = found.sensed[: len(known)]
    before = _told(measured, prior)
    gains, unranked = [], []
    for s in found.sensed[len(known) :]:
        reason = s.failure or ("" if len(s.W) else "it has no markers to measure")
        if reason:
            unranked.append(Unranked(s.name, reason))
        else:
            gains.append(_gain(s.name, found, before, _told((*measured, s), prior)))
    gains.sort(key=lambda gain: -gain.d_gain)
    blind = _blind_count(_information(before))
    return Ranking(tuple(gains), tuple(unranked), len(prior), blind)


def _told(
    sensed: Sequence[Sensed], prior: Float[HostArray, " n_p"]
) -> Float[HostArray, "n n_p"]:
    """Return what configurations tell together, per prior standard deviation."""
    if not sensed:
        return np.zeros((0, len(prior)))
    W, W_c = in_noise_units(sensed)
    return marginalised(W * prior, W_c)


def _gain(
    name: str,
    found: Survey,
    before: Float[HostArray, "n_before n_p"],
    after: Float[HostArray, "n_after n_p"],
) -> Gain:
    """Compare the signal per prior standard deviation without and with a candidate."""
    spreads = [np.sqrt(np.diag(posterior(G))) for G in (before, after)]
    best = int(np.argmax(spreads[0] - spreads[1]))
    parameter = found.space.parameters[best]
    prior = (si_slope(found.space, found.z) * prior_std(found.space))[best]
    value = np.asarray(found.space.from_scaled(found.z))[best]
    old, new = (_information(G) for G in (before, after))
    return Gain(
        name=name,
        d_gain=float(np.sum(np.log(new)) - np.sum(np.log(old))),
        e_gain=float(new[-1] - old[-1]),
        blind_left=_blind_count(new),
        parameter=parameter.name,
        before=float(prior * spreads[0][best]),
        after=float(prior * spreads[1][best]),
        value=float(value),
        unit=parameter.unit,
    )


def _information(G: Float[HostArray, "n_e n_p"]) -> Float[HostArray, " n_p"]:
    """Return the eigenvalues of M = I + G^T G, descending, from those of G [-]."""
    singular = np.linalg.svd(G, compute_uv=False)
    return 1.0 + np.pad(singular, (0, G.shape[1] - len(singular))) ** 2


def _blind_count(eigenvalues: Float[HostArray, " n_p"]) -> int:
    """Count the directions that are not identifiable (spread = eigenvalue^-1/2)."""
    return int(np.sum(1.0 / np.sqrt(eigenvalues) > WEAK_BELOW))
