"""Input files of Abaqus and CalculiX: nodes, elements, their sets and surfaces."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from softcal_jax._files import check_file
from softcal_jax._limits import MEGABYTES
from softcal_jax.elements import TET_FACES
from softcal_jax.mesh._topology import LOCAL_FACES

_KINDS = {
    r"[AD]?C3D10": ("tetra10", 10),
    r"[AD]?C3D4": ("tetra", 4),
    r"([AD]?C|COH)3D|SC[68]|CSS": ("hexahedron", 0),
    r"STRI65|(S|DS|CPE|CPS|M3D|SFM3D)6": ("triangle6", 6),
    r"STRI3|(S|DS|CPE|CPS|M3D|SFM3D|R3D)3": ("triangle", 3),
    r"(S|DS|CPE|CPS|M3D|SFM3D|R3D)[489]": ("quad", 0),
    "": ("line", 0),
}
"""How types of elements begin, what they are, and with how many nodes.

Where the number is 0, a row is an element. Wedges count as hexahedra, beams and springs
as lines.
"""

_FACES = {
    f"S{label}": next(k for k, face in enumerate(TET_FACES) if opposite not in face)
    for label, opposite in ((1, 3), (2, 2), (3, 0), (4, 1))
}
"""Rows of `LOCAL_FACES` by the labels of the faces of a tet."""

_RULES = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"}
"""Keywords that make or move nodes and elements."""


class _Section(NamedTuple):
    keyword: str
    options: dict[str, str]
    rows: list[list[str]]

    @classmethod
    def opened_by(cls, line: str) -> "_Section":
        """Take a line apart; one without a star opens a section without a keyword."""
        keyword, *options = line[1:].split(",") if line.startswith("*") else [""]
        pairs = [option.partition("=") for option in options]
        values = {key.strip().upper(): text.strip(" \t\"'") for key, _, text in pairs}
        return cls(keyword.strip().upper(), values, [])

    def numbers(self) -> list[list[int]]:
        return [[int(cell) for cell in row if cell] for row in self.rows]


def included_files(path: Path) -> list[Path]:
    """List the files that an Abaqus file includes, once each and in its folder."""
    files = [path.resolve()]
    list(_lines(files))
    return files[1:]


def _lines(files: list[Path]) -> Iterator[str]:
    """Yield the lines of the last of the files; those that they name are added."""
    source = files[-1]
    text = re.sub(r"(?m)^\*\*.*", "", source.read_text(errors="replace"))
    # A line with a keyword goes on after a comma.
    for line in re.sub(r"(?m)^(\*.*,)\s*\n", r"\1", text).splitlines():
        keyword, options, _ = _Section.opened_by(line)
        if keyword != "INCLUDE" and line.strip():
            yield line
        if "INPUT" in options and keyword in ("INCLUDE", "NODE", "ELEMENT"):
            files.append(_included(options["INPUT"], source, files))
            yield from _lines(files)


def _included(name: str, source: Path, files: list[Path]) -> Path:
    folder = files[0].parent
    file = (Path(name) if Path(name).exists() else source.parent / name).resolve()
    where = f"mesh file {source}: *INCLUDE of {name!r}"
    if not file.is_relative_to(folder):
        raise ValueError(
            f"{where}: it lies outside the folder of the mesh, {folder}; copy it there."
        )
    check_file(file, f"{where}:")
    if file in files:
        raise ValueError(f"{where}: it is included already; include it once.")
    size = sum(file.stat().st_size for file in (*files, file)) / 1e6
    MEGABYTES.check(f"mesh file {files[0]} with what it includes", size)
    return file


def read_inp(path: Path) -> meshio.Mesh:
    """Read what a file defines, as one flat model.

    Raises:
        ValueError: If something refers to what no line above it defines, or the file
            holds several parts, or makes nodes and elements by rules.
    """
    model, sections = _Model(), [_Section.opened_by("")]
    for line in _lines([path.resolve()]):
        if line.startswith("*"):
            sections.append(_Section.opened_by(line))
        else:
            sections[-1].rows.append([cell.strip() for cell in line.split(",")])
    for section in sections:
        try:
            model.add(section)
        except KeyError as error:
            what = f"{error} is missing, or no line above defines it"
            raise ValueError(f"*{section.keyword}: {what}.") from error
        except ValueError as error:
            raise ValueError(f"*{section.keyword}: {error}.") from error
    return model.mesh()


class _Model:
    """Nodes and elements by number, and their sets by kind and name.

    The faces of surfaces are elements too, with numbers below 0.
    """

    def __init__(self):
        self.points: dict[int, list[float]] = {}
        self.elements: dict[int, tuple[str, list[int]]] = {}
        self.sets: dict[str, dict[str, set[int]]] = defaultdict(dict)
        self.parts: Counter[str] = Counter()
        self.in_assembly: dict[tuple[str, str], int] = {}

    def add(self, section: _Section) -> None:
        """Take over a section; those that define no part of a mesh are passed over."""
        keyword, options, rows = section
        self.parts[keyword] += keyword in ("PART", "INSTANCE", "ASSEMBLY")
        moved = keyword == "INSTANCE" and any(float(x or 0) for x in chain(*rows))
        if moved or self.parts[keyword] > 1 or keyword in _RULES or "SYSTEM" in options:
            raise ValueError(
                "it moves or repeats a part, or makes nodes or elements by a rule; "
                "export a flat file, without parts, that lists all of them"
            )
        if keyword == "NODE":
            for number, *x in rows:
                point = [float(value or 0) for value in (x + ["0"] * 3)[:3]]
                if self.points.setdefault(int(number), point) != point:
                    raise ValueError(f"node {number} has two places, as in two parts")
            self._extend("NSET", options.get("NSET"), {int(row[0]) for row in rows})
        elif keyword == "ELEMENT":
            self._add_elements(section)
        elif keyword in ("NSET", "ELSET"):
            self._extend(keyword, options[keyword], self._members(section))
        elif keyword == "SURFACE":
            self._add_surface(section)

    def _add_elements(self, section: _Section) -> None:
        name, rows = section.options["TYPE"].upper(), section.numbers()
        kind, n = next(k for start, k in _KINDS.items() if re.match(start, name))
        if n:  # an element may take several rows
            numbers = list(chain(*rows))
            rows = [numbers[k : k + n + 1] for k in range(0, len(numbers), n + 1)]
        for number, *nodes in rows:
            if n and len(nodes) != n:
                raise ValueError(f"element {number} has {len(nodes)} nodes, not {n}")
            self.elements[number] = kind, nodes
        self._extend("ELSET", section.options.get("ELSET"), {row[0] for row in rows})

    def _members(self, section: _Section) -> set[int]:
        keyword, options, rows = section
        if "GENERATE" in options:
            known = self.points if keyword == "NSET" else self.elements
            spans = [range(a, b + 1, *step) for a, b, *step in section.numbers()]
            return {number for span in spans for number in known if number in span}
        cells = [cell for cell in chain(*rows) if cell]
        members = set(chain(*(self._named(keyword, cell) for cell in cells)))
        if keyword == "NSET" and "ELSET" in options:
            for element in self._named("ELSET", options["ELSET"]):
                members.update(self.elements[element][1])
        return members

    def _add_surface(self, section: _Section) -> None:
        name, rows = section.options["NAME"], section.rows
        if section.options.get("TYPE", "").upper() == "NODE":
            nodes = set(chain(*(self._named("NSET", of) for of, *_ in rows)))
            return self._extend("NSET", name, nodes)
        if self._written("ELSET", name) in self.sets["ELSET"]:
            raise ValueError(f"an *ELSET is called {name} too; rename one of them")
        for of, *label in rows:
            for element in self._named("ELSET", of):
                kind, nodes = self.elements[element]
                if not (label and label[0] in _FACES and kind in ("tetra", "tetra10")):
                    raise ValueError(
                        f"the row {', '.join([of, *label])} of {name} stands for a "
                        f"{kind}; expected a face S1 to S4 of tets"
                    )
                face = [nodes[k] for k in LOCAL_FACES[len(nodes)][_FACES[label[0]]]]
                number = -1 - len(self.elements)
                self.elements[number] = ("triangle6" if face[3:] else "triangle"), face
                self._extend("SURFACE", name, {number})

    def _named(self, kind: str, text: str) -> set[int]:
        """Return what a number or the name of a set stands for."""
        if text.isdigit():
            return {int(text)}
        return self.sets[kind][self._written(kind, text.rpartition(".")[2])]

    def _written(self, kind: str, name: str) -> str:
        """Return a name in upper and lower case as the file has it first."""
        return next((k for k in self.sets[kind] if k.upper() == name.upper()), name)

    def _extend(self, kind: str, name: str | None, members: set[int]) -> None:
        if name is None:
            return
        name, level = self._written(kind, name), self.parts["ASSEMBLY"]
        if self.in_assembly.setdefault((kind, name), level) != level:
            raise ValueError(f"the part has a set {name} too; rename one of them")
        self.sets[kind].setdefault(name, set()).update(members)

    def mesh(self) -> meshio.Mesh:
        """Return what was taken over; elements of one kind are one block."""
        blocks: dict[tuple[str, int], list[int]] = {}
        for number, (kind, nodes) in self.elements.items():
            blocks.setdefault((kind, len(nodes)), []).append(number)
        index = {number: k for k, number in enumerate(self.points)}
        nodes_of = lambda e: [index[node] for node in self.elements[e][1]]
        of_cells = {**self.sets["ELSET"], **self.sets["SURFACE"]}
        if missing := set().union(*of_cells.values()) - self.elements.keys():
            raise ValueError(f"no *ELEMENT line defines element {min(missing)}.")
        try:
            return meshio.Mesh(
                np.array(list(self.points.values())),
                [
                    (kind, [*map(nodes_of, block)])
                    for (kind, _), block in blocks.items()
                ],
                point_sets={
                    name: [index[node] for node in sorted(nodes)]
                    for name, nodes in self.sets["NSET"].items()
                },
                cell_sets={
                    name: [
                        [k for k, e in enumerate(block) if e in elements]
                        for block in blocks.values()
                    ]
                    for name, elements in of_cells.items()
                },
            )
        except KeyError as error:
            raise ValueError(f"no *NODE line defines node {error}.") from error
