"""Inputs that must be refused: tables, meshes, checkpoints, sweeps and arguments."""

import math
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks._malformed import LARGE, Given, Random, calibrate, edit, kind, pick


def _table(given: Given, change: Callable[[list[str]], list[str]]) -> list[str]:
    path = given.folder / "markers.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(change(lines)) + "\n", encoding="utf-8")
    return calibrate(given)


_HEADER = 3
"""Line of the header of the table, after its comments."""


@kind
def tables_that_are_none(given, random):
    """Tables that are none."""
    path = given.folder / "markers.csv"
    n = int(random.integers(1, 4096))
    path.write_bytes(
        pick(random, [b"", b"\x00" * n, random.bytes(n), b"\n" * n, b"a,b\n"])
    )
    return calibrate(given)


@kind
def missing_columns(given, random):
    """Missing columns."""
    column = pick(random, ["marker", "x_mm", "y_mm", "z_mm", "run", "phase"])
    new = pick(random, ["", "w", column + "2", column.replace("mm", "furlong") + "'"])
    spoil = lambda lines: [
        line.replace(column, new, 1) if i == _HEADER else line
        for i, line in enumerate(lines)
    ]
    return _table(given, spoil)


@kind
def cells_that_are_no_numbers(given, random):
    """Cells that are no numbers."""
    bad = pick(
        random, ["inf", "-inf", "1e999", "x", "1.2.3", "=1+1", "1 000", "0x10", "nan"]
    )

    def spoil(lines):
        row = pick(
            random, [i for i, s in enumerate(lines) if s.startswith("gravity,")][:3]
        )
        row += 6 * int(random.integers(2))
        cells = lines[row].split(",")
        cells[4 + random.integers(3)] = bad
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return _table(given, spoil)


@kind
def rows_that_do_not_fit(given, random):
    """Rows that do not fit."""
    bad = pick(random, ['"', "a,b", "," * 200, "gravity,0.0,held,1", "x" * 200_000])

    def spoil(lines):
        at = int(random.integers(_HEADER + 1, len(lines)))
        return [*lines[:at], bad, *lines[at:]]

    return _table(given, spoil)


@kind
def rows_missing_or_twice(given, random):
    """Rows missing or twice."""

    def spoil(lines):
        rows = [
            i for i, s in enumerate(lines) if s.split(",")[3:4] in (["1"], ["2"], ["3"])
        ]
        at = pick(random, rows)
        return [*lines[:at], *[lines[at]] * pick(random, [0, 2, 3]), *lines[at + 1 :]]

    return _table(given, spoil)


def _mesh(given: Given, name: str, content: bytes) -> list[str]:
    (given.folder / name).write_bytes(content)
    text = given.project.read_text(encoding="utf-8")
    beam = next(line for line in text.splitlines() if line.startswith("beam ="))
    return edit(given, (beam, f'file = "{name}"\nlength_unit = "mm"'))


@kind
def meshes_that_are_none(given, random):
    """Meshes that are none."""
    end = pick(random, ["msh", "vtu", "vtk", "inp", "med", "stl", "xyz"])
    n = int(random.integers(0, 4096))
    content = pick(
        random,
        [
            b"",
            random.bytes(n),
            b"$MeshFormat\n4.1 0 8\n",
            b"*NODE\n1, 0, 0",
            b"<VTKFile>",
        ],
    )
    return _mesh(given, f"m.{end}", content)


@kind
def meshes_with_wrong_numbers(given, random):
    """Meshes with wrong numbers."""
    points = random.uniform(0.0, 100.0, (4, 3)).tolist()
    tet = [1, 2, 3, 4]
    bad = pick(random, ["nan", "inf", "index", "negative", "flat", "huge", "twice"])
    if bad in ("nan", "inf"):
        points[random.integers(4)][random.integers(3)] = float(bad)
    elif bad == "flat":
        points[3] = points[2]
    elif bad == "twice":
        tet[3] = tet[0]
    else:
        tet[3] = {"index": 5, "negative": -4, "huge": 10**19}[bad]
    rows = [f"{i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(points, start=1)]
    text = ["*NODE", *rows, "*ELEMENT, TYPE=C3D4", "1, " + ", ".join(map(str, tet))]
    return _mesh(given, "m.inp", "\n".join(text).encode())


@kind
def includes_of_other_files(given, random):
    """Includes of other files."""
    name = pick(
        random, ["/dev/zero", "/dev/random", "../../etc/passwd", "m.inp", "fifo", "no"]
    )
    if name == "fifo":
        os.mkfifo(given.folder / name)
    return _mesh(given, "m.inp", f"*INCLUDE, INPUT={name}\n".encode())


@kind
def spoilt_checkpoints(given, random):
    """Spoilt checkpoints."""
    path = given.folder / "spoilt.npz"
    content = bytearray(given.checkpoint.read_bytes())
    way = random.integers(4)
    if way == 0:
        content = content[: random.integers(1, len(content) - 1)]
    elif way == 1:
        content = bytearray(random.bytes(int(random.integers(0, 4096))))
    elif way == 2:
        at = int(random.integers(len(content) // 2))
        content[at : at + 64] = random.bytes(64)
    else:
        return calibrate(given, "--checkpoint", str(_edited_checkpoint(given, random)))
    path.write_bytes(content)
    return calibrate(given, "--checkpoint", str(path))


def _edited_checkpoint(given: Given, random: Random) -> Path:
    """A checkpoint in which an array has been changed, or is missing."""
    path = given.folder / "edited.npz"
    with np.load(given.checkpoint) as file:
        arrays = {name: file[name] for name in file.files}
    name = pick(random, sorted(arrays))
    if random.random() < 0.3:
        del arrays[name]
    elif arrays[name].dtype.kind == "U":
        arrays[name] = np.array(pick(random, ["", "{}", "[]", "[1]", "null"]))
    else:
        arrays[name] = np.full(3 + arrays[name].size, math.nan)
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


@kind
def checkpoints_that_grow(given, random):
    """Checkpoints that grow."""
    path = given.folder / "grows.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        n = int(10.0 ** random.uniform(9.0, 15.0))
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({n},), }}"
        head = head.ljust(117) + "\n"
        data = b"\x93NUMPY\x01\x00v\x00" + head.encode()
        file.writestr("mark.npy", data + bytes(10**7))
    return calibrate(given, "--checkpoint", str(path))


@kind
def spoilt_rows(given, random):
    """Spoilt rows of a sweep."""
    folder = given.folder / "spoilt"
    shutil.copytree(given.rows, folder)
    path = folder / "rows.parquet"
    content = bytearray(path.read_bytes())
    way = random.integers(3)
    if way == 0:
        content = random.bytes(int(random.integers(1, 8192)))
    elif way == 1:
        begin = int(random.integers(len(content)))
        content[begin : begin + int(random.integers(1, 100))] = b"\x00" * 16
    else:
        content = content[: random.integers(len(content))]
    path.write_bytes(content)
    return ["sweep", "show", str(folder)]


@kind
def wrong_sweeps(given, random):
    """Wrong sweeps."""
    path = given.folder / "sweep.toml"
    n = int(pick(random, LARGE))
    line = pick(
        random,
        [
            f"noise = {{ count = {n} }}",
            f"start = {{ count = -{n} }}",
            '"material.E" = [1979-05-27]',
            '"material.Q" = [1, 2]',
            '"material.nu" = [0.3, nan]',
            '"material.nu" = []',
            "noise = 3",
            'layout = ["ends"]',
            "configurations = { choose = 7 }",
        ],
    )
    path.write_text(f'project = "{given.project.name}"\n[axes]\n{line}\n')
    return ["sweep", str(path), "--workers", "1"]


@kind
def wrong_places(given, random):
    """Wrong places."""
    words = calibrate(given)
    way = random.integers(6)
    if way == 0:
        words[1] = str(given.folder)
    elif way == 1:
        words[1] = str(given.folder / pick(random, ["no.toml", "x" * 300, "a\nb.toml"]))
    elif way == 2:
        words[3] = str(given.project)
    elif way == 3:
        words[3] = str(given.project / "out")
    elif way == 4:
        words[3] = str(given.folder / ("o" * int(random.integers(256, 5000))))
    else:
        words += ["--checkpoint", str(given.folder / "no" / "fit.npz")]
    return words


@kind
def wrong_arguments(given, random):
    """Wrong arguments."""
    word = pick(random, ["-1", "nan", "1e9", "", "--", "\x1b[31m"])
    return pick(
        random,
        [
            ["calibrate"],
            [word],
            ["calibrate", str(given.project), "-o"],
            ["sweep", str(given.project), "--workers", word],
            ["demo", word or "x", "-o", str(given.folder / "o")],
            ["simulate", str(given.project), f"--{word}"],
        ],
    )
