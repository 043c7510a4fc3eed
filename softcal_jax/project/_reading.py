"""Read files into tables, and report everything that is wrong in them.

The description of a key is also the text of the message if the key is missing.
"""

import datetime
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Set
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import (
    BaseModel,
    Field,
    StrictFloat,
    StrictInt,
    ValidationError,
    create_model,
    field_validator,
)

from softcal_jax._files import check_file
from softcal_jax._text import check_characters, escaped
from softcal_jax.calibration import LEVEL, CalibrationSettings, check_level
from softcal_jax.equilibrium import NewtonSettings
from softcal_jax.fields import PRECISION, check_starts
from softcal_jax.project._design import CandidateTable, ConfigurationTable, DesignTable
from softcal_jax.project._laws import Material, material_table
from softcal_jax.project._markers import MarkersTable, WindowTable
from softcal_jax.project._quantities import recognised
from softcal_jax.project._robot import AnyActuator, AnyMesh, BodyTable, GroupTable
from softcal_jax.project._sensors import AnyEffector
from softcal_jax.project._setup import (
    AnyControlPoints,
    AnySetup,
    AnyShape,
    AnyUncertain,
    ParameterSpaceTable,
    ParameterTable,
)
from softcal_jax.project._table import (
    Choice,
    Context,
    ProjectError,
    Table,
    describe,
    key_path,
    known_here,
    one_by_one,
    table_of,
)

Keys = tuple[str | int, ...]

T = TypeVar("T", bound=BaseModel)


class SettingsTable(table_of(CalibrationSettings, "least_fall", "least_cost")):
    """Settings of the calibration.

    Without `starts`, `default_starts` chooses; `intervals = 0` computes no intervals.
    """

    noise: Literal["estimated", "stated"] = "estimated"
    starts: StrictInt | None = None
    seed: Annotated[StrictInt, Field(ge=0)] = 0
    intervals: StrictFloat | None = LEVEL
    precision: Annotated[StrictFloat, Field(gt=0, allow_inf_nan=False)] = PRECISION

    @field_validator("intervals")
    @classmethod
    def _check_intervals(cls, value: float) -> float | None:
        if value == 0.0:
            return None
        check_level(value)
        return value

    @field_validator("starts")
    @classmethod
    def _check_starts(cls, value: int) -> int:
        check_starts(value)
        return value


class NewtonTable(table_of(NewtonSettings, "strict_below", "max_backtracks")):
    """Settings of the equilibrium, with the `solver` of `build_model`."""

    solver: Literal["pardiso", "klu", "pardiso-host"] | None = None


def _relaxed(
    kind: type[Table], checks: Set[str] = frozenset(), without: Set[str] = frozenset()
) -> type[Table]:
    """Make a table that checks only some keys of another, and may lack some."""
    keys: dict[str, Any] = {
        key: (field.annotation, field) if key in checks else (Any, None)
        for key, field in kind.model_fields.items()
        if key not in without
    }
    return create_model(kind.__name__, __base__=Table, **keys)


SharedTable = _relaxed(ConfigurationTable, without={"name"})
"""The table [shared], whose values are checked in each configuration."""


AnyMaterial = Annotated[Material, Choice(lambda value, _: material_table(value))]


class ProjectTable(Table):
    """A whole project file."""

    name: str = Field(description="name of the project")
    mesh: AnyMesh = Field(description="a table [mesh]")
    groups: dict[str, GroupTable] = Field(default_factory=dict)
    shapes: dict[str, AnyShape] = Field(default_factory=dict)
    material: AnyMaterial = Field(description="a table [material]")
    bodies: dict[str, BodyTable] = Field(default_factory=dict)
    actuators: dict[str, AnyActuator] = Field(default_factory=dict)
    control_points: dict[str, AnyControlPoints] = Field(default_factory=dict)
    parameters: tuple[ParameterTable, ...] = ()
    setup: tuple[AnySetup, ...] = ()
    parameter_space: ParameterSpaceTable = ParameterSpaceTable()
    markers: MarkersTable | None = None
    effectors: dict[str, AnyEffector] = Field(default_factory=dict)
    shared: Annotated[Table, Choice(lambda *_: SharedTable)] = SharedTable()
    configurations: tuple[ConfigurationTable, ...] = ()
    candidates: tuple[CandidateTable, ...] = ()
    design: DesignTable = DesignTable()
    uncertain: AnyUncertain = Field({}, validate_default=True)
    settings: SettingsTable = SettingsTable()
    newton: NewtonTable = NewtonTable()

    @field_validator("control_points", mode="before")
    @classmethod
    def _check_named(cls, sets: Any) -> Any:
        if not isinstance(sets, dict):
            return sets
        loose = [k for k, points in sets.items() if not isinstance(points, dict)]
        if loose or set(sets) == {"positions"}:
            raise ValueError(
                f"got {', '.join(loose or sets)}; a set of control points needs a "
                "name: write [control_points.ends] and below positions = "
                '{ tip = "(0, 0, 0) mm" }, and control_points = "ends" in '
                "[[parameters]]."
            )
        return sets


MeshTables = _relaxed(ProjectTable, checks={"mesh", "groups"})
"""The tables of a project file that make its mesh; other tables are not read."""


def read_tables(path: Path, changes: Mapping[str, Any] | None = None) -> ProjectTable:
    """Read a project file into tables, with [shared] merged into each configuration.

    `changes` replace values of the file, see `load_project`.
    """
    raw = with_changes(path, read_toml(path, "project file"), changes)
    problems, table, material = [], None, None
    with suppress(ValueError):  # reported under [material] below
        material = material_table(raw.get("material"))
    try:
        context = Context(path.parent, material)
        table = ProjectTable.model_validate(_with_shared(raw), context=context)
    except ValidationError as error:
        problems = describe(error, raw)
    if not (raw.get("configurations") or raw.get("candidates")):
        problems.append("configurations: missing. Expected a table [[configurations]].")
    if problems or table is None:
        raise one_by_one(path, problems)
    return table


def read_schema(path: Path, schema: type[T], what: str) -> T:
    """Read another kind of TOML file; `what` says which, like "sweep file".

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is not TOML, or keys or values in it are wrong.
    """
    raw = read_toml(path, what)
    try:
        return schema.model_validate(raw, context=Context(path.parent))
    except ValidationError as error:
        raise one_by_one(path, describe(error, raw)) from error


def with_changes(
    path: Path, raw: dict[str, Any], changes: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Replace some values of a file, see `load_project`, creating missing tables."""
    for key, value in (changes or {}).items():
        parts = [quoted or part for quoted, part in _PART.findall(f"{key}.")]
        table, last = raw, _taken(parts, raw)
        while parts:
            table, where = table.setdefault(last, {}), last
            if isinstance(table, list):
                entries = [e for e in table if isinstance(e, dict)]
                named = {str(e.get("name", e.get("field"))): e for e in entries}
                name = _taken(parts, named)
                if name not in named:
                    none = f"there is no {name!r}.{known_here(name, named)}"
                    raise ProjectError(f"{path}: {key}: {none}")
                table = named[name] if parts else None
            if not isinstance(table, dict):
                raise ProjectError(f"{path}: {key}: {where} is no table of the file.")
            last = _taken(parts, table)
        if value is None:
            table.pop(last, None)
        else:
            table[last] = deepcopy(value)
    return raw


_PART = re.compile(r'(?:"([^"]+)"|([^.]*))\.')
"""A part of a key, up to the next dot; in quotes, as in TOML, it may have dots."""


def _taken(parts: list[str], known: Mapping[str, Any]) -> str:
    """Take the longest known name off the parts of a key, or else the first part."""
    longest = range(len(parts), 0, -1)
    n = next((n for n in longest if ".".join(parts[:n]) in known), 1)
    name = ".".join(parts[:n])
    del parts[:n]
    return name


def _with_shared(raw: dict[str, Any]) -> dict[str, Any]:
    merged, shared = dict(raw), raw.get("shared")
    kinds = {"configurations": ConfigurationTable, "candidates": CandidateTable}
    for key, kind in kinds.items():
        if isinstance(raw.get(key), list) and isinstance(shared, dict):
            base = {k: value for k, value in shared.items() if k in kind.model_fields}
            merged[key] = [_merged(base, entry) for entry in raw[key]]
    return merged


def _merged(shared: Any, value: Any) -> Any:
    """Merge a value over the shared one, key by key where both are tables."""
    if not (isinstance(shared, dict) and isinstance(value, dict)):
        return value
    return shared | {key: _merged(shared.get(key), value[key]) for key in value}


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file; refuse dates, and texts that would act on a terminal.

    Messages say `what` it is, like "project file".

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is too large, no TOML, or has dates or control characters.
    """
    try:
        check_file(path, what)
    except ValueError as error:
        raise ProjectError(str(error)) from error
    try:
        # Decoded here: `read_text` turns bare carriage returns, no TOML, into lines.
        raw = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
        values = [*values_in(raw)]
    except (ValueError, OSError, RecursionError) as error:  # of TOML, or of UTF-8
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    problems = []
    for keys, value in values:
        try:
            if isinstance(value, datetime.date | datetime.time):
                raise ValueError(f"got {value}, which no key takes; put it in quotes.")
            check_characters("".join(map(str, (*keys, value))))
        except ValueError as error:
            problems.append(f"{escaped(key_path(keys, raw)) or 'file'}: {error}")
    if problems:
        raise one_by_one(path, problems)
    return raw


def values_in(value: Any, keys: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Find all values in tables and lists, with the keys that lead to them."""
    if isinstance(value, dict | BaseModel):
        for key, inner in dict(value).items():
            yield from values_in(inner, (*keys, key))
    elif isinstance(value, list | tuple):
        for i, inner in enumerate(value):
            yield from values_in(inner, (*keys, i))
    else:
        yield keys, value


_NAMES = ("name", "displacement_from", "recording")
"""Keys whose values are names, which may look like quantities: a pose "350 mbar"."""


class QuantityAsRead(NamedTuple):
    """A quantity of a project file, like "material.E" in the table "material".

    It has the text as `typed`, and its `values`, one number or three, in the SI `unit`.
    """

    table: str
    key: str
    typed: str
    values: tuple[float, ...]
    unit: str

    @property
    def read(self) -> str:
        """The quantity as it was read: in SI units, but lengths in mm."""
        factor, unit = (1e3, "mm") if self.unit == "m" else (1.0, self.unit)
        numbers = [f"{factor * value:.10g}" for value in self.values]
        listed = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
        return f"{listed} {unit}"


def quantities_as_read(path: str | os.PathLike[str]) -> tuple[QuantityAsRead, ...]:
    """List every text with a unit in a project file, in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is not TOML.
    """
    raw = read_toml(Path(path), "project file")
    entries = []
    for keys, text in values_in(raw):
        rows = "select" in keys and not {*keys} & {*WindowTable.model_fields}
        quantity = recognised(text) if isinstance(text, str) else None
        if quantity is not None and not rows and not {*keys} & {*_NAMES}:
            table = key_path(keys[:-1], raw)
            entries.append(QuantityAsRead(table, key_path(keys, raw), text, *quantity))
    return tuple(entries)
