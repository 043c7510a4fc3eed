"""How a run can be repeated, and what it was made with, for its page."""

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from softcal_jax._text_table import text_table
from softcal_jax.report._html import Html, Section, facts_html, node, table_html

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


def closing(
    command: str,
    data: Mapping[str, Any],
    sources: Iterable[Mapping[str, Any] | None],
    *,
    files: Sequence[Mapping[str, str]] | None = None,
    options: Sequence[str] = (),
    out: str = REPEATED,
) -> list[Section]:
    """Say how a run can be repeated, what it read, and what it was made with.

    The command reads the project files `sources`, as `source_dict` converts them, None
    where a model was made in Python; or `files`, which lead to them. It writes `out`.
    """
    every = list(sources)
    known = [source for source in every if source is not None]
    named = files or []
    if files is None and len(known) == len(every):
        named = [source["project"] for source in known]
    made_in_python = "This was made in Python, so there is no command that repeats it."
    content = [node("p", made_in_python)]
    if named:
        words = ["softcal", command, *(own["file"] for own in named), *options]
        code = node("code", shlex.join([*words, "-o", out]))
        content = [node("p", "In the folder of this page:"), node("pre", code)]
    for source in known if files is None else ():
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
    read = [*(files or ()), *(own for source in known for own in _files_of(source))]
    if read:
        rows = dict.fromkeys((own["file"], own["sha256"]) for own in read)
        table = text_table("Files that were read", ("file", "SHA-256"), rows)
        content.append(table_html(table))
    return [
        Section("repeat", "Repeat it", content),
        Section("made", "Settings, versions and times", _made_html(data)),
    ]


def _files_of(source: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """List a project file and those that it names, relative to the results."""
    project = source["project"]
    files = [project]
    for own in source["files"]:
        path = os.path.normpath(
            os.path.join(os.path.dirname(project["file"]), own["file"])
        )
        files.append({**own, "file": Path(path).as_posix()})
    return files


def _made_html(data: Mapping[str, Any]) -> list[Html]:
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
