"""Values as JSON can hold them, and the versions that a result was computed with."""

import dataclasses
import json
import math
import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softcal_jax._machine import cpu_name, installed_version
from softcal_jax.equilibrium import Model

_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "jaxopt")


def pick(owner: object, *names: str) -> dict[str, Any]:
    """Return some attributes by name."""
    return {name: getattr(owner, name) for name in names}


def plain(value: Any) -> Any:
    """Convert modules to dictionaries, arrays to lists, and non-finite numbers to None.

    NumPy numbers become those of Python.
    """
    if dataclasses.is_dataclass(value):
        value = pick(value, *(field.name for field in dataclasses.fields(value)))
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

    The sparse solver of the model names its package.
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
