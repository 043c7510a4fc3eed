"""A real silicone tentacle that tendons bend: how well is another session predicted?

The packaged robot `tentacle` (TU Delft): fitted are the eight poses of one session, 0.1
to 0.25 N m on one of two motors, and held out the six of another. Errors are root mean
squares over the poses of each marker, and their mean over the markers.

Its authors state mean distances over 22 poses: 15.8 mm, and 28.4 mm at the tip, with
a rod model that was fitted to eight of them; and 6.4 mm, 6.1 mm at the tip, with a
network for the missing forces that was trained on 20 of them. As root mean squares
these are 17.6 and 6.8 mm (`violin_data.csv` of their repository has the distances).

How well can any model of one session predict the other? Splines through the fitted
readings themselves, over the tension of each tendon, are asked at the four tensions of
the other session that lie between (`interpolated`), where `between` are our errors.
What splines miss is how the experiment repeats, and not the model.
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks._predicted import called_identified, predicted_coordinates
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.identifiability import assess
from softcal_jax.project import load_project
from softcal_jax.robots import ready_made_path

AUTHORS_MM = 15.8
"""Mean distance of the authors' rod model, which is less than its rms."""

TIP = "p4"

GOALS = {
    "held_out_mean_mm": Goal("at most", 6.0),
    "held_out_tip_mm": Goal("at most", 10.0),
    "coverage_95_of_held_out": Goal("between", 0.85, 0.99),
    "unidentifiable_called_identified": Goal("at most", 0),
    "nu_and_density_named": Goal("at least", 1),
    "called_identified": Goal("at most", 0),
}


def run(options: Options) -> Outcome:
    """One calibration."""
    options.say("fit of eight poses, prediction of six")
    result = load_project(ready_made_path("tentacle")).calibrate()
    fitted, held_out = (
        [c for c in result.configurations if c.role == role]
        for role in ("calibration", "validation")
    )
    verdict, held_out_mm = assess(result), marker_errors(held_out)
    least = min(pull(c)[1] for c in fitted)
    between = [c for c in held_out if pull(c)[1] > least]
    figures: dict[str, Figure] = {
        **_mean_and_tip("fitted", marker_errors(fitted)),
        **_mean_and_tip("held_out", held_out_mm),
        **_mean_and_tip("between", marker_errors(between)),
        **_mean_and_tip("interpolated", interpolated(fitted, between)),
        "held_out_rms_mm": float(np.sqrt(np.mean([c.rms_after**2 for c in held_out])))
        * 1e3,
        "authors_over_ours": AUTHORS_MM / float(np.mean([*held_out_mm.values()])),
        "E_kPa": result.value("E") / 1e3,
        "newton_iterations_per_pose": _iterations(result),
        "coverage_95_of_held_out": predicted_coordinates(result, held_out).coverage,
        "unidentifiable_called_identified": called_identified(result),
        "nu_and_density_named": int({"nu", "density"} <= {*verdict.held}),
        "converged": int(result.converged),
        "called_identified": int(verdict.identified),
    }
    rows = [
        [c.name, c.role, f"{1e3 * c.motion:.1f}", f"{1e3 * c.rms_after:.1f}"]
        for c in result.configurations
    ]
    columns = ["pose", "role", "motion [mm]", "rms distance [mm]"]
    values = {"parameters": [p.value for p in result.parameters]}
    return Outcome(
        figures, values, goals=GOALS, tables=[Table("Errors", columns, rows)]
    )


def marker_errors(poses: Sequence[ConfigurationResult]) -> dict[str, float]:
    """Root mean square distance of each marker over some poses [mm]."""
    squares: dict[str, list[float]] = {}
    for pose in poses:
        for marker in pose.points:
            if marker.seen.any():
                square = marker.distance(marker.simulated) ** 2
                squares.setdefault(marker.name, []).append(square)
    return _rms_mm(squares)


def pull(pose: ConfigurationResult) -> tuple[str, float]:
    """The tendon that is pulled, and its tension [N]."""
    assert pose.posed is not None
    ((tendon, force),) = pose.posed.actuation.items()
    return tendon, force.value


def interpolated(
    fitted: Sequence[ConfigurationResult], asked: Sequence[ConfigurationResult]
) -> dict[str, float]:
    """Errors of the measured markers against splines through the fitted ones [mm]."""
    squares: dict[str, list[float]] = {}
    for pose in asked:
        tendon, tension = pull(pose)
        known = sorted((c for c in fitted if pull(c)[0] == tendon), key=pull)
        loads = [pull(c)[1] for c in known]
        for k, marker in enumerate(pose.points):
            spline = CubicSpline(loads, [c.points[k].measured for c in known])
            error = spline(tension) - marker.measured
            squares.setdefault(marker.name, []).append(float(error @ error))
    return _rms_mm(squares)


def _rms_mm(squares: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(1e3 * np.sqrt(np.mean(s))) for name, s in squares.items()}


def _mean_and_tip(which: str, errors_mm: dict[str, float]) -> dict[str, float]:
    mean = float(np.mean([*errors_mm.values()]))
    return {f"{which}_mean_mm": mean, f"{which}_tip_mm": errors_mm[TIP]}


def _iterations(result: CalibrationResult) -> float:
    """Newton iterations of the equilibria of the last evaluation, per pose."""
    return float(np.mean([c.newton_steps for c in result.configurations]))
