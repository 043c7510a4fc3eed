"""Balance of forces of a posed model: residual, gaps and their norm."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import energy_and_force, internal_force
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed

_TAUT = 1e-6
"""Slack below which a cable still counts as taut, relative to the mesh size [-]."""


class Deformed(NamedTuple):
    """A displacement with the quantities that the balance of forces needs.

    Attributes:
        u: The displacement [m].
        force: Internal force [N].
        delta_a: Displacements of the actuators.
    """

    u: Float[Array, "n_points 3"]
    force: Float[Array, "n_points 3"]
    delta_a: Float[Array, " n_a"]


class Point(NamedTuple):
    """A deformed state with its energy, as a line search needs it.

    Attributes:
        deformed: Displacement, internal force and displacements of the actuators.
        energy: Strain energy [J].
        energy_scale: Sum of its absolute parts, the scale of its rounding [J].
        min_det_F: Smallest det F [-].
    """

    deformed: Deformed
    energy: Float[Array, ""]
    energy_scale: Float[Array, ""]
    min_det_F: Float[Array, ""]

    @property
    def u(self) -> Float[Array, "n_points 3"]:
        """The displacement [m]."""
        return self.deformed.u

    @property
    def finite(self) -> Bool[Array, ""]:
        """Whether energy and force are finite."""
        return jnp.isfinite(self.energy) & jnp.all(jnp.isfinite(self.deformed.force))


def deform(model: Model, u: Float[Array, "n_points 3"]) -> Deformed:
    """Compute internal force and actuator displacements, without the energy."""
    return Deformed(u, internal_force(model, u), actuation.displacements(model, u))


def evaluate(model: Model, u: Float[Array, "n_points 3"]) -> Point:
    """Compute energy, internal force and actuator displacements."""
    energy, scale, force, det = energy_and_force(model, u)
    deformed = Deformed(u, force, actuation.displacements(model, u))
    return Point(deformed, energy, scale, det)


def at_rest(model: Model) -> Point:
    """Return the undeformed state, where every law is free of energy and stress."""
    none = jnp.zeros((model.n_points, 3))
    delta_a = jnp.zeros(model.mechanism.n_actuators) - model.mechanism.motor_zero
    zero, one = jnp.zeros(()), jnp.ones(())
    return Point(Deformed(none, none, delta_a), zero, zero, one)


def by_multiplier(posed: Posed) -> Bool[Array, " n_a"]:
    """Flag the actuators with an imposed displacement, whose force is unknown."""
    return actuation.by_multiplier(posed.model, posed.configuration.actuation)


def actuator_loads(
    posed: Posed, lambda_a: Float[Array, " n_a"]
) -> Float[Array, " n_a"]:
    """Return the forces of all actuators: solved for, or imposed at this load.

    Args:
        posed: The configuration.
        lambda_a: Forces of the actuators whose displacement is imposed.
    """
    imposed = posed.configuration.actuation.forces
    return jnp.where(by_multiplier(posed), lambda_a, posed.load * imposed)


def unbalanced(posed: Posed, at: Deformed, lambda_a: Float[Array, " n_a"]):
    """Compute the out-of-balance forces g on all nodes [N], and the rows F_a.

    Args:
        posed: The configuration.
        at: The deformed state.
        lambda_a: Forces of the actuators whose displacement is imposed.
    """
    rows = actuation.force_rows(posed.model, at.u)
    forces = actuator_loads(posed, lambda_a)
    g = at.force - posed.load * posed.f_ext + posed.spring_force(at.u)
    if len(forces) > 0:
        g = g - jnp.sum(forces[:, None, None] * rows, axis=0)
    return g, rows


def add_boundary_stiffness(
    posed: Posed,
    values: Float[Array, " nnz"],
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"],
) -> Float[Array, " nnz"]:
    """Add the stiffness of actuators and elastic supports to the tangent.

    Args:
        posed: The configuration.
        values: Tangent of the mesh over all nodes.
        u: Displacement [m].
        lambda_a: Forces of the actuators whose displacement is imposed.
    """
    model, springs = posed.model, posed.configuration.springs
    loads = actuator_loads(posed, lambda_a)
    values = actuation.add_curvature(model, values, u, loads)
    if not springs.names:
        return values
    return values.at[model.pattern.diagonal].add(springs.coefficients().ravel())


def rows_on_free(
    posed: Posed, u: Float[Array, "n_points 3"], rows: Float[Array, "n n_points 3"]
) -> Float[Array, "n n_dof"]:
    """Reduce rows of forces on all nodes to forces on the free unknowns."""
    if rows.shape[0] == 0:
        return jnp.zeros((0, posed.model.n_dof), rows.dtype)
    return jax.vmap(lambda row: posed.on_free(u, row))(rows)


def bordered_system(
    posed: Posed,
    u: Float[Array, "n_points 3"],
    *,
    values: Float[Array, " nnz_reduced"],
    forces: Float[Array, "n_a n_points 3"],
    active: Bool[Array, " n_a"],
) -> tuple[actuation.System, Float[Array, "n_m n_points 3"]]:
    """Border the tangent with the actuators whose lambda_a may be an unknown.

    Args:
        posed: The configuration.
        u: Displacement [m].
        values: Tangent of the unknowns, supports masked.
        forces: F_a of all actuators on all nodes, by rows.
        active: Which actuators have an imposed displacement that acts.

    Returns:
        The system, and H_a of these actuators on all nodes.
    """
    which = actuation.with_multiplier(posed.model)
    own = actuation.own_displacement_rows(posed.model, u)
    system = actuation.System(
        values=values,
        F_a=rows_on_free(posed, u, forces[which]),
        active=active[which],
        H_own=None if own is None else rows_on_free(posed, u, own),
    )
    return system, forces[which] if own is None else own


def gap(posed: Posed, at: Deformed, lambda_a, stiffness):
    """Compute imposed minus current displacements, 0 where a cable is slack.

    Args:
        posed: The configuration.
        at: The deformed state.
        lambda_a: Forces of the actuators.
        stiffness: Force per unit of gap, to distinguish slack from taut.

    Returns:
        The gaps, and which actuators act.
    """
    wanted = posed.load * jnp.asarray(posed.configuration.actuation.value)
    gap = wanted - at.delta_a
    unilateral = jnp.asarray(posed.model.mechanism.actuators.unilateral)
    taut = lambda_a + stiffness * gap > 0.0
    active = by_multiplier(posed) & (taut | ~unilateral)
    return jnp.where(active, gap, 0.0), active


def taut(posed: Posed, at: Deformed) -> Bool[Array, " n_a"]:
    """Flag the imposed displacements that act at an equilibrium: no slack cables."""
    model = posed.model
    wanted = posed.load * jnp.asarray(posed.configuration.actuation.value)
    short = wanted - at.delta_a >= -_TAUT * model.mechanism.bodies.length
    unilateral = jnp.asarray(model.mechanism.actuators.unilateral)
    return by_multiplier(posed) & (short | ~unilateral)


def estimated_forces(posed: Posed, at: Deformed) -> Float[Array, " n_a"]:
    """Estimate the forces behind imposed displacements from the balance of forces.

    Exact at equilibrium; 0 for slack cables.
    """
    g, rows = unbalanced(posed, at, jnp.zeros_like(at.delta_a))
    return actuation.estimated_forces(
        rows_on_free(posed, at.u, rows), taut(posed, at), posed.on_free(at.u, g)
    )


def merit(posed: Posed, at: Deformed, lambda_a, gap_stiffness) -> Float[Array, ""]:
    """Compute the norm of out-of-balance forces and of gaps, as forces [N]."""
    g, _ = unbalanced(posed, at, lambda_a)
    g = posed.on_free(at.u, g)
    to_go, _ = gap(posed, at, lambda_a, gap_stiffness)
    return jnp.sqrt(jnp.sum(g**2) + jnp.sum((gap_stiffness * to_go) ** 2))


def relative(posed: Posed, at: Deformed, merit, stiffness, rtol: float):
    """Divide a merit by the larger of external and internal force [-].

    Args:
        posed: The configuration.
        at: The deformed state.
        merit: Value of `merit` there [N].
        stiffness: Mean stiffness of an unknown [N/m].
        rtol: Relative residual at which Newton stops [-].
    """
    points = jnp.asarray(posed.model.mechanism.points)
    size = jnp.maximum(jnp.max(jnp.ptp(points, axis=0)), jnp.max(jnp.abs(at.u)))
    norm = jnp.linalg.norm
    scale = jnp.maximum(norm(posed.load * posed.f_ext), norm(at.force))
    # Without any load only rounding of the displacements remains, also in a robot that
    # is rotated as a whole.
    eps = jnp.finfo(points.dtype).eps
    rounding = eps / rtol * stiffness * size * posed.model.n_dof**0.5
    return merit / jnp.maximum(scale, rounding)
