"""Newton's method on the potential energy, with line search and load stepping.

Minimises Pi(x) = sum_e V_e psi(F_e) - t (f_ext . u + lambda_a . delta_a) over the free
unknowns, while the load factor t goes from 0 to 1 (paper Eqs. 1-3; equilibrium is a
minimum of Pi when forces are imposed). One state machine in one `while_loop`: an
iteration is a Newton step, and the end of a load step, or its failure, only changes t.
Where no potential exists, or the equilibrium is a saddle because displacements of
actuators are imposed, the line search is on the norm of the residual.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._problem import (
    Direction,
    EquilibriumProblem,
    Point,
    evaluate,
    external_force,
)

_NEAR = 1e-3
"""Residual, in internal forces, of a state whose tangent is that of the next one."""


class NewtonSettings(eqx.Module):
    """Settings of the equilibrium solve; static, so each set compiles once.

    Attributes:
        rtol: Residual at which Newton stops, relative to the largest of external force,
            internal force and reactions [-].
        max_steps: Newton iterations for one configuration, all load steps together.
        max_steps_per_load: Newton iterations after which a load step is cut, unless
            the last one brought the residual down by a factor of ten.
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
    the stopping rule too, is of the body with theta = J_bar(u). `turned` tells whether
    the last trial step turned a tet inside out. `merit_before` is the norm of the
    residual one step ago, for the line search on it; inf at the start of a load step,
    None where the line search is always on the potential.
    """

    at: Point
    theta: Float[Array, "n_blocks block"]
    lambda_a: Float[Array, " n_a"]
    u_ok: Float[Array, "n_points 3"]
    lambda_ok: Float[Array, " n_a"]
    load: Float[Array, ""]
    load_ok: Float[Array, ""]
    increment: Float[Array, ""]
    step: Int[Array, ""]
    step_in_load: Int[Array, ""]
    load_steps: Int[Array, ""]
    merit_before: Float[Array, ""] | None
    residual: Float[Array, ""]
    n_negative: Int[Array, ""]
    any_singular: Bool[Array, ""]
    turned: Bool[Array, ""]
    result: RESULTS
    done: Bool[Array, ""]


class _Trial(NamedTuple):
    """A point along a Newton step."""

    at: Point
    lambda_a: Float[Array, " n_a"]
    merit: Float[Array, ""]
    good: Bool[Array, ""]


@dataclass(frozen=True, eq=False)  # JAX caches its methods by identity
class NewtonLoop:
    """The iterations of one configuration."""

    body: EquilibriumProblem
    settings: NewtonSettings

    @property
    def model(self) -> Model:
        """The model."""
        return self.body.model

    def strict(self, s: NewtonState):
        """Whether only steps that lower Pi are taken."""
        if not self.model.solver.counts_negative:
            # Nobody would notice that full steps had ended in an unstable state.
            return jnp.ones((), bool)
        return s.increment < self.settings.strict_below

    @property
    def _always_potential(self) -> bool:
        return self.model.conservative and not self.body.has_multipliers

    def remembered(self, merit):
        """Norm of a residual, kept only where the line search may need it."""
        return None if self._always_potential else jnp.asarray(merit)

    def potential(self, at: Point, load):
        """Pi at a point, and the scale of its rounding [J]."""
        f_ext = self.body.f_ext
        work = load * f_ext * at.u
        value, scale = at.energy - jnp.sum(work), at.energy_scale
        scale = scale + jnp.sum(jnp.abs(work))
        forces = self.body.configuration.actuation.forces
        of_actuators = load * forces * at.delta_a
        value = value - jnp.sum(of_actuators)
        return value, scale + jnp.sum(jnp.abs(of_actuators))

    def lower_potential(self, s: NewtonState, direction: Direction):
        """Test of a trial step: whether Pi has gone down enough (Armijo)."""
        before, scale = self.potential(s.at, s.load)
        slope, d = direction.slope, direction.d

        def test(alpha, at, lambda_a, merit):
            del merit
            new, new_scale = self.potential(at, s.load)
            armijo = new <= before + 1e-4 * alpha * slope
            # Near the solution Pi changes by less than its own rounding, and the slope
            # decides (approximate Wolfe condition of Hager and Zhang, SIAM J. Optim.
            # 16, 2005).
            g, _ = self.body.unbalanced(at, lambda_a, s.load)
            slope_new = jnp.sum(self.body.on_unknowns(at.u, s.load, g) * d)
            flat = (slope_new <= 0.8 * jnp.abs(slope)) & (
                new <= before + 1e-6 * (scale + new_scale)
            )
            return armijo | flat

        return test

    def lower_residual(self, s: NewtonState, direction: Direction):
        """Test of a trial step: whether the residual has gone down enough.

        Below the larger of the last two, which a Newton direction always can (Grippo,
        Lampariello and Lucidi, SIAM J. Numer. Anal. 23, 1986), and the first step of a
        load step is free: a rotation that the step completes only to first order
        stretches a slender body, so its residual rises by orders of magnitude and
        falls again one step later. Monotone descent creeps already under own weight.
        """
        assert s.merit_before is not None
        now = self.body.merit(s.at, direction.lambda_a, s.load, direction.gap_stiffness)
        reference = jnp.maximum(s.merit_before, now)

        def test(alpha, at, lambda_a, merit):
            del at, lambda_a
            return merit <= (1.0 - 1e-4 * alpha) * reference

        return test

    def lower(self, s: NewtonState, direction: Direction):
        """The test that suits what is imposed."""
        if not self.model.conservative:
            return self.lower_residual(s, direction)
        if self._always_potential:
            return self.lower_potential(s, direction)
        saddle = jnp.any(self.body.by_multiplier())
        residual = self.lower_residual(s, direction)
        potential = self.lower_potential(s, direction)

        def test(alpha, at, lambda_a, merit):
            return jnp.where(
                saddle,
                residual(alpha, at, lambda_a, merit),
                potential(alpha, at, lambda_a, merit),
            )

        return test

    def line_search(self, s: NewtonState, direction: Direction) -> _Trial:
        """Backtrack until the step passes the test and all is finite.

        Full steps are taken first, downhill or not: the first step of a large rotation
        always raises Pi, and of a nearly incompressible body by orders of magnitude; a
        strict search then creeps. They are only trusted
        when they end in a stable state; see `step`.
        """
        lower, moving = self.lower(s, direction), direction.moving

        def trial(alpha):
            u = self.body.unknowns(s.load).swing(s.at.u, alpha * direction.d)
            at = evaluate(self.model, u)
            lambda_a = direction.lambda_a + alpha * direction.d_lambda
            merit = self.body.merit(at, lambda_a, s.load, direction.gap_stiffness)
            enough = lower(alpha, at, lambda_a, merit)
            # Some laws survive a tet turned inside out, and then hardly find back. A
            # support that goes too far is cut short like a load.
            inside_out = (at.min_det_F <= 0.0) & (s.at.min_det_F > 0.0)
            inside_out = inside_out & (~moving | ~self.strict(s))
            good = (enough | moving | ~self.strict(s)) & at.finite & ~inside_out
            return _Trial(at, lambda_a, merit, good)

        def keep_trying(carry):
            _, backtracks, tried = carry
            return ~tried.good & (backtracks < self.settings.max_backtracks) & ~moving

        def halve(carry):
            alpha, backtracks, _ = carry
            return 0.5 * alpha, backtracks + 1, trial(0.5 * alpha)

        start = (direction.reach, 0, trial(direction.reach))
        return jax.lax.while_loop(keep_trying, halve, start)[2]

    def step(self, s: NewtonState) -> NewtonState:
        """One Newton iteration, and what follows from it for the load."""
        direction = self.body.direction(
            s.at, s.theta, s.lambda_a, s.load, self.strict(s)
        )
        downhill = jnp.ones((), bool)
        if self.model.conservative:  # otherwise it always points down the residual
            saddle = jnp.any(self.body.by_multiplier())
            downhill = direction.moving | (direction.slope <= 0.0) | ~self.strict(s)
            downhill = downhill | saddle
        tried = self.line_search(s, direction)
        good = tried.good & direction.ok & downhill
        residual = self.body.relative(
            tried.merit, tried.at, tried.lambda_a, s.load, direction.stiffness
        )
        residual = jnp.where(good, residual, jnp.inf)
        before_step = s.residual
        s = s._replace(
            step=s.step + 1,
            step_in_load=s.step_in_load + 1,
            n_negative=direction.n_negative,
            any_singular=~direction.ok,
            # A singular tangent gives no step; the ones before it tell why.
            turned=jnp.where(direction.ok, tried.at.min_det_F <= 0.0, s.turned),
        )
        before = self.body.merit(
            s.at, direction.lambda_a, s.load, direction.gap_stiffness
        )
        # Where one step went all the way, as in a strut under an axial force, the
        # tangent was that of another state: look at that of this one, and stay.
        near = before <= _NEAR * jnp.linalg.norm(tried.at.force)
        near = near | (direction.n_negative < 0)
        stay = (s.residual <= self.settings.rtol) & (s.step_in_load > 1)
        good, near = good | (stay & direction.ok), near | stay
        residual = jnp.where(stay, s.residual, residual)
        tried = _select(stay, tried._replace(at=s.at, lambda_a=s.lambda_a), tried)
        u, du = s.at.u, tried.at.u - s.at.u
        moved = s._replace(
            at=tried.at,
            lambda_a=tried.lambda_a,
            merit_before=self.remembered(before),
            residual=residual,
            theta=self.body.dilatation(s.theta, u, du),
        )
        settled = residual <= self.settings.rtol
        astray = settled & near & self.suspicious(s, tried.at.min_det_F)
        good, converged = good & ~astray, settled & near & ~astray
        # A step that is closing in is not cut short of its end.
        closing = residual < 0.1 * before_step
        out_of_steps = s.step_in_load >= self.settings.max_steps_per_load
        failed = ~good | (~settled & out_of_steps & ~closing)
        s = _select(good, moved, s)
        s = _select(converged, self.next_load(s), s)
        return jax.lax.cond(failed, self.back, lambda s: s, s)

    def suspicious(self, s: NewtonState, det):
        """Whether full steps may have jumped; load stepping then finds the path.

        To a saddle, where negative eigenvalues show it, or past a tet turned inside
        out, which some laws survive.
        """
        jumped = (det <= 0.0) & (s.increment >= self.settings.strict_below)
        if self.model.conservative:
            jumped = jumped | ((s.n_negative > 0) & ~self.strict(s))
        return jumped

    def next_load(self, s: NewtonState) -> NewtonState:
        """Keep an equilibrium; raise the load, or finish."""
        increment = jnp.minimum(2.0 * s.increment, 1.0 - s.load)
        finished = s.load >= 1.0
        sound = s.at.min_det_F > 0.0
        outcome = RESULTS.where(sound, RESULTS.converged, RESULTS.inverted)
        outcome = RESULTS.where(s.n_negative > 0, RESULTS.unstable, outcome)
        return s._replace(
            u_ok=s.at.u,
            lambda_ok=s.lambda_a,
            load_ok=s.load,
            load=jnp.minimum(s.load + increment, 1.0),
            increment=increment,
            merit_before=self.remembered(jnp.inf),
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
        why = RESULTS.where(s.turned, RESULTS.inverted, why)
        return s._replace(
            at=evaluate(self.model, s.u_ok),
            theta=self.body.dilatation(s.theta, s.u_ok, jnp.zeros_like(s.u_ok)),
            lambda_a=s.lambda_ok,
            load=s.load_ok + increment,
            increment=increment,
            merit_before=self.remembered(jnp.inf),
            step_in_load=jnp.zeros_like(s.step),
            result=RESULTS.where(give_up, why, s.result),
            done=give_up,
        )

    def start(self, u0: Float[Array, "n_points 3"]) -> NewtonState:
        """State before the first iteration, at full load."""
        zero, one = jnp.zeros((), u0.dtype), jnp.ones((), u0.dtype)
        rest, count = jnp.zeros_like(u0), jnp.zeros((), jnp.int32)
        guess = evaluate(self.model, self.body.unknowns(one).rigid(u0))
        # A guess with inverted tets or infinite energy is worth less than rest.
        usable = guess.finite & (guess.min_det_F > 0.0)
        none = jnp.zeros(self.model.mechanism.n_actuators)
        delta_a = none - self.model.mechanism.motor_zero
        at = _select(usable, guess, Point(rest, zero, zero, rest, delta_a, one))
        lambda_a = none
        if self.body.has_multipliers:
            warm = jnp.any(at.u != 0.0)
            lambda_a = jnp.where(warm, self.body.estimated_forces(at, one), 0.0)
        state = NewtonState(
            at=at,
            theta=zero,
            lambda_a=lambda_a,
            u_ok=rest,
            lambda_ok=none,
            load=one,
            load_ok=zero,
            increment=one,
            step=count,
            step_in_load=count,
            load_steps=count,
            merit_before=self.remembered(jnp.inf),
            residual=jnp.full_like(zero, jnp.inf),
            n_negative=count,
            any_singular=jnp.zeros((), bool),
            turned=jnp.zeros((), bool),
            result=RESULTS.max_steps,
            done=jnp.zeros((), bool),
        )
        return state._replace(theta=self.body.dilatation(zero, at.u, rest))


def newton(
    model: Model,
    configuration: ConfigurationArrays,
    u0: Float[Array, "n_points 3"],
    settings: NewtonSettings,
) -> NewtonState:
    """Solve one configuration from the guess `u0`, at full load first.

    A guess that does not lead to the solution at full load is dropped, and load
    stepping begins from rest.
    """
    model = model.tabulated()
    f_ext = external_force(model, configuration)
    body = EquilibriumProblem(model, configuration, f_ext, settings.rtol)
    loop = NewtonLoop(body, settings)
    keep_going = lambda s: ~s.done & (s.step < settings.max_steps)
    return jax.lax.while_loop(keep_going, loop.step, loop.start(u0))


def _select(flag, new, old):
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)
