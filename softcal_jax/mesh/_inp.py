"""Input files of Abaqus and CalculiX: nodes, elements, their sets and surfaces."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from softcal_jax._files import check_file
from softcal_jax._places import MEGABYTES
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

_RULES = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"}
"""Keywords that make or move nodes and elements."""

Rows = list[list[str]]
Items = Iterable[tuple[int, tuple[str, Any]]]


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
        keyword, options = _opened(line)
        if keyword != "INCLUDE" and line.strip():
            yield line
        if "INPUT" in options and keyword in ("INCLUDE", "NODE", "ELEMENT"):
            files.append(_included(options["INPUT"], source, files))
            yield from _lines(files)


def _opened(line: str) -> tuple[str, dict[str, str]]:
    """Return the keyword and the options of a line; without a star it has none."""
    keyword, *options = line[1:].split(",") if line.startswith("*") else [""]
    pairs = [option.partition("=") for option in options]
    values = {key.strip().upper(): text.strip(" \t\"'") for key, _, text in pairs}
    return keyword.strip().upper(), values


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
    model, sections = _Model(), [("", {}, [])]
    for line in _lines([path.resolve()]):
        if line.startswith("*"):
            sections.append((*_opened(line), []))
        else:
            sections[-1][2].append([cell.strip() for cell in line.split(",")])
    for keyword, options, rows in sections:
        try:
            model.add(keyword, options, rows)
        except (KeyError, ValueError) as error:
            lost = " is missing, or no line above defines it"
            what = f"{error}{lost if isinstance(error, KeyError) else ''}"
            raise ValueError(f"*{keyword}: {what}.") from error
    return model.mesh()


class _Model:
    """Items by number: nodes (NSET) and elements (ELSET); and their sets by name.

    The faces of surfaces are elements too, with numbers below 0.
    """

    def __init__(self):
        self.items: dict[str, dict[int, tuple[str, Any]]] = {"NSET": {}, "ELSET": {}}
        self.sets: dict[str, dict[str, set[int]]] = {"NSET": {}, "ELSET": {}}
        self.written: dict[str, str] = {}  # names as the file has them first
        self.origins: dict[tuple[str, str], tuple[str, int]] = {}
        self.parts: Counter[str] = Counter()

    def add(self, keyword: str, options: dict[str, str], rows: Rows) -> None:
        """Take over a section; those that define no part of a mesh are passed over."""
        self.parts[keyword] += keyword in ("PART", "INSTANCE", "ASSEMBLY")
        moved = keyword == "INSTANCE" and any(float(x or 0) for x in chain(*rows))
        if moved or self.parts[keyword] > 1 or keyword in _RULES or "SYSTEM" in options:
            raise ValueError(
                "it moves or repeats a part, or makes nodes or elements by a rule; "
                "export a flat file, without parts, that lists all of them"
            )
        if keyword == "NODE":
            place = lambda x: [float(value or 0) for value in (*x, "", "", "")[:3]]
            nodes = [(int(number), ("point", place(x))) for number, *x in rows]
            self._extend("NSET", options.get("NSET"), self._put("NSET", nodes))
        elif keyword == "ELEMENT":
            elements = _elements(options["TYPE"].upper(), _integers(rows))
            self._extend("ELSET", options.get("ELSET"), self._put("ELSET", elements))
        elif keyword in ("NSET", "ELSET"):
            members = self._members(keyword, options, rows)
            self._extend(keyword, options[keyword], members)
        elif keyword == "SURFACE" and options.get("TYPE", "").upper() == "NODE":
            nodes = [self._of("NSET", row[0]) for row in rows]
            self._extend("NSET", options["NAME"], set().union(*nodes), "surface")
        elif keyword == "SURFACE":
            faces = self._put("ELSET", self._faces(rows))
            self._extend("ELSET", options["NAME"], faces, "surface")

    def _put(self, kind: str, items: Items) -> set[int]:
        known, numbers = self.items[kind], set()
        for number, item in items:
            numbers.add(number)
            if known.setdefault(number, item) != item:
                raise ValueError(f"{number} is defined twice, as in two parts")
        return numbers

    def _extend(
        self, kind: str, name: str | None, members: set[int], by: str = ""
    ) -> None:
        if name is None:
            return
        key, origin = name.upper(), (by, self.parts["ASSEMBLY"])
        if self.origins.setdefault((kind, key), origin) != origin:
            raise ValueError(
                f"{name} is a set and a surface, or a set of the part and another one "
                "of the assembly; rename one of them"
            )
        self.written.setdefault(key, name)
        self.sets[kind].setdefault(key, set()).update(members)

    def _of(self, kind: str, text: str) -> set[int]:
        """Return what a number or the name of a set stands for."""
        if text.isdigit():
            return {int(text)}
        return self.sets[kind][text.rpartition(".")[2].upper()]

    def _members(self, kind: str, options: dict[str, str], rows: Rows) -> set[int]:
        if "GENERATE" in options:
            spans = [range(a, b + 1, *step) for a, b, *step in _integers(rows)]
            return {n for span in spans for n in self.items[kind] if n in span}
        members = {n for cell in chain(*rows) if cell for n in self._of(kind, cell)}
        if kind == "NSET" and "ELSET" in options:
            for element in self._of("ELSET", options["ELSET"]):
                members.update(self.items["ELSET"][element][1])
        return members

    def _faces(self, rows: Rows) -> Items:
        for of, *labels in rows:
            label = "".join(labels[:1]).upper()
            for element in sorted(self._of("ELSET", of)):
                kind, nodes = self.items["ELSET"][element]
                if label not in ("S1", "S2", "S3", "S4") or not kind.startswith("tet"):
                    raise ValueError(
                        f"the row {', '.join([of, *labels])} stands for a {kind}; "
                        "expected a face S1 to S4 of tets"
                    )
                face = [nodes[k] for k in LOCAL_FACES[len(nodes)][int(label[1]) - 1]]
                kind = "triangle6" if len(face) == 6 else "triangle"
                yield -10 * element - int(label[1]), (kind, face)

    def mesh(self) -> meshio.Mesh:
        """Return what was taken over; elements of one kind are one block."""
        points, elements = self.items.values()
        index = {number: k for k, number in enumerate(points)}
        blocks: dict[tuple[str, int], list[int]] = defaultdict(list)
        for number, (kind, nodes) in elements.items():
            blocks[kind, len(nodes)].append(number)
        of_nodes, of_cells = (
            {self.written[key]: members for key, members in sets.items()}
            for sets in self.sets.values()
        )
        if lost := set().union(*of_cells.values()) - elements.keys():
            raise ValueError(f"no *ELEMENT line defines element {min(lost)}.")
        nodes_of = lambda e: [index[node] for node in elements[e][1]]
        rows = lambda block, of: np.flatnonzero([e in of for e in block])
        try:
            return meshio.Mesh(
                np.array([place for _, place in points.values()]),
                [(kind, [*map(nodes_of, b)]) for (kind, _), b in blocks.items()],
                point_sets={
                    name: [index[node] for node in sorted(members)]
                    for name, members in of_nodes.items()
                },
                cell_sets={
                    name: [rows(block, members) for block in blocks.values()]
                    for name, members in of_cells.items()
                },
            )
        except KeyError as error:
            raise ValueError(f"no *NODE line defines node {error}.") from error


def _integers(rows: Rows) -> list[list[int]]:
    return [[int(cell) for cell in row if cell] for row in rows]


def _elements(name: str, rows: list[list[int]]) -> Items:
    kind, n = next(k for start, k in _KINDS.items() if re.match(start, name))
    if n:  # an element may take several rows
        numbers = list(chain(*rows))
        rows = [numbers[k : k + n + 1] for k in range(0, len(numbers), n + 1)]
    for number, *nodes in rows:
        if n and len(nodes) != n:
            raise ValueError(f"element {number} has {len(nodes)} nodes, not {n}")
        yield number, (kind, nodes)
