"""Rank configurations that might be measured next, and find the fewest that suffice."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._names import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import EquilibriumProgress, Model, NewtonSettings
from softcal_jax.fields import PRECISION, Uncertain, asked_errors
from softcal_jax.identifiability._identify import AnyVector, Parameters, survey
from softcal_jax.identifiability._spread import IDENTIFIABLE_UP_TO, spread_of
from softcal_jax.inference import readable_error

MOST_TOGETHER = 4  # most candidates that are combined to reach the target

READINGS = 2, 4, 10, 30, 100, 300, 1000
"""Readings of each pose in place of one, of which the fewest that suffice is named."""


class Gain(Module):
    """What candidates would add if they were measured as well.

    Attributes:
        name: Name of the candidate, or of several.
        errors: Expected standard errors of the parameters with it, over those that are
            asked for [-].
        parameter: Parameter whose error falls most, in these units; with an error that
            was infinite first.
        before: Its standard error without the candidate, in SI; infinite where nothing
            sees it.
        after: Its standard error with it, in SI.
        value: Value of the parameter, in SI.
        unit: Its SI unit.
    """

    name: str
    errors: Float[HostArray, " n_p"]
    parameter: str
    before: float
    after: float
    value: float
    unit: str

    @property
    def cost(self) -> tuple[int, float]:
        """Number of blind parameters, and the squared errors of the others [-]."""
        blind = np.isinf(self.errors)
        return int(blind.sum()), float(np.sum(self.errors[~blind] ** 2))

    @property
    def effect(self) -> str:
        """What becomes of that parameter: "expected error of E: 12 % -> 7 %"."""
        ends = [
            readable_error(e, self.value, self.unit) for e in (self.before, self.after)
        ]
        return f"expected error of {self.parameter}: {ends[0]} -> {ends[1]}"


class Ranking(Result):
    """Candidates, the most informative first.

    Attributes:
        gains: One entry per candidate that can be ranked.
        unranked: Why the others, by name, cannot be ranked.
        reached: Which fewest candidates reach the target, or what else would, in a
            sentence.
        helps: Whether the best one lowers the errors.
    """

    gains: tuple[Gain, ...]
    unranked: dict[str, str]
    reached: str
    helps: bool

    @property
    def headline(self) -> str:
        """Which candidate to measure next, in a sentence."""
        if not self.gains:
            return "No candidate can be ranked."
        if not self.helps:
            return "No candidate lowers the errors: know what is held fixed better."
        best = self.gains[0]
        return f"Candidate {best.name!r} tells most: {best.effect}."

    def _words(self) -> str:
        return self.headline


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

    Candidates are ordered by the sum of the squared standard errors of the parameters
    that they leave, each in units of the one that is asked for (A-optimality; Chaloner
    and Verdinelli, Statistical Science 10, 1995), by all causes, and first by how many
    parameters stay blind. What suffices is sought among all pairs, and beyond that by
    adding one candidate after another.

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
    in_si = seen.space.slopes(seen.z) * asked
    values = np.asarray(seen.space.from_scaled(seen.z))

    def with_these(*chosen: str, jitter: float = 1.0) -> Gain:
        left_out = [name for name in names if name not in chosen]
        linear = seen.linear.without(*left_out).with_jitter(jitter)
        errors = spread_of(linear.per(asked)).errors()
        before = errors if not chosen else nothing.errors
        fall = np.where(np.isinf(errors), 0.0, before) - np.where(
            np.isinf(errors), 0.0, errors
        )
        i = int(np.argmax(fall if chosen else errors))
        return Gain(
            name=listed(chosen),
            errors=errors,
            parameter=seen.space.names[i],
            before=float(in_si[i] * before[i]),
            after=float(in_si[i] * errors[i]),
            value=float(values[i]),
            unit=seen.space.parameters[i].unit,
        )

    nothing = with_these()
    reasons = dict(zip(names, seen.failures[len(known) :], strict=True))
    rows = set(seen.linear.pose.tolist())
    for k, name in enumerate(names, start=len(known)):
        if not reasons[name] and k not in rows:
            reasons[name] = "it has no markers to measure"
    usable = [name for name in names if not reasons[name]]
    gains = sorted(map(with_these, usable), key=lambda gain: gain.cost)
    return Ranking(
        gains=tuple(gains),
        unranked={name: reason for name, reason in reasons.items() if reason},
        reached=_reached(with_these, usable, f"{100.0 * precision:.3g} %"),
        helps=bool(gains) and gains[0].cost < nothing.cost,
    )


def _reached(with_these: Callable[..., Gain], names: Sequence[str], target: str) -> str:
    """Say which fewest candidates reach a target, or what else it would take."""
    reached = lambda gain: bool(np.max(gain.errors) <= IDENTIFIABLE_UP_TO)
    best, chosen = with_these(), ()
    for n in range(1, min(len(names), MOST_TOGETHER) + 1):
        if reached(best):
            break
        beside = [(*chosen, name) for name in names if name not in chosen]
        sets = beside if n > 2 else [*combinations(names, n)]
        each = [(with_these(*those), those) for those in sets]
        best, chosen = min(each, key=lambda one: (not reached(one[0]), one[0].cost))
    if reached(best):
        fewest = f"Fewest that reach {target}: {best.name}; {best.effect}."
        return fewest if chosen else f"The poses that are there reach {target}."
    beside = f"with {best.name} ({best.effect})" if chosen else "as it is"
    for n in READINGS:
        if reached(with_these(*chosen, jitter=n**-0.5)):
            return (
                f"No {MOST_TOGETHER} candidates reach {target}: {beside}, it takes {n} "
                f"readings of each pose, or {n**-0.5:.2g} times the noise."
            )
    return (
        f"Nothing in reach gives {target}: {beside}, know what is held fixed better, "
        "or calibrate fewer parameters."
    )
