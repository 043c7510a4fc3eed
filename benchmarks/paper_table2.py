"""Table II of the paper: the parallel robot, calibrated and tested on seven poses each.

The measured robot is not public: ten printed ones take its place (`_robot.py`). The
model is calibrated with a prior of 30 % and 20 degrees, since the seven poses see few
of its 36 directions, and together with the zeros and mountings of its motors; "material
alone" leaves these where they are, on three robots. A reduction is the mean of those of
position and orientation; a calibration that did not converge counts in none.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks._parallel_robot import ParallelRobot
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._robot import (
    QUANTITIES,
    calibrated,
    fits_of,
    measured_robot,
    model_robot,
    reductions,
    values_of,
)
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.fields import ControlPointParameters
from softcal_jax.plotting import plot_fibres

ROBOTS = 10
"""Printed robots."""

ROBOTS_ALONE = 3
"""Those that are calibrated with the material alone, too."""

ROLES = ("calibration", "validation")

TITLES = {"": "With zeros and mountings of the motors", "_material": "Material alone"}

GOALS = {
    "median_reduction_calibration": Goal("at least", 60),
    "median_reduction_validation": Goal("at least", 50),
    "worst_validation": Goal("at least", 0),
}


def run(options: Options) -> Outcome:
    """Calibrate against every robot in both ways, and compare errors."""
    robot, alone = model_robot(), model_robot(setup=None)
    fits: dict[str, list[CalibrationResult]] = {"": [], "_material": []}
    picture = options.folder() / "fig6.png"
    picture.unlink(missing_ok=True)
    for seed in range(ROBOTS):
        options.say(f"robot {seed + 1} of {ROBOTS}")
        measured = measured_robot(robot, seed)
        fits[""].append(calibrated(robot, measured))
        if seed < ROBOTS_ALONE:
            fits["_material"].append(calibrated(alone, measured))
        if fits[""][-1].converged and not picture.exists():
            truth = measured.printed.parameters
            calibrated_to = values_of(fits[""][-1])
            plot(robot, {"calibrated": calibrated_to, "printed": truth}, picture)
            options.say(f"picture: {picture}")
    figures, samples, tables = {}, {}, []
    for suffix, every in fits.items():
        results = [result for result in every if result.converged]
        figures[f"converged{suffix}"] = len(results)
        figures[f"robots{suffix}"] = len(every)
        if not results:
            continue
        for role in ROLES:
            each = np.array([reductions(fits_of(r, role)) for r in results])
            both = each.mean(axis=1)
            figures[f"median_reduction_{role}{suffix}"] = float(np.median(both))
            figures[f"worst_{role}{suffix}"] = float(np.min(both))
            for (what, *_), values in zip(QUANTITIES, each.T, strict=True):
                samples[f"{what}_{role}{suffix}_percent"] = values.tolist()
                name = f"median_{what}_{role}{suffix}"
                figures[name] = float(np.median(values))
        if suffix == "":
            figures |= _errors(results)
        tables.append(_table(TITLES[suffix], results))
    return Outcome(figures, samples, GOALS, tables)


def _errors(results: Sequence[CalibrationResult]) -> dict[str, Figure]:
    """Mean errors over all robots and poses."""
    figures: dict[str, Figure] = {}
    for role in ROLES:
        fits = [fit for result in results for fit in fits_of(result, role)]
        for what, unit, before, after in QUANTITIES:
            figures[f"{what}_{role}_before_{unit}"] = _mean(fits, before)
            figures[f"{what}_{role}_after_{unit}"] = _mean(fits, after)
    return figures


def _mean(fits: Sequence[ConfigurationResult], error) -> float:
    return float(np.mean([error(fit) for fit in fits]))


def _table(title: str, results: Sequence[CalibrationResult]) -> Table:
    """Rows as in Table II: each pose, mean over all robots, then the mean of all."""
    rows = []
    for role in ROLES:
        robots = [fits_of(result, role) for result in results]
        rows += [_row(poses[0].name, poses) for poses in zip(*robots, strict=True)]
        rows.append(_row(f"mean, {role}", [fit for fits in robots for fit in fits]))
    columns = ["pose"]
    for what, unit, *_ in QUANTITIES:
        columns += [f"{what} before [{unit}]", "after", "reduction [%]"]
    return Table(f"Mean errors of the effector. {title}", columns, rows)


def _row(name: str, fits: Sequence[ConfigurationResult]) -> list[str]:
    cells = [name]
    for (_, _, *errors), reduced in zip(QUANTITIES, reductions(fits), strict=True):
        cells += [*(f"{_mean(fits, error):.2f}" for error in errors), f"{reduced:.0f}"]
    return cells


def plot(robot: ParallelRobot, ends, path) -> None:
    """Fig. 6: the fibres on a sheet as ordered, as calibrated, and as printed.

    Args:
        robot: The model, for its control points.
        ends: Values of the parameters, by title.
        path: PNG file.
    """
    field = next(
        entry
        for entry in robot.space.entries
        if isinstance(entry, ControlPointParameters) and entry.field == "theta"
    )
    ordered = {p.name: p.start for p in field.parameters}
    sheet = robot.geometry.sheet(size=0.005)
    angles = {
        title: np.asarray(field.evaluate(sheet, values))
        for title, values in ({"ordered": ordered} | ends).items()
    }
    turn = lambda theta: np.mod(theta + np.pi / 2, np.pi) - np.pi / 2
    plot_fibres(
        sheet,
        {title: turn(theta) for title, theta in angles.items()},
        path,
        plane="xz",
        control_points=np.asarray(field.control_points.positions),
        title="Fig. 6: fibres of the sheets, ordered, calibrated, and printed",
    )
