"""Load a calibration that was written to a results folder."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from pydantic_core import SchemaValidator, ValidationError, core_schema as cs, from_json

from softcal_jax import configurations
from softcal_jax._files import check_file, sha256_of, similar_file
from softcal_jax._module import Module
from softcal_jax._process import installed_version
from softcal_jax._text import SoftcalWarning, check_known, listed
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable
from softcal_jax.equilibrium import Model
from softcal_jax.export import (
    RESULT_FORMAT,
    complete_results,
    read_displacement,
    solver_dict,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import Estimate
from softcal_jax.project import Project, load_project

RESULT = "result.json"  # name of the file in a results folder


def _record(optional: str = "", **fields: Any) -> Any:
    """Return the schema of a JSON object with these keys, and others."""
    field = lambda key, of: cs.typed_dict_field(
        of, required=key not in optional.split()
    )
    return cs.typed_dict_schema({key: field(key, of) for key, of in fields.items()})


_TEXT, _TRUTH, _NUMBER = cs.str_schema(), cs.bool_schema(), cs.float_schema()
_END = cs.nullable_schema(_NUMBER)  # of what has none
_FILE = _record(file=_TEXT, sha256=_TEXT)
_CHANGES = cs.dict_schema(_TEXT, cs.any_schema())
_SOURCE = _record(project=_FILE, files=cs.list_schema(_FILE), changes=_CHANGES)
_PARAMETER = _record("lower upper", name=_TEXT, value=_NUMBER, lower=_END, upper=_END)
_SIZE = cs.nullable_schema(cs.union_schema([_TEXT, cs.int_schema()]))
_JUDGED = {"outcome": _TEXT, "contradicted": _TRUTH, "reasons": cs.list_schema(_TEXT)}
_READ = _record(
    format=_TEXT,
    converged=_TRUTH,
    source=cs.nullable_schema(_SOURCE),
    parameters=cs.list_schema(_PARAMETER),
    configurations=cs.list_schema(
        _record("files", name=_TEXT, rms_after_mm=_END, files=cs.list_schema(_TEXT))
    ),
    solver=cs.dict_schema(_TEXT, _SIZE),
    budget=_record(covariance=cs.list_schema(cs.list_schema(_END))),
    assessment=_record("outcome contradicted", **_JUDGED),
    versions=cs.dict_schema(_TEXT, _TEXT),
)
"""What is read of a file, which has more."""


class ResultError(ValueError):
    """A result cannot be loaded; the text says which file is in the way, and why."""


class ResultWarning(SoftcalWarning):
    """A result was loaded whose values should not be used as they are."""


class LoadedResult(Module):
    """A calibration that was loaded from a results folder.

    Attributes:
        path: The file `result.json`.
        project: The project that was calibrated, as `load_project` gives it: its model
            has the start values.
        model: The model with the calibrated values.
        space: The parameters, with start and bounds.
        values: The calibrated values by name, in SI units.
        z: The same, scaled [-].
        estimate: What the calibration says of them, to compare with another's.
        errors: Root mean square of the distances of markers and other points from
            where they were measured, by configuration; nan without points [m].
        states: The .vtu of each configuration that had an equilibrium.
        converged: Whether the calibration converged; if not, do not use the values.
        outcome: What may be done with the values, see `Assessment`.
        doubts: Why it is no more than that.
    """

    path: Path
    project: Project
    model: Model
    space: ParameterSpace
    values: dict[str, float]
    z: Float[Array, " n_p"]
    estimate: Estimate
    errors: dict[str, float]
    states: dict[str, Path]
    converged: bool
    outcome: str
    doubts: tuple[str, ...]

    def _words(self) -> str:
        values = (
            f"{q.name} = {readable(self.values[q.name], q.unit)}"
            for q in self.space.parameters
        )
        end = "converged" if self.converged else "NOT CONVERGED"
        return ", ".join([self.project.name, end, *values])

    def posed(
        self, name: str | None = None
    ) -> tuple[configurations.Configuration, configurations.ConfigurationArrays]:
        """Return a configuration, and its arrays with calibrated factors and offsets.

        Args:
            name: Its name; may be left out where there is one configuration.

        Raises:
            ValueError: If there is none of this name, or several and no name is given.
        """
        posed = {c.name: c for c in self.project.configurations}
        if name is None:
            if len(posed) > 1:
                raise ValueError(
                    f"the project {self.project.name!r} has the configurations "
                    f"{listed([*map(repr, posed)])}; name one of them."
                )
            name = next(iter(posed))
        check_known("configuration", posed, name)
        mesh, mechanism = self.model.mesh, self.model.mechanism
        batch = configurations.configuration_arrays(mesh, [posed[name]], mechanism)
        return posed[name], self.space.apply(self.model, batch[0], self.z)[1]

    def displacement(self, name: str) -> Float[Array, "n_points 3"] | None:
        """Read the equilibrium that the calibration found of a configuration [m].

        It is near any other with the same supports and loads: a `guess` for
        `solve_equilibrium` and `solve_inverse`. None where no file holds it.

        Raises:
            ResultError: If its file is damaged.
        """
        path = self.states.get(name)
        if path is None or not path.is_file():
            return None
        try:
            return jnp.asarray(read_displacement(path, self.model))
        except ValueError as error:
            remedy = "delete that file to start from rest, or calibrate again"
            raise ResultError(f"{error}: {remedy}.") from error


def load_result(
    path: str | os.PathLike[str], *, project: str | os.PathLike[str] | None = None
) -> LoadedResult:
    """Load a calibration of a project file, and set its values in the model.

    `result.json` names the project file and the files of mesh and measurements with
    their SHA-256. The model is built from them again, so they must not have changed.

    Args:
        path: `result.json`, or the results folder.
        project: Where the project file is, if it was moved; the files that it names are
            looked for beside it, as before.

    Raises:
        FileNotFoundError: If there is no such file.
        ResultError: If it is no result of a calibration of a project file, or one of
            the files has changed or is missing; the text names each of them.
        ProjectError: If the project file cannot be loaded any more.
        ValueError: If float64 is off in JAX.

    Warns:
        ResultWarning: If the calibration did not converge.
    """
    path = result_path(path)
    data = _read(path)
    source = data["source"]
    if source is None:
        raise ResultError(
            f"{path}: this calibration was made in Python, without a project file. "
            "Build model and space in Python as they were, and set the values by "
            "space.model_at(model, space.to_scaled(values)); or describe them in a "
            "project file, and calibrate that."
        )
    if project is None:
        project = os.path.normpath(path.parent.resolve() / source["project"]["file"])
    _check_unchanged(path, Path(project), source)
    # With `changes`, even empty ones, `load_project` does not warn a second time.
    loaded = load_project(project, changes=source["changes"])
    space = _checked_space(path, loaded, data)
    values = {entry["name"]: entry["value"] for entry in data["parameters"]}
    z = space.to_scaled(jnp.asarray([values[name] for name in space.names]))
    said = data["assessment"]
    missed = {fit["name"]: fit["rms_after_mm"] for fit in data["configurations"]}
    errors = {k: np.nan if mm is None else 1e-3 * mm for k, mm in missed.items()}
    states = {
        fit["name"]: path.parent / file
        for fit in data["configurations"]
        for file in fit.get("files", [])[:1]
        if file.endswith(".vtu")
    }
    C = np.array(data["budget"]["covariance"], float)
    return LoadedResult(
        path=path,
        project=loaded,
        model=space.model_at(loaded.model, z),
        space=space,
        values=values,
        z=z,
        estimate=Estimate(space, z, C, said.get("contradicted", False)),
        errors=errors,
        states=states,
        converged=data["converged"],
        outcome=said.get("outcome", "take with care"),
        doubts=tuple(said["reasons"]),
    )


def result_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of `result.json`, given it or its folder."""
    path = Path(path)
    complete_results(path.parent if path.name == RESULT else path)
    return path / RESULT if path.is_dir() else path


def load_values(path: str | os.PathLike[str]) -> dict[str, float]:
    """Load values alone, by name in SI units; project and mesh may have changed."""
    data = _read(result_path(path))
    return {entry["name"]: entry["value"] for entry in data["parameters"]}


def _read(path: Path) -> dict[str, Any]:
    """Read and check the file."""
    check_file(path, "result file")
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = from_json(text)
        kind = content.get("format") if isinstance(content, dict) else None
        if kind != RESULT_FORMAT:
            raise ValueError(
                f"Its format is {kind!r}; expected {RESULT_FORMAT!r}: calibrate again, "
                "or load it with the version that wrote it"
            )
        data: Any = SchemaValidator(_READ).validate_json(text, strict=True)
        _check_values(data)
    except ValueError as error:  # of JSON, UTF-8 and pydantic as well
        what = str(error)
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            what = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise ResultError(
            f"{path}: expected {RESULT} as softcal calibrate writes it. {what}."
        ) from error
    if not data["converged"]:
        warnings.warn(
            f"{path}: the calibration did not converge: do not use its values. Run it "
            "again with more steps, or see its notes.",
            ResultWarning,
            stacklevel=3,
        )
    return data


def _check_values(data: Mapping[str, Any]) -> None:
    """Raise ValueError for values that no calibration gives."""
    for p in data["parameters"]:
        value, ends = p["value"], [p.get("lower"), p.get("upper")]
        ordered = [x for x in (ends[0], value, ends[1]) if x is not None]
        off = np.diff(ordered) < -1e-9 * abs(value)  # it may lie on a bound
        if not np.isfinite(value) or np.any(off):
            bounds = f"its bounds {ends[0]} and {ends[1]}"
            raise ValueError(f"The value of {p['name']} is {value:g}, not in {bounds}")
    n, C = len(data["parameters"]), data["budget"]["covariance"]
    if [len(row) for row in C] != [n] * n or any(
        (C[i][i] or 0.0) < 0 for i in range(n)
    ):
        raise ValueError(f"budget.covariance is none of {n} parameters")


def _check_unchanged(path: Path, project: Path, source: Mapping[str, Any]) -> None:
    """Raise unless project, mesh and measurements are what they were."""
    files = [(project, source["project"]["sha256"])]
    moved = "; if the project was moved, say where it is: load_result(..., project=)"
    if project.is_file():  # the files that it names are looked for beside it
        files += [(project.parent / f["file"], f["sha256"]) for f in source["files"]]
        moved = ""
    problems = ""
    for file, old in files:
        if not file.is_file():
            problems += f"\n- {file} is missing.{similar_file(file)}"
        elif (now := sha256_of(file)) != old:
            problems += f"\n- {file} has changed: its SHA-256 was {old} and is {now}."
    if problems:
        raise ResultError(
            f"{path}: the input files have changed since the calibration, so its "
            f"values may belong to another model.{problems}\nTo go on, calibrate again "
            f"(softcal calibrate), or restore the original file{moved}."
        )


def _checked_space(
    path: Path, project: Project, data: Mapping[str, Any]
) -> ParameterSpace:
    """Return the parameters, if they and the model are those of the result."""
    names = [entry["name"] for entry in data["parameters"]]
    space = project.space
    problems = [
        f"{key} was {data['solver'].get(key)} and is {now}"
        for key, now in solver_dict(project.model).items()
        if key != "name" and data["solver"].get(key) != now
    ]
    known = [] if space is None else space.names
    if known != names:
        problems.append(f"the parameters were {listed(names)} and are {listed(known)}")
    if problems or space is None:
        before, now = (
            data["versions"].get("softcal_jax"),
            installed_version("softcal-jax"),
        )
        raise ResultError(
            f"{path}: the project file {project.path} is the same, but what it makes "
            f"is not: {'; '.join(problems)}. Was the project changed in Python before "
            f"it was calibrated? Was it another version (softcal-jax {before}, now "
            f"{now})? Calibrate again."
        )
    return space
