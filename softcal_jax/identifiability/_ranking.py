"""Rank configurations that might be measured next."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._text_table import TextTable, text_table
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import EquilibriumProgress, Model, NewtonSettings
from softcal_jax.fields import PRECISION, Uncertain, asked_errors
from softcal_jax.identifiability._identify import AnyVector, Parameters, Survey, survey
from softcal_jax.identifiability._result import number
from softcal_jax.identifiability._spread import information, named_directions, spread_of
from softcal_jax.inference import LinearModel

NOTHING = 10.0
"""Standard error, over the asked one, that stands for knowing nothing [-].

With the default precision a factor of e on a value. It gives the uncertainty a volume
where neither data nor prior see a direction; bounds do not, as users type them freely.
"""

HARDLY = 1.05  # factor on a standard error below which a candidate hardly helps [-]


class Gain(Module):
    """What one candidate would add if it were measured as well.

    Attributes:
        name: Name of the candidate.
        d_gain: log det(M + J) - log det M, see `rank_configurations` [nat].
        e_gain: Increase of the smallest eigenvalue of M [-].
        blind_left: Number of directions that it leaves unidentifiable.
        parameter: Parameter whose standard error falls most, relative to the asked one.
        before: Its standard error without the candidate, in SI; infinite where nothing
            sees it.
        after: Its standard error with it, in SI.
        value: Value of the parameter, in SI.
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
        if not np.isfinite(self.after):
            return f"{self.parameter}: still blind"
        factor, unit = readable_unit([self.value], self.unit)
        before = number(factor * self.before) if np.isfinite(self.before) else "blind"
        after = number(factor * self.after)
        return f"{self.parameter}: {before} to {after} {unit}".rstrip()

    @property
    def words(self) -> str:
        """What the candidate does, as the end of a sentence."""
        if not np.isfinite(self.after) or self.before < HARDLY * self.after:
            return "hardly changes any standard error"
        if np.isinf(self.before):
            return f"reveals a direction that was blind ({self.effect})"
        ratio = self.before / self.after
        return f"reduces a standard error {number(ratio, 2)}-fold ({self.effect})"


class Unranked(Module):
    """A candidate that cannot be ranked, and the reason."""

    name: str
    reason: str

    def __str__(self) -> str:
        """Format the name and the reason in one line."""
        return f"Not ranked: {self.name!r}: {self.reason}."


class Ranking(Result):
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

    @property
    def headline(self) -> str:
        """Which candidate to measure next, in a sentence."""
        if not self.gains:
            return "No candidate can be ranked."
        best = self.gains[0]
        if best.d_gain <= 0.0:
            fewer = ", or calibrate fewer parameters" if self.blind_before else ""
            return (
                "No candidate reduces the overall uncertainty: measure what is held "
                f"fixed more accurately{fewer}."
            )
        return f"Candidate {best.name!r} is the most informative: it {best.words}."

    @property
    def tabulated(self) -> TextTable:
        """What each candidate would add, in texts."""
        head = "candidate, D gain [nat], volume, E gain, blind left, standard error"
        rows = [
            (
                gain.name,
                *map(number, (gain.d_gain, gain.volume, gain.e_gain)),
                f"{gain.blind_left} of {self.n_parameters}",
                gain.effect,
            )
            for gain in self.gains
        ]
        return text_table("Candidates", head.split(", "), rows)

    @property
    def legend(self) -> str:
        """What the columns of the table mean."""
        text = (
            f"Without a candidate, {self.blind_before} of {self.n_parameters} "
            "directions are blind. Volume: factor on the volume of the uncertainty, "
            "exp(-D gain / 2). E gain: information added in the worst direction, in "
            "units of that which gives the target standard error."
        )
        if any(gain.d_gain < 0.0 for gain in self.gains):
            text += (
                " D gain below 0: the fit weights readings by their noise alone, and "
                "the pose adds more error from what is held fixed (clamp, loads, mesh) "
                "than information."
            )
        return text

    def __str__(self) -> str:
        """Describe the best candidate, and tabulate all."""
        table = [*self.tabulated.lines(), self.legend] if self.gains else []
        return "\n".join([self.headline, *table, *map(str, self.unranked)])


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
    precision: float = PRECISION,
    progress: Callable[[EquilibriumProgress], None] = lambda _: None,
) -> Ranking:
    """Rank candidate configurations by what they would tell, before measuring.

    Let G be the compliances in units of the noise per asked standard error, P the
    information of stated priors, M = I / NOTHING^2 + P + G^T G that of prior and
    configurations, and J = G_c^T G_c that of a candidate; errors that are considered
    reduce both. Candidates are ordered by log det(M + J) - log det M (D-optimality;
    Chaloner and Verdinelli, Statistical Science 10, 1995). The increase of the smallest
    eigenvalue of M (E-optimality) is given too: D rewards shrinking any direction of
    the uncertainty, E only the worst one.

    The `configurations` are measured already, and may be none; the `candidates` may be
    measured next, and need other names. Candidates without an equilibrium or markers
    are listed with the reason. Other arguments are those of `identify`.

    Raises:
        ValueError: If an input is wrong, there is no candidate, or a name repeats.
        RuntimeError: If an already measured configuration has no equilibrium.
    """
    known, tried = as_sequence(configurations), as_sequence(candidates)
    if not tried:
        raise ValueError("at least one candidate is needed, got none.")
    seen = survey(
        model,
        parameters,
        (*known, *tried),
        at=at,
        noise=noise,
        newton=newton,
        uncertain=uncertain,
        required=len(known),
        progress=progress,
    )
    names = [c.name for c in tried]
    asked = asked_errors(seen.space, seen.z, precision, model=model)
    in_asked = seen.linear.per(asked)
    before = _knowledge(in_asked.without(*names))
    gains, unranked = [], []
    for k, name in enumerate(names, start=len(known)):
        reason = seen.failures[k]
        if not reason and not np.any(in_asked.pose == k):
            reason = "it has no markers to measure"
        if reason:
            unranked.append(Unranked(name, reason))
            continue
        others = [other for other in names if other != name]
        after = _knowledge(in_asked.without(*others))
        gains.append(_gain(name, seen, asked, before=before, after=after))
    gains.sort(key=lambda gain: -gain.d_gain)
    return Ranking(tuple(gains), tuple(unranked), len(asked), before.blind)


class _Knowledge(NamedTuple):
    """What configurations tell together, in units of the asked standard errors.

    `blind` is the number of directions that are not identifiable.
    """

    errors: Float[HostArray, " n_p"]
    information: Float[HostArray, "n_p n_p"]
    blind: int


def _knowledge(linear: LinearModel) -> _Knowledge:
    """Sum up what configurations tell."""
    spread = spread_of(linear)
    directions = named_directions(spread, linear.names)
    blind = sum(d.verdict == "not identifiable" for d in directions)
    least = np.diag(linear.prior_weights**2 + NOTHING**-2.0)
    return _Knowledge(spread.errors(), least + information(linear), blind)


def _gain(
    name: str,
    seen: Survey,
    asked: Float[HostArray, " n_p"],
    *,
    before: _Knowledge,
    after: _Knowledge,
) -> Gain:
    """Compare what is known without and with a candidate."""
    bounded = [np.sqrt(np.diag(np.linalg.inv(k.information))) for k in (before, after)]
    best = int(np.argmax(bounded[0] - bounded[1]))
    parameter = seen.space.parameters[best]
    in_si = (seen.space.slopes(seen.z) * asked)[best]
    value = np.asarray(seen.space.from_scaled(seen.z))[best]
    old, new = (np.linalg.eigvalsh(k.information) for k in (before, after))
    return Gain(
        name=name,
        d_gain=float(np.sum(np.log(new)) - np.sum(np.log(old))),
        e_gain=float(new[0] - old[0]),
        blind_left=after.blind,
        parameter=parameter.name,
        before=float(in_si * before.errors[best]),
        after=float(in_si * after.errors[best]),
        value=float(value),
        unit=parameter.unit,
    )
