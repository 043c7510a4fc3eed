"""Load a calibration that was written to a results folder."""

import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from pydantic_core import from_json

from softcal_jax import configurations
from softcal_jax._files import check_file, sha256_of, similar_file
from softcal_jax._module import Module
from softcal_jax._process import installed_version
from softcal_jax._text import SoftcalWarning, check_known, listed
from softcal_jax._typing import Array, Float
from softcal_jax._units import is_number, readable
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import Estimate
from softcal_jax.project import Project, load_project
from softcal_jax.results._folder import complete_results
from softcal_jax.results._json import RESULT_FORMAT, read_column, solver_dict
from softcal_jax.results._vtu import read_displacement

RESULT = "result.json"  # name of the file in a results folder


class ResultError(ValueError):
    """A result cannot be loaded; the text says which file is in the way, and why."""


class ResultWarning(SoftcalWarning):
    """A result was loaded whose values should not be used as they are."""


class LoadedResult(Module):
    """A calibration that was loaded from a results folder.

    Attributes:
        path: The file `result.json`.
        content: What it holds, by its keys and in its units.
        project: The project that was calibrated, as `load_project` gives it: its model
            has the start values.
        model: The model with the calibrated values.
        estimate: What the calibration says of the parameters.
    """

    path: Path
    content: Mapping[str, Any]
    project: Project
    model: Model
    estimate: Estimate

    @property
    def space(self) -> ParameterSpace:
        """The parameters, with start and bounds."""
        return self.estimate.space

    @property
    def z(self) -> Float[Array, " n_p"]:
        """The calibrated values, scaled [-]."""
        return jnp.asarray(self.estimate.z)

    @property
    def values(self) -> dict[str, float]:
        """The calibrated values by name, in SI units."""
        return self.column("value", of="parameters")

    def column(self, key: str, *, of: str = "configurations") -> dict[str, Any]:
        """Return what one of its tables has under a key, by name; lengths in m."""
        return read_column(self.content[of], key)

    def _words(self) -> str:
        values = (
            f"{q.name} = {readable(self.values[q.name], q.unit)}"
            for q in self.space.parameters
        )
        end = "converged" if self.content["converged"] else "NOT CONVERGED"
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

    def state_of(self, name: str) -> Path | None:
        """Return the .vtu of a configuration; None without an equilibrium."""
        entries = [e for e in self.content["configurations"] if e["name"] == name]
        files = (file for entry in entries for file in entry.get("files", []))
        vtu = [file for file in files if file.endswith(".vtu")]
        return self.path.parent / vtu[0] if vtu else None

    def displacement(self, name: str) -> Float[Array, "n_points 3"] | None:
        """Read the equilibrium that the calibration found of a configuration [m].

        It is near any other with the same supports and loads: a `guess` for
        `solve_equilibrium` and `solve_inverse`. None where no file holds it.

        Raises:
            ResultError: If its file is damaged.
        """
        path = self.state_of(name)
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
    data, values = _read(path)
    with _as_written(path):
        source, said = data["source"], data["assessment"]
        if source is None:
            raise ResultError(
                f"{path}: this calibration was made in Python, without a project file. "
                "Build model and space in Python as they were, and set the values by "
                "space.model_at(model, space.to_scaled(values)); or describe them in a "
                "project file, and calibrate that."
            )
        if project is None:
            beside = path.parent.resolve() / source["project"]["file"]
            project = os.path.normpath(beside)
        _check_unchanged(path, Path(project), source)
        read_column(data["configurations"], "rms_after_mm")
        C = np.array(data["budget"]["covariance"], float)
        solver, version = {**data["solver"]}, data["versions"]["softcal_jax"]
        changes = {**source["changes"]}
    # With `changes`, even empty ones, `load_project` does not warn a second time.
    loaded = load_project(project, changes=changes)
    space = _checked_space(path, loaded, [*values], solver, version)
    z = space.to_scaled(jnp.asarray([*values.values()]))
    estimate = Estimate(space, z, C, said.get("contradicted", False))
    return LoadedResult(path, data, loaded, space.model_at(loaded.model, z), estimate)


def result_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of `result.json`, given it or its folder."""
    path = Path(path)
    complete_results(path.parent if path.name == RESULT else path)
    return path / RESULT if path.is_dir() else path


def load_values(path: str | os.PathLike[str]) -> dict[str, float]:
    """Load values alone, by name in SI units; project and mesh may have changed."""
    return _read(result_path(path))[1]


@contextmanager
def _as_written(path: Path) -> Iterator[None]:
    """Raise ResultError where the content is not what a calibration writes."""
    try:
        yield
    except ResultError:
        raise
    # Of JSON and UTF-8 as well.
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as e:
        what = f"{e.args[0]}: Field required" if isinstance(e, KeyError) else str(e)
        raise ResultError(
            f"{path}: expected {RESULT} as softcal calibrate writes it. {what}."
        ) from e


def _read(path: Path) -> tuple[dict[str, Any], dict[str, float]]:
    """Read the file, and the values of the parameters, which are checked."""
    check_file(path, "result file")
    with _as_written(path):
        data = from_json(path.read_text(encoding="utf-8-sig"))
        kind = data.get("format") if isinstance(data, dict) else None
        if kind != RESULT_FORMAT:
            raise ValueError(
                f"Its format is {kind!r}; expected {RESULT_FORMAT!r}: calibrate again, "
                "or load it with the version that wrote it"
            )
        values: dict[str, float] = {}
        for k, entry in enumerate(data["parameters"]):
            name, value = entry["name"], entry["value"]
            lower, upper = entry.get("lower"), entry.get("upper")
            sound = is_number(value) and math.isfinite(value)
            ordered = [end for end in (lower, value, upper) if end is not None]
            # It may lie on a bound.
            if not sound or np.any(np.diff(ordered) < -1e-9 * abs(value)):
                raise ValueError(
                    f"parameters.{k}.value: The value of {name} is {value}, not in its "
                    f"bounds {lower} and {upper}"
                )
            values[name] = value
        n, C = len(values), np.array(data["budget"]["covariance"], float)
        if C.size != n * n or np.any(np.diag(C.reshape(n, n)) < 0.0):
            raise ValueError(f"budget.covariance is none of {n} parameters")
        said = data["assessment"]
        for key, written, kind in (
            ("converged", data["converged"], bool),
            ("assessment.contradicted", said.get("contradicted", False), bool),
            ("assessment.outcome", said.get("outcome", ""), str),
            ("assessment.reasons", said["reasons"], list),
            *(("assessment.reasons", reason, str) for reason in said["reasons"]),
        ):
            if not isinstance(written, kind):
                raise ValueError(f"{key} is {written!r}, expected a {kind.__name__}")
    if not data["converged"]:
        warnings.warn(
            f"{path}: the calibration did not converge: do not use its values. Run it "
            "again with more steps, or see its notes.",
            ResultWarning,
            stacklevel=3,
        )
    return data, values


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
    path: Path,
    project: Project,
    names: Sequence[str],
    solver: Mapping[str, Any],
    version: str,
) -> ParameterSpace:
    """Return the parameters, if they and the model are those of the result."""
    space = project.space
    problems = [
        f"{key} was {solver.get(key)} and is {now}"
        for key, now in solver_dict(project.model).items()
        if key != "name" and solver.get(key) != now
    ]
    known = [] if space is None else space.names
    if known != names:
        problems.append(f"the parameters were {listed(names)} and are {listed(known)}")
    if problems or space is None:
        raise ResultError(
            f"{path}: the project file {project.path} is the same, but what it makes "
            f"is not: {'; '.join(problems)}. Was the project changed in Python before "
            f"it was calibrated? Was it another version (softcal-jax {version}, now "
            f"{installed_version('softcal-jax')})? Calibrate again."
        )
    return space
