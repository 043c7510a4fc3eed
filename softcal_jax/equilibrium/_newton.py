"""Newton's method on the potential energy, with line search and load stepping.

Minimises Pi(x) = sum_e V_e psi(F_e) - t (f_ext . u) over the free nodes, while the load
factor t goes from 0 to 1 (paper Eqs. 1-3; equilibrium is a minimum of Pi when forces
are imposed). One state machine in one `while_loop`: an iteration is a Newton step, and
the end of a load step, or its failure, only changes t. Where no potential exists, the
line search is on the norm of the residual.
"""

from dataclasses import dataclass
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
    the stopping rule too, is of the body with theta = J_bar(u). `unbalanced_before` is
    the norm of the residual one step ago, for the line search without a potential; inf
    at the start of a load step, None where a potential exists.
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
    unbalanced_before: Float[Array, ""] | None
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
    weight = gravity_load(model, jnp.asarray(configuration.gravity))
    return jnp.asarray(configuration.force) + weight


def product(sparsity, values, v):
    """K v, for a K kept as its pattern says."""
    rows, cols = sparsity.rows, sparsity.indices
    if not sparsity.symmetric:
        return jnp.zeros_like(v).at[rows].add(values * v[cols])
    lower = jnp.where(rows == cols, 0.0, values)
    upper = jnp.zeros_like(v).at[rows].add(values * v[cols])
    return upper.at[cols].add(lower * v[rows])


def mask_supports(sparsity, values, fixed):
    """Tangent whose supported rows and columns are those of the identity, scaled."""
    held = fixed[sparsity.rows] | fixed[sparsity.indices]
    diagonal = values[sparsity.diagonal]
    # The mean stiffness, not 1, keeps the matrix well scaled in any unit.
    scale = jnp.mean(jnp.abs(diagonal))
    on_diagonal = jnp.where(fixed, scale, diagonal)
    return jnp.where(held, 0.0, values).at[sparsity.diagonal].set(on_diagonal), scale


@dataclass(frozen=True, eq=False)  # JAX caches its methods by identity
class EquilibriumProblem:
    """One configuration while it is solved: the parts of a Newton iteration."""

    model: Model
    fixed: Bool[Array, "n_nodes 3"]
    imposed: Float[Array, "n_nodes 3"]
    f_ext: Float[Array, "n_nodes 3"]
    settings: NewtonSettings

    @property
    def mixed(self) -> bool:
        """Whether the volume ratios are unknowns of the Newton step."""
        return is_mixed(self.model.formulation, self.model.weights.shape[1])

    def evaluate(self, u):
        """Energy, its scale, internal force and smallest det F."""
        return energy_and_force(self.model, u)

    def strict(self, s: NewtonState):
        """Whether only steps that lower Pi are taken."""
        if not self.model.solver.counts_negative:
            # Nobody would notice that full steps had ended in an unstable state.
            return jnp.ones((), bool)
        return s.increment < self.settings.strict_below

    def dilatation(self, s: NewtonState, u, du):
        """Volume ratios after a step; nothing to do in the displacement formulation."""
        return predicted_dilatation(self.model, u, du) if self.mixed else s.theta

    def remembered(self, unbalanced):
        """Norm of a residual, kept only where the line search needs it."""
        return None if self.model.conservative else jnp.linalg.norm(unbalanced)

    def unbalanced(self, force, load):
        """Out-of-balance force on the free coordinates."""
        return jnp.where(self.fixed, 0.0, force - load * self.f_ext)

    def relative_residual(self, force, load, stiffness):
        """Residual on free nodes, relative to external, internal and reaction force."""
        points = jnp.asarray(self.model.mesh.points)
        size = jnp.max(jnp.ptp(points, axis=0))
        norm = jnp.linalg.norm
        scale = jnp.maximum(norm(load * self.f_ext), norm(force))
        # Without any load, what remains is the rounding of positions.
        eps = jnp.finfo(points.dtype).eps
        rounding = eps / self.settings.rtol * stiffness * size
        return norm(self.unbalanced(force, load)) / jnp.maximum(scale, rounding)

    def direction(self, s: NewtonState, du_held):
        """Newton step at the current load, and the mean stiffness of a node."""
        sparsity, fixed = self.model.solver.sparsity, self.fixed.ravel()
        if self.mixed:
            at_u = self.dilatation(s, s.u, jnp.zeros_like(s.u))
            theta = jnp.where(self.strict(s), at_u, s.theta)
            values, force = mixed_tangent(self.model, s.u, theta)
        else:
            values, force = tangent_values(self.model, s.u), s.force
        # Held nodes that still have to move pull on the free ones: - K du_held.
        pull = jax.lax.cond(
            jnp.any(du_held != 0.0),
            lambda: product(sparsity, values, du_held.ravel()),
            lambda: jnp.zeros_like(du_held.ravel()),
        )
        masked, stiffness = mask_supports(sparsity, values, fixed)
        rhs = (s.load * self.f_ext - force).ravel() - pull
        rhs = jnp.where(fixed, stiffness * du_held.ravel(), rhs)
        solved = self.model.solver.factor_solve(masked, rhs[None])
        return solved, solved.x[0].reshape(s.u.shape), stiffness

    def lower_potential(self, s: NewtonState, d, slope):
        """Test of a trial step: whether Pi has gone down enough (Armijo)."""
        potential = s.energy - s.load * jnp.sum(self.f_ext * s.u)
        work = jnp.sum(jnp.abs(self.f_ext * s.u))

        def test(alpha, u, energy, scale, force):
            new = energy - s.load * jnp.sum(self.f_ext * u)
            armijo = new <= potential + 1e-4 * alpha * slope
            # Near the solution Pi changes by less than its own rounding, and the slope
            # decides (approximate Wolfe condition of Hager and Zhang, SIAM J. Optim.
            # 16, 2005).
            slope_new = jnp.sum(self.unbalanced(force, s.load) * d)
            flat = (slope_new <= 0.8 * jnp.abs(slope)) & (
                new <= potential + 1e-6 * (scale + s.energy_scale + work)
            )
            return armijo | flat

        return test

    def lower_residual(self, s: NewtonState, unbalanced_before: Float[Array, ""]):
        """Test of a trial step: whether the residual has gone down enough.

        Below the larger of the last two, which a Newton direction always can (Grippo,
        Lampariello and Lucidi, SIAM J. Numer. Anal. 23, 1986), and the first step of a
        load step is free: a rotation that the step completes only to first order
        stretches a slender body, so its residual rises by orders of magnitude and
        falls again one step later. Monotone descent creeps already under own weight.
        """
        norm = jnp.linalg.norm
        now = norm(self.unbalanced(s.force, s.load))
        reference = jnp.maximum(unbalanced_before, now)

        def test(alpha, u, energy, scale, force):
            del u, energy, scale
            new = norm(self.unbalanced(force, s.load))
            return new <= (1.0 - 1e-4 * alpha) * reference

        return test

    def line_search(self, s: NewtonState, d, lower, moving):
        """Backtrack until the step passes the test `lower` and all is finite.

        Full steps are taken first, downhill or not: the first step of a large rotation
        always raises Pi, and of a nearly incompressible body by orders of magnitude; a
        strict search then creeps. They are only trusted
        when they end in a stable state; see `step`.
        """

        def trial(alpha):
            u = s.u + alpha * d
            energy, scale, force, det = self.evaluate(u)
            enough = lower(alpha, u, energy, scale, force)
            finite = jnp.isfinite(energy) & jnp.all(jnp.isfinite(force))
            good = (enough | moving | ~self.strict(s)) & finite
            return u, energy, scale, force, det, good

        def keep_trying(carry):
            _, backtracks, (*_, good) = carry
            return ~good & (backtracks < self.settings.max_backtracks) & ~moving

        def halve(carry):
            alpha, backtracks, _ = carry
            return 0.5 * alpha, backtracks + 1, trial(0.5 * alpha)

        one = jnp.ones((), s.u.dtype)
        return jax.lax.while_loop(keep_trying, halve, (one, 0, trial(one)))[2]

    def step(self, s: NewtonState) -> NewtonState:
        """One Newton iteration, and what follows from it for the load."""
        du_held = jnp.where(self.fixed, s.load * self.imposed - s.u, 0.0)
        moving = jnp.any(du_held != 0.0)
        solved, d, stiffness = self.direction(s, du_held)
        slope = jnp.sum(self.unbalanced(s.force, s.load) * d)
        if s.unbalanced_before is None:  # a potential exists
            downhill = moving | (slope <= 0.0) | ~self.strict(s)
            lower = self.lower_potential(s, d, slope)
        else:  # a Newton step always points down the residual
            downhill = jnp.ones((), bool)
            lower = self.lower_residual(s, s.unbalanced_before)
        u, energy, scale, force, det, good = self.line_search(s, d, lower, moving)
        good = good & solved.ok & downhill
        residual = self.relative_residual(force, s.load, stiffness)
        residual = jnp.where(good, residual, jnp.inf)
        s = s._replace(
            step=s.step + 1,
            step_in_load=s.step_in_load + 1,
            n_negative=solved.n_negative,
            any_singular=~solved.ok,
        )
        moved = s._replace(
            u=u,
            force=force,
            energy=energy,
            energy_scale=scale,
            unbalanced_before=self.remembered(self.unbalanced(s.force, s.load)),
            residual=residual,
            min_det_F=det,
            theta=self.dilatation(s, s.u, u - s.u),
        )
        converged = residual <= self.settings.rtol
        astray = converged & self.suspicious(s, det)
        good, converged = good & ~astray, converged & ~astray
        out_of_steps = s.step_in_load >= self.settings.max_steps_per_load
        failed = ~good | (~converged & out_of_steps)
        s = _select(good, moved, s)
        s = _select(converged, self.next_load(s), s)
        return jax.lax.cond(failed, self.back, lambda s: s, s)

    def suspicious(self, s: NewtonState, det):
        """Whether full steps may have jumped; load stepping then finds the path.

        To a saddle, where negative eigenvalues show it; without a potential, inverted
        tets are the only sign.
        """
        if self.model.conservative:
            return (s.n_negative > 0) & ~self.strict(s)
        return (det <= 0.0) & (s.increment >= self.settings.strict_below)

    def next_load(self, s: NewtonState) -> NewtonState:
        """Keep an equilibrium; raise the load, or finish."""
        increment = jnp.minimum(2.0 * s.increment, 1.0 - s.load)
        finished = s.load >= 1.0
        outcome = RESULTS.where(s.min_det_F > 0.0, RESULTS.converged, RESULTS.inverted)
        outcome = RESULTS.where(s.n_negative > 0, RESULTS.unstable, outcome)
        return s._replace(
            u_ok=s.u,
            load_ok=s.load,
            load=jnp.minimum(s.load + increment, 1.0),
            increment=increment,
            unbalanced_before=self.remembered(jnp.inf),
            step_in_load=jnp.zeros_like(s.step),
            load_steps=s.load_steps + 1,
            result=RESULTS.where(finished, outcome, s.result),
            done=finished,
        )

    def back(self, s: NewtonState) -> NewtonState:
        """Return to the last equilibrium and take half the load increment."""
        increment = 0.5 * s.increment
        give_up = increment < self.settings.smallest_load_step
        buckled = RESULTS.where(
            s.n_negative > 0, RESULTS.unstable, RESULTS.load_step_too_small
        )
        why = RESULTS.where(s.any_singular, RESULTS.singular, buckled)
        energy, scale, force, _ = self.evaluate(s.u_ok)
        return s._replace(
            u=s.u_ok,
            theta=self.dilatation(s, s.u_ok, jnp.zeros_like(s.u_ok)),
            force=force,
            energy=energy,
            energy_scale=scale,
            load=s.load_ok + increment,
            increment=increment,
            unbalanced_before=self.remembered(jnp.inf),
            step_in_load=jnp.zeros_like(s.step),
            result=RESULTS.where(give_up, why, s.result),
            done=give_up,
        )

    def start(self, u0: Float[Array, "n_nodes 3"]) -> NewtonState:
        """State before the first iteration, at full load."""
        energy, scale, force, det = self.evaluate(u0)
        # A guess with inverted tets or infinite energy is worth less than rest.
        usable = jnp.isfinite(energy) & jnp.all(jnp.isfinite(force)) & (det > 0.0)
        keep = lambda value, rest: jnp.where(usable, value, rest)
        zero, one = jnp.zeros((), u0.dtype), jnp.ones((), u0.dtype)
        rest, count = jnp.zeros_like(u0), jnp.zeros((), jnp.int32)
        state = NewtonState(
            u=keep(u0, rest),
            theta=zero,
            force=keep(force, rest),
            energy=keep(energy, zero),
            energy_scale=keep(scale, zero),
            u_ok=rest,
            load=one,
            load_ok=zero,
            increment=one,
            step=count,
            step_in_load=count,
            load_steps=count,
            unbalanced_before=self.remembered(jnp.inf),
            residual=jnp.full_like(zero, jnp.inf),
            min_det_F=keep(det, one),
            n_negative=count,
            any_singular=jnp.zeros((), bool),
            result=RESULTS.max_steps,
            done=jnp.zeros((), bool),
        )
        return state._replace(theta=self.dilatation(state, state.u, rest))


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
    f_ext = external_force(model, configuration)
    fixed, imposed = map(jnp.asarray, (configuration.fixed, configuration.imposed))
    body = EquilibriumProblem(model, fixed, imposed, f_ext, settings)
    keep_going = lambda s: ~s.done & (s.step < settings.max_steps)
    return jax.lax.while_loop(keep_going, body.step, body.start(u0))


def _select(flag, new: NewtonState, old: NewtonState) -> NewtonState:
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)
