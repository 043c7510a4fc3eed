"""The job that all libraries do: the paper's beam in a law that each of them can state.

The beam of Sec. V (525 nodes, quadratic tets with four points, {E_t, E_l, theta} at two
control points, four poses by gravity, a marker at the tip) with the paper's tensor in
the Green strain: psi = 1/2 E : C : E. No peer has the paper's corotational law.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._cantilever import nearest
from benchmarks._paper import CELLS, STD, Cells, MeasuredBeam, parameter_errors
from benchmarks._timing import forget_starts
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import MultiStartResult, build_problem, multi_start
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    internal_force,
    solve_equilibrium,
)
from softcal_jax.materials import StVenantKirchhoff
from softcal_jax.robots import anisotropic_beam, synthetic_measurements
from softcal_jax.sensitivity import equilibrium_response
from softcal_jax.unknowns import Problem

NEWTON = NewtonSettings()
"""Our settings; their relative tolerance, 1e-8, is that of all."""


class Pose(NamedTuple):
    """One configuration, for the peers.

    Attributes:
        held: Whether each node is held.
        gravity: Acceleration [m/s2].
        marker: Node whose displacement is measured.
        measured: That displacement [m].
    """

    held: HostArray
    gravity: HostArray
    marker: int
    measured: HostArray


class Job(NamedTuple):
    """The beam as plain arrays for the peers, and our own problem.

    Attributes:
        points: Node positions [m].
        tets: Ten nodes of each tet, in the order of meshio.
        nu: Poisson's ratio [-].
        density: Mass density [kg/m3].
        poses: The configurations.
        tolerance: Norm of the forces out of balance at which a solve may stop: the
            relative tolerance times the norm of the nodal forces, reactions and all, in
            the pose where it is least [N].
        measured: Our problem.
    """

    points: HostArray
    tets: HostArray
    nu: float
    density: float
    poses: tuple[Pose, ...]
    tolerance: float
    measured: MeasuredBeam

    @property
    def problem(self) -> Problem:
        """Our problem."""
        return self.measured.problem

    @property
    def start(self) -> HostArray:
        """Scaled parameters at which the runs of Fig. 3 begin [-]."""
        return np.asarray(self.measured.space.start())

    @property
    def target(self) -> HostArray:
        """p_target, scaled [-]."""
        return np.asarray(self.measured.target)

    def errors(self, z: HostArray) -> HostArray:
        """Errors of scaled parameters, see `parameter_errors`."""
        space, target = self.measured.space, self.measured.target
        return parameter_errors(space, jnp.asarray(z), target)

    def fields(self, z: HostArray) -> HostArray:
        """E_t [Pa], E_l [Pa] and theta [rad] of each tet, one row per tet."""
        return np.asarray(_fields(self.problem, jnp.asarray(z)))

    def field_rows(self, z: HostArray) -> HostArray:
        """Derivative of the fields: tet, {E_t, E_l, theta}, scaled parameter."""
        return np.asarray(_field_rows(self.problem, jnp.asarray(z)))


def peer_job(cells: Cells = CELLS) -> Job:
    """The beam, measured at p_target without noise.

    Args:
        cells: Cells along, up and across.

    Raises:
        RuntimeError: If a pose has no equilibrium.
    """
    beam = anisotropic_beam(cells=cells, plane="xy", std=STD)
    law: Any = beam.model.law
    model = beam.model.with_law(StVenantKirchhoff(law.elasticity))
    posed = synthetic_measurements(
        model, beam.space, beam.configurations, beam.target, newton=NEWTON
    )
    problem = build_problem(model, beam.space, posed, NEWTON)
    beam = eqx.tree_at(lambda b: b.model, beam, model)
    measured = MeasuredBeam(beam, problem)
    poses, forces = [], []
    for i, configuration in enumerate(posed):
        markers = configuration.markers
        assert markers is not None
        marker = nearest(model.mesh.points, tuple(markers.positions[0]))
        lane = lane_of(problem, i)
        poses.append(
            Pose(
                np.asarray(lane.fixed)[:, 0],  # a support holds all axes
                np.asarray(lane.gravity),
                marker,
                np.asarray(lane.effectors.measured[0]) - model.mesh.points[marker],
            )
        )
        forces.append(_force(problem, lane, measured.target))
    return Job(
        np.asarray(model.mesh.points),
        np.asarray(model.mesh.tets),
        float(law.elasticity.nu),
        float(model.density),
        tuple(poses),
        NEWTON.rtol * min(forces),
        measured,
    )


def lane_of(problem: Problem, pose: int) -> ConfigurationArrays:
    """One configuration, without the leading axis."""
    pick = lambda leaf: np.asarray(leaf)[pose]
    return jax.device_put(jax.tree.map(pick, problem.configurations))


def our_static(job: Job, pose: int, z: HostArray) -> EquilibriumSolution:
    """Our equilibrium of one pose from rest, ready."""
    lane = lane_of(job.problem, pose)
    return jax.block_until_ready(_static(job.problem, lane, jnp.asarray(z)))


class Gradient(NamedTuple):
    """Half the squared error of one pose in units of the noise, and its derivative."""

    value: float
    by_parameter: HostArray


def our_gradient(job: Job, pose: int, z: HostArray) -> Gradient:
    """The error of the marker and its gradient in the scaled parameters, from rest."""
    lane = lane_of(job.problem, pose)
    value, by_parameter = _gradient(job.problem, lane, jnp.asarray(z))
    return Gradient(float(value), np.asarray(by_parameter))


def our_calibration(job: Job) -> MultiStartResult:
    """Our calibration from the start of Fig. 3 to its own end."""
    forget_starts()
    return multi_start(job.problem, jnp.asarray(job.start)[None])


def _material(model: Model) -> Float[Array, "n_tets 3"]:
    elasticity: Any = getattr(model.law, "elasticity")  # noqa: B009
    fields = (elasticity.E_t, elasticity.E_l, elasticity.fibre.theta)
    shape = (model.n_tets,)
    return jnp.stack([jnp.broadcast_to(field, shape) for field in fields], axis=1)


def _fields_of(problem: Problem, z):
    return _material(problem.space.model_at(problem.model, z))


_fields = eqx.filter_jit(_fields_of)
_field_rows = eqx.filter_jit(
    lambda problem, z: jax.jacfwd(lambda z: _fields_of(problem, z))(z)
)


_internal_force = eqx.filter_jit(internal_force)


@eqx.filter_jit
def _static(problem: Problem, lane: ConfigurationArrays, z):
    model = problem.space.model_at(problem.model, z)
    return solve_equilibrium(model, lane, settings=problem.newton)


@eqx.filter_jit
def _gradient(problem: Problem, lane: ConfigurationArrays, z):
    model = problem.space.model_at(problem.model, z)
    solved = solve_equilibrium(model, lane, settings=problem.newton)
    shared = model, problem.space, problem.newton, z
    response = equilibrium_response(*shared, lane, solved.displacement)
    weight = jnp.asarray(lane.effectors.inverse_std)
    error = weight * (response.effectors - lane.effectors.measured)
    by_parameter = jnp.ravel(weight * error) @ response.W_ep
    return 0.5 * jnp.sum(error**2), by_parameter


def _force(problem: Problem, lane: ConfigurationArrays, z) -> float:
    """Norm of the internal forces in equilibrium, those on the ground included [N]."""
    u = _static(problem, lane, z).displacement
    model = problem.space.model_at(problem.model, z)
    return float(jnp.linalg.norm(_internal_force(model, u)))
