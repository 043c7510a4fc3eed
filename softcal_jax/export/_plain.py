"""Conversion of values to what JSON can hold."""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np


def fields_of(module: Any) -> dict[str, Any]:
    """Return the fields of a module by name."""
    return {f.name: getattr(module, f.name) for f in dataclasses.fields(module)}


def plain(value: Any) -> Any:
    """Convert arrays to lists, NumPy to Python numbers, and non-finite ones to None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, jax.Array)):
        return plain(np.asarray(value).tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a dictionary as JSON that every parser reads.

    Args:
        path: The file.
        data: The dictionary, as from `result_dict`.

    Raises:
        ValueError: If it holds a NaN or an infinity, which JSON lacks.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
