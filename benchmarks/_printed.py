"""What a user reads for each calibrated parameter, and whether it holds the truth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax.calibration import CalibrationResult
from softcal_jax.calibration._result import IntervalKind


class Printed(NamedTuple):
    """The interval of a parameter, in SI units.

    Attributes:
        name: Its name.
        lower: Lower end; the bound where the data do not exclude it, nan without one.
        upper: Upper end; likewise.
        kind: How it was found, or that there is none.
        turn: What the parameter is counted modulo: half a turn for an axis, else 0.
    """

    name: str
    lower: float
    upper: float
    kind: IntervalKind
    turn: float

    @property
    def half_width(self) -> float:
        """Half its width; nan without an interval."""
        return 0.5 * (self.upper - self.lower)

    def error(self, truth: float) -> float:
        """How far its middle is from the truth, the shorter way for an axis."""
        gap = 0.5 * (self.lower + self.upper) - truth
        if self.turn:
            gap = float(np.mod(gap + 0.5 * self.turn, self.turn)) - 0.5 * self.turn
        return gap

    def off(self, truth: float) -> float:
        """That distance in half-widths; above 1 outside, nan without an interval."""
        return abs(self.error(truth)) / self.half_width


def printed(result: CalibrationResult) -> tuple[Printed, ...]:
    """What is printed for each parameter of a fit.

    Args:
        result: The fit.
    """
    entries = []
    for p in result.parameters:
        assert p.interval is not None
        interval, turn = p.interval, np.pi if p.unit == "rad" else 0.0
        entries.append(
            Printed(p.name, interval.lower, interval.upper, interval.kind, turn)
        )
    return tuple(entries)


def share_percent(flags: Sequence[bool]) -> float | str:
    """Percentage of flags that are set; a word where there are none."""
    return 100.0 * float(np.mean(flags)) if len(flags) else "no intervals"
