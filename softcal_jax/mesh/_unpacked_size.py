"""Limit on the arrays of a mesh file, by the sizes that the file states.

A kilobyte of a compressed file can hold a megabyte of zeros, so the sizes are checked
before anything is unpacked.
"""

import re
from pathlib import Path

from softcal_jax._limits import MEGABYTES


def check_unpacked_size(path: Path) -> None:
    """Raise LimitError if the arrays of a mesh file are larger than a file may be."""
    stated_bytes = {".vtu": _vtu_bytes, ".med": _hdf5_bytes}.get(path.suffix.lower())
    if stated_bytes is not None:
        MEGABYTES.check(f"mesh file {path}, unpacked", stated_bytes(path) / 1e6)


def _vtu_bytes(path: Path) -> int:
    """Add up the arrays of a VTK file from the attributes of its tags."""
    tags = path.read_text(errors="replace").partition("<AppendedData")[0]
    total, n_rows = 0, 0
    rows_of: dict[str, int] = {}
    for tag, text in re.findall(r"<(\w+)([^>]*)", tags):
        attributes = re.findall(r'(\w+)\s*=\s*"[A-Za-z]*(\d{1,18})"', text)
        numbers = {name: int(digits) for name, digits in attributes}
        if tag == "Piece":
            n_points = numbers.get("NumberOfPoints", 0)
            n_cells = numbers.get("NumberOfCells", 0)
            rows_of = dict.fromkeys(("Points", "PointData"), n_points)
            rows_of |= dict.fromkeys(("Cells", "CellData"), n_cells)
        n_rows = rows_of.get(tag, n_rows)
        if tag == "DataArray":
            # The type, like "Float64", ends in the number of bits.
            n_bytes = numbers.get("type", 64) // 8
            total += n_rows * numbers.get("NumberOfComponents", 1) * n_bytes
    return total


def _hdf5_bytes(path: Path) -> int:
    """Add up the datasets of an HDF5 file."""
    import h5py

    sizes = []
    with h5py.File(path) as file:
        file.visititems(lambda _, part: sizes.append(getattr(part, "nbytes", 0)))
    return sum(sizes)
