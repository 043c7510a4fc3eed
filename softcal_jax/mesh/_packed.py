"""Limits on what a mesh file unpacks to, decided before it is in memory.

A kilobyte of a compressed file can hold a megabyte of zeros, or name one in another.
"""

import lzma
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio

from softcal_jax._limits import MEGABYTES


@contextmanager
def bounded_unpacking(path: Path) -> Iterator[None]:
    """Bound what meshio unpacks inside, all parts of the file together.

    Raises:
        LimitError: If it unpacks to more than a file may have.
    """
    if path.suffix.lower() == ".med":
        _check_datasets(path)
    # The reader of .vtu files knows its two decompressors as modules of its own.
    reader: Any = meshio.vtu._vtu
    left = [int(1e6 * MEGABYTES.most)]

    def bounded(decompressor: Callable[[], Any]) -> SimpleNamespace:
        return SimpleNamespace(
            decompress=lambda data: _unpacked(path, decompressor(), data, left)
        )

    reader.zlib, reader.lzma = (
        bounded(zlib.decompressobj),
        bounded(lzma.LZMADecompressor),
    )
    try:
        yield
    finally:
        reader.zlib, reader.lzma = zlib, lzma


def _unpacked(path: Path, decompressor: Any, data: bytes, left: list[int]) -> bytes:
    """Unpack a block, and take it from the bytes that are `left` for the file."""
    out = decompressor.decompress(data, left[0] + 1)
    left[0] -= len(out)
    if left[0] < 0:
        MEGABYTES.check(f"mesh file {path}, unpacked", MEGABYTES.most + 1)
    if not decompressor.eof:
        raise ValueError("a compressed block ends too early")
    return out


def _check_datasets(path: Path) -> None:
    """Raise LimitError if the arrays of an HDF5 file are too large, packed or not."""
    import h5py

    sizes = []

    def add(_: str, part: Any) -> None:
        if isinstance(part, h5py.Dataset):
            sizes.append(part.nbytes)

    with h5py.File(path) as file:
        file.visititems(add)
    MEGABYTES.check(f"mesh file {path}, unpacked", sum(sizes) / 1e6)
