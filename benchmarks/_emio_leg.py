"""One leg of Emio, clamped at both ends: how stiff are elements that bend?

The scene of Emio's authors has linear tets (`blueleg.vtk`), whose modulus it multiplies
by 0.2. Here the end in the centre part is shifted across the strip, as it is in the
robot, and the force is compared among elements of the same E. The nodes that are held
are those of the authors' boxes.
"""

from typing import NamedTuple

import meshio
import numpy as np

import softcal_jax as sc
from softcal_jax.configurations import SupportReaction
from softcal_jax.mesh import TetMesh, to_quadratic
from softcal_jax.robots import ready_made_path

E, NU = 35e6, 0.45

SHIFT = 1e-4
"""Small enough for the linear limit [m]."""

_CHILDREN = (
    *((0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3)),
    *((4, 9, 5, 6), (4, 9, 6, 7), (4, 9, 7, 8), (4, 9, 8, 5)),
)
"""Eight tets of the ten nodes of one, around the diagonal from node 4 to node 9."""


class Stiffness(NamedTuple):
    """Force per shift of the far end, across the strip and along its width [N/m]."""

    elements: str
    n_nodes: int
    across: float
    width: float


def stiffnesses() -> list[Stiffness]:
    """Linear tets, finer and finer, then quadratic ones, likewise."""
    coarse = authors_mesh()
    finer = refine(coarse)
    finest = refine(finer)
    return [
        stiffness("linear", coarse),
        stiffness("linear, 8 times as many", finer),
        stiffness("linear, 64 times as many", finest),
        stiffness("quadratic", to_quadratic(coarse)),
        stiffness("quadratic, 8 times as many", to_quadratic(finer)),
    ]


def authors_mesh() -> TetMesh:
    """Read the leg of the authors' scene."""
    file = meshio.read(ready_made_path("emio").parent / "blueleg.vtk")
    return TetMesh(1e-3 * file.points, file.cells_dict["tetra"])


def refine(mesh: TetMesh) -> TetMesh:
    """Split each linear tet into eight."""
    quadratic = to_quadratic(mesh)
    tets = quadratic.tets[:, np.array(_CHILDREN)].reshape(-1, 4)
    edges = quadratic.points[tets[:, 1:]] - quadratic.points[tets[:, :1]]
    inverted = np.linalg.det(edges) < 0.0
    tets[inverted, 2:] = tets[inverted, :1:-1]
    return TetMesh(quadratic.points, tets)


def beam_across(length: float) -> float:
    """Stiffness of the strip between two clamps by the theory of beams [N/m]."""
    width, thickness = 10e-3, 5e-3
    return 12.0 * E * width * thickness**3 / 12.0 / length**3


def held(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Nodes that the motor holds, and those that the centre part holds."""
    _, y, z = 1e3 * mesh.points.T
    motor = (z <= 1e-6) | (y <= 2.0)
    return np.flatnonzero(motor), np.flatnonzero(y >= 190.0)


def stiffness(elements: str, mesh: TetMesh) -> Stiffness:
    """Shift the far end a little, and compute the force that it takes."""
    law = sc.Corotational(sc.Isotropic(E, NU))
    model = sc.build_model(mesh, law, density=1220.0)
    motor, tip = held(mesh)
    forces = []
    for axis in (2, 0):
        shift = SHIFT * np.eye(3)[axis]
        supports = sc.Support(motor), sc.Support(tip, displacement=tuple(shift))
        pose = sc.Configuration(
            "shifted",
            supports,
            gravity=(0.0, 0.0, 0.0),
            effectors=[SupportReaction("force", tip)],
        )
        (reading,) = sc.simulated_measurements(model, [pose])
        (force,) = reading.effectors
        assert isinstance(force, SupportReaction)
        assert force.measured is not None
        forces.append(force.measured[axis] / SHIFT)
    return Stiffness(elements, mesh.n_nodes, *map(float, forces))
