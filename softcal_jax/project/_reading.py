"""From a file on the disk to its tables, and everything that is wrong in them."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from softcal_jax.project._kinds import kind_problems
from softcal_jax.project._laws import law_problems
from softcal_jax.project._problems import (
    ProjectError,
    describe,
    one_by_one,
    suggestion,
)
from softcal_jax.project._schema import ProjectTable
from softcal_jax.project._schema_poses import CandidateTable, ConfigurationTable

_OF_CONFIGURATIONS = tuple(
    key
    for key in ConfigurationTable.model_fields
    if key not in CandidateTable.model_fields
)
"""Keys of [shared] that candidates do not take over."""


def read_tables(path: Path) -> ProjectTable:
    """The file as tables, with [shared] merged into each configuration.

    Raises:
        FileNotFoundError: If there is no such file.
        ProjectError: If it is no TOML, or keys or values in it are wrong.
    """
    raw = _toml(path)
    shared = raw.get("shared", {})
    problems = _shared_problems(shared)
    if problems:
        raise one_by_one(path, problems)
    merged = _with_shared(raw, shared)
    table = None
    try:
        table = ProjectTable.model_validate(merged)
    except ValidationError as error:
        problems = describe(error, ProjectTable, raw)
    problems += _measured_candidates(raw) + law_problems(raw) + kind_problems(raw)
    if not (raw.get("configurations") or raw.get("candidates")):
        problems.append(
            "configurations: missing. Expected at least one table [[configurations]]."
        )
    if problems or table is None:
        raise one_by_one(path, problems)
    return table


def _toml(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise FileNotFoundError(f"project file {path} does not exist.")
    if not path.is_file():
        raise ProjectError(f"project file {path} is a directory; name the file in it.")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ProjectError(f"{path} cannot be read as TOML: {error}.") from error
    return raw


def _with_shared(raw: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    """The file with [shared] merged into every configuration and candidate."""
    merged = {key: value for key, value in raw.items() if key != "shared"}
    common = {key: v for key, v in shared.items() if key not in _OF_CONFIGURATIONS}
    for key, base in (("configurations", shared), ("candidates", common)):
        if isinstance(raw.get(key), list):
            merged[key] = [
                _merged(base, own) if isinstance(own, dict) else own for own in raw[key]
            ]
    for own in _tables(merged, "candidates"):
        own.pop("measured", None)  # `_measured_candidates` says it in better words
    return merged


def _shared_problems(shared: Any) -> list[str]:
    """What does not belong into [shared]; its values are judged where they land."""
    if not isinstance(shared, dict):
        return [f"shared: got {shared!r}; expected a table [shared]."]
    known = [key for key in ConfigurationTable.model_fields if key != "name"]
    return [
        f"shared.{key}: unknown key.{suggestion(key, known)} Known here: "
        f"{', '.join(known)}."
        for key in shared
        if key not in known
    ]


def _tables(raw: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = raw.get(key)
    return (
        [e for e in entries if isinstance(e, dict)] if isinstance(entries, list) else []
    )


def _measured_candidates(raw: dict[str, Any]) -> list[str]:
    return [
        f"candidates.{own.get('name', i)}.measured: a candidate is what might be "
        "measured; once it is, make it one of [[configurations]]."
        for i, own in enumerate(_tables(raw, "candidates"), start=1)
        if "measured" in own
    ]


def _merged(shared: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The own table on top of the shared one; tables in both are merged alike."""
    out = dict(shared)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = _merged(out[key], value) if both else value
    return out
