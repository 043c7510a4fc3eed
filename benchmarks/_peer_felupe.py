"""The job in FElupe: its own element, assembly, Newton and sparse solvers.

https://github.com/adtzlr/felupe. The law is a `Material` in whole arrays, as FElupe
documents for laws that it lacks. It has no adjoint.
"""

from collections.abc import Callable
from functools import partial

import felupe as fem
import numpy as np

from benchmarks import _peer_law as law
from benchmarks._felupe import Solver, linear_solvers
from benchmarks._peer import AbstractPeer, NoEquilibrium
from benchmarks._peer_job import NEWTON, Job
from softcal_jax._typing import HostArray


def variants(job: Job) -> list[Callable[[], AbstractPeer]]:
    """Each linear solver that FElupe documents, with and without threads."""
    return [
        partial(FelupePeer, job, name, solver, parallel=parallel)
        for name, solver in linear_solvers().items()
        for parallel in (False, True)
    ]


class FelupePeer(AbstractPeer):
    """FElupe on quadratic tets with four points; equilibria can start from a guess."""

    def __init__(self, job: Job, name: str, solver: Solver, *, parallel: bool):
        """Mesh, region, field and degrees of freedom.

        Args:
            job: The job.
            name: Name of the linear solver.
            solver: The linear solver.
            parallel: Assemble with threads.
        """
        super().__init__(job, f"{name}, {'threads' if parallel else 'no threads'}")
        self.solver, self.parallel = solver, parallel
        mesh = fem.Mesh(job.points, job.tets, "tetra10")
        region = fem.RegionQuadraticTetra(mesh)
        self.field = fem.FieldContainer([fem.Field(region, dim=3)])
        body = fem.SolidBody(self._material(job.fields(job.start)), self.field)
        weight = fem.SolidBodyForce(self.field, scale=job.density)
        self.body, self.weight = body, weight
        self.partitions = [self._partition(pose.held) for pose in job.poses]

    def _material(self, fields: HostArray) -> fem.Material:
        C = law.stiffness(fields, self.job.nu)
        return fem.Material(
            lambda x: [law.stress(x[0], C), x[-1]], lambda x: [law.tangent(x[0], C)]
        )

    def _partition(self, held: HostArray):
        """Held and free degrees of freedom."""
        clamp = {"clamp": fem.Boundary(self.field[0], mask=held)}
        return fem.dof.partition(self.field, clamp)

    def solve(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> HostArray:
        """Equilibrium of one pose, see `AbstractPeer.solve`."""
        self.body.umat = self._material(fields)
        self.weight.update(self.job.poses[pose].gravity)
        self.field[0].values[:] = 0.0 if guess is None else guess
        held, free = self.partitions[pose]
        try:
            solution = fem.newtonraphson(
                x0=self.field.copy(),
                items=[self.body, self.weight],
                dof0=held,
                dof1=free,
                solver=self.solver,
                tol=NEWTON.rtol,  # relative to the forces on the ground
                maxiter=50,
                verbose=0,
                kwargs={"parallel": self.parallel},
            )
        except fem.tools.NewtonConvergenceError as error:
            raise NoEquilibrium(str(error)) from error
        # A copy: FElupe links the array to the field, and the next solve resets it.
        return np.array(solution.x[0].values)
