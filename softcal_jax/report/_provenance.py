"""How a run can be repeated, and what it was made with, for its page."""

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from softcal_jax._text_table import text_table
from softcal_jax.report._html import Html, facts_html, node, table_html

REPEATED = "repeated"
"""Folder that the command to repeat a run writes to."""

_KINDS = {
    ".vtu": "for ParaView",
    ".pvd": "all configurations for ParaView",
    ".png": "picture",
    ".svg": "picture",
    ".csv": "table",
    ".txt": "text",
    ".html": "this page",
}


def repeat_html(
    command: str, what: str, sources: Sequence[Mapping[str, Any] | None]
) -> list[Html]:
    """Give the command that repeats a run of project files, and what it read.

    Args:
        command: Name of the command, like "calibrate".
        what: What it made, like "calibration".
        sources: The project files, in their order, as `source_dict` converts them.
    """
    known = [source for source in sources if source is not None]
    if not known or len(known) < len(sources):
        text = (
            f"This {what} was made in Python, without a project file, so there is no "
            "command that repeats it."
        )
        return [node("p", text)]
    words = [command, *(own["project"]["file"] for own in known), "-o", REPEATED]
    content = [command_html(words)]
    for own in known:
        if own["changes"]:
            rows = [(key, repr(value)) for key, value in own["changes"].items()]
            of = f" of {own['project']['file']}" if len(known) > 1 else ""
            changes = text_table(
                f"Changes{of}", ("key of the project file", "value"), rows
            )
            text = (
                "Some values of the project file were replaced when it was loaded. Set "
                "them in the file, or give them to load_project(changes=...) in Python:"
            )
            content += [node("p", text), table_html(changes)]
    return [*content, files_html([file for own in known for file in files_of(own)])]


def inverse_repeat_html(data: Mapping[str, Any], options: Sequence[str]) -> list[Html]:
    """Give the command that repeats an inverse run, and what it was computed from."""
    own, files = data["calibration"], []
    if own is None:
        text = "This was computed in Python, so there is no command that repeats it."
        content = [node("p", text)]
    else:
        content = [command_html(["inverse", own["file"], *options, "-o", REPEATED])]
        files.append(own)
    if data["source"] is not None:
        files += files_of(data["source"])
    return [*content, files_html(files)] if files else content


def command_html(words: Sequence[str]) -> Html:
    """Show a command of softcal that is given in the folder of the page."""
    code = node("code", shlex.join(["softcal", *words]))
    return node("div", node("p", "In the folder of this page:"), node("pre", code))


def files_of(source: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """List a project file and those that it names, relative to the results."""
    project = source["project"]
    files = [project]
    for own in source["files"]:
        path = os.path.normpath(
            os.path.join(os.path.dirname(project["file"]), own["file"])
        )
        files.append({**own, "file": Path(path).as_posix()})
    return files


def files_html(files: Sequence[Mapping[str, str]]) -> Html:
    """Tabulate files, each once, with what they held."""
    rows = dict.fromkeys((own["file"], own["sha256"]) for own in files)
    return table_html(text_table("Files that were read", ("file", "SHA-256"), rows))


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
