"""Line search along a Newton step, on the potential or on the residual.

The norm of the residual is used where no potential exists, or where imposed actuator
displacements make the equilibrium a saddle point.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._balance import (
    Point,
    by_multiplier,
    evaluate,
    merit,
    unbalanced,
)
from softcal_jax.equilibrium._direction import Direction
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed


class Trial(NamedTuple):
    """A point along a Newton step.

    Attributes:
        at: The point.
        lambda_a: Forces of the actuators whose displacement is imposed.
        merit: Norm of the residual there [N].
        good: Whether the point is acceptable.
    """

    at: Point
    lambda_a: Float[Array, " n_a"]
    merit: Float[Array, ""]
    good: Bool[Array, ""]


def always_potential(model: Model) -> bool:
    """Tell whether the line search uses the potential in every configuration."""
    return model.conservative and actuation.with_multiplier(model).size == 0


def line_search(
    posed: Posed,
    at: Point,
    direction: Direction,
    *,
    strict: Bool[Array, ""],
    merit_before: Float[Array, ""] | None,
    max_backtracks: int,
) -> Trial:
    """Backtrack until the step passes the test and all values are finite.

    At first, full steps are taken even uphill: the first step of a large rotation
    always raises Pi, by orders of magnitude in a nearly incompressible body, and a
    strict search would take very short steps. Full steps are only trusted if they end
    in a stable state.

    Args:
        posed: The configuration, under a share of its load.
        at: Where the step begins.
        direction: The step.
        strict: Whether only steps that pass the test are taken.
        merit_before: Norm of the residual one step ago; None if the search always uses
            the potential [N].
        max_backtracks: Halvings before the step counts as failed.
    """
    lower, moving = _lower(posed, at, direction, merit_before), direction.moving
    step, gap_stiffness = direction.step, direction.factor.gap_stiffness

    def trial(alpha):
        new = evaluate(posed.model, posed.swing(at.u, alpha * step.d))
        lambda_a = step.lambda_a + alpha * step.d_lambda
        size = merit(posed, new.deformed, lambda_a, gap_stiffness)
        enough = lower(alpha, new, lambda_a, size)
        # Some laws survive an inverted tet but hardly recover from it. A support that
        # moves too far is cut like a load.
        inside_out = (new.min_det_F <= 0.0) & (at.min_det_F > 0.0)
        inside_out = inside_out & (~moving | ~strict)
        good = (enough | moving | ~strict) & new.finite & ~inside_out
        return Trial(new, lambda_a, size, good)

    def keep_trying(carry):
        _, trials, tried = carry
        again = ~tried.good & (trials <= max_backtracks) & ~moving
        return (trials == 0) | again

    def halve(carry):
        alpha, trials, _ = carry
        return 0.5 * alpha, trials + 1, trial(alpha)

    # The first trial is inside the loop, so that it is compiled only once.
    none = Trial(at, step.lambda_a, jnp.zeros(()), jnp.zeros((), bool))
    return jax.lax.while_loop(keep_trying, halve, (direction.reach, 0, none))[2]


def _lower(posed: Posed, at: Point, direction: Direction, merit_before):
    """Choose the test of a trial step: on the potential, or on the residual."""
    if always_potential(posed.model):
        return _lower_potential(posed, at, direction)
    assert merit_before is not None
    residual = _lower_residual(posed, at, direction, merit_before)
    if not posed.model.conservative:
        return residual
    potential = _lower_potential(posed, at, direction)
    saddle = jnp.any(by_multiplier(posed))
    return lambda *trial: jnp.where(saddle, residual(*trial), potential(*trial))


def _lower_potential(posed: Posed, at: Point, direction: Direction):
    """Return a test of whether a trial step lowers Pi enough (Armijo)."""
    before, scale = _potential(posed, at)
    slope, d = direction.slope, direction.step.d

    def test(alpha, at, lambda_a, merit):
        del merit
        new, new_scale = _potential(posed, at)
        armijo = new <= before + 1e-4 * alpha * slope
        # Near the solution Pi changes by less than its rounding, so the slope
        # decides (approximate Wolfe condition of Hager and Zhang, SIAM J. Optim. 16,
        # 2005).
        g, _ = unbalanced(posed, at.deformed, lambda_a)
        slope_new = jnp.sum(posed.on_free(at.u, g) * d)
        flat = (slope_new <= 0.8 * jnp.abs(slope)) & (
            new <= before + 1e-6 * (scale + new_scale)
        )
        return armijo | flat

    return test


def _lower_residual(posed: Posed, at: Point, direction: Direction, merit_before):
    """Return a test of whether a trial step lowers the residual enough.

    The residual must fall below the larger of the last two, which a Newton direction
    can always reach (Grippo, Lampariello and Lucidi, SIAM J. Numer. Anal. 23, 1986);
    the first step of a load step is free. A rotation completed only to first order
    stretches a slender body, so the residual rises by orders of magnitude for one step.
    Monotone descent would take very short steps even under gravity alone.
    """
    now = merit(
        posed,
        at.deformed,
        direction.step.lambda_a,
        direction.factor.gap_stiffness,
    )
    reference = jnp.maximum(merit_before, now)

    def test(alpha, at, lambda_a, merit):
        del at, lambda_a
        return merit <= (1.0 - 1e-4 * alpha) * reference

    return test


def _potential(posed: Posed, at: Point):
    """Compute Pi at a point, and the scale of its rounding [J]."""
    work = posed.load * posed.f_ext * at.u
    springs = posed.spring_energy(at.u)
    value, scale = at.energy + springs - jnp.sum(work), at.energy_scale + springs
    scale = scale + jnp.sum(jnp.abs(work))
    forces = posed.configuration.actuation.forces
    of_actuators = posed.load * forces * at.deformed.delta_a
    value = value - jnp.sum(of_actuators)
    return value, scale + jnp.sum(jnp.abs(of_actuators))
