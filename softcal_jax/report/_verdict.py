"""The answer of a calibration: values, verdict, held-out error, what to do next."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._names import MOST_NAMED, listed
from softcal_jax._text_table import Tone
from softcal_jax.calibration import (
    FLAT,
    NOT_TAKEN,
    CalibrationResult,
    ConfigurationResult,
    ParameterEstimate,
)
from softcal_jax.configurations import EffectorRecord, beyond, rms_distance
from softcal_jax.identifiability import Assessment

_SCOPE = (
    "The values hold for these loads and this shape. To test whether they are material "
    "properties, calibrate a second robot (softcal transfer)."
)
"""For what calibrated values hold."""

MOST_LISTED = 6  # held-out configurations that are listed one by one
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
    """The verdict with which the page of a run begins."""

    sentence: str  # ends with a colon where reasons follow
    tone: Tone
    reasons: tuple[str, ...] = ()  # what there is to doubt, one sentence each


class Answer(NamedTuple):
    """What a calibration answers, in the order in which it is read."""

    mistakes: tuple[str, ...]  # what would explain contradictory data, likeliest first
    values: tuple[tuple[str, str, str], ...]  # name, value and interval
    verdict: RunVerdict  # whether the values can be used
    held_out: tuple[str, ...]  # how well poses are predicted that were not fitted
    next_step: str
    scope: str  # for what the values hold, and what is held fixed

    def lines(self) -> list[str]:
        """Write it for a terminal."""
        lines = [f"Possible mistake: {text}" for text in self.mistakes[:1]]
        for name, value, interval in self.values[:MOST_VALUES]:
            lines.append(f"{name} = {value}{f' ({interval})' if interval else ''}")
        if len(self.values) > MOST_VALUES:
            lines.append(f"and {len(self.values) - MOST_VALUES} more.")
        lines.append(self.verdict.sentence)
        lines += [f"  {text}" for text in self.verdict.reasons[:MOST_REASONS]]
        more = len(self.verdict.reasons) - MOST_REASONS
        lines += [f"  and {more} more."] if more > 0 else []
        return [*lines, *self.held_out, f"Next: {self.next_step}", self.scope]


def answer_of(result: CalibrationResult, assessment: Assessment) -> Answer:
    """Collect what a calibration answers."""
    none = "Held-out error: unknown, because every pose was used in the fit."
    return Answer(
        values=tuple((p.name, value_of(p), _interval_of(p)) for p in result.parameters),
        verdict=verdict_of(assessment),
        mistakes=result.mistakes,
        held_out=tuple(held_out_sentences(result.configurations) or [none]),
        next_step=_next_step(result, assessment),
        scope=" ".join(filter(None, [assessment.held_fixed, _SCOPE])),
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
    if result.parameters[worst].at_bound:
        step = f"widen the bounds of {outlook.parameters[worst].name}."
    if outlook.advice and not np.isfinite(outlook.parameters[worst].ratio):
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


def listed_fits(fits: Sequence[ConfigurationResult]) -> list[ConfigurationResult]:
    """Return the configurations to list one by one: all that were fitted, few others.

    Of many that were held out these are the three with the largest errors and the one
    with the smallest, in this order.
    """
    held_out = [fit for fit in fits if fit.role == "validation"]
    if len(held_out) <= MOST_LISTED:
        return list(fits)
    ranked = sorted(held_out, key=lambda fit: -np.nan_to_num(fit.rms_after))
    return [f for f in fits if f.role != "validation"] + [*ranked[:3], ranked[-1]]


def held_out_sentences(fits: Sequence[ConfigurationResult]) -> list[str]:
    """Say how well configurations are predicted that were not fitted, in a sentence."""
    asked = ("validation", "prediction")
    poses = [fit for fit in fits if fit.role in asked and fit.converged]
    points = [e for fit in poses for e in fit.points if e.seen.any()]
    turns = [e for fit in poses for e in fit.turns if e.seen.any()]
    if not (points or turns):
        return []
    parts = []
    if points:
        rms, motion = (
            rms_distance(points, values)
            for values in (lambda e: e.simulated, lambda e: e.at_rest)
        )
        parts.append(f"{1e3 * rms:.2f} mm rms over {_points(points, turns)}")
        if motion > 0.0:
            parts[0] += f", {100.0 * rms / motion:.1f} % of the motion"
    if turns:
        off = math.degrees(rms_distance(turns, lambda e: e.simulated))
        parts.append(f"{off:.2f} deg rms in orientation")
    poses = [fit for fit in poses if any(e.seen.any() for e in fit.effectors)]
    held_out = poses[0].role == "validation"
    head = "Held-out error" if held_out else "Prediction error"
    of = poses[0].name if len(poses) == 1 else f"{len(poses)} poses"
    seen = " not used in the fit" * (held_out and len(poses) > 1)
    sentences = [f"{head} of {of}{seen}: {'; '.join(parts)}{_range(poses)}."]
    fitted = [fit.posed for fit in fits if fit.role == "calibration" and fit.posed]
    names: dict[str, list[str]] = {}
    for pose in poses if fitted else ():
        if pose.posed is not None:
            names.setdefault(beyond(fitted, pose.posed), []).append(pose.name)
    names.pop("", None)
    return sentences + [
        f"Beyond what was fitted: {listed(of_text, MOST_NAMED)}, as {text}."
        for text, of_text in names.items()
    ]


def _range(poses: Sequence[ConfigurationResult]) -> str:
    """Name the poses that are predicted best and worst, and quantiles of many."""
    poses = [pose for pose in poses if math.isfinite(pose.rms_after)]
    if len(poses) < 2:
        return ""
    errors = 1e3 * np.array([pose.rms_after for pose in poses])
    best, worst = poses[int(np.argmin(errors))], poses[int(np.argmax(errors))]
    ends = f"{errors.min():.2f} mm ({best.name})"
    ends += f" to {errors.max():.2f} mm ({worst.name})"
    if len(poses) <= MOST_LISTED:
        return f"; {ends}"
    half, most = np.quantile(errors, [0.5, 0.95])
    return f"; {ends}, median {half:.2f} mm, 95th percentile {most:.2f} mm"


def _points(points: Sequence[EffectorRecord], turns: Sequence[EffectorRecord]) -> str:
    """Count the markers and the 6-D sensors that were measured, in words."""
    turning, names = ({e.name for e in of} for of in (turns, points))
    counts = {"marker": len(names - turning), "6-D sensor": len(names & turning)}
    return listed([f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n])
