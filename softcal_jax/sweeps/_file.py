"""Loading a sweep file."""

import itertools
import json
import math
import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softcal_jax._files import similar_file
from softcal_jax._limits import TRIALS
from softcal_jax._module import one_line
from softcal_jax.calibration import SourceFile
from softcal_jax.export import Made
from softcal_jax.project import (
    Project,
    ProjectError,
    at,
    load_project,
    read_schema,
    read_toml,
    suggestion,
)
from softcal_jax.sweeps._calibration import (
    CalibrationTrial,
    digest_of,
    file_keys,
    truth_in_si,
)
from softcal_jax.sweeps._result import SweepResult
from softcal_jax.sweeps._run import run_sweep
from softcal_jax.sweeps._schema import (
    OWN_AXES,
    REPEATS,
    ChooseTable,
    CountTable,
    RangeTable,
    SweepTable,
)
from softcal_jax.sweeps._trial import Point, Range, grid, is_number, sample

_QUANTITY = re.compile(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


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
        made: Model, settings and files of the project, before an axis changes them.
    """

    name: str
    path: Path
    function: CalibrationTrial
    points: tuple[Point, ...]
    seed: int
    definitions: Mapping[str, str]
    file: SourceFile
    made: Made

    __repr__ = one_line

    @property
    def database(self) -> Path:
        """Default SQLite file of the rows: beside the sweep file."""
        return self.path.with_suffix(".sqlite")

    def run(
        self, database: str | os.PathLike[str] | None = None, **options: Any
    ) -> SweepResult:
        """Run all trials that are not in the database yet, see `run_sweep`.

        Args:
            database: SQLite file; by default that beside the sweep file.
            options: `workers`, `cores_per_worker`, `scheduler`, `retry_failed` and
                `progress` of `run_sweep`. Workers of a Dask scheduler must find the
                project file under the same path.

        Raises:
            ValueError, OSError, RuntimeError: See `run_sweep`.
        """
        return run_sweep(
            self.function,
            self.points,
            self.database if database is None else database,
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
        FileNotFoundError: If it or its project file does not exist.
        ProjectError: If anything in either is wrong; the text names the key.
        ValueError: If JAX is not in float64.
    """
    path = Path(path)
    table = read_schema(path, SweepTable, "sweep file")
    source = path.parent / table.project
    if not source.exists():
        hint = similar_file(source)
        raise FileNotFoundError(f"{path}: project: there is no file {source}.{hint}")
    project = load_project(source)
    files = {str(file.resolve()): digest_of(file) for file in project.files}
    function = CalibrationTrial(
        source.resolve(), files, table.layouts, _replaced(path, table), table.truth
    )
    _check_calibration(path, table, project)
    axes = {
        axis: _values(path, axis, values, table, project)
        for axis, values in table.axes.items()
    }
    # Trials of one shape stand next to each other, so that a worker compiles less.
    ordered = {a: axes[a] for a in (*file_keys(axes), *OWN_AXES) if a in axes}
    _check_variants(path, function, ordered)
    with at(path, "axes"):
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
        points=tuple(points),
        seed=seed,
        definitions=definitions,
        file=SourceFile.of(path),
        made=Made(project.model, settings, project.source),
    )


def _replaced(path: Path, table: SweepTable) -> str:
    """Find the set of control points that layouts replace."""
    if not table.layouts:
        return ""
    sets = list(read_toml(path.parent / table.project, "").get("control_points", {}))
    name = table.replaces
    if name is None and len(sets) == 1:
        return sets[0]
    if name is not None and name in sets:
        return name
    what = (
        "missing. Expected a set of control points"
        if name is None
        else f'no control points "{name}".{suggestion(name, sets)} Expected some'
    )
    known = ", ".join(sets) or "none"
    raise ProjectError(f"{path}: replaces: {what} of the project, which has {known}.")


def _check_calibration(path: Path, table: SweepTable, project: Project) -> None:
    """Raise unless there is something to calibrate, with or without measurements."""
    if not table.truth:
        project.check_calibration()
        return
    project.check_identify()
    assert project.space is not None
    names = project.space.names
    with at(path, "truth"):
        for name in table.truth:
            _check_known(f"parameter {name!r}", name, names)
        missing = [name for name in names if name not in table.truth]
        if missing:
            raise ValueError(f"it has no value for {', '.join(missing)}.")
        truth_in_si(project.space, table.truth)


def _check_known(what: str, name: Any, known: Collection[str]) -> None:
    if name not in known:
        hint = suggestion(str(name), known)
        raise ValueError(f"there is no {what}.{hint} Known: {', '.join(known)}.")


def _values(
    path: Path, axis: str, given: Any, table: SweepTable, project: Project
) -> Sequence[Any] | Range:
    """Check the values of an axis against the project."""
    with at(path, f"axes.{axis}"):
        if isinstance(given, CountTable):
            TRIALS.check(f"count = {given.count}", given.count)
            return list(range(1, given.count + 1))
        if isinstance(given, RangeTable):
            return _range(given)
        if axis == "layout":
            for name in given:
                _check_known(f"[layouts.{name}]", name, table.layouts)
        if axis == "configurations":
            return _subsets(given, [c.name for c in project.calibration])
    return given


def _subsets(given: Any, names: list[str]) -> list[list[str]]:
    """List the sets of configurations that are fitted."""
    if isinstance(given, ChooseTable):
        if not 1 <= given.choose <= len(names):
            raise ValueError(
                f"choose = {given.choose}, but the project has {len(names)} "
                f"configurations with the role calibration: {', '.join(names)}."
            )
        n = math.comb(len(names), given.choose)
        TRIALS.check(f"choose = {given.choose} of {len(names)}", n)
        return [list(s) for s in itertools.combinations(names, given.choose)]
    for subset in given:
        if not isinstance(subset, list) or not subset:
            raise ValueError(
                f"got {subset}; expected lists of configurations that are fitted "
                'together, like [["pose 1"], ["pose 1", "pose 2"]].'
            )
        for name in subset:
            what = f"configuration {name!r} with the role calibration"
            _check_known(what, name, names)
    # In the project's order, so that [a, b] and [b, a] are the same trial.
    return [[name for name in names if name in subset] for subset in given]


def _range(table: RangeTable) -> Range:
    ends = [table.low, table.high]
    if all(map(is_number, ends)):
        return Range(float(table.low), float(table.high), table.scale)
    parts = [_QUANTITY.fullmatch(str(end)) for end in ends]
    if parts[0] is None or parts[1] is None or parts[0][2] != parts[1][2]:
        raise ValueError(
            f"got {table.low} and {table.high}; expected two numbers, or two "
            'quantities in the same unit, like "100 kPa" and "300 kPa".'
        )
    low, high = (float(part[1]) for part in parts if part is not None)
    return Range(low, high, table.scale, f"{{:.9g}} {parts[0][2]}")


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
