"""Make arm.msh, the mesh of the pneumatic arm, with gmsh.

    python -m benchmarks._arm_mesh [--size MM] [-o arm.msh]

The dimensions are those of the README.md beside arm.msh. Needs gmsh: pip install
'softcal-jax[cad]'.
"""

import argparse
from pathlib import Path

import gmsh  # pyright: ignore[reportMissingImports]
import numpy as np

RADIUS = 22.22
HEIGHT = 100.0
CORE = 7.15  # half the side of the square hole
CORE_WALL = 2.27
OUTER_WALL = 2.03
WEB = 4.4
FLOOR = 6.93
ROOF = 3.0
INNER_RADIUS = RADIUS - OUTER_WALL
TOLERANCE = 1e-3


def main() -> None:
    """Write the mesh: linear tets [mm], and a group for all that the project names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "--size", type=float, default=6.0, help="edges of the tets [mm]"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("arm.msh"))
    options = parser.parse_args()
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    core, wall = body()
    name_groups(core, wall)
    gmsh.option.setNumber("Mesh.MeshSizeMax", options.size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.3 * options.size)
    gmsh.option.setNumber("Mesh.Algorithm3D", 10)  # HXT
    gmsh.option.setNumber("General.NumThreads", 1)  # the same mesh each time
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("")
    gmsh.write(str(options.output))
    gmsh.finalize()


def body() -> tuple[list[int], list[int]]:
    """Build the volumes inside the outer wall, and those of the wall."""
    shape = gmsh.model.occ
    whole = shape.addCylinder(0, 0, 0, 0, 0, HEIGHT, RADIUS)
    inner = shape.addCylinder(0, 0, 0, 0, 0, HEIGHT, INNER_RADIUS)
    wall, _ = shape.cut([(3, whole)], [(3, inner)], removeTool=False)
    core, _ = shape.cut([(3, inner)], [(3, square(CORE, FLOOR, HEIGHT)), *chambers()])
    _, (of_core, of_wall) = shape.fragment(core, wall)
    shape.synchronize()
    return [tag for _, tag in of_core], [tag for _, tag in of_wall]


def square(half: float, bottom: float, top: float) -> int:
    """Build a square prism about the axis."""
    return gmsh.model.occ.addBox(-half, -half, bottom, 2 * half, 2 * half, top - bottom)


def chambers() -> list[tuple[int, int]]:
    """Build the four cavities between the core, the outer wall and the webs."""
    shape, top = gmsh.model.occ, HEIGHT - ROOF
    ring = shape.addCylinder(0, 0, FLOOR, 0, 0, top - FLOOR, INNER_RADIUS)
    parts = [(3, square(CORE + CORE_WALL, FLOOR, top))]
    for angle in (45.0, -45.0):
        web = shape.addBox(-RADIUS, -WEB / 2, FLOOR, 2 * RADIUS, WEB, top - FLOOR)
        shape.rotate([(3, web)], 0, 0, 0, 0, 0, 1, np.deg2rad(angle))
        parts.append((3, web))
    return shape.cut([(3, ring)], parts)[0]


def name_groups(core: list[int], wall: list[int]) -> None:
    """Name the volumes, both ends, and the wall of the chamber that is inflated."""
    gmsh.model.addPhysicalGroup(3, core, name="inside")
    gmsh.model.addPhysicalGroup(3, wall, name="wall")
    outside = [
        tag
        for _, tag in gmsh.model.getBoundary(
            [(3, tag) for tag in (*core, *wall)], combined=True, oriented=False
        )
    ]
    centres = {tag: gmsh.model.occ.getCenterOfMass(2, tag) for tag in outside}
    faces = lambda z: [tag for tag in outside if abs(centres[tag][2] - z) < 1e-6]
    gmsh.model.addPhysicalGroup(2, faces(HEIGHT), name="clamp")
    gmsh.model.addPhysicalGroup(2, faces(0.0), name="tip")
    inflated = [tag for tag in outside if in_chamber(tag)]
    gmsh.model.addPhysicalGroup(2, inflated, name="chamber")


def in_chamber(surface: int) -> bool:
    """Tell whether a face bounds the chamber at +x, by the box that it lies in."""
    x_min, _, z_min, _, _, z_max = gmsh.model.getBoundingBox(2, surface)
    beside_core = x_min > CORE + CORE_WALL - TOLERANCE
    return (
        beside_core and z_min > FLOOR - TOLERANCE and z_max < HEIGHT - ROOF + TOLERANCE
    )


if __name__ == "__main__":
    main()
