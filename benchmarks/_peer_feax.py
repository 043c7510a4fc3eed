"""The job in feax: its own element, assembly, Newton, direct solver and adjoint.

https://github.com/Naruki-Ichihara/feax. Stress and load are its tensor and mass maps;
solve and adjoint are compiled, with the structure as an argument, as it recommends.
"""

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._peer import AbstractAdjointPeer, AbstractPeer, NoEquilibrium, Response
from benchmarks._peer_job import Job
from softcal_jax._typing import HostArray

FULL_STEPS = -1e100
"""Constant of its line search with which every finite step passes, as in FElupe and
torch-fem. With descent of the residual, its default, Newton creeps from rest."""


def variants(job: Job) -> list[Callable[[], AbstractPeer]]:
    """Its direct solvers on the CPU: SciPy's, and CHOLMOD where scikit-sparse is."""
    import_module("feax")
    solvers = ["spsolve", *(["cholmod"] if find_spec("sksparse") else [])]
    return [partial(FeaxPeer, job, solver) for solver in solvers]


class Programs(NamedTuple):
    """Compiled programs for one set of held nodes."""

    solve: Callable[..., jax.Array]
    pull: Callable[..., jax.Array]


class FeaxPeer(AbstractAdjointPeer):
    """feax on quadratic tets with four points; equilibria can start from a guess."""

    def __init__(self, job: Job, solver: str):
        """Problem, structure, and programs for each set of held nodes.

        Args:
            job: The job.
            solver: Direct solver.
        """
        super().__init__(job, solver)
        self.feax: Any = import_module("feax")
        self.problem = self._problem()
        self.structure = self.feax.TracedStructure.from_problem(self.problem)
        of_held = {pose.held.tobytes(): pose.held for pose in job.poses}
        of_held = {key: self._programs(held) for key, held in of_held.items()}
        self.programs = [of_held[pose.held.tobytes()] for pose in job.poses]

    def _problem(self) -> Any:
        feax, density = self.feax, self.job.density
        ratio = self.job.nu / (1.0 - 2.0 * self.job.nu)
        scale = 1.0 / (1.0 + self.job.nu)

        class Beam(feax.Problem):
            def get_tensor_map(self):
                def first_stress(H, E_t, E_l, theta, *gravity):
                    del gravity
                    u = jnp.stack([jnp.cos(theta), jnp.sin(theta), 0.0 * theta])
                    root_t, root_l = jnp.sqrt(E_t), jnp.sqrt(E_l)
                    B = root_t * jnp.eye(3) + (root_l - root_t) * jnp.outer(u, u)
                    F = jnp.eye(3) + H
                    strain = 0.5 * (F.T @ F - jnp.eye(3))
                    volume = ratio * jnp.sum(B * strain)
                    return scale * F @ (B @ strain @ B + volume * B)

                return first_stress

            def get_mass_map(self):
                def load(u, x, E_t, E_l, theta, *gravity):
                    del u, x, E_t, E_l, theta
                    return -density * jnp.stack(gravity)

                return load

        mesh = feax.Mesh(self.job.points, self.job.tets, ele_type="TET10")
        return Beam(mesh, vec=3, dim=3, ele_type="TET10")

    def _programs(self, held: HostArray) -> Programs:
        feax, job = self.feax, self.job
        mask = np.repeat(held, 3)
        rows = np.flatnonzero(mask)
        clamp = feax.DirichletBC(
            jnp.asarray(rows), jnp.asarray(mask), jnp.zeros(len(rows)), len(mask)
        )

        def values(fields, gravity):
            along = jnp.broadcast_to(gravity, fields.shape)
            return feax.TracedParams(volume_vars=(*fields.T, *along.T))

        start = jnp.asarray(job.fields(job.start))
        newton = feax.NewtonOptions(
            tol=job.tolerance,
            rel_tol=0.0,
            max_iter=50,
            line_search_max_backtracks=1,
            line_search_c1=FULL_STEPS,
        )
        with redirect_stdout(sys.stderr):  # it tells of its progress there
            solver = feax.create_solver(
                self.problem,
                clamp,
                feax.DirectSolverOptions(solver=self.label),
                newton_options=newton,
                traced_params=values(start, jnp.asarray(job.poses[0].gravity)),
                traced_structure=self.structure,
                return_solution=False,
            )

        def solve(fields, gravity, guess, structure):
            return solver(values(fields, gravity), guess, traced_structure=structure)

        def pull(fields, gravity, guess, structure, covector):
            at = lambda fields: solve(fields, gravity, guess, structure)
            return jax.vjp(at, fields)[1](covector)[0]

        return Programs(jax.jit(solve), jax.jit(pull))

    def _solve(
        self, pose: int, fields: jax.Array, guess: HostArray | None
    ) -> jax.Array:
        start = jnp.zeros(self.job.points.size) if guess is None else guess.ravel()
        gravity = jnp.asarray(self.job.poses[pose].gravity)
        solve = self.programs[pose].solve
        u = solve(fields, gravity, jnp.asarray(start), self.structure)
        # It says nothing of a Newton loop that has not converged.
        if not np.all(np.isfinite(u)):
            raise NoEquilibrium("feax returned displacements that are not finite.")
        return u

    def solve(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> HostArray:
        """Equilibrium of one pose, see `AbstractPeer.solve`."""
        u = self._solve(pose, jnp.asarray(fields), guess)
        return np.asarray(u).reshape(-1, 3)

    def response(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> Response:
        """Equilibrium of one pose, see `AbstractAdjointPeer.response`."""
        at, given = self.job.poses[pose], jnp.asarray(fields)
        gravity = jnp.asarray(at.gravity)
        u = self._solve(pose, given, guess)

        def pull(covector: HostArray) -> HostArray:
            whole = np.zeros(self.job.points.shape)
            whole[at.marker] = covector
            # Starting from its own solution, Newton ends before its first step.
            by_field = self.programs[pose].pull(
                given, gravity, u, self.structure, jnp.asarray(whole.ravel())
            )
            return np.asarray(by_field)

        return Response(np.asarray(u).reshape(-1, 3), pull)
