"""What data can tell about the parameters: the result and its text."""

import math

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.identifiability._conditioning import Conditioning
from softcal_jax.identifiability._spread import Direction, Verdict

MOST_SHOWN = 8
"""Most blind directions that are listed; the others are only counted."""


class ParameterOutlook(eqx.Module):
    """How well one parameter can be determined, in SI units.

    Attributes:
        name: Its name.
        value: Value at which it was judged.
        standard_error: Predicted from noise and prior; never above `prior`.
        data_only: Predicted from the noise alone; infinite where the data are blind.
        prior: Standard deviation before any data: the width between the bounds over the
            root of 12, or the stated one if that is smaller.
        relative: Standard error over value [-]; None for an angle or a value of zero.
        spread: Standard error over `prior`, in scaled units [-].
        verdict: Verdict on the spread.
        unit: SI unit.
    """

    name: str
    value: float
    standard_error: float
    data_only: float
    prior: float
    relative: float | None
    spread: float
    verdict: Verdict
    unit: str


class Identifiability(eqx.Module):
    """What data can tell about the parameters, to first order at one value of them.

    Attributes:
        verdict: Verdict on the worst direction.
        parameters: One entry per parameter.
        directions: From the best to the worst seen.
        covariance: Covariance of the scaled parameters, from noise and prior [-].
        conditioning: Singular values and condition numbers.
        n_data: Number of measured coordinates.
        known: What the spread is compared with: "prior" if stated, else "bounds".
    """

    verdict: Verdict
    parameters: tuple[ParameterOutlook, ...]
    directions: tuple[Direction, ...]
    covariance: Float[HostArray, "n_p n_p"]
    conditioning: Conditioning
    n_data: int
    known: str

    @property
    def informed(self) -> int:
        """Number of directions along which the data tell more than the prior."""
        return sum(d.signal > 1.0 for d in self.directions)

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def correlation(self) -> Float[HostArray, "n_p n_p"]:
        """Correlation of the parameters [-]."""
        std = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(std, std)

    @property
    def blind(self) -> tuple[Direction, ...]:
        """The directions that are not identifiable, the worst last."""
        return tuple(d for d in self.directions if d.verdict == "not identifiable")

    def __str__(self) -> str:
        """Format the verdict, the parameters, blind directions and what to do."""
        n_data, n_p, known = self.n_data, self.n_parameters, self.known
        lines = [
            f"{self.verdict.capitalize()} at these values: {n_data} measured "
            f"coordinate{'s' * (n_data != 1)} for {n_p} parameter{'s' * (n_p != 1)}."
        ]
        head = ("parameter", "value", "standard error", "from data alone", "verdict")
        lines += table(head, [_row(p, known) for p in self.parameters])
        if any(p.data_only > p.prior for p in self.parameters):
            lines.append(
                f"The standard error takes the {known} for knowledge; the verdict "
                f"compares it with that of the {known} alone."
            )
        blind = self.blind
        if blind:
            lines.append(
                f"The data hardly see {len(blind)} of {n_p} "
                f"direction{'s' * (n_p != 1)} (standard error over that of the "
                f"{known}):"
            )
            lines += [
                f"  {d.words} ({100 * d.spread:.0f} %)"
                for d in blind[: -MOST_SHOWN - 1 : -1]
            ]
            if len(blind) > MOST_SHOWN:
                lines.append(f"  and {len(blind) - MOST_SHOWN} more.")
            lines.append(
                f"They tell more than the {known} along {self.informed} of {n_p}."
            )
        if n_data:
            lines += str(self.conditioning).splitlines()
        return "\n".join(lines + _remedies(self))


def _row(p: ParameterOutlook, known: str) -> tuple[str, ...]:
    factor, unit = readable_unit([p.value], p.unit)
    with_unit = lambda v, digits: f"{number(v * factor, digits)} {unit}".rstrip()
    error = with_unit(p.standard_error, 3)
    if p.relative is not None:
        error += f" ({number(100 * p.relative, 2)} %)"
    alone = with_unit(p.data_only, 3)
    if p.data_only > p.prior:
        alone = f"wider than {known}" if math.isfinite(p.data_only) else "blind"
    return (p.name, with_unit(p.value, 4), error, alone, p.verdict)


def _remedies(found: Identifiability) -> list[str]:
    """Advise what to do, if anything."""
    if found.n_data == 0:
        return ["Nothing is measured: give the configurations markers."]
    if found.verdict == "identifiable":
        return []
    missing, first = found.n_parameters - found.n_data, ""
    if missing > 0:
        several = "s are" if missing > 1 else " is"
        first = f"At least {missing} more measured coordinate{several} needed. "
    return [
        f"{first}What to do: another configuration (load, orientation, other end "
        "clamped), more markers, or less noise; ranking candidates tells which "
        "configuration adds most. Or calibrate fewer parameters."
    ]


def number(value: float, digits: int = 3) -> str:
    """Format a number with a few digits, without an exponent where none is needed."""
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Format the lines of a table, columns aligned on the left."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return [
        "  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in (head, *rows)
    ]
