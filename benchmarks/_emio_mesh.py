"""Make emio.msh, the mesh of the four legs of Emio.

    python -m benchmarks._emio_mesh [--cells N] [-o emio.msh]

A leg is a strip of 10 x 5 mm: an arc about the axis of its motor, and a straight part.
The legs hang straight down from their motors, as printed; what bends them is the
mounting of their far ends in the centre part. Two small blocks stand for that part and
for the sensor on it. Bricks are cut into six tets each, in a mirrored pattern.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
from numpy.typing import ArrayLike

LEGS = ("leg 1", "leg 2", "leg 3", "leg 4")

SOFT = ("hubs", "strips", "sockets")
"""Parts of all legs that deform: in the hubs, between, and in the centre part."""

AZIMUTHS = np.deg2rad([0.0, 90.0, 180.0, 270.0])
"""Of the motors about the vertical axis y, from z to x [rad]."""

HOME = np.array([0.0, -130.0, 0.0])
"""Where the block of the centre part is: the middle of the poses [mm]."""

WIDTH, THICKNESS, END = 10.0, 5.0, 205.0

SENSOR = np.array([0.0, -160.0, 0.0])
"""Where the block of the sensor is in the mesh [mm]."""

BLOCK = 5.0
"""Half the edge of the blocks [mm]."""


class Leg(NamedTuple):
    """Dimensions of a leg, y along it from the axis of its motor [mm].

    Attributes:
        radius: Distance of its centre line from the axis of the motor.
        root: Up to where the hub of the motor holds it firmly; negative on its arc.
        held: Where the hub lets go of it.
        clamped: Where the centre part takes it.
        firm: From where the centre part holds it firmly.
        inside: Distance of `clamped` from the middle of the centre part.
        above: Height of the leg above the origin of the centre part.
        circle: Distance of the motors from the middle of the robot.
    """

    radius: float
    root: float
    held: float
    clamped: float
    firm: float
    inside: float
    above: float
    circle: float


BUILT = Leg(22.5, -12.0, 0.0, 191.5, 203.0, 18.5, 1.6, 97.5)
"""As the files of the parts have it: sockets of the centre part from 5 mm to 18.5 mm.

Slots and sockets hold the legs with some give: material of its own in both."""

SCENE = Leg(22.0, 0.0, 0.0, 202.44, 202.44, 10.0, 3.0, 100.0)
"""As the authors' scene has its beams: free up to the last point of the centre line."""


def main() -> None:
    """Write the mesh: linear tets [mm], and a group for all that the project names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--cells", type=int, default=24, help="along a leg")
    parser.add_argument("-o", "--output", type=Path, default=Path("emio.msh"))
    options = parser.parse_args()
    mesh = emio(BUILT, options.cells)
    mesh.write(options.output, file_format="gmsh22", binary=False)


def emio(leg: Leg, cells: int, across: tuple[int, int] = (2, 1)) -> meshio.Mesh:
    """Four legs around the centre part, and the block of the sensor [mm]."""
    s = levels(leg, cells)
    strip, tets = bricks((across[0], len(s) - 1, across[1]))
    y = s[np.rint(strip[:, 1] * (len(s) - 1)).astype(int)]
    curved = bend(leg, np.column_stack([strip[:, 0] - 0.5, y, strip[:, 2] - 0.5]))
    middle = y[tets].mean(axis=1)
    edges = [leg.root, leg.held, leg.clamped, leg.firm]
    part = np.searchsorted(edges, middle)
    cube, of_cube = bricks((1, 1, 1))
    points = [block + BLOCK * (2.0 * cube - 1.0) for block in (HOME, SENSOR)]
    cells_of = [of_cube, of_cube + len(cube)]
    tags = [np.repeat([1, 2], len(of_cube))]
    ends = [f"{name}/{end}" for name in LEGS for end in ("motor", "tip")]
    names = ["centre", "sensor", *SOFT, *ends]
    for k, azimuth in enumerate(AZIMUTHS):
        cells_of.append(tets + 2 * len(cube) + k * len(strip))
        points.append(place(leg, azimuth, curved))
        tags.append(np.array([6 + 2 * k, 3, 4, 5, 7 + 2 * k])[part])
    all_points, all_tets = np.concatenate(points), np.concatenate(cells_of)
    physical: list[ArrayLike] = [np.concatenate(tags)]
    return meshio.Mesh(
        all_points,
        [("tetra", oriented(all_points, all_tets))],
        cell_data={"gmsh:physical": physical, "gmsh:geometrical": physical},
        field_data={name: np.array([k + 1, 3]) for k, name in enumerate(names)},
    )


def levels(leg: Leg, cells: int) -> np.ndarray:
    """Return lengths along a leg [mm]; those of its arc are negative."""
    start = -0.5 * np.pi * leg.radius
    ends = np.array([start, leg.root, leg.held, leg.clamped, leg.firm, END])
    pieces = [3, 2, cells, 2, 1]
    between = zip(ends[:-1], ends[1:], pieces, strict=True)
    lengths = [np.linspace(a, b, n + 1) for a, b, n in between if b > a]
    return np.unique(np.round(np.concatenate(lengths), 9))


def bend(leg: Leg, strip: np.ndarray) -> np.ndarray:
    """Give a strip its section and its arc, in the frame of the leg [mm]."""
    x, y, z = strip.T
    r = leg.radius + THICKNESS * z
    turn = np.minimum(y, 0.0) / leg.radius
    along = np.where(y < 0.0, r * np.sin(turn), y)
    return np.column_stack([WIDTH * x, along, r * np.cos(turn)])


def place(leg: Leg, azimuth: float, points: np.ndarray) -> np.ndarray:
    """Bring a leg from its frame to its motor, from which it hangs [mm]."""
    outwards, up, across = axes(azimuth)
    x, y, z = points.T[..., None]
    return x * across + (leg.circle + z) * outwards - y * up


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
