"""The length unit of files that state none, guessed by the size of the model."""

import os
import warnings
from pathlib import Path

import numpy as np

from softcal_jax._files import check_file
from softcal_jax.mesh._meshio import MeshWarning, read_raw
from softcal_jax.mesh._stl import read_stl

_LARGEST = 2.0
"""Largest number that is taken for metres: no soft robot is 2 mm long, few are 2 m."""


def guess_length_unit(path: str | os.PathLike[str]) -> str:
    """Guess whether the coordinates of a mesh or STL file are in "mm" or "m".

    Programs write either of them, nearly always. A model of more than 2 units across
    would hardly be a robot in metres, and one of fewer hardly one in millimetres.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read.
    """
    path = Path(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # said when the mesh is read
        if path.suffix.lower() == ".stl":
            check_file(path, "CAD model")
            points = read_stl(path).points
        else:
            points = np.asarray(read_raw(path, []).points, float)
    points = points if points.ndim == 2 else np.zeros((0, 3))  # of a broken file
    finite = points[np.isfinite(points).all(axis=1)]
    across = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    return "mm" if across > _LARGEST else "m"
