"""The answer of a calibration: values, verdict, held-out error, what to do next."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from softcal_jax._text import MOST_NAMED, listed
from softcal_jax._tree import Column, Section, Table, Tone
from softcal_jax._units import readable
from softcal_jax.calibration import (
    FLAT,
    NOT_TAKEN,
    CalibrationResult,
    ConfigurationResult,
    ParameterEstimate,
)
from softcal_jax.configurations import EffectorRecord, beyond, rms_distance
from softcal_jax.export import headline
from softcal_jax.identifiability import Assessment

_SCOPE = (
    "The values hold for these loads and this shape. To test whether they are material "
    "properties, calibrate a second robot (softcal transfer)."
)
"""For what calibrated values hold."""

MOST_LISTED = 6  # held-out configurations that are listed one by one
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


def answer(result: CalibrationResult, assessment: Assessment) -> tuple[Section, ...]:
    """Say what a calibration answers, in the order in which it is read."""
    every = result.parameters
    shown, more = every[:MOST_VALUES], len(every) - MOST_VALUES
    columns = (
        Column("parameter", [p.name for p in shown]),
        value_column("value", shown),
        Column("interval", [_interval_of(p) for p in shown]),
    )
    note = f"and {more} more." if more > 0 else ""
    none = "Held-out error: unknown, because every pose was used in the fit."
    held_out = held_out_sentences(result.configurations) or [none]
    scope = " ".join(filter(None, [assessment.held_fixed, _SCOPE]))
    follows = *held_out, f"Next: {_next_step(result, assessment)}", scope
    mistakes = tuple(f"Possible mistake: {text}" for text in result.mistakes)
    return (
        Section("answer", "", mistakes, (Table("", columns, note),)),
        verdict_of(assessment),
        Section("next", "", follows),
    )


def value_column(
    head: str, parameters: Sequence[ParameterEstimate], tones: Sequence[Tone] = ()
) -> Column:
    """Return values, their errors where these may be shown, and what is on a bound."""
    given = lambda p: f"(with {', '.join(p.given)} on a bound)" * bool(p.given)
    return Column(
        head,
        [p.value for p in parameters],
        [p.unit for p in parameters],
        errors=[p.standard_error if p.is_symmetric else math.nan for p in parameters],
        notes=["(on a bound)" if p.at_bound else given(p) for p in parameters],
        tones=tones,
    )


def _interval_of(parameter: ParameterEstimate) -> str:
    interval = parameter.interval
    if interval is None or interval.kind == "none":
        return ""
    return f"{100.0 * interval.level:g} % interval {interval}"


def verdict(sentence: str, tone: Tone, reasons: Iterable[str] = ()) -> Section:
    """Begin a result with a sentence on it, and what there is to doubt."""
    return Section("verdict", "", (sentence, *reasons), tone=tone)


def verdict_of(assessment: Assessment) -> Section:
    """Say in one sentence whether the values of a calibration can be used."""
    return verdict(headline(assessment), TONES[assessment.outcome], assessment.reasons)


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
        parts.append(f"{readable(rms, 'distance')} rms over {_points(points, turns)}")
        if motion > 0.0:
            parts[0] += f", {readable(rms / motion, 'share')} of the motion"
    if turns:
        off = rms_distance(turns, lambda e: e.simulated)
        parts.append(f"{readable(off, 'turn')} rms in orientation")
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
    ranked = sorted(poses, key=lambda pose: pose.rms_after)
    size = lambda metres: readable(metres, "distance")
    ends = (f"{size(pose.rms_after)} ({pose.name})" for pose in (ranked[0], ranked[-1]))
    text = f"; {' to '.join(ends)}"
    if len(poses) <= MOST_LISTED:
        return text
    half, most = np.quantile([pose.rms_after for pose in poses], [0.5, 0.95])
    return f"{text}, median {size(half)}, 95th percentile {size(most)}"


def _points(points: Sequence[EffectorRecord], turns: Sequence[EffectorRecord]) -> str:
    """Count the markers and the 6-D sensors that were measured, in words."""
    turning, names = ({e.name for e in of} for of in (turns, points))
    counts = {"marker": len(names - turning), "6-D sensor": len(names & turning)}
    return listed([f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n])
