"""Equilibrium from a good guess, with its last factors kept for sensitivities.

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
from softcal_jax.equilibrium._actuation import with_multiplier
from softcal_jax.equilibrium._balance import (
    Point,
    estimated_forces,
    evaluate,
    merit,
    relative,
    unbalanced,
)
from softcal_jax.equilibrium._direction import (
    Factor,
    Step,
    has_volume_unknowns,
    newton_direction,
)
from softcal_jax.equilibrium._linearisation import Linearisation, linearise
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings, newton
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._solution import EquilibriumSolution
from softcal_jax.equilibrium._solve import as_solution

MAX_QUICK_STEPS = 5
"""Full Newton steps after which a guess was not good."""

CHORDS_FROM = 1e-4
"""Relative residual from which steps on the last factor take the place of Newton's.

Each takes an evaluation of the forces and a solve, no assembly and no factorization.
Begun further away, they would leave the sensitivities a tangent that is off by more.
"""

MOST_CHORDS = 3
"""Chord steps that may still be needed, if each reduces the residual like the last.

Where more would be needed, a Newton step follows.
"""

SHORT = 1e-3
"""Relative residual from which the next step needs no foreseen stress.

Newton's method converges quadratically there, and the tangent without the foreseen
stress takes less time.
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

    `before` is where the last step began, or where it ended if it left a small residual
    (`SHORT`); `factor` is that of the last Newton step; `chord` tells that the next
    step is taken on it, `arrived` that nothing is left but to factorize once more.
    """

    solution: EquilibriumSolution
    at: Point
    before: Float[Array, "n_points 3"]
    lambda_a: Float[Array, " n_a"]
    factor: Factor
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
    care. The last digits come from steps on the last factor (chord steps). The state
    of the linear system is the equilibrium; its tangent is that of the displacement
    before the last Newton step, and off by no more than the way from there. (With rows
    of the parameters from there too, a direction without any effect would seem to have
    one, as large as that way.)

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
    if not model.solver.counts_negative or has_volume_unknowns(model):
        # A quick step could end in an unstable state unseen (nobody counts negative
        # eigenvalues of a non-symmetric tangent either); or, in a nearly incompressible
        # body, it hardly ever converges.
        solution = as_solution(newton(model, configuration, guess, settings))
        u, lambda_a = solution.displacement, solution.multipliers
        return Continuation(solution, linearise(model, configuration, u, lambda_a))
    quick = _QuickSteps(Posed.of(model.tabulated(), configuration), settings, precise)
    state = jax.lax.while_loop(
        lambda s: ~s.done, quick.step, quick.start(guess, before)
    )
    linearisation = Linearisation(
        posed=Posed.of(model, configuration),
        u=state.solution.displacement,
        lambda_a=state.solution.multipliers,
        system=state.factor.system,
        regular=state.factor.ok,
        factorized=True,
    )
    return Continuation(state.solution, linearisation)


class _QuickSteps(NamedTuple):
    """Full Newton steps from a guess, and chord steps on the last factor.

    Attributes:
        posed: The configuration, at full load.
        settings: Settings of Newton's method, for the careful solve.
        precise: Whether the tangent has to be that of the equilibrium.
    """

    posed: Posed
    settings: NewtonSettings
    precise: bool | Bool[Array, ""]

    @property
    def model(self) -> Model:
        """The model."""
        return self.posed.model

    @property
    def has_multipliers(self) -> bool:
        """Whether forces of actuators may have to be solved for."""
        return with_multiplier(self.model).size > 0

    def start(self, guess: Float[Array, "n_points 3"], before) -> _Quick:
        """State before the first step; held nodes go where they are held."""
        posed = self.posed
        rigid = posed.rigid(guess)
        at = evaluate(self.model, posed.held_at(rigid))
        usable = at.finite & (at.min_det_F > 0.0)
        # A support that moved, or nothing but rest to start from: with care.
        usable = usable & ~jnp.any(posed.imposed(rigid) != 0.0)
        usable = usable & jnp.any(guess != 0.0)
        lambda_a = jnp.zeros_like(at.deformed.delta_a)
        if self.has_multipliers:
            lambda_a = estimated_forces(posed, at.deformed)
        count, one = jnp.zeros((), jnp.int32), jnp.ones((), guess.dtype)
        unsolved = EquilibriumSolution(
            displacement=at.u,
            multipliers=lambda_a,
            result=RESULTS.max_steps,
            steps=count,
            load_steps=count,
            load_reached=one,
            residual=jnp.inf * one,
            min_det_F=at.min_det_F,
            n_negative=count,
        )
        no = jnp.zeros((), bool)
        before = at.u if before is None else before
        return _Quick(
            solution=unsolved,
            at=at,
            before=jnp.where(self.residual(at, lambda_a) <= SHORT, at.u, before),
            lambda_a=lambda_a,
            factor=Factor.none(self.model),
            chord=no,
            arrived=no,
            step=count,
            robust=~usable,
            done=no,
        )

    def careful(self, s: _Quick) -> tuple[EquilibriumSolution, Point, Array]:
        """Newton with line search and load steps, from the state's displacement."""
        state = newton(self.model, self.posed.configuration, s.at.u, self.settings)
        return as_solution(state), state.at, state.lambda_a

    def residual(self, at: Point, lambda_a):
        """Out-of-balance forces, relative to all; gaps of actuators do not count."""
        size = merit(self.posed, at.deformed, lambda_a, jnp.zeros_like(lambda_a))
        no_stiffness = jnp.zeros((), at.u.dtype)
        return relative(self.posed, at.deformed, size, no_stiffness, self.settings.rtol)

    def newton_step(self, at: Point, lambda_a, before) -> tuple[Step, Factor]:
        """A Newton step, and its own factor."""
        found = newton_direction(self.posed, at.deformed, lambda_a, before=before)
        return found.step, found.factor

    def chord_step(self, s: _Quick) -> tuple[Step, Factor]:
        """A step on the factor of the last Newton step; imposes no displacements."""
        g, _ = unbalanced(self.posed, s.at.deformed, s.lambda_a)
        rhs = -self.posed.on_free(s.at.u, g)
        d = self.model.solver.solve_again(s.factor.system.values, rhs[None])[0]
        return Step(d, s.lambda_a, jnp.zeros_like(s.lambda_a)), s.factor

    def step(self, s: _Quick) -> _Quick:
        """A full Newton step, after a careful solve if one is due; or a chord step."""
        solution, at, lambda_a = jax.lax.cond(
            s.robust, self.careful, lambda s: (s.solution, s.at, s.lambda_a), s
        )
        was_careful, posed, rtol = s.robust, self.posed, self.settings.rtol
        before = jnp.where(was_careful, at.u, s.before)
        newton_step = lambda: self.newton_step(at, lambda_a, before)
        if self.has_multipliers:
            step, factor = newton_step()
        else:
            step, factor = jax.lax.cond(
                s.chord & ~was_careful, lambda: self.chord_step(s), newton_step
            )
        # A careful solution is an equilibrium already.
        share = jnp.where(was_careful, 0.0, 1.0)
        new = evaluate(self.model, posed.move(at.u, share * step.d))
        new_lambda = step.lambda_a + share * step.d_lambda
        size = merit(posed, new.deformed, new_lambda, factor.gap_stiffness)
        residual = relative(posed, new.deformed, size, factor.stiffness, rtol)
        stable = factor.ok & (factor.n_negative == 0) & (new.min_det_F > 0.0)
        sound = stable & jnp.isfinite(new.energy) & jnp.isfinite(residual)
        arrived = sound & (residual <= rtol)
        falls = residual <= solution.residual
        n_newton = s.step + (~s.chord).astype(s.step.dtype)
        contracts = s.chord | (sound & falls & (n_newton < MAX_QUICK_STEPS))
        last = arrived & (s.arrived | ~jnp.asarray(self.precise))
        quick = EquilibriumSolution(
            displacement=new.u,
            multipliers=new_lambda,
            result=RESULTS.converged,
            steps=solution.steps + (~s.chord).astype(solution.steps.dtype),
            load_steps=jnp.ones_like(s.step),
            load_reached=jnp.ones_like(residual),
            residual=residual,
            min_det_F=new.min_det_F,
            n_negative=factor.n_negative,
        )
        taken = ~was_careful & sound & (falls | ~s.chord)
        # Whether a few chord steps are enough is judged by how the residual falls.
        to_come = residual * (residual / solution.residual) ** MOST_CHORDS
        close = jnp.where(s.chord, to_come <= rtol, residual <= CHORDS_FROM)
        pick = lambda a, b: jnp.where(taken, a, b)
        solution = jax.tree.map(pick, quick, solution)
        done = was_careful | last
        short = self.residual(new, new_lambda) <= SHORT
        return _Quick(
            solution=solution,
            at=jax.tree.map(pick, new, at),
            before=jnp.where(taken & short, new.u, at.u),
            lambda_a=pick(new_lambda, lambda_a),
            factor=factor,
            chord=taken & ~arrived & close,
            arrived=arrived,
            step=n_newton,
            robust=~was_careful & ~arrived & ~contracts,
            done=done,
        )
