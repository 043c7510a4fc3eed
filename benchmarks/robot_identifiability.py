"""What 7, 14 and 21 poses tell about the 36 parameters of the parallel robot.

- Directions along which the data tell more than a prior of 30 % and 20 degrees, with
  the noise of the paper's Polhemus tracker (0.76 mm, 0.15 degrees) and of a finer one
  (0.1 mm, 0.05 degrees); and what it costs to calibrate the setup along.
- Calibrations of printed robots (`_robot.py`) on seven poses with the prior and without
  one: errors of the seven other poses, and of the parameters.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks._parallel_robot import SETUP, parallel_robot, pose
from benchmarks._printed_robot import PrintedRobot
from benchmarks._problem import Figure, Options, Outcome, Table
from benchmarks._robot import (
    QUANTITIES,
    SIZE,
    calibrated,
    fits_of,
    measured_robot,
    model_robot,
    reductions,
    values_of,
)
from softcal_jax.calibration import CalibrationResult
from softcal_jax.fields import exactly_known
from softcal_jax.identifiability import Identifiability, identify

TRACKERS = {
    "polhemus": (0.76e-3, float(np.deg2rad(0.15))),
    "fine": (0.1e-3, float(np.deg2rad(0.05))),
}
"""Standard deviations of position [m] and orientation [rad]."""

POSES = (7, 14, 21)
"""Numbers of poses; the first seven are those of Table II."""

EXTRA = 30.0 + 30.0 * np.random.default_rng(0).random((14, 6))
"""Motor angles of the other fourteen: all six at random between 30 and 60 [degrees]."""

ROBOTS = 3
"""Printed robots that are calibrated with and without the prior."""

WAYS = {"with_prior": {}, "without_prior": {"prior": None}}
"""How they are calibrated."""


def run(options: Options) -> Outcome:
    """Count directions, then calibrate."""
    figures: dict[str, Figure] = {}
    rows = []
    for tracker, (std, std_angle) in TRACKERS.items():
        for n in POSES:
            options.say(f"{tracker}, {n} poses")
            alone = outlook(n, std, std_angle)
            with_setup = outlook(n, std, std_angle, setup=SETUP)
            name = f"{tracker}_c{n}"
            figures[f"informed_directions_{name}"] = alone.informed
            figures[f"informed_directions_{name}_setup"] = with_setup.informed
            left = [spread_left(f) for f in (alone, with_setup)]
            figures[f"spread_left_percent_{name}"] = left[0]
            figures[f"spread_left_percent_{name}_setup"] = left[1]
            cells = [str(f.informed) for f in (alone, with_setup)]
            cells += [f"{value:.0f}" for value in left]
            rows.append([tracker, str(n), *cells])
            if name == "polhemus_c7":
                options.say(str(alone))
    titles = ["tracker", "poses", "informed of 36", "of 60, with setup"]
    titles += ["spread left of the 36 [%]", "with setup"]
    tables = [Table("Directions", titles, rows)]
    more, table = _prior_or_none(options)
    return Outcome(figures | more, tables=[*tables, table])


def outlook(
    n: int, std: float, std_angle: float, setup: Mapping[str, float] | None = None
) -> Identifiability:
    """What n poses tell at the ordered field.

    Args:
        n: Number of poses.
        std: Standard deviation of positions [m].
        std_angle: Standard deviation of orientations [rad].
        setup: Errors of the setup that are calibrated along.
    """
    robot = parallel_robot(size=SIZE, setup=setup, std=std, std_angle=std_angle)
    extra = tuple(
        pose(robot.geometry, f"extra {k}", angles, std=std, std_angle=std_angle)
        for k, angles in enumerate(EXTRA, start=1)
    )
    posed = (*robot.configurations, *extra)[:n]
    return identify(robot.model, robot.space, posed, uncertain=exactly_known())


def spread_left(forecast: Identifiability) -> float:
    """Mean standard error of the material over that of its prior [percent]."""
    material = [p for p in forecast.parameters if p.name.startswith(("E_", "theta"))]
    left = [p.standard_error / p.prior for p in material if p.prior is not None]
    return 100.0 * float(np.mean(left))


def _prior_or_none(options: Options) -> tuple[dict[str, Figure], Table]:
    """Held-out errors and parameter errors of calibrations with and without prior."""
    figures: dict[str, Figure] = {}
    robots = {way: model_robot(**choices) for way, choices in WAYS.items()}
    results: dict[str, list[CalibrationResult]] = {way: [] for way in WAYS}
    printed: list[PrintedRobot] = []
    for seed in range(ROBOTS):
        measured = measured_robot(robots["with_prior"], seed)
        printed.append(measured.printed)
        for way, robot in robots.items():
            options.say(f"robot {seed + 1} of {ROBOTS}, {way.replace('_', ' ')}")
            results[way].append(calibrated(robot, measured))
    rows = []
    for way, every in results.items():
        pairs = zip(every, printed, strict=True)
        done = [(result, p) for result, p in pairs if result.converged]
        figures[f"converged_{way}"] = len(done)
        cells = [way.replace("_", " "), f"{len(done)} of {ROBOTS}"]
        if done:
            numbers = _numbers(done)
            figures |= {f"{name}_{way}": value for name, value in numbers.items()}
            cells += [f"{value:.1f}" for value in numbers.values()]
        rows.append(cells + ["-"] * (6 - len(cells)))
    columns = ["calibration", "converged", "position, held out: reduction [%]"]
    columns += ["orientation [%]", "error of moduli [%]", "of theta [deg]"]
    return figures, Table("With a prior and without", columns, rows)


def _numbers(
    done: Sequence[tuple[CalibrationResult, PrintedRobot]],
) -> dict[str, float]:
    """Medians over the calibrations that converged."""
    reduced = np.median([reductions(fits_of(r, "validation")) for r, _ in done], 0)
    errors = np.median([parameter_errors(r, p) for r, p in done], 0)
    names = [f"held_out_reduction_{what}" for what, *_ in QUANTITIES]
    names += ["error_moduli_percent", "error_theta_deg"]
    return dict(zip(names, map(float, (*reduced, *errors)), strict=True))


def parameter_errors(
    result: CalibrationResult, printed: PrintedRobot
) -> tuple[float, float]:
    """Root-mean-square errors: of the moduli [percent], and of theta [degrees]."""
    values = values_of(result)
    moduli, theta = [], []
    for name, true in printed.parameters.items():
        if name.startswith(("E_t", "E_l")):
            moduli.append(np.log(values[name] / true))
        elif name.startswith("theta"):
            theta.append(np.mod(values[name] - true + np.pi / 2, np.pi) - np.pi / 2)
    rms = lambda errors: float(np.sqrt(np.mean(np.square(errors))))
    return 100.0 * rms(moduli), float(np.rad2deg(rms(theta)))
