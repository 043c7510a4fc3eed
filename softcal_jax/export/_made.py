"""What a result was made from, its values as JSON, and tables as CSV and LaTeX."""

import csv
import dataclasses
import json
import math
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softcal_jax._module import Module
from softcal_jax._process import cpu_name, installed_version
from softcal_jax._text import as_cell
from softcal_jax._tree import Table
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    HistoryEntry,
    LeftOut,
    MultiStartResult,
    ProjectSource,
    ResidualChecks,
    SourceFile,
)
from softcal_jax.configurations import EffectorRecord
from softcal_jax.contact import ContactState
from softcal_jax.equilibrium import BodyPlace, Model, RobotState
from softcal_jax.identifiability import Assessment, Identifiability, Prediction
from softcal_jax.inference import Uncertainty
from softcal_jax.layouts import FoldScore, ModelScore, PairedDifference
from softcal_jax.unknowns import CorrelatedNoise

KEYS: dict[type, str] = {
    CalibrationResult: "converged parameters intervals configurations history "
    "uncertainty noise checks starts mistakes notes",
    ConfigurationResult: "name role rms_before_mm rms_after_mm motion_mm "
    "rms_after_percent_of_motion=rms_share markers=points effectors=others robot "
    "newton_steps residual rounding at_rounding min_det_F",
    HistoryEntry: "step cost lambda_p step_bound accepted kkt_residual newton_steps "
    "values noise_level seconds rms_mm",
    Uncertainty: "noise noise_scale degrees_of_freedom chi_squared covariance "
    "correlation",
    CorrelatedNoise: "jitter share offset_mm",
    ResidualChecks: "reasons agreement lack_of_fit recordings level probability "
    "left_out",
    LeftOut: "name rms_mm expected_mm motion_mm probability by_scatter",
    MultiStartResult: "names starts values cost steps converged optima second_best "
    "missed",
    Assessment: "outcome contradicted reasons misfit_probability predictions held",
    Prediction: "name role std_mm",
    Identifiability: "verdict n_data precision parameters informed directions "
    "covariance correlation conditioning",
    RobotState: "rigid_bodies=bodies actuators reactions contacts",
    ContactState: "name force moment area depth sliding",
    BodyPlace: "name state position_mm translation_mm rotation_vector",
    ModelScore: "name n_parameters held_out_rms_mm held_out_noise_rms score fit_rms_mm "
    "fit_noise_rms fit_failure verdict folds",
    FoldScore: "held_out rms_mm noise_rms fit_rms_mm failure",
    PairedDifference: "name difference standard_error half_width n told_apart",
}
"""Keys of the classes that results are made of, by attributes; of others, all fields.

One in _mm is converted from metres, one in percent from a share; `key=attribute` gives
an attribute another name.
"""

POINT = "name measured_mm simulated_before_mm simulated_mm residual_mm"
OTHER = "name unit is_turn measured simulated_before simulated residual"
"""Keys of effectors: of points, and of what is no point."""


def plain(value: Any) -> Any:
    """Convert records to dictionaries, arrays to lists, non-finite numbers to None.

    Keys of records are `KEYS`, or else all fields. NumPy numbers become Python's.
    """
    if isinstance(value, EffectorRecord):
        return plain(pick(value, POINT if value.quantity == "point" else OTHER))
    if dataclasses.is_dataclass(value):
        every = " ".join(field.name for field in dataclasses.fields(value))
        value = pick(value, KEYS.get(type(value), every))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def pick(owner: object, names: str) -> dict[str, Any]:
    """Return some attributes, by keys like those of `KEYS`."""
    picked = {}
    for name in names.split():
        key, _, attribute = name.partition("=")
        value = getattr(owner, attribute or key.removesuffix("_mm"))
        if key.endswith("_mm") or "_percent_" in key:
            value = (1e3 if key.endswith("_mm") else 1e2) * np.asarray(value)
        picked[key] = value
    return picked


_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "jaxopt")


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a dictionary, as from `result_dict`, as JSON that every parser reads.

    Raises:
        ValueError: If it holds a NaN or an infinity, which JSON lacks.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


class Made(Module):
    """What a result was computed from and with.

    Attributes:
        model: The model; the name of its solver contains that of a package.
        settings: Settings by name, which may be nested.
        source: The project file, and what it names; None for a model made in Python.
    """

    model: Model
    settings: Mapping[str, Any]
    source: ProjectSource | None = None


def made_dict(
    made: Made | Mapping[str, Made] | None, directory: str | Path = "."
) -> dict[str, Any]:
    """Convert what a result was computed from and with, if that is known.

    Keys: `source` (`project`, relative to the folder of the results, `files`, relative
    to that of the project, `changes`), `settings`, `versions` of Python, the numerical
    packages and the machine; of several models by their names, and `sources`.
    """
    if isinstance(made, Mapping):
        each = {model: made_dict(of, directory) for model, of in made.items()}
        of_all = lambda key: {model: of[key] for model, of in each.items()}
        every = {k: v for of in each.values() for k, v in of["versions"].items()}
        both = {"sources": of_all("source"), "settings": of_all("settings")}
        return {**both, "versions": every}
    if made is None:
        return {"source": None, "settings": {}, "versions": {}}
    source = made.source and {
        "project": file_dict(made.source.project, directory),
        "files": [
            file_dict(file, made.source.project.path.parent)
            for file in made.source.files
        ],
        "changes": plain(made.source.changes),
    }
    packages = [*_PACKAGES, *re.findall(r"\((.+)\)", made.model.solver.name)]
    versions = {
        "python": platform.python_version(),
        "softcal_jax": installed_version("softcal-jax"),
        **{name: installed_version(name) for name in packages},
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "device": jax.devices()[0].device_kind,
    }
    settings = plain(made.settings)
    return {"source": source, "settings": settings, "versions": versions}


def file_dict(file: SourceFile, directory: str | Path = ".") -> dict[str, str]:
    """Convert a file to a dictionary: `file`, relative to a folder, and `sha256`."""
    try:
        relative = os.path.relpath(file.path, Path(directory).resolve())
    except ValueError:  # on another drive of Windows
        return {"file": file.path.as_posix(), "sha256": file.sha256}
    return {"file": Path(relative).as_posix(), "sha256": file.sha256}


_VALUES = ("measured", "simulated_before", "simulated", "residual")
_BODY = {"position": "m", "translation": "m", "rotation_vector": "rad"}
_CONTACT = {"force": "N", "moment": "N m", "area": "m2", "depth": "m", "sliding": "-"}
"""Attributes of bodies and of contacts that are written, and their units."""

_SPECIAL = {c: rf"\{c}" for c in "&%$#_{}"} | {"±": r"$\pm$", "^": r"\^{}"}
_SPECIAL |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}"}


def write_csv(folder: Path, configurations: Sequence[ConfigurationResult]) -> list[str]:
    """Write the values of all configurations; return the names of the files.

    A line of `markers.csv` is a marker or other point, in mm; one of `effectors.csv` a
    coordinate of an effector that is not a point, in SI; one of `robot.csv` a value of
    a body, actuator, reaction or contact, in SI. A file without lines is left out.
    """
    values = lambda e: [getattr(e, column) for column in _VALUES]
    points = [
        (c.name, c.role, p.name, *np.concatenate(values(p)), p.distance(p.simulated))
        for c in configurations
        for p in c.points
    ]
    others = [
        (c.name, c.role, e.name, name, e.unit, *coordinate)
        for c in configurations
        for e in c.others
        for name, *coordinate in zip(
            _coordinates("turn" if e.is_turn else "value", len(e.measured)),
            *values(e),
            strict=True,
        )
    ]
    state = [(c.name, *line) for c in configurations for line in _robot(c)]
    places = " | ".join(f"{v}_{axis} [distance]" for v in _VALUES for axis in "xyz")
    heads = f"configuration | role | marker | {places} | distance [distance]"
    rest = f"effector | coordinate | unit | {' | '.join(_VALUES)}"
    robot = "configuration | part | name | what | quantity | value | unit"
    tables = {
        "markers.csv": Table.of("", heads, points),
        "effectors.csv": Table.of("", f"configuration | role | {rest}", others),
        "robot.csv": Table.of("", robot, state),
    }
    written = {name: table for name, table in tables.items() if table}
    for name, table in written.items():
        _write_table(folder / name, table)
    return [*written]


def _coordinates(what: str, n: int) -> list[str]:
    return [f"{what}_{axis}" for axis in "xyz"[:n]] if n > 1 else [what]


def _robot(result: ConfigurationResult) -> Iterator[tuple[Any, ...]]:
    """Yield part, name, what it is, quantity, value and unit."""
    robot = result.robot
    if robot is None:
        return
    for body in robot.bodies:
        yield from _components("rigid body", body, body.state, _BODY)
    for a in robot.actuators:
        for what in ("force", "displacement"):
            value, unit = getattr(a, what), getattr(a, f"{what}_unit")
            if value is not None:
                quantity = f"{what}{' (imposed)' * (a.imposed == what)}"
                yield "actuator", a.name, a.kind, quantity, value, unit
    for reaction in robot.reactions:
        what = "force of the ground"
        yield from _components("reaction", reaction, what, {"force": "N"})
    bodies = {body.name for body in robot.bodies}
    for contact in robot.contacts:
        what = "obstacle" if contact.name in bodies else "pair of surfaces"
        yield from _components("contact", contact, what, _CONTACT)


def _components(
    part: str, of: Any, what: str, units: Mapping[str, str]
) -> Iterator[tuple[Any, ...]]:
    for key, unit in units.items():
        values = np.atleast_1d(getattr(of, key))
        for name, value in zip(_coordinates(key, len(values)), values, strict=True):
            yield part, of.name, what, name, value, unit


def _write_table(path: Path, table: Table) -> None:
    """Write a table as CSV, in SI, but distances in mm."""
    heads, columns = [], []
    for column in table.columns:
        in_mm = column.quantity == "distance"
        factor, form = (1e3, ".6f") if in_mm else (1.0, ".9g")
        heads.append(f"{column.title}_mm" if in_mm else column.title)
        columns.append([_cell(value, factor, form) for value in column.values])
    write_rows(path, heads, zip(*columns, strict=True))


def _cell(value: Any, factor: float, form: str) -> str:
    if isinstance(value, str):
        return value
    if value is None or not math.isfinite(value):
        return ""
    return f"{factor * value:{form}}"


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write rows as CSV, so that no spreadsheet takes a text for a formula."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in (heads, *rows):
            writer.writerow([as_cell(c) if isinstance(c, str) else c for c in row])


def latex(table: Table) -> str:
    """Write a table for LaTeX, with units in the heads of columns that have one."""
    escape = lambda text: re.sub(r"[\\&%$#_{}~^±]", lambda c: _SPECIAL[c[0]], text)
    heads = [f"{c.title}{f' [{c.unit}]' * bool(c.unit)}" for c in table.columns]
    columns = [column.texts(units=not column.unit) for column in table.columns]
    rows = [heads, *zip(*columns, strict=True)]
    lines = [" & ".join(map(escape, row)) + r" \\" for row in rows]
    shape = "".join("l" if c.holds_words else "r" for c in table.columns)
    lines.insert(1, r"\hline")
    return "\n".join([rf"\begin{{tabular}}{{{shape}}}", *lines, r"\end{tabular}"])
