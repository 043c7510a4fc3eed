"""Equilibrium from a good guess, with further solves on Newton's own factors.

After a step of the parameters, x + (dx/dp) dp is close to the new equilibrium, and one
or two full Newton steps reach it. The tangent of the last one then serves twice: for
the Newton step, and for the right-hand sides of the sensitivities.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._assembly import energy_and_force, tangent_values
from softcal_jax.equilibrium._element import is_mixed
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import (
    EquilibriumProblem,
    NewtonSettings,
    external_force,
    mask_supports,
    newton,
    product,
)
from softcal_jax.equilibrium._solve import (
    EquilibriumSolution,
    as_solution,
    factor_solve,
)

MAX_QUICK_STEPS = 4
"""Full Newton steps after which a guess was not good."""

CONTRACTION = 0.3
"""Factor by which each of them must bring the residual down [-]."""

SAME_MATRIX = 1e-6
"""Largest relative residual with which a solution is one of the given matrix [-]."""

RightHandSides = Callable[[Float[Array, "n_nodes 3"]], Float[Array, "n_rhs n_nodes 3"]]


class Continuation(NamedTuple):
    """An equilibrium, and further solutions with its tangent.

    Attributes:
        equilibrium: The equilibrium.
        x: K^-1 times the right-hand sides, zero on held nodes [m].
        ok: Whether `x` exists.
    """

    equilibrium: EquilibriumSolution
    x: Float[Array, "n_rhs n_nodes 3"]
    ok: Bool[Array, ""]


class _Quick(NamedTuple):
    """State of the full Newton steps."""

    solution: EquilibriumSolution
    force: Float[Array, "n_nodes 3"]
    x: Float[Array, "n_rhs n_nodes 3"]
    ok: Bool[Array, ""]
    step: Int[Array, ""]
    robust: Bool[Array, ""]
    done: Bool[Array, ""]


def continue_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_nodes 3"],
    right_hand_sides: RightHandSides,
    *,
    settings: NewtonSettings,
    rtol: float,
    transpose: bool = False,
) -> Continuation:
    """Equilibrium near a guess, and K^-1 of further right-hand sides.

    Full Newton steps are taken as long as each brings the residual down, the body is
    stable and no tet inverted; otherwise `solve_equilibrium` starts again with all its
    care. The right-hand sides are those of the equilibrium; the tangent is that of the
    displacement before the last Newton step, and off by no more than that step. (With
    right-hand sides from there too, a direction of the parameters without any effect
    would seem to have one, as large as that step.)

    Args:
        model: The body.
        configuration: One configuration.
        guess: Displacement close to the equilibrium [m].
        right_hand_sides: Nodal forces as a function of the displacement [N].
        settings: Settings of Newton's method, for the careful solve.
        rtol: Relative residual at which the quick steps stop [-].
        transpose: Take K^-T for the right-hand sides, for an adjoint.

    Returns:
        The equilibrium and the solutions.
    """
    if not model.solver.counts_negative or is_mixed(
        model.formulation, model.weights.shape[1]
    ):
        # A quick step could end in an unstable state unseen (nobody counts negative
        # eigenvalues of a non-symmetric tangent either); or, in a nearly incompressible
        # body, it hardly ever converges.
        solution = as_solution(newton(model, configuration, guess, settings))
        solved = factor_solve(
            model,
            configuration,
            solution.displacement,
            right_hand_sides(solution.displacement),
            transpose=transpose,
        )
        return Continuation(solution, solved.x, solved.ok)
    body = _Body(model, configuration, right_hand_sides, settings, rtol)
    state = jax.lax.while_loop(lambda s: ~s.done, body.step, body.start(guess))
    return Continuation(state.solution, state.x, state.ok)


class _Body(NamedTuple):
    """One configuration while it is continued."""

    model: Model
    configuration: ConfigurationArrays
    right_hand_sides: RightHandSides
    settings: NewtonSettings
    rtol: float

    def start(self, guess: Float[Array, "n_nodes 3"]) -> _Quick:
        """State before the first step; held nodes go where they are held."""
        fixed = jnp.asarray(self.configuration.fixed)
        u = jnp.where(fixed, jnp.asarray(self.configuration.imposed), guess)
        energy, _, force, det = energy_and_force(self.model, u)
        usable = jnp.isfinite(energy) & jnp.all(jnp.isfinite(force)) & (det > 0.0)
        # A support that moved, or nothing but rest to start from: with care.
        usable = usable & jnp.all(u == guess) & jnp.any(guess != 0.0)
        count, real = jnp.zeros((), jnp.int32), jnp.zeros((), u.dtype)
        solution = EquilibriumSolution(
            u, RESULTS.max_steps, count, count, real + 1.0, real + jnp.inf, det, count
        )
        n_rhs = jax.eval_shape(self.right_hand_sides, u).shape
        return _Quick(
            solution,
            force,
            jnp.zeros(n_rhs, u.dtype),
            jnp.zeros((), bool),
            count,
            ~usable,
            jnp.zeros((), bool),
        )

    def careful(self, s: _Quick) -> tuple[EquilibriumSolution, Array]:
        """Newton with line search and load steps, from the state's displacement."""
        state = newton(
            self.model, self.configuration, s.solution.displacement, self.settings
        )
        return as_solution(state), state.force

    def step(self, s: _Quick) -> _Quick:
        """A full Newton step, after a careful solve if one is due."""
        solution, force = jax.lax.cond(
            s.robust, self.careful, lambda s: (s.solution, s.force), s
        )
        was_careful = s.robust
        u = solution.displacement
        f_ext = external_force(self.model, self.configuration)
        fixed = jnp.asarray(self.configuration.fixed)
        values = tangent_values(self.model, u)
        sparsity = self.model.solver.sparsity
        masked, stiffness = mask_supports(sparsity, values, fixed.ravel())
        unbalanced = jnp.where(fixed, 0.0, f_ext - force)
        solved = self.model.solver.factor_solve(masked, unbalanced.reshape(1, -1))
        # A careful solution is one already.
        du = solved.x[0].reshape(u.shape)
        new_u = jnp.where(was_careful, u, u + du)
        energy, _, new_force, det = energy_and_force(self.model, new_u)
        imposed = jnp.asarray(self.configuration.imposed)
        residual = EquilibriumProblem(
            self.model, fixed, imposed, f_ext, self.settings
        ).relative_residual(new_force, jnp.ones_like(energy), stiffness)
        stable = solved.ok & (solved.n_negative == 0) & (det > 0.0)
        sound = stable & jnp.isfinite(energy) & jnp.isfinite(residual)
        arrived = sound & (residual <= self.rtol)
        contracts = sound & (
            (residual <= CONTRACTION * s.solution.residual) & (s.step < MAX_QUICK_STEPS)
        )
        quick = EquilibriumSolution(
            new_u,
            RESULTS.converged,
            solution.steps + 1,
            jnp.ones_like(s.step),
            jnp.ones_like(residual),
            residual,
            det,
            solved.n_negative,
        )
        taken = ~was_careful & sound
        pick = lambda a, b: jnp.where(taken, a, b)
        solution = jax.tree.map(pick, quick, solution)
        done = was_careful | arrived
        x, ok = jax.lax.cond(
            done,
            lambda u: self.further(masked, u, solved.ok),
            lambda u: (s.x, s.ok),
            solution.displacement,
        )
        return _Quick(
            solution,
            pick(new_force, force),
            x,
            ok,
            s.step + 1,
            ~was_careful & ~arrived & ~contracts,
            done,
        )

    def further(self, masked, u, regular):
        """The further solutions, once the equilibrium is there."""
        rhs = self.right_hand_sides(u)
        rhs = jnp.where(jnp.asarray(self.configuration.fixed)[None], 0.0, rhs)
        b = rhs.reshape(len(rhs), -1)
        ok = regular & jnp.all(jnp.isfinite(b))
        solve = lambda: self.solve_again(masked, b)
        x = jax.lax.cond(ok, solve, lambda: jnp.zeros_like(b))
        return x.reshape(rhs.shape), ok

    def solve_again(self, masked, b: Float[Array, "n_rhs n_dof"]):
        """Solutions on the factors of the last Newton step.

        PARDISO keeps its factors in a place that other programs may write to in
        between; a mixture of all right-hand sides tells, in one product. Then the
        matrix is factorized again.
        """
        solver = self.model.solver
        x = solver.solve_again(masked, b)
        size = jnp.linalg.norm(b, axis=1)
        mix = jnp.where(size > 0.0, 1.0 / size, 0.0)[:, None]
        gap = product(solver.sparsity, masked, jnp.sum(mix * x, axis=0))
        gap = jnp.linalg.norm(gap - jnp.sum(mix * b, axis=0))
        again = lambda: solver.factor_solve(masked, b).x
        return jax.lax.cond(gap <= SAME_MATRIX, lambda: x, again)
