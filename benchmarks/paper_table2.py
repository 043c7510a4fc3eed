"""Table II of the paper: the parallel robot, calibrated and tested on seven poses each.

The measured robot is not public: ten synthetic ones take its place, with another law, a
finer mesh, printed fields that vary smoothly, and errors of motors, mounting and
tracker (`printed_robot`). The model is calibrated with a prior of 30 % and 20 degrees:
the seven poses see few of its 36 directions.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationFit, calibrate
from softcal_jax.robots import (
    ParallelRobot,
    parallel_robot,
    printed_robot,
    read_poses_of,
)

ROBOTS = 10
"""Synthetic robots."""

SIZE = 0.0075
"""Edge length of the calibrated model; the robots are finer [m]."""

STD, STD_ANGLE = 0.5e-3, float(np.deg2rad(0.5))
"""What the calibration takes a pose to be known to: tracker and setup together."""

READINGS = 10
"""Readings of the tracker that are averaged."""

GOALS = {
    "median_reduction_calibration": Goal("at least", 60),
    "median_reduction_validation": Goal("at least", 50),
    "worst_validation": Goal("at least", 0),
}


def run(options: Options) -> Outcome:
    """Calibrate against every robot, and compare errors before and after."""
    robot = parallel_robot(size=SIZE, std=STD, std_angle=STD_ANGLE)
    results = []
    for seed in range(ROBOTS):
        options.say(f"robot {seed + 1} of {ROBOTS}")
        results.append(calibrated(robot, seed))
    fits = {
        role: [_of_role(result, role) for result in results]
        for role in ("calibration", "validation")
    }
    reductions = {role: [reduction(f) for f in fits[role]] for role in fits}
    figures: dict[str, Figure] = {
        f"median_reduction_{role}": float(np.median(values))
        for role, values in reductions.items()
    }
    figures["worst_validation"] = float(np.min(reductions["validation"]))
    figures["converged"] = sum(result.converged for result in results)
    for role, found in fits.items():
        for what, unit, before, after in _QUANTITIES:
            figures[f"{what}_{role}_before_{unit}"] = _mean(found, before)
            figures[f"{what}_{role}_after_{unit}"] = _mean(found, after)
    samples = {f"reduction_{role}_percent": v for role, v in reductions.items()}
    return Outcome(figures, samples, GOALS, [_table(fits)])


def calibrated(robot: ParallelRobot, seed: int) -> CalibrationResult:
    """The model calibrated on seven poses of one printed robot, and tested on seven."""
    poses = robot.configurations + robot.validation
    printed = printed_robot(robot.geometry, seed=seed)
    measured = read_poses_of(printed, poses, seed=seed, readings=READINGS)
    n = len(robot.configurations)
    return calibrate(
        robot.model,
        robot.space,
        measured[:n],
        validation=measured[n:],
        noise="stated",
    )


_QUANTITIES = (
    ("position", "mm", lambda f: 1e3 * f.rms_before, lambda f: 1e3 * f.rms_after),
    (
        "orientation",
        "deg",
        lambda f: np.rad2deg(f.turn_before),
        lambda f: np.rad2deg(f.turn_after),
    ),
)


def _of_role(result: CalibrationResult, role: str) -> list[ConfigurationFit]:
    return [fit for fit in result.configurations if fit.role == role]


def _mean(robots: Sequence[Sequence[ConfigurationFit]], quantity) -> float:
    return float(np.mean([[quantity(fit) for fit in fits] for fits in robots]))


def reduction(fits: Sequence[ConfigurationFit]) -> float:
    """Reduction of the mean error, position and orientation alike [percent]."""
    shares = []
    for _, _, before, after in _QUANTITIES:
        total = np.sum([before(fit) for fit in fits])
        shares.append(1.0 - np.sum([after(fit) for fit in fits]) / total)
    return 100.0 * float(np.mean(shares))


def _table(fits: dict[str, list[list[ConfigurationFit]]]) -> Table:
    """Rows as in Table II: each pose over all robots, then the mean."""
    rows = []
    for role, robots in fits.items():
        for i, fit in enumerate(robots[0]):
            rows.append(_row(fit.name, [[fits[i]] for fits in robots]))
        rows.append(_row(f"mean, {role}", robots))
    columns = ["pose", "position before [mm]", "after", "orientation before [deg]"]
    columns += ["after", "reduction [%]"]
    return Table("Errors of the effector, mean of all robots", columns, rows)


def _row(name: str, robots: Sequence[Sequence[ConfigurationFit]]) -> list[str]:
    cells = [name]
    for _, _, before, after in _QUANTITIES:
        cells += [f"{_mean(robots, before):.2f}", f"{_mean(robots, after):.2f}"]
    every = [fit for fits in robots for fit in fits]
    return [*cells, f"{reduction(every):.0f}"]
