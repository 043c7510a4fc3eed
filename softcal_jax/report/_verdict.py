"""The verdict on a run, and how its fit ended: what a page says first."""

from typing import NamedTuple

from softcal_jax._text_table import Tone
from softcal_jax.calibration import FLAT, NOT_TAKEN, CalibrationResult
from softcal_jax.identifiability import Assessment

SCOPE = (
    "The values hold for these loads and this shape; whether they are those of the "
    "material, a second robot tells (softcal transfer)."
)
"""For what calibrated values hold."""


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


def verdict_of(result: CalibrationResult, assessment: Assessment) -> RunVerdict:
    """Say in one sentence whether the values of a calibration can be used."""
    steps = len(result.history) - 1
    taken = f"{steps} step{'s' * (steps != 1)}"
    if not result.converged:
        text = f"NOT CONVERGED after {taken}: do not use these values."
        return RunVerdict(text, "bad")
    if assessment.identified:
        text = f"Converged in {taken}, and nothing speaks against the values. {SCOPE}"
        return RunVerdict(text, "good")
    text = f"Converged in {taken}, but take the values with care:"
    return RunVerdict(text, "doubtful", (*assessment.reasons, SCOPE))


def end_of(result: CalibrationResult) -> str:
    """Say which criterion ended the fit, see `CalibrationSettings`."""
    if result.interrupted:
        return "The user interrupted it."
    if len(result.history) < 2:
        return "The fit ended before its first step."
    settings, last = result.settings, result.history[-1]
    size = max(abs(step) for step in last.lambda_p)
    if not result.converged and last.step >= settings.max_steps:
        where = f"at max_steps = {settings.max_steps}"
    elif not result.converged:
        where = "where every step was refused, though the cost still falls"
    elif not last.accepted:
        where = "where steps were refused and the cost is flat: its slope vanishes to "
        where += f"{FLAT:g}"
    elif size <= settings.tol:
        where = f"as |lambda_p| = {size:.1e} is below {settings.tol:g}"
    else:
        where = (
            f"as one more step, |lambda_p| = {size:.1e}, would lower the cost by less "
            f"than {NOT_TAKEN**2:g} of it"
        )
    return f"The fit ended {where}."
