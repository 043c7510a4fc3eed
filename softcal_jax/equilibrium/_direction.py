"""The Newton step of a posed model, and the line search along it.

The search is on the potential. The norm of the residual is used where no potential
exists, or where imposed actuator displacements make the equilibrium a saddle point.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import KINDS
from softcal_jax.equilibrium._assembly import newton_terms
from softcal_jax.equilibrium._balance import (
    Point,
    System,
    assemble,
    evaluate,
    gap,
    merit,
    stiffness_of_gaps,
    unbalanced,
)
from softcal_jax.equilibrium._element import Strains
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import product

_LARGEST_TURN = 0.5
"""Rotation on a hinge beyond which a Newton step is meaningless [rad]."""


class Factor(NamedTuple):
    """A factorized tangent, the mean stiffness of an unknown, and the solver's report.

    For `gap_stiffness` see `stiffness_of_gaps`.
    """

    system: System
    stiffness: Float[Array, ""]
    gap_stiffness: Float[Array, " n_a"]
    n_negative: Int[Array, ""]
    ok: Bool[Array, ""]


class Step(NamedTuple):
    """A step d of the unknowns, held ones included [m], and of the actuators' forces.

    `lambda_a` are the forces before the step where the displacement is imposed; 0 if
    slack.
    """

    d: Float[Array, " n_dof"]
    lambda_a: Float[Array, " n_a"]
    d_lambda: Float[Array, " n_a"]


class NewtonDirection(NamedTuple):
    """A Newton step with its slope, the out-of-balance force times the step [J].

    `moving`: held nodes or bodies still have to move into place. `reach` is the longest
    share of the step that is worth trying [-].
    """

    step: Step
    slope: Float[Array, ""]
    moving: Bool[Array, ""]
    reach: Float[Array, ""]
    factor: Factor


def newton_direction(
    posed: Posed,
    point: Point,
    lambda_a: Float[Array, " n_a"],
    *,
    strains: Strains,
    exact: bool | Bool[Array, ""],
    placed: bool = False,
    near: Bool[Array, ""] | None = None,
    tamed: int | Int[Array, ""] = 0,
) -> NewtonDirection:
    """Compute the Newton step at a deformed state.

    `strains`, and whether it is `exact` to take those of u: see `newton_terms`.
    `placed`: held nodes and bodies are known to be in place. `near`: the tangent is
    near the last that was factorized. `tamed`: see `Posed.contact_tangent`.
    """
    model, u = posed.model, point.u
    held_step = jnp.zeros_like(u) if placed else posed.imposed(u)
    moving = jnp.any(held_step != 0.0)
    to_go, active = gap(posed, point, lambda_a, jnp.ones(()))
    # A slack cable loses its force before the step.
    lambda_a = jnp.where(active, lambda_a, 0.0)
    values, force = newton_terms(model, u, point.force, strains, exact)
    options = {"mesh": values, "active": active, "tamed": tamed}
    tangent = assemble(posed, point, lambda_a, **options)
    # Held nodes that still have to move pull on the rest: - K du_held.
    pull = jax.lax.cond(
        moving,
        lambda: product(model.pattern, tangent.nodal, held_step.ravel()),
        lambda: jnp.zeros_like(held_step.ravel()),
    )
    g_newton = tangent.g + (force - point.force) + pull.reshape(u.shape)
    rhs = -posed.on_free(u, g_newton)
    on_held = jnp.sum(tangent.H_a * held_step[None], axis=(1, 2))
    which = model.with_multiplier
    to_close = (to_go[which] - on_held)[None]
    solve = partial(tangent.system.solve, model.solver, rhs[None], to_close)
    again = partial(solve, near=True)
    solved = solve() if near is None else jax.lax.cond(near, again, solve)
    d = solved.x[0]
    slope = jnp.sum(posed.on_free(u, tangent.g) * d)
    supports = jnp.where(jnp.asarray(posed.configuration.fixed), held_step, 0.0)
    sign, reach = _of_turning_bodies(posed, d[u.size :], slope, moving)
    factor = Factor(
        system=tangent.system,
        stiffness=tangent.stiffness,
        gap_stiffness=stiffness_of_gaps(posed, solved.W_aa),
        n_negative=solved.n_negative,
        ok=solved.ok,
    )
    return NewtonDirection(
        step=Step(
            d=sign * d + jnp.pad(supports.ravel(), (0, d.size - u.size)),
            lambda_a=lambda_a,
            d_lambda=sign * model.among_all(solved.lambda_a[0]),
        ),
        slope=sign * slope,
        moving=moving,
        reach=reach,
        factor=factor,
    )


def _of_turning_bodies(posed: Posed, twists, slope, moving):
    """Return the sign and the reach of a step that turns bodies.

    If only weight or a torque holds a body on a hinge, its rotational stiffness at rest
    is almost zero, with either sign. A full Newton step would spin it many times, or
    turn it into the unstable upright position. And by more than half a turn a body
    comes nearer again, while the nodes beside it move away along straight lines.
    """
    one, model = jnp.ones(()), posed.model
    if posed.states is None:
        return one, one
    hinged = (posed.states.kind == KINDS.index("hinged")) & ~moving
    turns = jnp.linalg.norm(twists.reshape(-1, 6)[:, 3:], axis=1)
    turns = turns / model.mechanism.bodies.length
    uphill = jnp.any(hinged) & (slope > 0.0) & ~jnp.any(posed.by_multiplier)
    uphill = uphill & model.conservative
    too_far = jnp.max(turns / jnp.where(hinged, _LARGEST_TURN, jnp.pi))
    reach = 1.0 / jnp.where(moving, 1.0, jnp.maximum(too_far, 1.0))
    return jnp.where(uphill, -one, one), reach


class LineSearchTrial(NamedTuple):
    """A point that a `share` of the step leads to, and the norm of its residual."""

    point: Point
    lambda_a: Float[Array, " n_a"]
    merit: Float[Array, ""]
    share: Float[Array, ""]
    good: Bool[Array, ""]


def line_search(
    posed: Posed,
    point: Point,
    direction: NewtonDirection,
    *,
    strict: Bool[Array, ""],
    reference: Float[Array, ""] | None,
    backtracks: int | Int[Array | HostArray, ""],
) -> LineSearchTrial:
    """Backtrack until the step passes the test and all values are finite.

    Unless `strict`, full steps are taken even uphill: the first step of a large
    rotation always raises Pi, by orders of magnitude in a nearly incompressible body,
    and a strict search would take very short steps. Full steps are only trusted if they
    end in a stable state.

    `reference` is the larger of the last two norms of the residual, inf at the start of
    a load step; None if the search always uses the potential [N]. After
    `backtracks` halvings the step counts as failed.
    """
    lower, moving = _lower(posed, point, direction, reference), direction.moving
    step, gap_stiffness = direction.step, direction.factor.gap_stiffness

    def trial(alpha):
        new = evaluate(posed, posed.swing(point.u, alpha * step.d))
        lambda_a = step.lambda_a + alpha * step.d_lambda
        size = merit(posed, new, lambda_a, gap_stiffness)
        enough = lower(alpha, new, lambda_a, size)
        # Some laws survive an inverted tet but hardly recover from it. A support that
        # moves too far is cut like a load.
        inside_out = (new.min_det_F <= 0.0) & (point.min_det_F > 0.0)
        inside_out = inside_out & (~moving | ~strict)
        free = ~strict & ~(point.touches | new.touches)
        good = (enough | moving | free) & new.finite & ~inside_out
        good = good & ~posed.passes_through(point.u, new.u)
        good = good & ~posed.is_lost(new.u)
        return LineSearchTrial(new, lambda_a, size, alpha, good)

    def keep_trying(carry):
        _, trials, tried = carry
        again = ~tried.good & (trials <= backtracks) & ~moving
        return (trials == 0) | again

    def halve(carry):
        alpha, trials, _ = carry
        return 0.5 * alpha, trials + 1, trial(alpha)

    # The first trial is inside the loop, so that it is compiled only once.
    zero = jnp.zeros(())
    none = LineSearchTrial(point, step.lambda_a, zero, zero, jnp.zeros((), bool))
    return jax.lax.while_loop(keep_trying, halve, (direction.reach, 0, none))[2]


def _lower(posed: Posed, point: Point, direction: NewtonDirection, reference):
    """Return the test of a trial step: does it lower Pi, or the residual, enough?

    The residual must fall below the larger of the last two, `reference`, which a Newton
    direction can always reach (Grippo, Lampariello and Lucidi, SIAM J. Numer. Anal. 23,
    1986). A rotation completed only to first order stretches a slender body, so the
    residual rises for one step. Monotone descent would take very short steps.
    """
    before, scale = _potential(posed, point)
    slope, d = direction.slope, direction.step.d

    def test(alpha, new, lambda_a, merit):
        falls = reference is not None and merit <= (1.0 - 1e-4 * alpha) * reference
        if not posed.model.has_energy:
            return falls
        potential, new_scale = _potential(posed, new)
        if point.friction is not None:  # counts as a dead load
            potential = potential + jnp.sum(point.friction * (new.u - point.u))
        armijo = potential <= before + 1e-4 * alpha * slope
        # Near the solution Pi changes by less than its rounding, so the slope
        # decides (approximate Wolfe condition of Hager and Zhang, SIAM J. Optim. 16,
        # 2005).
        g, _ = unbalanced(posed, new, lambda_a)
        flat = jnp.sum(posed.on_free(new.u, g) * d) <= 0.8 * jnp.abs(slope)
        flat = flat & (potential <= before + 1e-6 * (scale + new_scale))
        saddle = jnp.any(posed.by_multiplier)
        return jnp.where(saddle, falls, armijo | flat)

    return test


def _potential(posed: Posed, point: Point):
    """Compute Pi at a point, and the scale of its rounding [J]."""
    work = posed.load * posed.f_ext * point.u
    springs = posed.spring_energy(point.u) + posed.anchor_energy(point.u)
    value, scale = point.energy + springs - jnp.sum(work), point.energy_scale + springs
    scale = scale + jnp.sum(jnp.abs(work))
    forces = posed.configuration.actuation.forces
    of_actuators = posed.load * forces * point.delta_a
    value = value - jnp.sum(of_actuators)
    return value, scale + jnp.sum(jnp.abs(of_actuators))
