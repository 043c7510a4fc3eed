"""Make emio.msh, the mesh of the four legs of Emio.

    python -m benchmarks._emio_mesh [--cells N] [-o emio.msh]

A leg is a strip of 10 x 5 mm: an arc about the axis of its motor, and a straight part.
The legs stand around the centre part as they are printed, straight outwards, with their
far ends in it; what bends them down to the motors is the mounting of the motors. Bricks
are cut into six tets each, in a mirrored pattern.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

LEGS = ("leg 1", "leg 2", "leg 3", "leg 4")

AZIMUTHS = np.deg2rad([0.0, 90.0, 180.0, 270.0])
"""Of the motors about the vertical axis y, from z to x [rad]."""

HOME = np.array([0.0, -130.0, 0.0])
"""Where the centre part is in the mesh: the middle of the poses [mm]."""

WIDTH, THICKNESS, END = 10.0, 5.0, 205.0

SENSOR = 5.0
"""Half the edge of the block that carries the sensor [mm]."""


class Leg(NamedTuple):
    """Dimensions of a leg, y along it from the axis of its motor [mm].

    Attributes:
        radius: Distance of its centre line from the axis of the motor.
        held: Where the motor lets go of it.
        clamped: Where the centre part takes it.
        inside: Distance of that place from the middle of the centre part.
        above: Height of the leg above the origin of the centre part.
        circle: Distance of the motors from the middle of the robot.
    """

    radius: float
    held: float
    clamped: float
    inside: float
    above: float
    circle: float


BUILT = Leg(22.5, 2.0, 191.5, 18.5, 1.6, 97.5)
"""As the files of the parts have it: sockets of the centre part from 5 mm to 18.5 mm."""

SCENE = Leg(22.0, 0.0, 202.44, 10.0, 3.0, 100.0)
"""As the authors' scene has its beams: free up to the last point of the centre line."""


def main() -> None:
    """Write the mesh: linear tets [mm], and a group for all that the project names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--cells", type=int, default=24, help="along a leg")
    parser.add_argument("-o", "--output", type=Path, default=Path("emio.msh"))
    options = parser.parse_args()
    mesh = emio(BUILT, options.cells)
    mesh.write(options.output, file_format="gmsh22", binary=False)


def emio(leg: Leg, cells: int, across: tuple[int, int] = (1, 1)) -> meshio.Mesh:
    """Four legs around the centre part, and the block of the sensor [mm]."""
    s = levels(leg, cells)
    strip, tets = bricks((across[0], len(s) - 1, across[1]))
    y = s[np.rint(strip[:, 1] * (len(s) - 1)).astype(int)]
    curved = bend(leg, np.column_stack([strip[:, 0] - 0.5, y, strip[:, 2] - 0.5]))
    middle = y[tets].mean(axis=1)
    part = np.select([middle < leg.held, middle > leg.clamped], [1, 2], 0)
    cube, of_cube = bricks((1, 1, 1))
    points = [HOME + SENSOR * (2.0 * cube - 1.0)]
    cells_of, tags = [of_cube], [np.ones(len(of_cube), dtype=int)]
    for k, azimuth in enumerate(AZIMUTHS):
        cells_of.append(tets + len(cube) + k * len(strip))
        points.append(place(leg, azimuth, curved))
        tags.append(2 + 3 * k + part)
    names = ["sensor", *(f"{n}{e}" for n in LEGS for e in ("", "/motor", "/centre"))]
    all_points, all_tets = np.concatenate(points), np.concatenate(cells_of)
    physical = [np.concatenate(tags)]
    return meshio.Mesh(
        all_points,
        [("tetra", oriented(all_points, all_tets))],
        cell_data={"gmsh:physical": physical, "gmsh:geometrical": physical},
        field_data={name: np.array([k + 1, 3]) for k, name in enumerate(names)},
    )


def levels(leg: Leg, cells: int) -> np.ndarray:
    """Return lengths along a leg [mm]; those of its arc are negative."""
    arc = -0.5 * np.pi * leg.radius * np.linspace(1.0, 0.0, 5)
    free = np.linspace(leg.held, leg.clamped, cells + 1)
    return np.unique(np.concatenate([arc, free, [END]]))


def bend(leg: Leg, strip: np.ndarray) -> np.ndarray:
    """Give a strip its section and its arc, in the frame of the leg [mm]."""
    x, y, z = strip.T
    r = leg.radius + THICKNESS * z
    turn = np.minimum(y, 0.0) / leg.radius
    along = np.where(y < 0.0, r * np.sin(turn), y)
    return np.column_stack([WIDTH * x, along, r * np.cos(turn)])


def place(leg: Leg, azimuth: float, points: np.ndarray) -> np.ndarray:
    """Bring a leg from its frame to the centre part, straight outwards [mm]."""
    outwards, up, across = axes(azimuth)
    x, y, z = points.T
    out = leg.inside + leg.clamped - y
    height = leg.above + leg.radius - z
    return HOME + x[:, None] * across + out[:, None] * outwards + height[:, None] * up


def axes(azimuth: float) -> np.ndarray:
    """Directions outwards and up, and the axis of the motor, by rows [-]."""
    out, up = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)]), np.array([0.0, 1, 0])
    return np.round([out, up, np.cross(out, up)], 12)


def bricks(counts: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Fill the unit cube with bricks of six tets, mirrored from brick to brick.

    Else the diagonals would all run one way, and the strip would twist as it bends.
    """
    grid = np.stack(np.meshgrid(*map(np.arange, np.add(counts, 1)), indexing="ij"), -1)
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    tets = []
    for cell in np.ndindex(counts):
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
            corners = np.zeros((4, 3), dtype=int)
            for k, axis in enumerate(order):
                corners[k + 1 :, axis] = 1
            mirrored = np.where(np.array(cell) % 2 == 1, 1 - corners, corners)
            tets.append(index[tuple((mirrored + cell).T)])
    return grid.reshape(-1, 3) / counts, np.array(tets)


def oriented(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Order the nodes of each tet so that its volume is positive."""
    ordered = tets.copy()
    edges = points[ordered[:, 1:]] - points[ordered[:, :1]]
    inverted = np.linalg.det(edges) < 0.0
    ordered[inverted, 2:] = ordered[inverted, :1:-1]
    return ordered


if __name__ == "__main__":
    main()
