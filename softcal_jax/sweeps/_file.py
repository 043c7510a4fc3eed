"""Loading a sweep file: its axes with their values, its project, its points."""

import itertools
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, StrictInt

from softcal_jax._files import similar_file
from softcal_jax._places import PLANNED, TRIALS
from softcal_jax._text import check_known
from softcal_jax._units import is_number
from softcal_jax.calibration import SourceFile
from softcal_jax.project import (
    Project,
    ProjectError,
    Table,
    at,
    load_project,
    read_schema,
    read_toml,
    suggestion,
)
from softcal_jax.sweeps._calibration import (
    OWN_AXES,
    CalibrationTrial,
    file_digest,
    file_keys,
    truth_in_si,
)
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._run import run_sweep
from softcal_jax.sweeps._trial import Points, Range, grid, sample

REPEATS = ("start", "noise")  # axes whose values are mere repetitions

_EXPECTED = {
    "start": "{ count = 10 } or a list of numbers: 0 for none, 1, 2, ...",
    "noise": "{ count = 20 } or a list of numbers: 0 for none, 1, 2, ...",
    "configurations": "{ choose = 2 } or a list of lists of configurations that are "
    'fitted together, like [["pose 1"], ["pose 1", "pose 2"]]',
    "layout": 'a list of names, like ["ends"]',
}

_QUANTITY = re.compile(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


class SweepTable(Table):
    """A whole sweep file; a message on a missing key quotes its description."""

    project: str = Field(description='the project file: "project.toml"')
    axes: dict[str, Any] = Field(
        description=f"a table [axes] of {', '.join(OWN_AXES)} or keys of the project"
    )
    name: str | None = None
    seed: StrictInt = 0
    sample: StrictInt | None = Field(None, ge=1)
    layouts: dict[str, dict[str, Any]] = Field(default_factory=dict)
    replaces: str | None = None
    truth: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True)
class Sweep:
    """A sweep file as objects; everything in it has been checked.

    Attributes:
        name: Name of the sweep.
        path: The file it came from.
        function: The calibration that each trial runs.
        points: Points of the trials, in the order in which they begin.
        seed: Seed of noise, starts and sample.
        definitions: What rows depend on besides their points, by name.
        file: The sweep file, as it was when it was read.
        project: The project, before an axis changes it.
        settings: Those of its calibrations, by name.
    """

    name: str
    path: Path
    function: CalibrationTrial
    points: Points
    seed: int
    definitions: Mapping[str, str]
    file: SourceFile
    project: Project
    settings: Mapping[str, Any]

    @property
    def folder(self) -> Path:
        """Default folder of the rows: that of the sweep file's name, beside it."""
        return self.path.with_suffix("")

    def run(
        self, folder: str | os.PathLike[str] | None = None, **options: Any
    ) -> SweepResult:
        """Run all trials that have no row in the folder yet, see `run_sweep`.

        Args:
            folder: Folder of the rows; by default that of the sweep file's name.
            options: `executor`, `workers`, `cores_per_worker`, `part`, `retry_failed`
                and `progress` of `run_sweep`. Workers elsewhere must find the project
                file under the same path.

        Raises:
            ValueError, OSError, RuntimeError: See `run_sweep`.
        """
        return run_sweep(
            self.function,
            self.points,
            self.folder if folder is None else folder,
            name=self.name,
            seed=self.seed,
            repeats=[axis for axis in REPEATS if axis in self.points[0]],
            definitions=self.definitions,
            **options,
        )


def load_sweep(path: str | os.PathLike[str]) -> Sweep:
    """Read and check a sweep file and its project, without solving anything.

    The project is loaded with each layout and each value of a key, so that a wrong one
    is found before the first trial.

    Args:
        path: A TOML file; docs/guide/sweeps.md shows one.

    Returns:
        The sweep, ready for `run`.

    Raises:
        FileNotFoundError: If the sweep file or its project file does not exist.
        ProjectError: If anything in one of the two is wrong; the text names the key.
        ValueError: If JAX is not in float64.
    """
    path = Path(path)
    table = read_schema(path, SweepTable, "sweep file")
    source = path.parent / table.project
    if not source.exists():
        hint = similar_file(source)
        raise FileNotFoundError(f"{path}: project: there is no file {source}.{hint}")
    project = load_project(source)
    files = {str(file.resolve()): file_digest(file) for file in project.files}
    function = CalibrationTrial(
        source.resolve(), files, table.layouts, _replaced(path, table), table.truth
    )
    _check_calibration(path, table, project)
    axes, poses = {}, [c.name for c in project.calibration]
    for axis, given in table.axes.items():
        with at(path, f"axes.{axis}"):
            axes[axis] = axis_values(axis, given, list(table.layouts), poses)
    # Trials of one shape stand next to each other, so that a worker compiles less.
    ordered = {a: axes[a] for a in (*file_keys(axes), *OWN_AXES) if a in axes}
    _check_variants(path, function, ordered)
    with at(path, "axes"):
        if not axes:
            raise ValueError(
                f"there are none. Expected {', '.join(OWN_AXES)}, or a key of the "
                "project file."
            )
        n, seed = table.sample, table.seed
        points = grid(ordered) if n is None else sample(ordered, n, seed=seed)
    definitions = {
        f"content of {os.path.relpath(file, source.resolve().parent)}": digest
        for file, digest in files.items()
    }
    definitions |= {f"layout {k}": json.dumps(v) for k, v in table.layouts.items()}
    definitions["truth"] = json.dumps(table.truth, sort_keys=True)
    settings = {
        "seed": seed,
        "sample": n,
        "calibration": project.settings,
        "newton": project.newton,
        "noise": project.noise,
        "starts": project.starts,
    }
    return Sweep(
        name=table.name or path.stem,
        path=path,
        function=function,
        points=points,
        seed=seed,
        definitions=definitions,
        file=SourceFile.of(path),
        project=project,
        settings=settings,
    )


def _replaced(path: Path, table: SweepTable) -> str:
    """Find the set of control points that layouts replace."""
    if not table.layouts:
        return ""
    if "layout" not in table.axes:
        raise ProjectError(
            f"{path}: layouts: they need the axis `layout`, a list of their names."
        )
    sets = list(read_toml(path.parent / table.project, "").get("control_points", {}))
    name = table.replaces or (sets[0] if len(sets) == 1 else "")
    if name not in sets:
        raise ProjectError(
            f"{path}: replaces: got {name!r}; expected a set of control points of the "
            f"project.{suggestion(name, sets)} Known: {', '.join(sets) or 'none'}."
        )
    return name


def _check_calibration(path: Path, table: SweepTable, project: Project) -> None:
    """Raise unless there is something to calibrate, with or without measurements."""
    if not table.truth:
        project.check_calibration()
        return
    project.check_identify()
    assert project.space is not None
    names = project.space.names
    with at(path, "truth"):
        check_known("parameter", names, *table.truth)
        missing = [name for name in names if name not in table.truth]
        if missing:
            raise ValueError(f"it has no value for {', '.join(missing)}.")
        truth_in_si(project.space, table.truth)


def _check_variants(
    path: Path, function: CalibrationTrial, axes: Mapping[str, Sequence[Any] | Range]
) -> None:
    """Load the project with each layout and each value of a key once."""
    tried = {
        axis: [values.at(0.0), values.at(1.0)] if isinstance(values, Range) else values
        for axis, values in axes.items()
        if axis == "layout" or axis not in OWN_AXES
    }
    first = {axis: values[0] for axis, values in tried.items()}
    for axis, values in tried.items():
        for value in values:
            with at(path, f"axes.{axis} = {value}"):
                try:
                    function.variant({**first, axis: value})
                except ProjectError as error:
                    raise ValueError(str(error)) from error


def axis_values(
    axis: str, given: Any, layouts: Sequence[str], poses: Sequence[str]
) -> Sequence[Any] | Range:
    """Return the values of an axis, given what the file has for it.

    `layouts` are the names of the file's layouts, `poses` those of the project's
    configurations with the role calibration.
    """
    is_key = axis not in OWN_AXES
    if is_key and "." not in axis:
        raise ValueError(
            f"unknown axis.{suggestion(axis, OWN_AXES)} Known: {', '.join(OWN_AXES)}, "
            'or a key of the project file, like "material.nu".'
        )
    number = lambda value, least: type(value) is int and value >= least
    scales = {}, {"scale": "linear"}, {"scale": "log"}
    match given:
        case {"count": n, **rest} if axis in REPEATS and number(n, 1) and not rest:
            PLANNED.check(f"count = {n}", n)
            return range(1, n + 1)
        case {"choose": n, **rest} if (
            axis == "configurations" and type(n) is int and not rest
        ):
            return _subsets(n, poses)
        case {"low": low, "high": high, **rest} if is_key and rest in scales:
            return _range(low, high, **rest)
        case [_, *_] if axis == "layout":
            check_known("layout", layouts, *given)
            return given
        case [_, *_] if axis == "configurations" and all(
            isinstance(subset, list) and subset for subset in given
        ):
            names = itertools.chain(*given)
            check_known("configuration with the role calibration", poses, *names)
            # In the project's order, so that [a, b] and [b, a] are the same trial.
            return [[name for name in poses if name in subset] for subset in given]
        case [_, *_] if is_key or (
            axis in REPEATS and all(number(n, 0) for n in given)
        ):
            return given
    usual = "a list of values, or { low = 1, high = 2 }"
    raise ValueError(f"got {given}; expected {_EXPECTED.get(axis, usual)}.")


def _subsets(size: int, poses: Sequence[str]) -> list[list[str]]:
    """Return all subsets of poses of one size."""
    if not 1 <= size <= len(poses):
        raise ValueError(
            f"choose = {size}, but the project has {len(poses)} configurations with "
            f"the role calibration: {', '.join(poses)}."
        )
    n = math.comb(len(poses), size)
    TRIALS.check(f"choose = {size} of {len(poses)}", n)
    return [list(subset) for subset in itertools.combinations(poses, size)]


def _range(low: Any, high: Any, scale: Literal["linear", "log"] = "linear") -> Range:
    """Return all values between two numbers, or two quantities in the same unit."""
    if is_number(low) and is_number(high):
        return Range(float(low), float(high), scale)
    first, last = (_QUANTITY.fullmatch(str(end)) for end in (low, high))
    if first is None or last is None or first[2] != last[2]:
        raise ValueError(
            f"got {low} and {high}; expected two numbers, or two quantities in the "
            'same unit, like "100 kPa" and "300 kPa".'
        )
    return Range(float(first[1]), float(last[1]), scale, f"{{:.9g}} {first[2]}")
