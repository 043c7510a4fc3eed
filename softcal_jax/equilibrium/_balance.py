"""Balance of forces of a posed model: what is out of balance, and by how much."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import energy_and_force, internal_force
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed

_TAUT = 1e-6
"""Slack of a cable, in sizes of the mesh, that may still be rounding of a taut one."""


class Deformed(NamedTuple):
    """A displacement, and what the balance of forces needs to know there.

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
        """Whether energy and force are numbers."""
        return jnp.isfinite(self.energy) & jnp.all(jnp.isfinite(self.deformed.force))


def deform(model: Model, u: Float[Array, "n_points 3"]) -> Deformed:
    """Internal force and displacements of the actuators, without the energy."""
    return Deformed(u, internal_force(model, u), actuation.displacements(model, u))


def evaluate(model: Model, u: Float[Array, "n_points 3"]) -> Point:
    """Energy, force and displacements of the actuators at a displacement."""
    energy, scale, force, det = energy_and_force(model, u)
    deformed = Deformed(u, force, actuation.displacements(model, u))
    return Point(deformed, energy, scale, det)


def at_rest(model: Model) -> Point:
    """The undeformed state: every law is free of energy and stress there."""
    none = jnp.zeros((model.n_points, 3))
    delta_a = jnp.zeros(model.mechanism.n_actuators) - model.mechanism.motor_zero
    zero, one = jnp.zeros(()), jnp.ones(())
    return Point(Deformed(none, none, delta_a), zero, zero, one)


def by_multiplier(posed: Posed) -> Bool[Array, " n_a"]:
    """Which actuators have a displacement imposed, and their force solved for."""
    return actuation.by_multiplier(posed.model, posed.configuration.actuation)


def actuator_loads(
    posed: Posed, lambda_a: Float[Array, " n_a"]
) -> Float[Array, " n_a"]:
    """Forces of all actuators: solved for, or the imposed ones at this load.

    Args:
        posed: The configuration.
        lambda_a: Forces of the actuators whose displacement is imposed.
    """
    imposed = posed.configuration.actuation.forces
    return jnp.where(by_multiplier(posed), lambda_a, posed.load * imposed)


def unbalanced(posed: Posed, at: Deformed, lambda_a: Float[Array, " n_a"]):
    """Out-of-balance forces g on all nodes, and forces F_a of the actuators [N].

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
    """Add to the tangent of the body what actuators and elastic supports have in it.

    Args:
        posed: The configuration.
        values: Tangent of the body over all nodes.
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
    """Rows of forces on all nodes as forces on the free unknowns."""
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
    """The tangent with its border, the actuators whose lambda_a may be solved for.

    Args:
        posed: The configuration.
        u: Displacement [m].
        values: Tangent of the unknowns, supports masked.
        forces: F_a of all actuators on all nodes, by rows.
        active: Which actuators have a displacement imposed that acts.

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
    """How far imposed displacements have to go, 0 where a cable is slack.

    Args:
        posed: The configuration.
        at: The deformed state.
        lambda_a: Forces of the actuators.
        stiffness: Force that a unit of gap is worth, to tell slack from taut.

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
    """Which imposed displacements act at an equilibrium: all but slack cables'."""
    model = posed.model
    wanted = posed.load * jnp.asarray(posed.configuration.actuation.value)
    short = wanted - at.delta_a >= -_TAUT * model.mechanism.bodies.length
    unilateral = jnp.asarray(model.mechanism.actuators.unilateral)
    return by_multiplier(posed) & (short | ~unilateral)


def estimated_forces(posed: Posed, at: Deformed) -> Float[Array, " n_a"]:
    """Forces of actuators whose displacement is imposed, from the balance of all.

    Exact at equilibrium, where a slack cable has none.
    """
    g, rows = unbalanced(posed, at, jnp.zeros_like(at.delta_a))
    return actuation.estimated_forces(
        rows_on_free(posed, at.u, rows), taut(posed, at), posed.on_free(at.u, g)
    )


def merit(posed: Posed, at: Deformed, lambda_a, gap_stiffness) -> Float[Array, ""]:
    """Norm of the out-of-balance forces, gaps by the force they need [N]."""
    g, _ = unbalanced(posed, at, lambda_a)
    g = posed.on_free(at.u, g)
    to_go, _ = gap(posed, at, lambda_a, gap_stiffness)
    return jnp.sqrt(jnp.sum(g**2) + jnp.sum((gap_stiffness * to_go) ** 2))


def relative(posed: Posed, at: Deformed, merit, stiffness, rtol: float):
    """A merit relative to the larger of external and internal force [-].

    Args:
        posed: The configuration.
        at: The deformed state.
        merit: What `merit` gives there [N].
        stiffness: Mean stiffness of an unknown [N/m].
        rtol: Relative residual at which Newton stops [-].
    """
    points = jnp.asarray(posed.model.mechanism.points)
    size = jnp.maximum(jnp.max(jnp.ptp(points, axis=0)), jnp.max(jnp.abs(at.u)))
    norm = jnp.linalg.norm
    scale = jnp.maximum(norm(posed.load * posed.f_ext), norm(at.force))
    # Without any load, what remains is the rounding of each unknown's displacement,
    # also in a robot that is turned as a whole.
    eps = jnp.finfo(points.dtype).eps
    rounding = eps / rtol * stiffness * size * posed.model.n_dof**0.5
    return merit / jnp.maximum(scale, rounding)
