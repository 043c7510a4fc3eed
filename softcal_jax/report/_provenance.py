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
        without = "without a project file"
        return made_in_python(f"This {what} was made in Python, {without}")
    words = [command, *(source["project"]["file"] for source in known), "-o", REPEATED]
    content = [command_html(words)]
    for source in known:
        if source["changes"]:
            rows = [(key, repr(value)) for key, value in source["changes"].items()]
            of = f" of {source['project']['file']}" if len(known) > 1 else ""
            columns = "key of the project file", "value"
            text = (
                "Some values of the project file were replaced when it was loaded. Set "
                "them in the file, or give them to load_project(changes=...) in Python:"
            )
            changes = text_table(f"Changes{of}", columns, rows)
            content += [node("p", text), table_html(changes)]
    files = [file for source in known for file in files_of(source)]
    return [*content, files_html(files)]


def inverse_repeat_html(data: Mapping[str, Any], options: Sequence[str]) -> list[Html]:
    """Give the command that repeats an inverse run, and what it was computed from."""
    loaded, source = data["calibration"], data["source"]
    content = made_in_python("This was computed in Python")
    if loaded is not None:
        words = ["inverse", loaded["file"], *options, "-o", REPEATED]
        content = [command_html(words)]
    files = [] if loaded is None else [loaded]
    files += [] if source is None else files_of(source)
    return [*content, files_html(files)] if files else content


def made_in_python(what: str) -> list[Html]:
    """Say that no command repeats what was made so."""
    return [node("p", f"{what}, so there is no command that repeats it.")]


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
