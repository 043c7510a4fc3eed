"""Change values of a project file before it is checked."""

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from softcal_jax.project._problems import ProjectError, suggestion


def with_changes(
    path: Path, raw: dict[str, Any], changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Replace some values of a file.

    Args:
        path: The file, for messages.
        raw: The file as it was read.
        changes: New values by key, like "material.E", or "parameters.E.lower" for an
            entry of a list, by its name. None removes a key. Missing tables on the way
            to a key are created.

    Raises:
        ProjectError: If a key leads through something that is not a table.
    """
    raw = deepcopy(raw)
    for key, value in changes.items():
        *way, last = key.split(".")
        here: Any = raw
        for i, part in enumerate(way):
            here = _inside(path, here, part, ".".join(way[: i + 1]), key)
        if not isinstance(here, dict):
            raise _no_table(path, ".".join(way), key)
        if value is None:
            here.pop(last, None)
        else:
            here[last] = deepcopy(value)
    return raw


def _inside(path: Path, here: Any, part: str, where: str, key: str) -> Any:
    if isinstance(here, list):
        entries = [e for e in here if isinstance(e, dict)]
        named = {str(e.get("name", e.get("field"))): e for e in entries}
        if part not in named:
            raise ProjectError(
                f"{path}: {key}: there is no {where}.{suggestion(part, named)} Known: "
                f"{', '.join(named)}."
            )
        return named[part]
    if not isinstance(here, dict):
        raise _no_table(path, where, key)
    return here.setdefault(part, {})


def _no_table(path: Path, where: str, key: str) -> ProjectError:
    return ProjectError(f"{path}: {key}: {where} is no table of the project file.")
