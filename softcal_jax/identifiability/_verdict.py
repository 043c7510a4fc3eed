"""What may be said of a calibration in one sentence, wherever it is said."""

from typing import NamedTuple

from softcal_jax._module import one_line
from softcal_jax._text_table import Tone
from softcal_jax.calibration import FLAT, SMALLEST_FALL, CalibrationResult
from softcal_jax.identifiability._assessment import Assessment


class RunVerdict(NamedTuple):
    """What may be said of a run, first of all.

    Attributes:
        sentence: The verdict; it ends with a colon where reasons follow.
        tone: How it is meant.
        reasons: What there is to doubt, one sentence each.
    """

    sentence: str
    tone: Tone
    reasons: tuple[str, ...] = ()

    __repr__ = one_line


def verdict_of(result: CalibrationResult, found: Assessment) -> RunVerdict:
    """Say in one sentence whether the values of a calibration can be used."""
    steps = len(result.history) - 1
    taken = f"{steps} step{'s' * (steps != 1)}"
    if not result.converged:
        text = f"NOT CONVERGED after {taken}: do not use these values."
        return RunVerdict(text, "bad")
    if found.identified:
        text = f"Converged in {taken}, and nothing speaks against the values."
        return RunVerdict(text, "good")
    text = f"Converged in {taken}, but take the values with care:"
    return RunVerdict(text, "doubtful", found.reasons)


def end_of(result: CalibrationResult) -> str:
    """Say which criterion ended the fit, see `CalibrationSettings`."""
    if result.interrupted:
        return "The user interrupted the fit."
    if len(result.history) < 2:
        return "The fit ended before its first step."
    settings, last = result.settings, result.history[-1]
    size = max(abs(step) for step in last.lambda_p)
    if not result.converged:
        if last.step >= settings.max_steps:
            return f"The fit ended at max_steps = {settings.max_steps}."
        return (
            "The fit ended where every step was refused, though the cost still falls."
        )
    if not last.accepted:
        return (
            "The fit ended where steps were refused and the cost is flat: its slope "
            f"vanishes to {FLAT:g}."
        )
    if size <= settings.tol:
        return f"The fit ended as |lambda_p| = {size:.1e} is below {settings.tol:g}."
    return (
        f"The fit ended as one more step, |lambda_p| = {size:.1e}, would lower the "
        f"cost by less than {SMALLEST_FALL:g} of it."
    )
