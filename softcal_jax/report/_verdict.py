"""The answer of a calibration: values, verdict, held-out error, what to do next."""

from typing import NamedTuple

import numpy as np

from softcal_jax._text_table import Tone
from softcal_jax.calibration import (
    FLAT,
    NOT_TAKEN,
    CalibrationResult,
    ParameterEstimate,
)
from softcal_jax.identifiability import Assessment
from softcal_jax.report._held_out import held_out_sentences

SCOPE = (
    "The values hold for these loads and this shape. To test whether they are material "
    "properties, calibrate a second robot (softcal transfer)."
)
"""For what calibrated values hold."""

MOST_REASONS = 3  # reasons of a verdict that stand in the first screen
MOST_VALUES = 8  # parameters whose values stand in the first screen
TONES: dict[str, Tone] = {
    "trust": "good",
    "take with care": "doubtful",
    "do not use": "bad",
    "identifiable": "good",
    "weakly identifiable": "doubtful",
    "not identifiable": "bad",
}
"""Tone of each outcome, and of each verdict on what the data tell of a parameter."""


class RunVerdict(NamedTuple):
    """The verdict with which the page of a run begins.

    Attributes:
        sentence: The verdict; it ends with a colon where reasons follow.
        tone: Whether it is good, doubtful or bad news.
        reasons: What there is to doubt, one sentence each.
    """

    sentence: str
    tone: Tone
    reasons: tuple[str, ...] = ()


class Answer(NamedTuple):
    """What a calibration answers, in the order in which it is read.

    Attributes:
        values: Name, value and interval of each parameter.
        verdict: Whether the values can be used.
        mistakes: What would explain contradictory data, the likeliest first.
        held_out: How well poses are predicted that were not fitted, in sentences.
        next_step: What to do next.
    """

    values: tuple[tuple[str, str, str], ...]
    verdict: RunVerdict
    mistakes: tuple[str, ...]
    held_out: tuple[str, ...]
    next_step: str

    def lines(self) -> list[str]:
        """Write it for a terminal."""
        lines = []
        for name, value, interval in self.values[:MOST_VALUES]:
            lines.append(f"{name} = {value}{f' ({interval})' if interval else ''}")
        if len(self.values) > MOST_VALUES:
            lines.append(f"and {len(self.values) - MOST_VALUES} more.")
        lines.append(self.verdict.sentence)
        lines += [f"  {text}" for text in self.verdict.reasons[:MOST_REASONS]]
        more = len(self.verdict.reasons) - MOST_REASONS
        lines += [f"  and {more} more."] if more > 0 else []
        return [*lines, *self.held_out, f"Next: {self.next_step}", SCOPE]


def answer_of(result: CalibrationResult, assessment: Assessment) -> Answer:
    """Collect what a calibration answers."""
    values = tuple((p.name, value_of(p), _interval_of(p)) for p in result.parameters)
    held_out = held_out_sentences(result.configurations)
    none = "Held-out error: unknown, because every pose was used in the fit."
    return Answer(
        values=values,
        verdict=verdict_of(assessment),
        mistakes=result.mistakes,
        held_out=tuple(held_out or [none]),
        next_step=_next_step(result, assessment),
    )


def value_of(parameter: ParameterEstimate) -> str:
    """Write a value with its error, and whether it stands on a bound."""
    if parameter.at_bound:
        return f"{parameter.estimate} (on a bound)"
    if parameter.given:
        return f"{parameter.estimate} (with {', '.join(parameter.given)} on a bound)"
    return parameter.estimate


def _interval_of(parameter: ParameterEstimate) -> str:
    interval = parameter.interval
    if interval is None or interval.kind == "none":
        return ""
    return f"{100.0 * interval.level:g} % interval {interval}"


def verdict_of(assessment: Assessment) -> RunVerdict:
    """Say in one sentence whether the values of a calibration can be used."""
    tone = TONES[assessment.outcome]
    return RunVerdict(assessment.headline, tone, assessment.reasons)


def _next_step(result: CalibrationResult, assessment: Assessment) -> str:
    """Say what helps most: against what contradicts, is not seen, or errs most."""
    if not result.converged:
        return "raise max_steps under [settings], or start from other values."
    if result.mistakes:
        return "check whether this mistake was made, correct it, and calibrate again."
    outlook = assessment.identifiability
    worst = int(np.argmax([p.ratio for p in outlook.parameters]))
    step = result.budget.advice(result.budget.names[worst])
    if outlook.advice:
        step = outlook.advice[0][0].lower() + outlook.advice[0][1:]
    if assessment.contradicted:
        return f"check the points that the verdict lists; then {step}"
    return step


def end_of(result: CalibrationResult) -> str:
    """Say which criterion ended the fit, see `CalibrationSettings`."""
    if result.interrupted:
        return "The user interrupted the fit."
    if len(result.history) < 2:
        return "The fit ended before its first step."
    settings, last = result.settings, result.history[-1]
    size = max(abs(step) for step in last.lambda_p)
    if not result.converged and last.step >= settings.max_steps:
        why = f"at max_steps = {settings.max_steps}"
    elif not result.converged:
        why = "because every step was refused, although the cost still decreases"
    elif not last.accepted:
        why = "because steps were refused and the cost is flat: its slope vanishes to "
        why += f"within {FLAT:g}"
    elif size <= settings.tol:
        why = f"because |lambda_p| = {size:.1e} is below {settings.tol:g}"
    else:
        why = (
            f"because one more step, |lambda_p| = {size:.1e}, would reduce the cost by "
            f"less than {NOT_TAKEN**2:g} of its value"
        )
    return f"The fit ended {why}."
