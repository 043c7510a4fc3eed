"""What a result was computed from and with, and values as JSON can hold them."""

import dataclasses
import json
import math
import os
import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softcal_jax._module import Module
from softcal_jax._process import cpu_name, installed_version
from softcal_jax.calibration import ProjectSource, SourceFile
from softcal_jax.equilibrium import Model

_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "jaxopt")


def pick(owner: object, names: str) -> dict[str, Any]:
    """Return some attributes by name; one that ends in _mm is converted from metres."""
    picked = {}
    for name in names.split():
        metres = name.removesuffix("_mm")
        value = getattr(owner, metres)
        picked[name] = value if metres == name else 1e3 * np.asarray(value)
    return picked


def plain(value: Any) -> Any:
    """Convert modules to dictionaries, arrays to lists, and non-finite numbers to None.

    NumPy numbers become those of Python.
    """
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        value = {name: getattr(value, name) for name in names}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        value = np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a dictionary, as from `result_dict`, as JSON that every parser reads.

    Raises:
        ValueError: If it holds a NaN or an infinity, which JSON lacks.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def versions(model: Model) -> dict[str, str]:
    """List versions of Python and the numerical packages, and the machine.

    The package of the model's sparse solver is one of them.
    """
    packages = [*_PACKAGES, *re.findall(r"\((.+)\)", model.solver.name)]
    return {
        "python": platform.python_version(),
        "softcal_jax": installed_version("softcal-jax"),
        **{name: installed_version(name) for name in packages},
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "device": jax.devices()[0].device_kind,
    }


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


def made_dict(made: Made | None, directory: str | Path = ".") -> dict[str, Any]:
    """Convert what a result was computed from and with, if that is known.

    Keys: `source` (see `source_dict`, for results in a folder), `settings`, `versions`.
    """
    if made is None:
        return {"source": None, "settings": {}, "versions": {}}
    return {
        "source": source_dict(made.source, directory),
        "settings": plain(made.settings),
        "versions": versions(made.model),
    }


def source_dict(
    source: ProjectSource | None, directory: str | Path = "."
) -> dict[str, Any] | None:
    """Convert what results were made from, see `result_file.SourceEntry`."""
    if source is None:
        return None
    folder = source.project.path.parent
    return {
        "project": file_dict(source.project, directory),
        "files": [file_dict(file, folder) for file in source.files],
        "changes": plain(source.changes),
    }


def file_dict(file: SourceFile, directory: str | Path = ".") -> dict[str, str]:
    """Convert a file to a dictionary: `file`, relative to a folder, and `sha256`."""
    try:
        relative = os.path.relpath(file.path, Path(directory).resolve())
    except ValueError:  # on another drive of Windows
        return {"file": file.path.as_posix(), "sha256": file.sha256}
    return {"file": Path(relative).as_posix(), "sha256": file.sha256}
