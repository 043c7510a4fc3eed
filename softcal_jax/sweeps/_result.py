"""Rows of a sweep so far, and their groups."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray
from softcal_jax.sweeps._database import read_content
from softcal_jax.sweeps._row import State, TrialRow
from softcal_jax.sweeps._trial import describe, shown


class FigureName(NamedTuple):
    """Name of a figure in two parts: "fit rms [m]" is "fit rms" and "m"."""

    words: str
    unit: str


def figure_name(name: str) -> FigureName:
    """Split the name of a figure; the unit is empty where there is none."""
    match = re.fullmatch(r"(.+?) \[(.+)\]", name)
    return FigureName(match[1], match[2]) if match else FigureName(name, "")


@dataclass(frozen=True)
class Group:
    """Trials that agree on some axes.

    Attributes:
        values: Their value on each of these axes.
        rows: Trials that have ended.
        missing: Number of trials that have not.
    """

    values: Mapping[str, Any]
    rows: tuple[TrialRow, ...]
    missing: int

    @property
    def label(self) -> str:
        """The values in one line."""
        return ", ".join(shown(value) for value in self.values.values()) or "all"

    def count(self, state: State) -> int:
        """Count the trials that ended in a state."""
        return sum(row.state == state for row in self.rows)

    def numbers(self, figure: str) -> Float[HostArray, " n"]:
        """Collect a figure of the trials that converged and have it as a number."""
        return _numbers(self.rows, figure)


@dataclass(frozen=True)
class SweepResult:
    """Rows of a sweep, finished or not.

    Attributes:
        name: Its name.
        axes: Names of its axes.
        repeats: Axes whose values are mere repetitions, like draws of noise.
        planned: Points that are planned, by key, in their order.
        rows: Trials that have ended, in the order of the plan; trials of an earlier
            plan that are not in this one come last.
    """

    name: str
    axes: tuple[str, ...]
    repeats: tuple[str, ...]
    planned: Mapping[str, Mapping[str, Any]]
    rows: tuple[TrialRow, ...]

    @property
    def missing(self) -> tuple[Mapping[str, Any], ...]:
        """Points of the trials that have not ended."""
        ended = {row.key for row in self.rows}
        return tuple(point for key, point in self.planned.items() if key not in ended)

    def of_state(self, state: State) -> tuple[TrialRow, ...]:
        """Return the rows that ended in a state."""
        return tuple(row for row in self.rows if row.state == state)

    @property
    def figure_names(self) -> tuple[str, ...]:
        """Names of all figures, in the order of their first appearance."""
        names = (name for row in self.rows for name in row.figures)
        return tuple(dict.fromkeys(names))

    def numbers(self, figure: str) -> Float[HostArray, " n"]:
        """Collect a figure of the trials that converged, where it is a number, in SI.

        Args:
            figure: Its name.

        Raises:
            ValueError: If no row has a figure of that name.
        """
        return _numbers(self.rows, self.figure(figure))

    def figure(self, name: str) -> str:
        """Return the full name of a figure, whose unit may be left out.

        Args:
            name: "fit rms [m]" or "fit rms".

        Raises:
            ValueError: If no row has a figure of that name.
        """
        by_words = {figure_name(figure).words: figure for figure in self.figure_names}
        if name in self.figure_names:
            return name
        if name in by_words:
            return by_words[name]
        raise unknown_name("figure", name, self.figure_names)

    @property
    def default_axes(self) -> tuple[str, ...]:
        """Axes that trials are grouped by: all but repetitions."""
        return tuple(axis for axis in self.axes if axis not in self.repeats)

    def groups(self, by: Sequence[str] | None = None) -> tuple[Group, ...]:
        """Group trials by their values on some axes.

        Args:
            by: The axes; by default all but repetitions.

        Returns:
            The groups, in the order of the plan.

        Raises:
            ValueError: If the sweep has no such axis.
        """
        by = self.default_axes if by is None else by
        for axis in by:
            if axis not in self.axes:
                raise unknown_name("axis", axis, self.axes)
        rows: dict[str, list[TrialRow]] = {}
        missing: dict[str, int] = {}
        values: dict[str, dict[str, Any]] = {}
        of = lambda point: {axis: point[axis] for axis in by}
        ended = {row.key: row for row in self.rows}
        for key, point in {
            **self.planned,
            **{r.key: r.point for r in self.rows},
        }.items():
            own = of(point)
            group = repr(own)
            values[group] = own
            rows.setdefault(group, []).extend([ended[key]] if key in ended else [])
            missing[group] = missing.get(group, 0) + (key not in ended)
        return tuple(
            Group(own, tuple(rows[group]), missing[group])
            for group, own in values.items()
        )

    def __str__(self) -> str:
        """Write how many trials ended in each state, and why the others failed."""
        lines = [
            f"{self.name}: {len(self.rows)} trials ended, "
            f"{len(self.of_state('converged'))} converged, "
            f"{len(self.of_state('not converged'))} not converged, "
            f"{len(self.of_state('failed'))} failed, {len(self.missing)} to do."
        ]
        for row in self.rows:
            if row.state != "converged":
                lines.append(f"  {describe(row.point)}: {row.state}: {row.reason}")
        return "\n".join(lines)


def _numbers(rows: Sequence[TrialRow], figure: str) -> Float[HostArray, " n"]:
    found = [row.figures.get(figure) for row in rows if row.state == "converged"]
    kept = [v for v in found if isinstance(v, int | float) and not isinstance(v, bool)]
    return np.array(kept, float)


def read_sweep(database: str | os.PathLike[str]) -> SweepResult:
    """Read the rows of a sweep, even while it runs.

    Args:
        database: The SQLite file.

    Raises:
        FileNotFoundError: If it does not exist.
        ValueError: If it is no database of a sweep.
        BlockingIOError: If another program keeps it locked.
    """
    content = read_content(Path(database))
    return SweepResult(
        content.about["name"],
        tuple(content.about["axes"]),
        tuple(content.about["repeats"]),
        content.planned,
        content.rows,
    )
