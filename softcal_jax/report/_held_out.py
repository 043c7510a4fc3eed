"""What is said of held-out configurations: each by itself, or many together."""

import math
from collections.abc import Sequence

import numpy as np

from softcal_jax._names import listed
from softcal_jax.calibration import ConfigurationResult

MOST_LISTED = 6  # held-out configurations that are listed one by one


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
    points = [fit for fit in poses if fit.points]
    turns = [fit.turn_after for fit in poses if math.isfinite(fit.turn_after)]
    if not (points or turns):
        return []
    parts = []
    if points:
        rms = [_rms([p.rms_after for p in points]), _rms([p.motion for p in points])]
        parts.append(f"{1e3 * rms[0]:.2f} mm rms over {_points(points)}")
        if rms[1] > 0.0:
            parts[0] += f", {100.0 * rms[0] / rms[1]:.1f} % of the motion"
    if turns:
        parts.append(f"{math.degrees(_rms(turns)):.2f} deg rms in orientation")
    held_out = poses[0].role == "validation"
    head = "Held-out error" if held_out else "Prediction error"
    of = poses[0].name if len(poses) == 1 else f"{len(poses)} poses"
    seen = " not used in the fit" * (held_out and len(poses) > 1)
    return [f"{head} of {of}{seen}: {'; '.join(parts)}{_range(points)}."]


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _range(poses: Sequence[ConfigurationResult]) -> str:
    """Name the poses that are predicted best and worst, and quantiles of many."""
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


def _points(poses: Sequence[ConfigurationResult]) -> str:
    """Count the markers and the 6-D sensors of a pose, in words."""
    turning = {turn.name for pose in poses for turn in pose.turns}
    names = {point.name for pose in poses for point in pose.points}
    counts = {"marker": len(names - turning), "6-D sensor": len(names & turning)}
    return listed([f"{n} {what}{'s' * (n > 1)}" for what, n in counts.items() if n])
