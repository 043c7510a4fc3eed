"""The Newton step of a posed model."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.bodies import KINDS
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import (
    mixed_tangent,
    predicted_dilatation,
    tangent_values,
)
from softcal_jax.equilibrium._balance import (
    Deformed,
    add_boundary_stiffness,
    bordered_system,
    by_multiplier,
    gap,
    unbalanced,
)
from softcal_jax.equilibrium._element import is_mixed
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import mask_supports, product

_LARGEST_TURN = 0.5
"""Rotation on a hinge beyond which a Newton step is meaningless [rad]."""


class Factor(NamedTuple):
    """A factorized tangent, and what its factorization reported.

    Attributes:
        system: The matrix.
        stiffness: Mean stiffness of an unknown [N/m].
        gap_stiffness: Force per displacement of each actuator whose displacement is
            imposed.
        n_negative: Number of negative eigenvalues, see `Bordered`.
        ok: Whether the factorization succeeded.
    """

    system: actuation.System
    stiffness: Float[Array, ""]
    gap_stiffness: Float[Array, " n_a"]
    n_negative: Int[Array, ""]
    ok: Bool[Array, ""]

    @classmethod
    def none(cls, model: Model) -> "Factor":
        """Return a placeholder, not ok, for the initial state of a loop."""
        n_m, real = actuation.with_multiplier(model).size, jnp.zeros(())
        rows = jnp.zeros((n_m, model.n_dof))
        system = actuation.System(
            values=jnp.zeros(model.solver.sparsity.nnz),
            F_a=rows,
            active=jnp.zeros(n_m, bool),
            H_own=rows if any(model.mechanism.actuators.has_friction) else None,
        )
        return cls(
            system=system,
            stiffness=real,
            gap_stiffness=jnp.zeros(model.mechanism.n_actuators),
            n_negative=jnp.zeros((), jnp.int32),
            ok=jnp.zeros((), bool),
        )


class Step(NamedTuple):
    """A step of the unknowns and of the actuators' forces.

    Attributes:
        d: Step of the unknowns, held ones included [m].
        lambda_a: Forces, before the step, of actuators whose displacement is imposed;
            0 for a cable found to be slack.
        d_lambda: Their step.
    """

    d: Float[Array, " n_dof"]
    lambda_a: Float[Array, " n_a"]
    d_lambda: Float[Array, " n_a"]


class Direction(NamedTuple):
    """A Newton step with its slope and longest sensible share.

    Attributes:
        step: The whole step.
        slope: Out-of-balance force times the step [J].
        moving: Whether held nodes or bodies still have to move into place.
        reach: Longest share of the step that is worth trying [-].
        factor: The factorized tangent.
    """

    step: Step
    slope: Float[Array, ""]
    moving: Bool[Array, ""]
    reach: Float[Array, ""]
    factor: Factor


def has_volume_unknowns(model: Model) -> bool:
    """Whether the volume ratios are unknowns of the Newton step."""
    return is_mixed(model.formulation, model.weights.shape[1])


def dilatation(model: Model, theta, u, du):
    """Update the volume ratios after a step; a no-op without volume unknowns."""
    return predicted_dilatation(model, u, du) if has_volume_unknowns(model) else theta


def newton_direction(
    posed: Posed,
    at: Deformed,
    lambda_a: Float[Array, " n_a"],
    *,
    theta=None,
    strict=None,
    before: Float[Array, "n_points 3"] | None = None,
) -> Direction:
    """Compute the Newton step at a deformed state.

    Args:
        posed: The configuration, under a share of its load.
        at: The deformed state.
        lambda_a: Forces of the actuators.
        theta: Volume ratios; only for the mixed formulation.
        strict: Whether only steps that lower the potential are taken; likewise.
        before: Displacement at which the step to this state began, to assemble the
            tangent with the stress predicted by that step; see `tangent_values` [m].
    """
    model, u = posed.model, at.u
    fixed, held_step = posed.fixed(), posed.imposed(u)
    moving = jnp.any(held_step != 0.0)
    to_go, active = gap(posed, at, lambda_a, jnp.ones(()))
    # A slack cable loses its force before the step.
    lambda_a = jnp.where(active, lambda_a, 0.0)
    if has_volume_unknowns(model):
        assert theta is not None
        assert strict is not None
        at_u = dilatation(model, theta, u, jnp.zeros_like(u))
        values, force = mixed_tangent(model, u, jnp.where(strict, at_u, theta))
    else:
        values, force = tangent_values(model, u, before), at.force
    g, rows = unbalanced(posed, at, lambda_a)
    values = add_boundary_stiffness(posed, values, u, lambda_a)
    # Held nodes that still have to move pull on the rest: - K du_held.
    pull = jax.lax.cond(
        moving,
        lambda: product(model.pattern, values, held_step.ravel()),
        lambda: jnp.zeros_like(held_step.ravel()),
    )
    reduced = posed.reduce(u, values, g)
    masked, stiffness = mask_supports(model.solver.sparsity, reduced, fixed)
    g_newton = g + (force - at.force)
    rhs = -posed.gather(u, g_newton + pull.reshape(u.shape))
    which = actuation.with_multiplier(model)
    system, H_a = bordered_system(posed, u, values=masked, forces=rows, active=active)
    on_held = jnp.sum(H_a * held_step[None], axis=(1, 2))
    rhs = jnp.where(fixed, 0.0, rhs)
    solved = system.solve(model, rhs[None], (to_go[which] - on_held)[None])
    d = solved.x[0]
    slope = jnp.sum(posed.on_free(u, g) * d)
    supports = jnp.where(jnp.asarray(posed.configuration.fixed), held_step, 0.0)
    sign, reach = _on_hinges(posed, d[u.size :], slope, moving)
    d_lambda = actuation.among_all(model, solved.lambda_a[0])
    compliance = jnp.abs(jnp.diag(solved.W_aa))
    tiny = jnp.finfo(u.dtype).tiny
    # Slack cables included: a step that tightens one leaves a gap to close.
    stiff = actuation.among_all(model, 1.0 / jnp.maximum(compliance, tiny))
    factor = Factor(
        system=system,
        stiffness=stiffness,
        gap_stiffness=jnp.where(by_multiplier(posed), stiff, 0.0),
        n_negative=solved.n_negative,
        ok=solved.ok,
    )
    return Direction(
        step=Step(
            d=(sign * d).at[: u.size].add(supports.ravel()),
            lambda_a=lambda_a,
            d_lambda=sign * d_lambda,
        ),
        slope=sign * slope,
        moving=moving,
        reach=reach,
        factor=factor,
    )


def _on_hinges(posed: Posed, twists, slope, moving):
    """Return the sign and the reach of a step where a body turns on a free hinge.

    If only weight or a torque holds the body, its rotational stiffness at rest is
    almost zero, with either sign. A full Newton step would spin it many times, or turn
    it into the unstable upright position.
    """
    one, model = jnp.ones(()), posed.model
    if posed.states is None:
        return one, one
    hinged = (posed.states.kind == KINDS.index("hinged")) & ~moving
    turns = jnp.abs(twists.reshape(-1, 6)[:, 5]) / model.mechanism.bodies.length
    largest = jnp.max(jnp.where(hinged, turns, 0.0))
    uphill = jnp.any(hinged) & (slope > 0.0) & ~jnp.any(by_multiplier(posed))
    uphill = uphill & model.conservative
    reach = _LARGEST_TURN / jnp.maximum(largest, _LARGEST_TURN)
    return jnp.where(uphill, -one, one), reach
