"""The parallel robot of Sec. VI, and printed ones in place of the measured one.

Another law, a finer mesh, fields that vary smoothly, and errors of motors, mounting and
tracker: see `printed_robot`. A pose is read ten times, and the mean is what counts.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks._parallel_robot import PRIOR, SETUP, ParallelRobot, parallel_robot
from benchmarks._printed_robot import (
    PrintedRobot,
    PrintingErrors,
    printed_robot,
    read_poses_of,
)
from softcal_jax.calibration import CalibrationResult, ConfigurationResult, calibrate
from softcal_jax.configurations import Configuration
from softcal_jax.fields import Uncertain

SIZE = 0.0075
"""Edge length of the calibrated model; the robots are finer [m]."""

READINGS = 10
"""Readings of the tracker that are averaged."""

STD, STD_ANGLE = 0.3e-3, float(np.deg2rad(0.2))
"""What the calibration takes a mean reading to be known to: it, and the setup."""

READ_STD = PrintingErrors().position / READINGS**0.5
READ_STD_ANGLE = PrintingErrors().orientation / READINGS**0.5
"""What a mean reading is known to by itself, [m] and [rad]: the tracker's noise."""

UNCERTAIN = Uncertain(recordings=0.0)
"""What the calibration holds fixed; errors of the readings are all in `STD`."""


class Measured(NamedTuple):
    """A printed robot, and its poses as read."""

    printed: PrintedRobot
    calibration: tuple[Configuration, ...]
    validation: tuple[Configuration, ...]


def model_robot(
    prior: Mapping[str, float] | None = PRIOR,
    setup: Mapping[str, float] | None = SETUP,
    *,
    std: float = STD,
    std_angle: float = STD_ANGLE,
) -> ParallelRobot:
    """The model that is calibrated.

    Args:
        prior: What is known of the fields, or None.
        setup: Errors of the setup that are calibrated along, or None.
        std: What positions are taken to be known to [m].
        std_angle: What orientations are taken to be known to [rad].
    """
    return parallel_robot(
        size=SIZE, prior=prior, setup=setup, std=std, std_angle=std_angle
    )


def measured_robot(robot: ParallelRobot, seed: int) -> Measured:
    """One printed robot in the poses of the model.

    Args:
        robot: The model.
        seed: Which printed robot, and which noise.
    """
    printed = printed_robot(robot.geometry, seed=seed)
    poses = robot.configurations + robot.validation
    read = read_poses_of(printed, poses, seed=seed, readings=READINGS)
    n = len(robot.configurations)
    return Measured(printed, read[:n], read[n:])


def calibrated(robot: ParallelRobot, measured: Measured) -> CalibrationResult:
    """The model calibrated on the poses of a printed robot, tested on the others.

    From the material as ordered alone, which is what the prior is about: five other
    starts would cost six times as much.
    """
    return calibrate(
        robot.model,
        robot.space,
        measured.calibration,
        validation=measured.validation,
        noise="stated",
        uncertain=UNCERTAIN,
        starts=1,
        intervals=None,
    )


def fits_of(result: CalibrationResult, role: str) -> list[ConfigurationResult]:
    """The poses that were fitted, or those that were only predicted."""
    return [fit for fit in result.configurations if fit.role == role]


def values_of(result: CalibrationResult) -> dict[str, float]:
    """Parameters of a calibration by name, in SI units."""
    return {p.name: p.value for p in result.parameters}


QUANTITIES = (
    ("position", "mm", lambda f: 1e3 * f.rms_before, lambda f: 1e3 * f.rms_after),
    (
        "orientation",
        "deg",
        lambda f: np.rad2deg(f.turn_before),
        lambda f: np.rad2deg(f.turn_after),
    ),
)
"""What is compared: name, unit, error before and after."""


def reductions(fits: Sequence[ConfigurationResult]) -> tuple[float, ...]:
    """Reduction of the mean error of position and of orientation [percent]."""
    total = lambda error: float(np.sum([error(fit) for fit in fits]))
    return tuple(
        100.0 * (1.0 - total(after) / total(before))
        for _, _, before, after in QUANTITIES
    )
