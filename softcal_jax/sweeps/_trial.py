"""One trial of a sweep: its point on the axes, and its random numbers."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal_jax._names import unknown_name


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
        values = {axis: _plain(axis, value) for axis, value in self.point.items()}
        object.__setattr__(self, "point", values)

    def __getitem__(self, axis: str) -> Any:
        """Return the value of an axis.

        Raises:
            ValueError: If the sweep has no such axis.
        """
        if axis not in self.point:
            raise unknown_name("axis", axis, self.point)
        return self.point[axis]

    @property
    def key(self) -> str:
        """Name of the trial in the database, which depends on its point alone."""
        return hashlib.sha256(_canonical(self.point).encode()).hexdigest()[:16]

    @property
    def seed(self) -> int:
        """Seed of the trial, which depends on its point and the sweep's seed alone."""
        return self.seed_of(*self.point)

    def seed_of(self, *axes: str) -> int:
        """Return a seed that depends on the values on some axes alone.

        Trials that agree on these axes share it: layouts are compared on the same draws
        of noise with `np.random.default_rng(trial.seed_of("noise"))`.

        Args:
            axes: Names of the axes.

        Returns:
            An integer of 63 bits.

        Raises:
            ValueError: If the sweep has no such axis.
        """
        values = {axis: self[axis] for axis in axes}
        text = f"{self.sweep_seed} {_canonical(values)}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) >> 1


def as_trials(
    points: Iterable[Mapping[str, Any]], sweep_seed: int
) -> tuple[Trial, ...]:
    """Make the trials of a sweep.

    Raises:
        ValueError: If there is none, or two are the same, or their axes differ.
    """
    trials = tuple(Trial(point, sweep_seed) for point in points)
    if not trials:
        raise ValueError("the sweep has no trials: give each axis at least one value.")
    axes = tuple(trials[0].point)
    seen = set()
    for trial in trials:
        if set(trial.point) != set(axes):
            raise ValueError(
                "all points of a sweep need the same axes; got "
                f"{', '.join(axes)} and {', '.join(trial.point)}."
            )
        if trial.key in seen:
            raise ValueError(
                f"the sweep tries {describe(trial.point)} twice; each point must "
                "stand in it once."
            )
        seen.add(trial.key)
    return trials


def describe(point: Mapping[str, Any]) -> str:
    """Write a point in words."""
    return ", ".join(f"{axis} = {shown(value)}" for axis, value in point.items())


def shown(value: Any) -> str:
    """Format a value for tables."""
    if isinstance(value, list):
        return " + ".join(map(shown, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _canonical(point: Mapping[str, Any]) -> str:
    return json.dumps(point, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _plain(axis: str, value: Any) -> Any:
    """Convert a value to what JSON would return."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return [_plain(axis, entry) for entry in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float) and np.isfinite(value):
        return value
    raise ValueError(
        f"axis {axis!r} has the value {value!r}; expected a text, a finite number, "
        "true or false, or a list of these."
    )
