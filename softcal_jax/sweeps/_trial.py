"""Points of a sweep, and its trials: a point with random numbers of its own."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from softcal_jax._places import PLANNED, TRIALS
from softcal_jax._text import check_known
from softcal_jax._typing import HostArray

Point = dict[str, Any]

COLUMNS = (
    "state",
    "reason",
    "seconds",
    "compile_seconds",
    "worker",
    "ended",
    "notes",
    "traceback",
    "point",
)
"""Columns of every row of a sweep between its axes and its figures."""


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


@dataclass(frozen=True, eq=False)
class Points(Sequence[Point]):
    """Points of a sweep, each made from its index when it is asked for.

    Attributes:
        axes: Values of each axis, or their range.
        cells: For each point the index of the value on each axis, or shares of the way
            along it; None for every combination, the last axis fastest.
    """

    axes: Mapping[str, Sequence[Any] | Range]
    cells: HostArray | None = None

    def __len__(self) -> int:
        """Return the number of points."""
        if self.cells is not None:
            return len(self.cells)
        return math.prod(map(len, self._lists))

    def __getitem__(self, index: int | slice) -> Any:
        """Return a point, or a list of some."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if self.cells is None:
            sizes = tuple(map(len, self._lists))
            cell = np.unravel_index(range(len(self))[index], sizes)
        else:
            cell = self.cells[index]
        pairs = zip(self.axes.items(), cell, strict=True)
        return {axis: _at(values, where.item()) for (axis, values), where in pairs}

    @property
    def _lists(self) -> list[Sequence[Any]]:
        """Values of the axes, none of which is a range."""
        return [v for v in self.axes.values() if not isinstance(v, Range)]


def grid(axes: Mapping[str, Sequence[Any] | Range]) -> Points:
    """List every combination of the values of each axis; the last varies fastest.

    Raises:
        ValueError: If there is no axis, one without values, a range, or too many
            combinations.
    """
    lists = _lists(axes)
    for axis in axes:
        if axis not in lists:
            raise ValueError(
                f"axis {axis!r} is a range, which has no end of values: draw some, "
                "like sample = 100, or list the values."
            )
    n = math.prod(map(len, lists.values()))
    PLANNED.check("all combinations of the values (`sample` draws some of them)", n)
    return Points(lists)


def sample(
    axes: Mapping[str, Sequence[Any] | Range], n: int, *, seed: int = 0
) -> Points:
    """Draw points at random.

    With a range among the axes, they are a Latin hypercube (McKay et al., Technometrics
    21, 1979): each axis is cut into n equal parts, with one point in each. With lists
    alone, they are different points of the grid.

    Args:
        axes: Values of each axis, or their range.
        n: Number of points.
        seed: Seed of the choice.

    Raises:
        ValueError: If there is no axis, an axis has no values, or n is less than one,
            larger than the grid, or too large.
    """
    lists = _lists(axes)
    if n < 1:
        raise ValueError(f"a sample has at least 1 point, got {n}.")
    PLANNED.check(f"a sample of {n}", n)
    random = np.random.default_rng(seed)
    if len(lists) == len(axes):
        sizes = [len(values) for values in lists.values()]
        total = math.prod(sizes)
        if n > total:
            raise ValueError(
                f"the axes have {total} different points, so {n} cannot be "
                "sampled; ask for fewer, or for the whole grid."
            )
        chosen = np.sort(random.choice(total, n, replace=False))
        return Points(lists, np.array(np.unravel_index(chosen, sizes)).T)
    from scipy.stats.qmc import LatinHypercube

    cells = LatinHypercube(len(axes), rng=random).random(n)
    return Points({axis: lists.get(axis, v) for axis, v in axes.items()}, cells)


def _at(values: Sequence[Any] | Range, where: float) -> Any:
    """Return the value at an index, or at a share of the way along an axis."""
    if isinstance(values, Range):
        return values.at(where)
    if isinstance(where, int):
        return values[where]
    return values[min(int(where * len(values)), len(values) - 1)]


def _lists(axes: Mapping[str, Sequence[Any] | Range]) -> dict[str, Sequence[Any]]:
    """Check the values of all axes, and return those that are no ranges."""
    if not axes:
        raise ValueError("a sweep needs at least one axis, got none.")
    # A copy, so that points do not change with a list of the caller's.
    lists: dict[str, Sequence[Any]] = {
        axis: values if isinstance(values, range | str) else tuple(values)
        for axis, values in axes.items()
        if not isinstance(values, Range)
    }
    for axis, values in lists.items():
        if isinstance(values, str):
            raise ValueError(
                f"axis {axis!r} needs a list of values, got the text {values!r}."
            )
        if not len(values):
            raise ValueError(
                f"axis {axis!r} has no values, so the sweep has no trials: give it at "
                "least one, or leave the axis out."
            )
    return lists


@dataclass(frozen=True)
class Trial:
    """A point of a sweep.

    Attributes:
        point: Value of each axis: a text, a number, true or false, or a list of these.
        sweep_seed: Seed of the whole sweep.
    """

    point: Mapping[str, Any]
    sweep_seed: int = 0

    def __post_init__(self):
        values = {axis: plain(axis, value) for axis, value in self.point.items()}
        object.__setattr__(self, "point", values)

    def __getitem__(self, axis: str) -> Any:
        """Return the value of an axis, or raise ValueError if there is none."""
        check_known("axis", self.point, axis)
        return self.point[axis]

    @property
    def key(self) -> str:
        """Name of the trial: its point as JSON."""
        return _canonical(self.point)

    @property
    def seed(self) -> int:
        """Seed of the trial, which depends on its point and the sweep's seed alone."""
        return self.seed_of(*self.point)

    def seed_of(self, *axes: str) -> int:
        """Return a seed of 63 bits that depends on the values of some axes alone.

        Trials that agree on these axes share it: layouts are compared on the same draws
        of noise with `np.random.default_rng(trial.seed_of("noise"))`.

        Raises:
            ValueError: If the sweep has no such axis.
        """
        values = {axis: self[axis] for axis in axes}
        text = f"{self.sweep_seed} {_canonical(values)}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) >> 1


def as_trials(
    points: Sequence[Mapping[str, Any]], these: range, seed: int
) -> tuple[Trial, ...]:
    """Make trials of a sweep; all must have the same axes and different points.

    That there are too many is said before any point is made.
    """
    TRIALS.check("a sweep (--part and --of run larger ones in parts)", len(these))
    trials = tuple(Trial(points[i], seed) for i in these)
    if not trials:
        raise ValueError("the sweep has no trials: give each axis at least one value.")
    axes = tuple(trials[0].point)
    for axis in axes:
        if axis in COLUMNS:
            raise ValueError(
                f"an axis cannot be called {axis!r}, as every row has a column of that "
                f"name, like {', '.join(COLUMNS)}."
            )
    seen = set()
    for trial in trials:
        if set(trial.point) != set(axes):
            raise ValueError(
                "all points of a sweep need the same axes; got "
                f"{', '.join(axes)} and {', '.join(trial.point)}."
            )
        if trial.key in seen:
            point = ", ".join(f"{axis} = {shown(v)}" for axis, v in trial.point.items())
            raise ValueError(
                f"the sweep tries {point} twice; each point must stand in it once."
            )
        seen.add(trial.key)
    return trials


def shown(value: Any) -> str:
    """Format a value for tables."""
    if isinstance(value, list):
        return " + ".join(map(shown, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _canonical(point: Mapping[str, Any]) -> str:
    return json.dumps(point, sort_keys=True, separators=(",", ":"), allow_nan=False)


def plain(axis: str, value: Any) -> Any:
    """Convert a value to what JSON would return."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return [plain(axis, entry) for entry in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float) and np.isfinite(value):
        return value
    raise ValueError(
        f"axis {axis!r} has the value {value!r}; expected a text, a finite number, "
        "true or false, or a list of these."
    )
