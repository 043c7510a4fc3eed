"""FElupe, the peer: the same cantilever, mesh, law and load, with its own solvers.

https://github.com/adtzlr/felupe. Its `NeoHookeCompressible` has the energy
mu/2 tr(C) - mu ln J + lambda/2 (ln J)^2, which is our `NeoHookean` up to a constant.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import felupe as fem
import numpy as np
from scipy.sparse import triu
from scipy.sparse.linalg import spsolve

from benchmarks._cantilever import DENSITY, GRAVITY, Beam, nearest, tip

Solver = Callable[[Any, np.ndarray], Any]
"""Takes a sparse matrix and a right-hand side."""


class FelupeSolution(NamedTuple):
    """Nodal displacement [m] and number of Newton iterations."""

    displacement: np.ndarray
    iterations: int


def linear_solvers() -> dict[str, Solver]:
    """Sparse solvers that FElupe's documentation names: SciPy's, and PyPardiso's."""
    from pypardiso import spsolve as pardiso_spsolve

    return {"SuperLU": spsolve, "PARDISO": pardiso_spsolve}


def tuned_solvers() -> dict[str, Solver]:
    """PARDISO on the upper triangle of a symmetric matrix, which halves its work.

    Nothing that FElupe or PyPardiso offer as it is: what its user could write.
    """
    from pypardiso import PyPardisoSolver, spsolve as pardiso_spsolve

    def symmetric(matrix_type: int) -> Solver:
        solver = PyPardisoSolver(mtype=matrix_type)
        return lambda A, b: pardiso_spsolve(triu(A, format="csr"), b, solver=solver)

    return {"PARDISO symmetric": symmetric(-2), "PARDISO definite": symmetric(2)}


class FelupeBeam:
    """A beam on a mesh of linear tets, built once, solved as often as wanted."""

    def __init__(
        self, problem: Beam, points: np.ndarray, tets: np.ndarray, *, parallel: bool
    ):
        """Mesh, region, field, law and load.

        Args:
            problem: The beam.
            points: Node positions [m].
            tets: Nodes of each tet.
            parallel: Assemble with threads.
        """
        lam, mu = problem.lame()
        region = fem.RegionTetra(fem.Mesh(points, tets, "tetra"))
        self.field = fem.FieldContainer([fem.Field(region, dim=3)])
        law = fem.NeoHookeCompressible(mu=mu, lmbda=lam, parallel=parallel)
        weight = [0.0, 0.0, -GRAVITY * DENSITY]
        self.items = [
            fem.SolidBody(law, self.field),
            fem.SolidBodyForce(self.field, values=weight),
        ]
        clamp = {"clamp": fem.Boundary(self.field[0], fx=lambda x: x == 0.0)}
        self.held, self.free = fem.dof.partition(self.field, clamp)
        self.parallel = parallel

    def solve(self, solver: Solver, tol: float) -> FelupeSolution:
        """Equilibrium from rest."""
        self.field[0].values[:] = 0.0
        solution = fem.newtonraphson(
            x0=self.field.copy(),
            items=self.items,
            dof0=self.held,
            dof1=self.free,
            solver=solver,
            tol=tol,
            verbose=0,
            kwargs={"parallel": self.parallel},
        )
        # A copy: FElupe links the array to the field, and the next solve resets it.
        return FelupeSolution(solution.x[0].values.copy(), solution.iterations)


def mixed_hexahedra(problem: Beam, cells: tuple[int, int, int]) -> np.ndarray:
    """Tip displacement by 27-node hexahedra with a linear pressure in each [m].

    Three-field form (displacement, pressure, volume ratio), which does not lock. The
    cells shrink towards the clamp and its edges, where the stress is singular.

    Args:
        problem: The beam.
        cells: Even numbers of cells across, so that a node stands at the tip.
    """
    lam, mu = problem.lame()
    unit = fem.mesh.Cube(n=tuple(n + 1 for n in cells))
    across = unit.points[:, 1:]
    bunched = 0.2 * across + 0.8 * (1.0 - np.cos(np.pi * across)) / 2.0
    points = np.column_stack([unit.points[:, 0] ** 1.7, bunched]) * problem.size
    mesh = fem.Mesh(points, unit.cells, unit.cell_type)
    mesh = mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    field = fem.FieldsMixed(fem.RegionTriQuadraticHexahedron(mesh), n=3)
    law = fem.ThreeFieldVariation(fem.NeoHookeCompressible(mu=mu, lmbda=lam))
    clamp = {"clamp": fem.Boundary(field[0], fx=lambda x: x == 0.0)}
    held, free = fem.dof.partition(field, clamp)
    body, x = fem.SolidBody(law, field), field
    solver = linear_solvers()["PARDISO"]
    for load in (0.5, 1.0):  # at once, the nearly incompressible body turns inside out
        weight = [0.0, 0.0, -load * GRAVITY * DENSITY]
        x = fem.newtonraphson(
            x0=x,
            items=[body, fem.SolidBodyForce(field, values=weight)],
            dof0=held,
            dof1=free,
            solver=solver,
            tol=1e-8,
            verbose=0,
            maxiter=30,
        ).x
    return x[0].values[nearest(mesh.points, tip(problem.size))]
