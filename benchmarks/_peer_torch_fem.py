"""The job in torch-fem: its own element, assembly, Newton, PARDISO and adjoint.

https://github.com/meyer-nils/torch-fem. The law is a `Hyperelastic3D`, whose stress and
tangent torch derives of the energy. `solve` starts from rest; there is no guess.
"""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from benchmarks._peer import AbstractAdjointPeer, AbstractPeer, NoEquilibrium, Response
from benchmarks._peer_job import Job
from softcal_jax._typing import HostArray


def variants(job: Job) -> list[Callable[[], AbstractPeer]]:
    """With as many threads as torch takes, and with one."""
    torch = import_module("torch")
    threads = sorted({1, torch.get_num_threads()})
    return [partial(TorchFemPeer, job, threads=number) for number in threads]


class TorchFemPeer(AbstractAdjointPeer):
    """torch-fem on quadratic tets with four points."""

    takes_guess = False

    def __init__(self, job: Job, *, threads: int):
        """A model per pose, since loads and supports belong to it.

        Args:
            job: The job.
            threads: Threads of torch.
        """
        super().__init__(job, f"direct, {threads} thread{'s' if threads > 1 else ''}")
        self.torch: Any = import_module("torch")
        self.threads = threads
        self.torch.set_default_dtype(self.torch.float64)
        self.models = [self._model(pose) for pose in range(len(job.poses))]

    def _model(self, pose: int) -> Any:
        torch, job, at = self.torch, self.job, self.job.poses[pose]
        law = self._law(self._roots(torch.tensor(job.fields(job.start))))
        points, tets = torch.tensor(job.points), torch.tensor(job.tets)
        model = import_module("torchfem").Solid(points, tets, law)
        model.constraints[torch.tensor(at.held)] = True
        load = torch.tensor(job.density * at.gravity)
        model.forces = model.integrate_body_load(load)
        return model

    def _roots(self, fields: Any) -> Any:
        """B of each tet in torch, as of `_peer_law.roots` [sqrt(Pa)]."""
        torch = self.torch
        root_t, root_l = fields[:, 0].sqrt(), fields[:, 1].sqrt()
        theta = fields[:, 2]
        u = torch.stack([theta.cos(), theta.sin(), torch.zeros_like(theta)], dim=1)
        outer = u[:, :, None] * u[:, None, :]
        step = (root_l - root_t)[:, None, None]
        return root_t[:, None, None] * torch.eye(3) + step * outer

    def _law(self, roots: Any) -> Any:
        torch, nu = self.torch, self.job.nu
        ratio = nu / (1.0 - 2.0 * nu)

        def energy(F, B):
            M = B.reshape(3, 3) @ (0.5 * (F.T @ F - torch.eye(3)))
            squares = (M * M.T).sum() + ratio * M.trace() ** 2
            return 0.5 * squares / (1.0 + nu)

        materials = import_module("torchfem.materials")
        return materials.Hyperelastic3D(energy, roots.reshape(-1, 9))

    def _solve(self, pose: int, fields: Any) -> Any:
        """Nodal displacements, on the tape if the fields are [m]."""
        model = self.models[pose]
        model.material = self._law(self._roots(fields))
        self.torch.set_num_threads(self.threads)
        try:
            return model.solve(
                rtol=0.0,
                atol=self.job.tolerance,
                method="direct",
                differentiable_parameters=model.material.params,
            )[0]
        except import_module("torchfem.sparse").ConvergenceError as error:
            raise NoEquilibrium(str(error)) from error

    def solve(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> HostArray:
        """Equilibrium of one pose from rest, see `AbstractPeer.solve`."""
        del guess
        return self._solve(pose, self.torch.tensor(fields)).numpy()

    def response(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> Response:
        """Equilibrium of one pose on the tape, see `AbstractAdjointPeer.response`."""
        del guess
        torch, marker = self.torch, self.job.poses[pose].marker
        leaf = torch.tensor(fields, requires_grad=True)
        u = self._solve(pose, leaf)

        def pull(covector: HostArray) -> HostArray:
            (by_field,) = torch.autograd.grad(
                u[marker], leaf, torch.tensor(covector), retain_graph=True
            )
            return by_field.numpy()

        return Response(u.detach().numpy(), pull)
