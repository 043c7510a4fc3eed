"""The calibration as it is done with a library that has none: SciPy's least squares."""

import time
from typing import NamedTuple

import numpy as np

from benchmarks._paper import STD, fit_by_scipy, recovered
from benchmarks._peer import (
    AbstractAdjointPeer,
    AbstractPeer,
    NoEquilibrium,
    Response,
    marker_differences,
    marker_rows,
)
from softcal_jax._typing import HostArray


class Arrival(NamedTuple):
    """A run: its time [s], its evaluations of all poses, whether it found p_target."""

    seconds: float
    evaluations: int
    reached: bool


class _OutOfTime(Exception):
    """The run has used up its time."""


class Residuals:
    """Errors of all poses in units of the noise, and their Jacobian.

    Each equilibrium starts from the last one of its pose, where the library can.
    """

    def __init__(
        self, peer: AbstractPeer, *, by_adjoint: bool, limit_s: float = np.inf
    ):
        """Errors of a calibration.

        Args:
            peer: The library.
            by_adjoint: Whether the Jacobian comes of adjoint solves, three per pose;
                else of forward differences, six per pose.
            limit_s: Time from now on after which `_OutOfTime` is raised [s].
        """
        self.peer, self.by_adjoint = peer, by_adjoint
        self.deadline = time.perf_counter() + limit_s
        self.count = 0
        self.responses: list[Response | None] = [None] * len(peer.job.poses)

    def __call__(self, z: HostArray) -> HostArray:
        """Errors of the markers; huge without equilibrium [-]."""
        if time.perf_counter() > self.deadline:
            raise _OutOfTime
        self.count += 1
        poses, fields = self.peer.job.poses, self.peer.job.fields(z)
        errors = []
        for i, pose in enumerate(poses):
            try:
                response = self._response(i, fields)
            except NoEquilibrium:
                # least_squares takes no NaN; such a point is only very bad.
                errors.append(np.full(3, 1e6))
                continue
            self.responses[i] = response
            moved = response.displacement[pose.marker]
            errors.append((moved - pose.measured) / STD)
        return np.concatenate(errors)

    def _response(self, pose: int, fields: HostArray) -> Response:
        last = self.responses[pose]
        if last is not None and self.peer.takes_guess:
            try:
                return self._from(pose, fields, last.displacement)
            except NoEquilibrium:
                pass  # the guess was too far off; rest may do
        return self._from(pose, fields, None)

    def _from(self, pose: int, fields: HostArray, guess: HostArray | None) -> Response:
        if self.by_adjoint:
            assert isinstance(self.peer, AbstractAdjointPeer)
            return self.peer.response(pose, fields, guess)
        return Response(self.peer.solve(pose, fields, guess), _no_adjoint)

    def jacobian(self, z: HostArray) -> HostArray:
        """Its derivative where it was called last, as `least_squares` does."""
        job = self.peer.job
        by_parameter = job.field_rows(z) if self.by_adjoint else None
        rows = []
        for i, response in enumerate(self.responses):
            assert response is not None
            if by_parameter is not None:
                rows.append(marker_rows(response, by_parameter))
            else:
                rows.append(marker_differences(self.peer, i, z, response.displacement))
        return np.concatenate(rows) / STD


def _no_adjoint(covector: HostArray) -> HostArray:
    raise TypeError(f"there is no adjoint to take {covector} with.")


def quicker_jacobian(peer: AbstractPeer) -> bool:
    """Whether adjoint solves are quicker than differences, each tried once.

    Also compiles whatever is compiled.

    Args:
        peer: The library.
    """
    kinds = (True, False) if isinstance(peer, AbstractAdjointPeer) else (False,)
    seconds = {}
    z = peer.job.start
    for by_adjoint in kinds:
        residuals = Residuals(peer, by_adjoint=by_adjoint)
        residuals(z)
        residuals.jacobian(z)
        begin = time.perf_counter()
        residuals(z)
        residuals.jacobian(z)
        seconds[by_adjoint] = time.perf_counter() - begin
    return min(seconds, key=lambda kind: seconds[kind])


def calibrate_by(peer: AbstractPeer, *, by_adjoint: bool, limit_s: float) -> Arrival:
    """`scipy.optimize.least_squares` from the start of Fig. 3, stopped at p_target.

    Args:
        peer: The library.
        by_adjoint: As of `Residuals`.
        limit_s: Wall time after which it is given up [s].
    """
    job, space = peer.job, peer.job.measured.space
    begin = time.perf_counter()
    residuals = Residuals(peer, by_adjoint=by_adjoint, limit_s=limit_s)
    reached = lambda z: recovered(job.errors(z))
    try:
        end = fit_by_scipy(residuals, residuals.jacobian, job.start, space, reached)
    except (_OutOfTime, NoEquilibrium):
        return Arrival(limit_s, residuals.count, reached=False)
    seconds = time.perf_counter() - begin
    return Arrival(seconds, residuals.count, reached(end))
