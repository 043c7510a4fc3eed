"""Models that CAD programs would write, made by the OpenCASCADE kernel of gmsh."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FINGER = (60.0, 16.0, 12.0)
"""Length, width and height of the finger [mm]."""

CAVITY = (40.0, 8.0, 4.0)
INLET = 1.5
"""Extent of its cavity, and radius of the inlet [mm]."""

MIDDLE = (0.030, 0.008, 0.006)
"""A point in the cavity [m]."""


@contextmanager
def modelled(path: Path, size: float | None = None) -> Iterator[Any]:
    """Give a kernel with an empty model, which is written to a file in the end.

    With a size its surface is meshed, for files of triangles.

    Args:
        path: The file; its extension chooses the format.
        size: Length of the edges of triangles [mm].

    Raises:
        ImportError: If gmsh is not installed.
    """
    import gmsh  # pyright: ignore[reportMissingImports]

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh.model.occ
        gmsh.model.occ.synchronize()
        if size is not None:
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            for _, tag in gmsh.model.getEntities(3):
                gmsh.model.mesh.setOutwardOrientation(tag)
            gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def write_finger(
    path: Path, *, is_open: bool = True, size: float | None = None, above: float = 0.0
) -> Path:
    """Write a finger with a cavity along it.

    Args:
        path: The file.
        is_open: Whether the cavity has an inlet, through the end x = 0.
        size: Length of the edges of triangles, for files of these [mm].
        above: How far the cavity lies above the middle; the finger bends then [mm].
    """
    with modelled(path, size) as shape:
        body = shape.addBox(0, 0, 0, *FINGER)
        corner = [0.5 * (a - b) for a, b in zip(FINGER, CAVITY, strict=True)]
        corner[2] += above
        tools = [(3, shape.addBox(*corner, *CAVITY))]
        if is_open:
            end = corner[0] + 1.0
            y, z = 0.5 * FINGER[1], 0.5 * FINGER[2] + above
            tools.append((3, shape.addCylinder(0, y, z, end, 0, 0, INLET)))
        shape.cut([(3, body)], tools)
    return path
