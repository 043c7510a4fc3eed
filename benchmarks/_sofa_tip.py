"""The tip of a hanging beam of SOFA's tets: known, by the package, and in NumPy."""

from collections.abc import Callable
from itertools import permutations

import numpy as np

from benchmarks import _sofa_tets
from benchmarks._cantilever import nearest
from benchmarks._problem import Figure
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import NewtonSettings, build_model, solve_equilibrium
from softcal_jax.materials import AbstractLaw, Isotropic, SofaCorotational
from softcal_jax.mesh import TetMesh

E, NU, DENSITY, GRAVITY = 3e5, 0.4, 1070.0, (0.0, 0.0, -9.81)
SIZE, CELLS = (0.1, 0.02, 0.02), (20, 4, 4)
HANGING = Configuration("hanging", "x_min", GRAVITY)

SOFA_TIP = (-0.49869, 1.01582, -9.38902)
"""Displacement of the centre of the end face of the beam with 20 x 4 x 4 cells, each
cut into Kuhn's six tets, all alike, by the forces of `TetrahedronFEMForceField` with
the method "polar" [mm]: a reference computed elsewhere, by none of the codes here."""

ROTATIONS = ("edge", "procrustes", "large")


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Hang the beam with the first so many rotations: edge, Procrustes, large.

    Returns:
        `sofa_tip_error_mm`: distance of the tip with the rotation by edges from what is
        known. `sofa_tip_numpy_difference_mm`: largest distance, of all rotations, from
        the tip by SOFA's forces in NumPy.
    """
    mesh, apart, error = kuhn_beam(), 0.0, np.inf
    tip = nearest(mesh.points, (SIZE[0], SIZE[1] / 2, SIZE[2] / 2))
    for kind in ROTATIONS[:count]:
        say(f"sofa_tip: rotation {kind}")
        law = SofaCorotational.of_mesh(mesh, Isotropic(E, NU), kind)
        ours, theirs = 1e3 * by_package(mesh, law)[tip], 1e3 * by_numpy(mesh, kind)[tip]
        apart = max(apart, float(np.linalg.norm(ours - theirs)))
        if kind == "edge":
            error = float(np.linalg.norm(ours - SOFA_TIP))
    return {"sofa_tip_error_mm": error, "sofa_tip_numpy_difference_mm": apart}


def kuhn_beam(cells: tuple[int, int, int] = CELLS) -> TetMesh:
    """The beam with each cell cut along the same diagonal; the package mirrors cuts."""
    counts = np.array(cells)
    corner = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1)
    tets = []
    for order in permutations(np.eye(3, dtype=int)):
        path = np.cumsum([np.zeros(3, int), *order], axis=0)
        if np.linalg.det(path[1:]) < 0:
            path = path[[0, 1, 3, 2]]
        tets.append(corner[..., None, :] + path)
    nodes = np.stack(tets, axis=3).reshape(-1, 4, 3)
    index = np.ravel_multi_index(tuple(np.moveaxis(nodes, -1, 0)), tuple(counts + 1))
    lattice = np.indices(tuple(counts + 1)).reshape(3, -1).T
    points = lattice / counts * SIZE
    return TetMesh(points, index, {"x_min": np.flatnonzero(lattice[:, 0] == 0)})


def by_package(mesh: TetMesh, law: AbstractLaw) -> np.ndarray:
    """Displacements under the own weight, by the package [m].

    Raises:
        RuntimeError: If there is no equilibrium.
    """
    model = build_model(mesh, law, density=DENSITY)
    solution = solve_equilibrium(model, HANGING, settings=NewtonSettings(rtol=1e-12))
    if not solution.converged:
        raise RuntimeError("the hanging beam has no equilibrium.")
    return np.asarray(solution.displacement)


def by_numpy(mesh: TetMesh, kind: str, E: np.ndarray | float = E) -> np.ndarray:
    """The same by SOFA's forces in NumPy [m]; E may differ by tet [Pa]."""
    stress = _sofa_tets.hooke(E, NU)
    pieces = [_sofa_tets.tets(mesh.points, mesh.tets, stress, kind)]
    masses = DENSITY * _sofa_tets.lumped_volumes(mesh.points, mesh.tets)
    load, free = masses[:, None] * np.array(GRAVITY), np.ones(mesh.points.shape, bool)
    free[mesh.points[:, 0] == 0.0] = False
    return _sofa_tets.equilibrium(mesh.points, pieces, load, free) - mesh.points
