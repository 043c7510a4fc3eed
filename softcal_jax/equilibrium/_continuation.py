"""Equilibrium from a good guess, with further solves on Newton's own factors.

After a step of the parameters, x + (dx/dp) dp is close to the new equilibrium, and one
or two full Newton steps reach it. The tangent of the last one then serves twice: for
the Newton step, and for the right-hand sides of the sensitivities.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._element import is_mixed
from softcal_jax.equilibrium._linearisation import Linearisation, linearise
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings, newton
from softcal_jax.equilibrium._problem import (
    Direction,
    EquilibriumProblem,
    Point,
    evaluate,
    external_force,
)
from softcal_jax.equilibrium._solution import EquilibriumSolution
from softcal_jax.equilibrium._solve import as_solution

MAX_QUICK_STEPS = 5
"""Full Newton steps after which a guess was not good."""

CHORDS_FROM = 1e-4
"""Relative residual from which steps on the last factor take the place of Newton's.

One takes an evaluation of the forces and a solve, no assembly and no factorization.
From further away the tangent, which also gives the sensitivities, would be off by more.
"""

MOST_CHORDS = 3
"""Chord steps that may still be to come, each as good as the last.

Where more are, a Newton step follows.
"""

SHORT = 1e-3
"""Relative residual from which the next step needs no foreseen stress.

Newton's method is at home there, and the tangent without it is quicker.
"""


class Continuation(NamedTuple):
    """An equilibrium, and the linear system there.

    Attributes:
        equilibrium: The equilibrium.
        linearisation: The system, on the factors of the last Newton step if possible.
    """

    equilibrium: EquilibriumSolution
    linearisation: Linearisation


class _Quick(NamedTuple):
    """State of the quick steps.

    `before` is where the last one began, or where it ended if it left little
    (`SHORT`); `direction` is the last one on a new factor; `chord` tells that the next
    is on the same, `arrived` that there is nothing left but to factorize once more.
    """

    solution: EquilibriumSolution
    at: Point
    before: Float[Array, "n_points 3"]
    lambda_a: Float[Array, " n_a"]
    direction: Direction
    chord: Bool[Array, ""]
    arrived: Bool[Array, ""]
    step: Int[Array, ""]
    robust: Bool[Array, ""]
    done: Bool[Array, ""]


def continue_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    *,
    settings: NewtonSettings,
    before: Float[Array, "n_points 3"] | None = None,
    precise: bool | Bool[Array, ""] = False,
) -> Continuation:
    """Find the equilibrium near a guess, and keep its last factors for sensitivities.

    Full Newton steps are taken as long as each brings the residual down, the body is
    stable and no tet inverted; otherwise `solve_equilibrium` starts again with all its
    care. The last digits come from steps on the last factor (chord steps). The
    right-hand sides are those of the equilibrium; the tangent is that of the
    displacement before the last Newton step, and off by no more than the way from
    there. (With right-hand sides from there too, a direction of the parameters without
    any effect would seem to have one, as large as that way.)

    Args:
        model: The body.
        configuration: One configuration.
        guess: Displacement close to the equilibrium [m].
        settings: Settings of Newton's method, for the careful solve.
        before: Displacement of an equilibrium from which the guess was extrapolated, to
            first order; it spares a Newton step of a slender body [m].
        precise: Whether one more Newton step is taken, so that the tangent is that of
            the equilibrium.

    Returns:
        The equilibrium and the linear system.
    """
    if not model.solver.counts_negative or is_mixed(
        model.formulation, model.weights.shape[1]
    ):
        # A quick step could end in an unstable state unseen (nobody counts negative
        # eigenvalues of a non-symmetric tangent either); or, in a nearly incompressible
        # body, it hardly ever converges.
        solution = as_solution(newton(model, configuration, guess, settings))
        u, lambda_a = solution.displacement, solution.multipliers
        return Continuation(solution, linearise(model, configuration, u, lambda_a))
    tabulated = model.tabulated()
    body = _Body(tabulated, configuration, settings, precise)
    state = jax.lax.while_loop(lambda s: ~s.done, body.step, body.start(guess, before))
    u, lambda_a = state.solution.displacement, state.solution.multipliers
    linearisation = Linearisation(
        unknowns=body.problem.unknowns(jnp.ones((), guess.dtype)),
        u=u,
        lambda_a=lambda_a,
        system=state.direction.system,
        regular=state.direction.ok,
        factorized=True,
    )
    return Continuation(state.solution, linearisation)


class _Body(NamedTuple):
    """One configuration while it is continued."""

    model: Model
    configuration: ConfigurationArrays
    settings: NewtonSettings
    precise: bool | Bool[Array, ""]

    @property
    def problem(self) -> EquilibriumProblem:
        """The parts of a Newton iteration."""
        f_ext = external_force(self.model, self.configuration)
        return EquilibriumProblem(
            self.model, self.configuration, f_ext, self.settings.rtol
        )

    def start(self, guess: Float[Array, "n_points 3"], before) -> _Quick:
        """State before the first step; held nodes go where they are held."""
        one = jnp.ones((), guess.dtype)
        unknowns = self.problem.unknowns(one)
        rigid = unknowns.rigid(guess)
        at = evaluate(self.model, unknowns.held_at(rigid))
        usable = at.finite & (at.min_det_F > 0.0)
        # A support that moved, or nothing but rest to start from: with care.
        usable = usable & ~jnp.any(unknowns.imposed(rigid) != 0.0)
        usable = usable & jnp.any(guess != 0.0)
        lambda_a = jnp.zeros_like(at.delta_a)
        if self.problem.has_multipliers:
            lambda_a = self.problem.estimated_forces(at, one)
        count, real = jnp.zeros((), jnp.int32), jnp.zeros((), guess.dtype)
        solution = EquilibriumSolution(
            at.u,
            lambda_a,
            RESULTS.max_steps,
            count,
            count,
            real + 1.0,
            real + jnp.inf,
            at.min_det_F,
            count,
        )
        no = jnp.zeros((), bool)
        before = at.u if before is None else before
        before = jnp.where(self.residual(at, lambda_a) <= SHORT, at.u, before)
        none = jax.eval_shape(self.newton_step, at, lambda_a, before)
        return _Quick(
            solution,
            at,
            before,
            lambda_a,
            jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), none),
            no,
            no,
            count,
            ~usable,
            no,
        )

    def careful(self, s: _Quick) -> tuple[EquilibriumSolution, Point, Array]:
        """Newton with line search and load steps, from the state's displacement."""
        state = newton(self.model, self.configuration, s.at.u, self.settings)
        return as_solution(state), state.at, state.lambda_a

    def residual(self, at: Point, lambda_a):
        """Out-of-balance forces, relative to all; gaps of actuators do not count."""
        one, no_gap = jnp.ones((), at.u.dtype), jnp.zeros_like(lambda_a)
        merit = self.problem.merit(at, lambda_a, one, no_gap)
        return self.problem.relative(merit, at, lambda_a, one, jnp.zeros_like(one))

    def newton_step(self, at: Point, lambda_a, before) -> Direction:
        """A Newton step on a factor of its own."""
        one = jnp.ones((), at.u.dtype)
        strict = jnp.zeros((), bool)
        return self.problem.direction(
            at, jnp.zeros_like(one), lambda_a, one, strict, before
        )

    def chord_step(self, s: _Quick) -> Direction:
        """A step on the factor of the last Newton step; imposes no displacements."""
        one = jnp.ones((), s.at.u.dtype)
        g, _ = self.problem.unbalanced(s.at, s.lambda_a, one)
        rhs = -self.problem.on_unknowns(s.at.u, one, g)
        d = self.model.solver.solve_again(s.direction.system.values, rhs[None])[0]
        return s.direction._replace(d=d, d_lambda=jnp.zeros_like(s.lambda_a))

    def step(self, s: _Quick) -> _Quick:
        """A full Newton step, after a careful solve if one is due; or a chord step."""
        solution, at, lambda_a = jax.lax.cond(
            s.robust, self.careful, lambda s: (s.solution, s.at, s.lambda_a), s
        )
        was_careful, problem, rtol = s.robust, self.problem, self.settings.rtol
        one = jnp.ones((), at.u.dtype)
        before = jnp.where(was_careful, at.u, s.before)
        newton_step = lambda: self.newton_step(at, lambda_a, before)
        if problem.has_multipliers:
            direction = newton_step()
        else:
            direction = jax.lax.cond(s.chord, lambda: self.chord_step(s), newton_step)
        # A careful solution is one already.
        step = jnp.where(was_careful, 0.0, 1.0)
        new_u = problem.unknowns(one).move(at.u, step * direction.d)
        new = evaluate(self.model, new_u)
        new_lambda = direction.lambda_a + step * direction.d_lambda
        merit = problem.merit(new, new_lambda, one, direction.gap_stiffness)
        residual = problem.relative(merit, new, new_lambda, one, direction.stiffness)
        stable = direction.ok & (direction.n_negative == 0) & (new.min_det_F > 0.0)
        sound = stable & jnp.isfinite(new.energy) & jnp.isfinite(residual)
        arrived = sound & (residual <= rtol)
        falls = residual <= solution.residual
        n_newton = s.step + (~s.chord).astype(s.step.dtype)
        contracts = s.chord | (sound & falls & (n_newton < MAX_QUICK_STEPS))
        last = arrived & (s.arrived | ~jnp.asarray(self.precise))
        quick = EquilibriumSolution(
            new_u,
            new_lambda,
            RESULTS.converged,
            solution.steps + (~s.chord).astype(solution.steps.dtype),
            jnp.ones_like(s.step),
            jnp.ones_like(residual),
            residual,
            new.min_det_F,
            direction.n_negative,
        )
        taken = ~was_careful & sound & (falls | ~s.chord)
        # How the residual falls tells how it goes on.
        to_come = residual * (residual / solution.residual) ** MOST_CHORDS
        close = jnp.where(s.chord, to_come <= rtol, residual <= CHORDS_FROM)
        chord = taken & ~arrived & close
        pick = lambda a, b: jnp.where(taken, a, b)
        solution = jax.tree.map(pick, quick, solution)
        done = was_careful | last
        return _Quick(
            solution,
            jax.tree.map(pick, new, at),
            jnp.where(taken & (self.residual(new, new_lambda) <= SHORT), new_u, at.u),
            pick(new_lambda, lambda_a),
            direction,
            chord,
            arrived,
            n_newton,
            ~was_careful & ~arrived & ~contracts,
            done,
        )
