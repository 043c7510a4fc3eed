"""How a run can be repeated, and what it was made with, for its page."""

import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softcal_jax.report._description import described
from softcal_jax.report._html import Html, facts_html, node, table_html

_REPEATED = "repeated"
"""Folder that the command to repeat a calibration writes to."""

_KINDS = {
    ".vtu": "for ParaView",
    ".pvd": "all configurations for ParaView",
    ".png": "picture",
    ".svg": "picture",
    ".csv": "table",
    ".txt": "text",
    ".html": "this page",
}


def repeat_html(data: Mapping[str, Any]) -> list[Html]:
    """Give the command that made a calibration, and the files that it read."""
    source = data["source"]
    if source is None:
        text = (
            "This calibration was made in Python, without a project file, so there is "
            "no command that repeats it."
        )
        return [node("p", text)]
    project = source["project"]
    command = f"softcal calibrate {shlex.quote(project['file'])} -o {_REPEATED}"
    first = [
        node("p", "In the folder of this page:"),
        node("pre", node("code", command)),
    ]
    if source["changes"]:
        rows = [(key, repr(value)) for key, value in source["changes"].items()]
        changes = described("Changes", ("key of the project file", "value"), rows)
        text = (
            "Some values of the project file were replaced when it was loaded. Set "
            "them in the file, or give them to load_project(changes=...) in Python:"
        )
        first += [node("p", text), table_html(changes)]
    files = [project]
    for own in source["files"]:
        path = os.path.normpath(
            os.path.join(os.path.dirname(project["file"]), own["file"])
        )
        files.append({**own, "file": Path(path).as_posix()})
    rows = [(own["file"], own["sha256"]) for own in files]
    return [
        *first,
        table_html(described("Files that were read", ("file", "SHA-256"), rows)),
    ]


def made_html(data: Mapping[str, Any]) -> list[Html]:
    """Tabulate settings, versions, times and files."""
    parts = {
        "Settings": _flat(data.get("settings", {})),
        "Versions": data.get("versions", {}),
        "Times": {k: f"{v:.2f} s" for k, v in data.get("timing_s", {}).items()},
        "Files": {name: _KINDS.get(Path(name).suffix, "") for name in data["files"]},
    }
    return [
        facts_html(title, {name: str(value) for name, value in rows.items()})
        for title, rows in parts.items()
        if rows
    ]


def _flat(settings: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Name nested settings by their path, like newton.rtol."""
    flat = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[f"{before}{key}"] = "none" if value is None else value
    return flat
