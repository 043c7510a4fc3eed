"""What a finite-element library of others must do for the comparison."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np

from benchmarks._peer_job import Gradient, Job
from softcal_jax._typing import HostArray

STEP = 1e-5
"""Step of forward differences in the scaled parameters [-]."""


class NoEquilibrium(RuntimeError):
    """The library has found none."""


class AbstractPeer(ABC):
    """The job, set up in another library: built once, solved as often as wanted.

    Attributes:
        takes_guess: Whether equilibria can start from a guess.
    """

    takes_guess: ClassVar[bool] = True

    def __init__(self, job: Job, label: str):
        """Keep the job.

        Args:
            job: The job.
            label: How the library solves it, for the table.
        """
        self.job, self.label = job, label

    @abstractmethod
    def solve(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> HostArray:
        """Equilibrium of one pose.

        Args:
            pose: Number of the pose, from 0.
            fields: E_t [Pa], E_l [Pa] and theta [rad] of each tet.
            guess: Displacements to start from, if the library can [m]; else from rest.

        Returns:
            Nodal displacements [m].

        Raises:
            NoEquilibrium: If it does not converge.
        """


class Response(NamedTuple):
    """An equilibrium, and how the marker follows the fields.

    Attributes:
        displacement: Nodal displacements [m].
        pull: Takes a covector of the marker's displacement and returns that of the
            fields, a row per tet; one adjoint solve.
    """

    displacement: HostArray
    pull: Callable[[HostArray], HostArray]


class AbstractAdjointPeer(AbstractPeer):
    """A library that differentiates its equilibria."""

    @abstractmethod
    def response(
        self, pose: int, fields: HostArray, guess: HostArray | None = None
    ) -> Response:
        """Equilibrium of one pose with its adjoint; arguments as of `solve`."""


def peer_gradient(peer: AbstractPeer, pose: int, z: HostArray, std: float) -> Gradient:
    """What `our_gradient` finds: one adjoint solve, or forward differences.

    Args:
        peer: The library.
        pose: Number of the pose, from 0.
        z: Scaled parameters [-].
        std: Standard deviation of the marker [m].
    """
    job, at = peer.job, peer.job.poses[pose]
    error = lambda u: (u[at.marker] - at.measured) / std
    if isinstance(peer, AbstractAdjointPeer):
        response = peer.response(pose, job.fields(z))
        e = error(response.displacement)
        by_field = response.pull(e / std)
        rows = np.einsum("tf,tfp->p", by_field, job.field_rows(z))
        return Gradient(0.5 * float(e @ e), rows)
    u = peer.solve(pose, job.fields(z))
    e = error(u)
    rows = marker_differences(peer, pose, z, u) / std
    return Gradient(0.5 * float(e @ e), e @ rows)


def marker_differences(
    peer: AbstractPeer, pose: int, z: HostArray, u: HostArray
) -> HostArray:
    """Forward differences of the marker in the parameters, axis by parameter [m].

    Args:
        peer: The library.
        pose: Number of the pose, from 0.
        z: Scaled parameters [-].
        u: Equilibrium there, from which the others start [m].
    """
    job, marker = peer.job, peer.job.poses[pose].marker
    moved = [
        peer.solve(pose, job.fields(z + STEP * unit), u)[marker]
        for unit in np.eye(len(z))
    ]
    return (np.stack(moved, axis=1) - u[marker][:, None]) / STEP


def marker_rows(response: Response, field_rows: HostArray) -> HostArray:
    """The same by adjoint solves, one per axis.

    Args:
        response: The equilibrium.
        field_rows: Derivative of the fields, see `Job.field_rows`.
    """
    pulled = np.stack([response.pull(unit) for unit in np.eye(3)])
    return np.einsum("atf,tfp->ap", pulled, field_rows)
