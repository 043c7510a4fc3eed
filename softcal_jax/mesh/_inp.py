"""What meshio leaves to its caller in Abaqus files: sections, sets and *INCLUDE."""

import re
from pathlib import Path

import meshio
import numpy as np

from softcal_jax._files import check_file
from softcal_jax._limits import MEGABYTES


def check_inp(path: Path) -> None:
    """Raise ValueError if meshio would misread a file, or it includes what it may not.

    meshio keeps the last of several *NODE sections, and opens all that *INCLUDE names.
    """
    included = included_files(path)
    size = sum(file.stat().st_size for file in (path, *included)) / 1e6
    MEGABYTES.check(f"mesh file {path} with what it includes", size)
    if (sections := len(_headers(path, "NODE"))) > 1:
        raise ValueError(
            f"mesh file {path} has {sections} *NODE sections, of which the reader "
            "keeps the last; merge them into one (export a flat file, without parts)."
        )


def included_files(path: Path) -> list[Path]:
    """List the files that an Abaqus file includes, and those that they include.

    Raises:
        ValueError: If one lies outside the folder of the mesh, or is included twice.
    """
    folder, files = path.resolve().parent, [path.resolve()]
    for source in files:  # the list grows meanwhile
        for name in _named_files(source):
            file = Path(name) if Path(name).exists() else source.parent / name
            file = file.resolve()
            where = f"mesh file {source}: *INCLUDE of {name!r}"
            if not file.is_relative_to(folder):
                raise ValueError(
                    f"{where}: it lies outside the folder of the mesh, {folder}; copy "
                    "it there."
                )
            check_file(file, f"{where}:")
            if file in files:
                raise ValueError(f"{where}: it is included already; include it once.")
            files.append(file)
    return files[1:]


def _named_files(path: Path) -> list[str]:
    """Find what a file includes, in the lines that meshio takes for an *INCLUDE."""
    text = path.read_text(errors="replace")
    lines = [line for line in text.split("\n") if not line.startswith("**")]
    keyword = lambda line: line.partition(",")[0].strip().replace("*", "").upper()
    return [line.split("=")[-1].strip() for line in lines if keyword(line) == "INCLUDE"]


def _headers(path: Path, keyword: str) -> list[str]:
    """Find the lines of an Abaqus file that open a section."""
    text = path.read_text(errors="replace")
    return re.findall(rf"(?im)^\*{keyword}[ \t]*(?:,.*)?$", text)


def mend_inp_sets(path: Path, raw: meshio.Mesh) -> None:
    """Assign the sets named in *ELEMENT lines to the cells of their own sections.

    meshio counts these sets by name, not by section, so a section without ELSET shifts
    all later ones, and a name that is used twice keeps only its last section.
    """
    headers = _headers(path, "ELEMENT")
    if len(headers) != len(raw.cells):
        return  # *INCLUDE brings sections of other files, which carry no sets.
    matches = [re.search(r"(?i)ELSET\s*=\s*([^,\s]+)", header) for header in headers]
    names = [match.group(1) if match else None for match in matches]
    for name in {name for name in names if name}:
        raw.cell_sets[name] = [
            np.arange(len(block) if section == name else 0)
            for section, block in zip(names, raw.cells, strict=True)
        ]
