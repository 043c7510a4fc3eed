"""Newton's method on the potential energy, with line search and load stepping.

Minimises Pi(x) = sum_e V_e psi(F_e) - t (f_ext . u) over the free nodes, while the load
factor t goes from 0 to 1 (paper Eqs. 1-3; equilibrium is a minimum of Pi when forces
are imposed). One state machine in one `while_loop`: an iteration is a Newton step, and
the end of a load step, or its failure, only changes t.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._assembly import (
    energy_and_force,
    gravity_load,
    mixed_tangent,
    predicted_dilatation,
    tangent_values,
)
from softcal_jax.equilibrium._element import is_mixed
from softcal_jax.equilibrium._model import Model


class NewtonSettings(eqx.Module):
    """Settings of the equilibrium solve; static, so each set compiles once.

    Attributes:
        rtol: Residual at which Newton stops, relative to the largest of external force,
            internal force and reactions [-].
        max_steps: Newton iterations for one configuration, all load steps together.
        max_steps_per_load: Newton iterations after which a load step is cut.
        smallest_load_step: Load increment below which load stepping gives up [-].
        strict_below: Load increment below which the line search is strict [-].
        max_backtracks: Halvings of a Newton step before it counts as failed.
    """

    rtol: float = eqx.field(static=True, default=1e-8)
    max_steps: int = eqx.field(static=True, default=200)
    max_steps_per_load: int = eqx.field(static=True, default=20)
    smallest_load_step: float = eqx.field(static=True, default=1e-3)
    strict_below: float = eqx.field(static=True, default=0.1)
    max_backtracks: int = eqx.field(static=True, default=12)

    def __check_init__(self):
        if not 0.0 < self.rtol < 1.0:
            raise ValueError(f"rtol must lie in (0, 1), got {self.rtol}.")
        if self.max_steps < 1 or self.max_steps_per_load < 1:
            raise ValueError(
                "max_steps and max_steps_per_load must be at least 1, got "
                f"{self.max_steps} and {self.max_steps_per_load}."
            )


class NewtonState(NamedTuple):
    """State of the loop; `*_ok` is the last equilibrium on the load path.

    `theta` is the volume ratio of each tet in the mixed Newton step; everything else,
    the stopping rule too, is of the body with theta = J_bar(u).
    """

    u: Float[Array, "n_nodes 3"]
    theta: Float[Array, "n_blocks block"]
    force: Float[Array, "n_nodes 3"]
    energy: Float[Array, ""]
    energy_scale: Float[Array, ""]
    u_ok: Float[Array, "n_nodes 3"]
    load: Float[Array, ""]
    load_ok: Float[Array, ""]
    increment: Float[Array, ""]
    step: Int[Array, ""]
    step_in_load: Int[Array, ""]
    load_steps: Int[Array, ""]
    residual: Float[Array, ""]
    min_det_F: Float[Array, ""]
    n_negative: Int[Array, ""]
    any_singular: Bool[Array, ""]
    result: RESULTS
    done: Bool[Array, ""]


def external_force(
    model: Model, configuration: ConfigurationArrays
) -> Float[Array, "n_nodes 3"]:
    """Dead loads and weight as nodal forces, f_ext(p) [N]."""
    return configuration.force + gravity_load(model, configuration.gravity)


def symmetric_product(sparsity, values, v):
    """K v for a symmetric K kept as its upper triangle."""
    rows, cols = sparsity.rows, sparsity.indices
    lower = jnp.where(rows == cols, 0.0, values)
    product = jnp.zeros_like(v).at[rows].add(values * v[cols])
    return product.at[cols].add(lower * v[rows])


def mask_supports(sparsity, values, fixed):
    """Tangent whose supported rows and columns are those of the identity, scaled."""
    held = fixed[sparsity.rows] | fixed[sparsity.indices]
    diagonal = values[sparsity.diagonal]
    # The mean stiffness, not 1, keeps the matrix well scaled in any unit.
    scale = jnp.mean(jnp.abs(diagonal))
    on_diagonal = jnp.where(fixed, scale, diagonal)
    return jnp.where(held, 0.0, values).at[sparsity.diagonal].set(on_diagonal), scale


def newton(
    model: Model,
    configuration: ConfigurationArrays,
    u0: Float[Array, "n_nodes 3"],
    settings: NewtonSettings,
) -> NewtonState:
    """Solve one configuration from the guess `u0`, at full load first.

    A guess that does not lead to the solution at full load is dropped, and load
    stepping begins from rest.
    """
    X = jnp.asarray(model.mesh.points)
    f_ext = external_force(model, configuration)
    fixed = configuration.fixed
    sparsity = model.solver.sparsity
    eps = jnp.finfo(X.dtype).eps
    size = jnp.max(jnp.ptp(X, axis=0))
    rest = jnp.zeros_like(u0)
    mixed = is_mixed(model.formulation, model.weights.shape[1])

    def evaluate(u):
        return energy_and_force(model, u)

    def relative_residual(force, load, stiffness):
        """Residual on free nodes, relative to external, internal and reaction force."""
        free = jnp.where(fixed, 0.0, force - load * f_ext)
        scale = jnp.maximum(jnp.linalg.norm(load * f_ext), jnp.linalg.norm(force))
        # Without any load, what remains is the rounding of positions.
        rounding = eps / settings.rtol * stiffness * size
        return jnp.linalg.norm(free) / jnp.maximum(scale, rounding)

    def strict(s):
        return s.increment < settings.strict_below

    def direction(s, du_held):
        if mixed:
            theta = jnp.where(strict(s), predicted_dilatation(model, s.u, rest), s.theta)
            values, force = mixed_tangent(model, s.u, theta)
        else:
            values, force = tangent_values(model, s.u), s.force
        # Held nodes that still have to move pull on the free ones: - K du_held.
        pull = jax.lax.cond(
            jnp.any(du_held != 0.0),
            lambda: symmetric_product(sparsity, values, du_held.ravel()),
            lambda: jnp.zeros_like(du_held.ravel()),
        )
        rhs = (s.load * f_ext - force).ravel() - pull
        masked, scale = mask_supports(sparsity, values, fixed.ravel())
        rhs = jnp.where(fixed.ravel(), scale * du_held.ravel(), rhs)
        solved = model.solver.factor_solve(masked, rhs[None])
        return solved, solved.x[0].reshape(s.u.shape), scale

    def line_search(s, d, slope, moving):
        """Backtrack until Pi has gone down enough (Armijo) and is finite.

        Full steps are taken first, downhill or not: the first step of a large rotation
        always raises Pi, and of a nearly incompressible body by orders of magnitude; a
        strict search then creeps (ten times the iterations). They are only trusted
        when they end in a stable state; see `body`.
        """
        potential = s.energy - s.load * jnp.sum(f_ext * s.u)
        work = jnp.sum(jnp.abs(f_ext * s.u))

        def trial(alpha):
            u = s.u + alpha * d
            energy, scale, force, det = evaluate(u)
            new = energy - s.load * jnp.sum(f_ext * u)
            armijo = new <= potential + 1e-4 * alpha * slope
            # Near the solution Pi changes by less than its own rounding, and the slope
            # decides (approximate Wolfe condition of Hager and Zhang, SIAM J. Optim.
            # 16, 2005).
            slope_new = jnp.sum(jnp.where(fixed, 0.0, force - s.load * f_ext) * d)
            flat = (slope_new <= 0.8 * jnp.abs(slope)) & (
                new <= potential + 1e-6 * (scale + s.energy_scale + work)
            )
            finite = jnp.isfinite(energy) & jnp.all(jnp.isfinite(force))
            good = (armijo | flat | moving | ~strict(s)) & finite
            return u, energy, scale, force, det, good

        def keep_trying(carry):
            _, backtracks, (*_, good) = carry
            return ~good & (backtracks < settings.max_backtracks) & ~moving

        def halve(carry):
            alpha, backtracks, _ = carry
            return 0.5 * alpha, backtracks + 1, trial(0.5 * alpha)

        one = jnp.ones((), X.dtype)
        _, _, tried = jax.lax.while_loop(keep_trying, halve, (one, 0, trial(one)))
        return tried

    def body(s: NewtonState) -> NewtonState:
        target = s.load * configuration.imposed
        du_held = jnp.where(fixed, target - s.u, 0.0)
        moving = jnp.any(du_held != 0.0)
        solved, d, stiffness = direction(s, du_held)
        slope = jnp.sum(jnp.where(fixed, 0.0, s.force - s.load * f_ext) * d)
        downhill = moving | (slope <= 0.0) | ~strict(s)
        u, energy, scale, force, det, good = line_search(s, d, slope, moving)
        good = good & solved.ok & downhill
        s = s._replace(
            step=s.step + 1,
            step_in_load=s.step_in_load + 1,
            n_negative=solved.n_negative,
            any_singular=~solved.ok,
        )
        residual = relative_residual(force, s.load, stiffness)
        residual = jnp.where(good, residual, jnp.inf)
        moved = s._replace(
            u=u,
            force=force,
            energy=energy,
            energy_scale=scale,
            residual=residual,
            min_det_F=det,
            theta=predicted_dilatation(model, s.u, u - s.u) if mixed else s.theta,
        )
        converged = residual <= settings.rtol
        # Full steps may have jumped to a saddle; load stepping finds the stable path.
        astray = converged & (s.n_negative > 0) & ~strict(s)
        good, converged = good & ~astray, converged & ~astray
        failed = ~good | (~converged & (s.step_in_load >= settings.max_steps_per_load))
        s = _select(good, moved, s)
        s = _select(converged, _next_load(s), s)
        return jax.lax.cond(failed, back, lambda s: s, s)

    def _next_load(s: NewtonState) -> NewtonState:
        increment = jnp.minimum(2.0 * s.increment, 1.0 - s.load)
        finished = s.load >= 1.0
        outcome = RESULTS.where(s.min_det_F > 0.0, RESULTS.converged, RESULTS.inverted)
        outcome = RESULTS.where(s.n_negative > 0, RESULTS.unstable, outcome)
        return s._replace(
            u_ok=s.u,
            load_ok=s.load,
            load=jnp.minimum(s.load + increment, 1.0),
            increment=increment,
            step_in_load=jnp.zeros_like(s.step),
            load_steps=s.load_steps + 1,
            result=RESULTS.where(finished, outcome, s.result),
            done=finished,
        )

    def back(s: NewtonState) -> NewtonState:
        """Return to the last equilibrium and take half the load increment."""
        increment = 0.5 * s.increment
        give_up = increment < settings.smallest_load_step
        why = RESULTS.where(
            s.any_singular,
            RESULTS.singular,
            RESULTS.where(
                s.n_negative > 0, RESULTS.unstable, RESULTS.load_step_too_small
            ),
        )
        energy, scale, force, det = evaluate(s.u_ok)
        return s._replace(
            u=s.u_ok,
            theta=predicted_dilatation(model, s.u_ok, rest) if mixed else s.theta,
            force=force,
            energy=energy,
            energy_scale=scale,
            load=s.load_ok + increment,
            increment=increment,
            step_in_load=jnp.zeros_like(s.step),
            result=RESULTS.where(give_up, why, s.result),
            done=give_up,
        )

    def keep_going(s: NewtonState):
        return ~s.done & (s.step < settings.max_steps)

    one, zero = jnp.ones((), X.dtype), jnp.zeros((), X.dtype)
    energy, scale, force, det = evaluate(u0)
    # A guess with inverted or infinite energy is worth less than the rest shape.
    usable = jnp.isfinite(energy) & jnp.all(jnp.isfinite(force))
    u0 = jnp.where(usable, u0, rest)
    count = jnp.zeros((), jnp.int32)
    start = NewtonState(
        u=u0,
        theta=predicted_dilatation(model, u0, rest) if mixed else zero,
        force=jnp.where(usable, force, rest),
        energy=jnp.where(usable, energy, zero),
        energy_scale=jnp.where(usable, scale, zero),
        u_ok=rest,
        load=one,
        load_ok=zero,
        increment=one,
        step=count,
        step_in_load=count,
        load_steps=count,
        residual=jnp.full_like(zero, jnp.inf),
        min_det_F=jnp.where(usable, det, one),
        n_negative=count,
        any_singular=jnp.zeros((), bool),
        result=RESULTS.max_steps,
        done=jnp.zeros((), bool),
    )
    return jax.lax.while_loop(keep_going, body, start)


def _select(flag, new: NewtonState, old: NewtonState) -> NewtonState:
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)
