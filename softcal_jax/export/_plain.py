"""Values as JSON holds them."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np


def fields_of(module: Any) -> dict[str, Any]:
    """The fields of a module by name."""
    return {f.name: getattr(module, f.name) for f in dataclasses.fields(module)}


def plain(value: Any) -> Any:
    """Arrays become lists, NumPy numbers Python ones, and what is not finite None."""
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
