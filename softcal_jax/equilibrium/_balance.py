"""Balance of forces of a posed model: residual, gaps and their norm."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.actuators import actuator_rows, curvature_entries, displacement_rows
from softcal_jax.equilibrium._assembly import energy_and_force, internal_force
from softcal_jax.equilibrium._bordered import System
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import element_entries, mask_supports

_TAUT = 1e-6
"""Slack below which a cable still counts as taut, relative to the mesh size [-]."""


class Point(NamedTuple):
    """A displacement u, with the internal force and the actuators' displacements at u.

    The energy, the sum of its absolute parts (the scale of its rounding) and the
    smallest det F are None where they are not needed.
    """

    u: Nodal
    force: Nodal
    delta_a: Float[Array, " n_a"]
    energy: Any = None
    energy_scale: Any = None
    min_det_F: Any = None

    @property
    def finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.energy) & jnp.all(jnp.isfinite(self.force))


def deform(model: Model, u: Nodal) -> Point:
    """Compute internal force and actuator displacements, without the energy."""
    return Point(u, internal_force(model, u), model.displacements(u))


def evaluate(model: Model, u: Nodal) -> Point:
    energy, scale, force, det = energy_and_force(model, u)
    return Point(u, force, model.displacements(u), energy, scale, det)


def at_rest(model: Model) -> Point:
    none = jnp.zeros((model.n_points, 3))
    delta_a = jnp.zeros(model.mechanism.n_actuators) - model.mechanism.motor_zero
    zero, one = jnp.zeros(()), jnp.ones(())
    return Point(none, none, delta_a, zero, zero, one)


def actuator_loads(
    posed: Posed, lambda_a: Float[Array, " n_a"]
) -> Float[Array, " n_a"]:
    imposed = posed.configuration.actuation.forces
    return jnp.where(posed.by_multiplier, lambda_a, posed.load * imposed)


def unbalanced(posed: Posed, point: Point, lambda_a: Float[Array, " n_a"]):
    """Compute the out-of-balance forces g on all nodes [N], and the rows F_a."""
    x = posed.model.positions(point.u)
    rows = actuator_rows(posed.model.mechanism.actuators, x)
    forces = actuator_loads(posed, lambda_a)
    g = point.force - posed.load * posed.f_ext + posed.spring_force(point.u)
    if len(forces) > 0:
        g = g - jnp.sum(forces[:, None, None] * rows, axis=0)
    return g, rows


def rows_on_free(
    posed: Posed, u: Nodal, rows: Float[Array, "n n_points 3"]
) -> Float[Array, "n n_dof"]:
    if rows.shape[0] == 0:
        return jnp.zeros((0, posed.model.n_dof), rows.dtype)
    return jax.vmap(lambda row: posed.on_free(u, row))(rows)


def nodal_tangent(
    posed: Posed, u: Nodal, lambda_a: Float[Array, " n_a"], mesh: Float[Array, " nnz"]
) -> Float[Array, " nnz"]:
    """Add actuators and springs to the tangent of the mesh over all nodes [N/m]."""
    model, nodal = posed.model, posed.spring_tangent(mesh)
    actuators = model.mechanism.actuators
    loads = actuator_loads(posed, lambda_a)
    # d(F_a^T lambda_a)/dx
    curvature = curvature_entries(actuators, model.positions(u), loads)
    for matrices, places in zip(curvature, model.curvature_at, strict=True):
        p, q = element_entries(matrices.shape[1] // 3, model.pattern.symmetric)
        nodal = nodal.at[places].add(-matrices[:, p, q].T)
    return nodal


class Tangent(NamedTuple):
    """The tangent at a deformed state.

    Attributes:
        nodal: Its entries over all nodes [N/m].
        stiffness: Mean stiffness of an unknown [N/m].
        system: Tangent of the unknowns, bordered by actuators `with_multiplier`.
        H_a: Derivatives of the displacements of these actuators by nodes, by rows.
        g: Out-of-balance forces on all nodes [N].
    """

    nodal: Float[Array, " nnz"]
    stiffness: Float[Array, ""]
    system: System
    H_a: Float[Array, "n_m n_points 3"]
    g: Nodal


def assemble(
    posed: Posed,
    point: Point,
    lambda_a: Float[Array, " n_a"],
    *,
    mesh: Float[Array, " nnz"],
    active: Bool[Array, " n_a"],
) -> Tangent:
    """Add actuators and springs to the tangent of the mesh, reduce it and border it.

    `active` flags the actuators with an imposed displacement that acts.
    """
    model, u = posed.model, point.u
    actuators, which = model.mechanism.actuators, model.with_multiplier
    g, rows = unbalanced(posed, point, lambda_a)
    nodal = nodal_tangent(posed, u, lambda_a, mesh)
    reduced = posed.reduce(u, nodal, g)
    values, stiffness = mask_supports(model.solver.sparsity, reduced, posed.fixed)
    H_a, H_other = rows[which], None
    if any(actuators.has_friction):
        H_a = displacement_rows(actuators, model.positions(u))[which]
        H_other = rows_on_free(posed, u, H_a)
    F_a = rows_on_free(posed, u, rows[which])
    system = System(values, F_a, active[which], H_other)
    return Tangent(nodal, stiffness, system, H_a, g)


def _wanting(posed: Posed, point: Point) -> tuple[Float[Array, " n_a"], Array]:
    wanted = posed.load * jnp.asarray(posed.configuration.actuation.value)
    unilateral = jnp.asarray(posed.model.mechanism.actuators.unilateral)
    return wanted - point.delta_a, unilateral


def gap(posed: Posed, point: Point, lambda_a, stiffness):
    """Return the gaps of imposed displacements, and which of them act.

    A slack cable has no gap; the stiffness [force per gap] tells slack from taut.
    """
    gap, unilateral = _wanting(posed, point)
    taut = lambda_a + stiffness * gap > 0.0
    active = posed.by_multiplier & (taut | ~unilateral)
    return jnp.where(active, gap, 0.0), active


def stiffness_of_gaps(
    posed: Posed, W_aa: Float[Array, "n_m n_m"]
) -> Float[Array, " n_a"]:
    """Return the force per displacement of actuators where it is imposed, 0 elsewhere.

    Slack cables count too, since a step that tightens one leaves a gap to close.
    """
    compliance = jnp.maximum(jnp.abs(jnp.diag(W_aa)), jnp.finfo(W_aa.dtype).tiny)
    stiff = posed.model.among_all(1.0 / compliance)
    return jnp.where(posed.by_multiplier, stiff, 0.0)


def taut(posed: Posed, point: Point) -> Bool[Array, " n_a"]:
    """Flag the imposed displacements that act at an equilibrium: no slack cables."""
    gap, unilateral = _wanting(posed, point)
    short = gap >= -_TAUT * posed.model.mechanism.bodies.length
    return posed.by_multiplier & (short | ~unilateral)


def estimated_forces(posed: Posed, point: Point) -> Float[Array, " n_a"]:
    """Estimate the forces behind imposed displacements by least squares.

    Exact at equilibrium; 0 for slack cables.
    """
    if posed.model.with_multiplier.size == 0:
        return jnp.zeros_like(point.delta_a)
    g, rows = unbalanced(posed, point, jnp.zeros_like(point.delta_a))
    active = taut(posed, point)
    F_a = jnp.where(active[:, None], rows_on_free(posed, point.u, rows), 0.0)
    normal = jnp.sum(F_a[:, None] * F_a[None], axis=-1)
    scale = jnp.maximum(jnp.diag(normal), jnp.finfo(F_a.dtype).tiny)
    unit = jnp.diag(jnp.where(active, 0.0, scale))
    work = jnp.sum(F_a * posed.on_free(point.u, g)[None], axis=1)
    return jnp.linalg.solve(normal + unit, work)


def merit(posed: Posed, point: Point, lambda_a, gap_stiffness) -> Float[Array, ""]:
    """Compute the norm of out-of-balance forces and of gaps, as forces [N]."""
    g, _ = unbalanced(posed, point, lambda_a)
    g = posed.on_free(point.u, g)
    to_go, _ = gap(posed, point, lambda_a, gap_stiffness)
    return jnp.sqrt(jnp.sum(g**2) + jnp.sum((gap_stiffness * to_go) ** 2))


class Residual(NamedTuple):
    """Out-of-balance forces, and how small rounding lets them become [-].

    Both are relative to the larger of external and internal force, or to the rounding
    of the internal forces if that is larger still.
    """

    size: Float[Array, ""]
    rounding: Float[Array, ""]

    def settled(self, rtol) -> Bool[Array, ""]:
        """Tell whether Newton stops: at `rtol`, or at rounding if that is larger."""
        return self.size <= jnp.maximum(rtol, self.rounding)

    def at_rounding(self, rtol) -> Bool[Array, ""]:
        return self.settled(rtol) & (self.size > rtol)


def relative(posed: Posed, point: Point, merit, stiffness) -> Residual:
    """Divide a merit by the larger of external and internal force.

    The rounding of the internal forces, which is the divisor without load, is the mean
    stiffness [N/m] times that of displacements; a much stiffer region raises it.
    """
    points = jnp.asarray(posed.model.mechanism.points)
    size = jnp.maximum(jnp.max(jnp.ptp(points, axis=0)), jnp.max(jnp.abs(point.u)))
    norm = jnp.linalg.norm
    scale = jnp.maximum(norm(posed.load * posed.f_ext), norm(point.force))
    eps = jnp.finfo(points.dtype).eps
    rounding = eps * stiffness * size * posed.model.n_dof**0.5
    scale = jnp.maximum(scale, rounding)
    return Residual(merit / scale, rounding / scale)
