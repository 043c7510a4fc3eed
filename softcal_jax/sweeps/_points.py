"""Points of a sweep: every combination of values, or a random sample."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Point = dict[str, Any]


@dataclass(frozen=True)
class Range:
    """All numbers between two ends, for `sample`.

    Attributes:
        low: Smallest number.
        high: Largest number.
        scale: "log" samples uniformly in the logarithm.
        form: Format of the number in the point; "{:.9g} kPa" gives it a unit.
    """

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"
    form: str | None = None

    def __post_init__(self):
        if not (math.isfinite(self.low) and self.low < self.high < math.inf):
            raise ValueError(
                f"a range needs two finite ends, low below high; got {self.low} and "
                f"{self.high}."
            )
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError(
                f"a range on a log scale needs positive ends, got {self.low}."
            )

    def at(self, share: float) -> Any:
        """Return the number at a share of the way from the low end to the high one."""
        if self.scale == "log":
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        value = min(max(value, self.low), self.high)
        return value if self.form is None else self.form.format(value)


def grid(axes: Mapping[str, Sequence[Any] | Range]) -> list[Point]:
    """List every combination of the values of some axes.

    Args:
        axes: Values of each axis. The last axis varies fastest.

    Returns:
        The points.

    Raises:
        ValueError: If there is no axis, one without values, or a range.
    """
    _check_axes(axes)
    lists = []
    for axis, values in axes.items():
        if isinstance(values, Range):
            raise ValueError(
                f"axis {axis!r} is a range, which has no end of values: sample it, or "
                "list the values."
            )
        lists.append(values)
    return [
        dict(zip(axes, values, strict=True)) for values in itertools.product(*lists)
    ]


def sample(
    axes: Mapping[str, Sequence[Any] | Range], n: int, *, seed: int = 0
) -> list[Point]:
    """Draw points at random.

    With a range among the axes, they are a Latin hypercube (McKay et al., Technometrics
    21, 1979): each axis is cut into n equal parts, with one point in each. With lists
    alone, they are different points of the grid.

    Args:
        axes: Values of each axis, or their range.
        n: Number of points.
        seed: Seed of the choice.

    Returns:
        The points.

    Raises:
        ValueError: If there is no axis, or one without values, or n is less than one or
            more than the grid has.
    """
    _check_axes(axes)
    if n < 1:
        raise ValueError(f"a sample has at least 1 point, got {n}.")
    random = np.random.default_rng(seed)
    lists = {a: v for a, v in axes.items() if not isinstance(v, Range)}
    if len(lists) == len(axes):
        sizes = [len(values) for values in lists.values()]
        if n > math.prod(sizes):
            raise ValueError(
                f"the axes have {math.prod(sizes)} different points, so {n} cannot be "
                "sampled; ask for fewer, or for the whole grid."
            )
        chosen = np.sort(random.choice(math.prod(sizes), n, replace=False))
        cells = np.array(np.unravel_index(chosen, sizes)).T.tolist()
        return [
            {axis: lists[axis][i] for axis, i in zip(lists, cell, strict=True)}
            for cell in cells
        ]
    from scipy.stats.qmc import LatinHypercube

    shares = LatinHypercube(len(axes), rng=random).random(n)
    return [
        {axis: _at(axes[axis], s) for axis, s in zip(axes, row, strict=True)}
        for row in shares.tolist()
    ]


def _at(values: Sequence[Any] | Range, share: float) -> Any:
    if isinstance(values, Range):
        return values.at(share)
    return values[min(int(share * len(values)), len(values) - 1)]


def _check_axes(axes: Mapping[str, Sequence[Any] | Range]) -> None:
    if not axes:
        raise ValueError("a sweep needs at least one axis, got none.")
    for axis, values in axes.items():
        if isinstance(values, str):
            raise ValueError(
                f"axis {axis!r} needs a list of values, got the text {values!r}."
            )
        if not isinstance(values, Range) and not len(values):
            raise ValueError(
                f"axis {axis!r} has no values, so the sweep has no trials: give it at "
                "least one, or leave the axis out."
            )
