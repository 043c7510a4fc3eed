"""What is said of held-out configurations: each by itself, or many together."""

import math
from collections.abc import Sequence

import numpy as np

from softcal_jax._names import listed
from softcal_jax.calibration import ConfigurationResult

MOST_LISTED = 6
"""Most held-out configurations that are listed one by one."""


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
    """Say how far off predicted configurations are, as far as it is known."""
    asked = ("validation", "prediction")
    held_out = [fit for fit in fits if fit.role in asked and fit.converged]
    if len(held_out) > MOST_LISTED and all(fit.points for fit in held_out):
        return [_together(held_out)]
    lines = []
    for fit in held_out:
        texts = []
        if fit.points:
            texts.append(f"{1e3 * fit.rms_after:.2f} mm rms over {_points(fit)}")
        if fit.points and math.isfinite(fit.rms_share):
            share = f"{100 * fit.rms_share:.1f} % of how far they moved"
            texts[0] += f", {share} ({1e3 * fit.motion:.1f} mm)"
        if math.isfinite(fit.turn_after):
            texts.append(f"{math.degrees(fit.turn_after):.2f} deg rms of orientations")
        if texts:
            lines.append(f"{_error(fit)}, {fit.name}: {'; '.join(texts)}.")
    return lines


def _together(fits: Sequence[ConfigurationResult]) -> str:
    """Sum up the errors of many held-out configurations."""
    errors = 1e3 * np.array([fit.rms_after for fit in fits])
    moved = 1e3 * np.array([fit.motion for fit in fits])
    rms = lambda values: float(np.sqrt(np.mean(np.square(values))))
    half, most = np.quantile(errors, [0.5, 0.95])
    best, worst = fits[int(np.argmin(errors))], fits[int(np.argmax(errors))]
    turns = np.degrees([f.turn_after for f in fits if math.isfinite(f.turn_after)])
    turned = f"; {rms(turns):.2f} deg rms of orientations" if len(turns) else ""
    share = f" ({100 * rms(errors) / rms(moved):.1f} % of how far they moved)"
    return (
        f"{_error(worst)} of {len(fits)} configurations: {rms(errors):.2f} mm rms"
        f"{share if rms(moved) > 0.0 else ''}; half below {half:.2f} mm, 95 % below "
        f"{most:.2f} mm; the largest is {errors.max():.2f} mm ({worst.name}), the "
        f"smallest {errors.min():.2f} mm ({best.name}){turned}."
    )


def _error(fit: ConfigurationResult) -> str:
    return "Prediction error" if fit.role == "prediction" else "Held-out error"


def _points(fit: ConfigurationResult) -> str:
    """Count the markers and the 6-D sensors of a configuration, in words."""
    turning = {turn.name for turn in fit.turns}
    sensors = sum(point.name in turning for point in fit.points)
    counts = {"marker": len(fit.points) - sensors, "6-D sensor": sensors}
    return listed([f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n])
