"""What a result was made from and with, and how to make it again."""

import os
import platform
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from softcal_jax._files import ProjectSource, SourceFile
from softcal_jax._module import Module
from softcal_jax._process import cpu_name, installed_version
from softcal_jax.equilibrium import Model
from softcal_jax.results._tree import Section, Table

REPEATED = "repeated"  # folder that the command to repeat a run writes to
COMMANDS = "repeat"  # a section whose list is one of commands
_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "jaxopt")
_KINDS = {
    ".vtu": "for ParaView",
    ".pvd": "all configurations for ParaView",
    ".png": "picture",
    ".svg": "picture",
    ".pdf": "picture",
    ".csv": "table",
    ".txt": "text",
    ".html": "this page",
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


def made_dict(
    made: Made | Mapping[str, Made] | None, directory: str | Path = "."
) -> dict[str, Any]:
    """Convert what a result was computed from and with, if that is known.

    Keys: `source` (`project`, relative to the folder of the results, `files`, relative
    to that of the project, `changes`), `settings`, `versions` of Python, the numerical
    packages and the machine; of several models by their names, and `sources`.
    """
    if isinstance(made, Mapping):
        each = {model: made_dict(of, directory) for model, of in made.items()}
        of_all = lambda key: {model: of[key] for model, of in each.items()}
        every = {k: v for of in each.values() for k, v in of["versions"].items()}
        both = {"sources": of_all("source"), "settings": of_all("settings")}
        return {**both, "versions": every}
    if made is None:
        return {"source": None, "settings": {}, "versions": {}}
    source = made.source and {
        "project": file_dict(made.source.project, directory),
        "files": [
            file_dict(file, made.source.project.path.parent)
            for file in made.source.files
        ],
        "changes": made.source.changes,
    }
    packages = [*_PACKAGES, *re.findall(r"\((.+)\)", made.model.solver.name)]
    versions = {
        "python": platform.python_version(),
        "softcal_jax": installed_version("softcal-jax"),
        **{name: installed_version(name) for name in packages},
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "device": jax.devices()[0].device_kind,
    }
    return {"source": source, "settings": made.settings, "versions": versions}


def file_dict(file: SourceFile, directory: str | Path = ".") -> dict[str, str]:
    """Convert a file to a dictionary: `file`, relative to a folder, and `sha256`."""
    try:
        relative = os.path.relpath(file.path, Path(directory).resolve())
    except ValueError:  # on another drive of Windows
        return {"file": file.path.as_posix(), "sha256": file.sha256}
    return {"file": Path(relative).as_posix(), "sha256": file.sha256}


def closing(
    command: str,
    data: Mapping[str, Any],
    *,
    files: Sequence[Mapping[str, str]] | None = None,
    options: Sequence[str] = (),
) -> list[Section]:
    """Write the last sections: the command that repeats a run, its files and settings.

    The command reads the project files of `data`, as `made_dict` lists them, or, if
    given, `files`. A simulation also reads values of a calibration; inverse control
    reads nothing else.
    """
    values = data.get("calibration")
    if command == "inverse":
        files = [values] if values else []
    elif values:
        options = ["--values", values["file"]]
    every = data["sources"].values() if "sources" in data else [data["source"]]
    known = [source for source in every if source is not None]
    named = files or []
    if files is None and len(known) == len(every):
        named = [source["project"] for source in known]
    text = ("This result was made in Python, so no command repeats it.",)
    if named:
        words = ["softcal", command, *(file["file"] for file in named), *options]
        text = "In the folder of this page:", shlex.join([*words, "-o", REPEATED])
    tables = []
    for source in known if files is None else ():
        rows = [(key, repr(value)) for key, value in source["changes"].items()]
        of = f" of {source['project']['file']}" if len(known) > 1 else ""
        heads = "key of the project file | value"
        note = (
            "These values of the project file were overridden when it was loaded. Set "
            "them in the file, or pass them to load_project(changes=...)."
        )
        tables.append(Table.of(f"Changes{of}", heads, rows, note=note))
    read = [*(files or ()), *(file for source in known for file in _files_of(source))]
    rows = dict.fromkeys((file["file"], file["sha256"]) for file in read)
    tables.append(Table.of("Input files", "file | SHA-256", rows))
    made = "Settings, versions and times"
    return [
        Section(COMMANDS, "How to repeat this run", text, (*tables,), folded=True),
        Section("made", made, (), tuple(_made(data)), folded=True),
    ]


def _files_of(source: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """List a project file and the files that it names, relative to the results."""
    project = source["project"]
    folder = os.path.dirname(project["file"])
    place = lambda file: Path(os.path.normpath(os.path.join(folder, file))).as_posix()
    return [project, *({**f, "file": place(f["file"])} for f in source["files"])]


def _made(data: Mapping[str, Any]) -> list[Table]:
    """Tabulate settings, versions, times and files."""
    parts = {
        "Settings": dict(_flat(data.get("settings", {}))),
        "Versions": data.get("versions", {}),
        "Times": {k: f"{v:.2f} s" for k, v in data.get("timing_s", {}).items()},
        "Files": {name: _KINDS.get(Path(name).suffix, "") for name in data["files"]},
    }
    return [
        Table.of(title, " | ", [(k, str(v)) for k, v in rows.items()])
        for title, rows in parts.items()
    ]


def _flat(settings: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Name nested settings by their path, like newton.rtol."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", "none" if value is None else value
