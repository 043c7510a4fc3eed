"""Equilibrium from another one that is known: from near by, or over what is between.

After a step of the parameters, x + (dx/dp) dp is close to the new equilibrium, and one
or two full Newton steps reach it; the last factors are kept for sensitivities.

The way between configurations: at the share s of the way from a configuration a to b,
loads, imposed motions and actuation are a + s (b - a). Each state begins where a
parabola through the last three leads: what turns far moves on a curve, and the tangent
alone would stretch it. Steps grow where few iterations are needed, and are halved where
Newton's method fails. What stops the straight way may lie beside a detour.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.distance import cdist

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._assembly import no_strains, predict, tangent_values
from softcal_jax.equilibrium._balance import (
    Point,
    Residual,
    estimated_forces,
    evaluate,
    merit,
    nodal_tangent,
    relative,
    unbalanced,
    zeros_of,
)
from softcal_jax.equilibrium._direction import (
    Factor,
    Step,
    newton_direction,
)
from softcal_jax.equilibrium._element import Strains
from softcal_jax.equilibrium._linearisation import Linearisation
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._newton import NEAR, NewtonSettings
from softcal_jax.equilibrium._path import WANTED_ITERATIONS
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._solve import EquilibriumSolution

_SMALLEST = 1.0 / 64.0  # step below which the way counts as ended [-]
_PARABOLA = 3  # states that the next one is extrapolated from


class Known(NamedTuple):
    """A configuration without effectors, and its equilibrium [m]."""

    configuration: ConfigurationArrays
    displacement: Nodal


class Approach(NamedTuple):
    """How far a way led [-], the equilibrium at its end, and Newton iterations."""

    share: float
    solution: EquilibriumSolution | None
    steps: int


def unloaded(configuration: ConfigurationArrays) -> Known:
    """Return the state at rest: nothing acts, and nothing that is held is moved."""
    loads = lambda c: (
        c.imposed,
        c.springs.rest,
        c.loads.force,
        c.loads.offset,
        c.gravity,
        c.actuation.value,
    )
    zeros = tuple(np.zeros(np.shape(leaf)) for leaf in loads(configuration))
    rest = eqx.tree_at(loads, configuration, zeros)
    return Known(rest, jax.device_put(np.zeros(np.shape(configuration.imposed))))


def distances(configurations: Sequence[ConfigurationArrays]) -> Float[HostArray, "n n"]:
    """Compute by how much what acts and is imposed differs [-].

    A number counts per the largest of its kind, an array by its root mean square. It is
    infinite where other coordinates are held, or actuators are imposed otherwise.
    """
    squares = np.zeros((len(configurations),) * 2)
    acting = lambda c: jax.tree.leaves(eqx.tree_at(_own, c, (None,) * 4))
    for leaf in zip(*map(acting, configurations), strict=True):
        rows = np.stack([np.ravel(values) for values in leaf])
        rows = rows[:, np.any(rows != rows[0], axis=0)]
        if rows.size == 0:
            continue
        if np.issubdtype(rows.dtype, np.floating):
            rows /= np.max(np.abs(rows), axis=0)
            squares += cdist(rows, rows, "sqeuclidean") / rows.shape[1]
        else:
            squares[cdist(rows, rows, "hamming") > 0.0] = np.inf
    return np.sqrt(squares)


def approach(
    at_once: Callable[[ConfigurationArrays, Nodal], EquilibriumSolution],
    known: Known,
    stops: Sequence[ConfigurationArrays],
    *,
    first: float,
    most: int,
    report: Callable[[float, int], None],
) -> Approach:
    """Follow the way from a known equilibrium to a configuration.

    Args:
        at_once: Solves a configuration from a guess, without load steps.
        known: Where the way begins.
        stops: Where it turns, and at last where it leads.
        first: First step towards each of them [-].
        most: Newton iterations after which it is given up.
        report: Called before each step with the share of the way, and the iterations.
    """
    from scipy.interpolate import KroghInterpolator  # slow to import

    begun, u, solution, taken = known.configuration, known.displacement, None, 0
    for k, stop in enumerate(stops):
        shares, states, step = [0.0], [np.asarray(u)], first
        while shares[-1] < 1.0:
            way = (k + shares[-1]) / len(stops)
            if step < _SMALLEST or taken >= most:
                return Approach(way, None, taken)
            report(way, taken)
            share = shares[-1] + step
            if 1.0 - share < 0.5 * step:  # a short rest costs as much as a step
                share = 1.0
            lane = stop if share == 1.0 else _between(begun, stop, share)
            last = KroghInterpolator(shares[-_PARABOLA:], states[-_PARABOLA:])
            solution = at_once(lane, jax.device_put(last(share)))
            iterations = int(solution.steps)
            taken += iterations
            if not solution.converged:
                step *= 0.5
                continue
            shares.append(share)
            states.append(np.asarray(solution.displacement))
            step *= float(np.clip(WANTED_ITERATIONS / iterations, 0.5, 2.0))
        begun, u = stop, states[-1]
    return Approach(1.0, solution, taken)


def detours(
    a: ConfigurationArrays, b: ConfigurationArrays
) -> list[tuple[ConfigurationArrays, ...]]:
    """List other ways from a to b, by where they turn, and their end.

    Of several actuators that differ, one changes after the other. If loads and
    something else differ, the loads change first, or last.
    """
    of_loads = lambda loads: (loads.force, loads.factor, loads.offset)
    loads = lambda c: (*of_loads(c.loads), c.gravity, c.tilt)
    start, end = (np.asarray(c.actuation.value) for c in (a, b))
    order = np.cumsum(start != end)
    inputs = [np.where(order <= k, end, start) for k in range(1, order.max(initial=0))]
    own = lambda c: (*_own(c), *loads(c))
    turns = [
        [eqx.tree_at(lambda c: c.actuation.value, b, value) for value in inputs],
        [eqx.tree_at(own, a, own(b))],
        [eqx.tree_at(loads, b, loads(a))],
    ]
    differ = lambda turn: np.all(distances([a, b, turn])[2, :2] > 0.0)
    return [(*jax.device_put(way), b) for way in turns if way and all(map(differ, way))]


def _between(
    a: ConfigurationArrays, b: ConfigurationArrays, share: float
) -> ConfigurationArrays:
    """Return a configuration between two that hold and impose the same.

    Friction remembers on the way what it does at its end.
    """

    def blend(a: Array | HostArray, b: Array | HostArray) -> HostArray:
        a, b = np.asarray(a), np.asarray(b)  # on the device, each shape is compiled
        return a + share * (b - a) if np.issubdtype(b.dtype, np.floating) else b

    between = eqx.tree_at(_own, jax.tree.map(blend, a, b), _own(b))
    return jax.device_put(between)


def _own(c: ConfigurationArrays):
    """Return what does not act: names, and what friction remembers."""
    return c.key, c.after, c.stages, c.is_stage


FORESEEN = 0.25
"""Largest distance of a held node from where the guess moved it, over the largest
motion of the guess, which turns bodies along straight lines [-]."""

MAX_QUICK_STEPS = 5  # full Newton steps after which the guess counts as bad

CHORDS_FROM = 1e-3
"""Relative residual below which chord steps replace Newton steps.

A chord step costs one evaluation of the forces and one solve. Starting them earlier
would leave a less accurate tangent to the sensitivities.
"""

MOST_CHORDS = 3
"""Most chord steps that may remain at the last rate; else take a Newton step."""

REFINEMENTS = 3
"""Refinements that a solution takes with the factor of one Newton step before."""

SHARP = 1e-6
"""Relative residual below which the tangent is as good as that of the equilibrium.

The relative error of the tangent and the sensitivities is then as small, far below that
of any data. Above this residual, the tangent is assembled once more at the end.
"""


class _Quick(NamedTuple):
    """State of the quick steps; nothing was solved before the first of them.

    `residual` and `steps` are those of the last step that was taken. A Newton step
    takes the strains that are predicted along `du` from `u`, where they were `strains`
    (or, if `was_exact`, those of u). If `exact`, as where the residual is small, see
    `NEAR`, or the guess was not extrapolated, it takes those of the point. `sharp`
    tells whether the residual is below `SHARP`. `factor` belongs to the last Newton
    step; with `chord` the next step reuses it. `arrived`: in equilibrium, but the
    tangent may still be that of an earlier state; `converged`: and that step was taken.
    """

    point: Point
    lambda_a: Float[Array, " n_a"]
    residual: Residual
    steps: Int[Array, ""]
    n_negative: Int[Array, ""]
    converged: Bool[Array, ""]
    strains: Strains
    was_exact: Bool[Array, ""]
    u: Nodal
    du: Nodal
    exact: Bool[Array, ""]
    sharp: Bool[Array, ""]
    factor: Factor
    chord: Bool[Array, ""]
    arrived: Bool[Array, ""]
    done: Bool[Array, ""]


@eqx.filter_jit
def continue_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    guess: Nodal,
    *,
    settings: NewtonSettings,
    before: Nodal | None = None,
    precise: bool | Bool[Array, ""] = False,
    rows: int = 1,
) -> tuple[EquilibriumSolution, Linearisation]:
    """Find the equilibrium near a guess, and the linear system there.

    Full Newton steps are taken (only one from rest) as long as each reduces the
    residual, the state is stable and no tet is inverted. Otherwise the solution is not
    converged; from a solution of `solve_equilibrium`, one step is enough. Only one step
    is taken if the solver does not count negative eigenvalues, because several could
    end in an unstable state unnoticed.

    The last digits come from steps on the last factor (chord steps). The linear system
    is stated at the equilibrium, but its tangent is that before the last Newton step,
    so its error is of the order of that step. If `precise`, it is assembled once more.
    `rows` is the number of right-hand sides that the caller will solve for: where
    refining them with the last factor would take longer, it is factorized, too. (Rows
    of parameters are always those at the equilibrium, or a direction without effect
    would seem to have one.)

    `before` is the equilibrium from which the guess was extrapolated to first order; it
    saves slender robots a Newton step [m].
    """
    posed = Posed.of(model, configuration)
    # From rest, several steps could end on another branch.
    several = model.solver.counts_negative & jnp.any(guess != 0.0)
    most = jnp.where(several, MAX_QUICK_STEPS, 1)
    tabulated = posed._replace(model=posed.model.tabulated())
    quick = _QuickSteps(tabulated, settings, most, precise, rows)
    start = quick.start(guess, before)
    state = jax.lax.while_loop(lambda s: ~s.done, quick.step, start)
    u, lambda_a = state.point.u, state.lambda_a
    # Without an equilibrium, no displacement may be mistaken for one.
    or_nan = lambda a: jnp.where(state.converged, a, jnp.nan)
    solution = EquilibriumSolution(
        displacement=or_nan(u),
        multipliers=or_nan(lambda_a),
        result=RESULTS.where(state.converged, RESULTS.converged, RESULTS.max_steps),
        steps=state.steps,
        load_steps=jnp.minimum(state.steps, 1),
        load_reached=jnp.minimum(state.steps, 1).astype(u.dtype),
        residual=state.residual.size,
        rounding=state.residual.rounding,
        at_rounding=state.residual.at_rounding(settings.rtol),
        min_det_F=state.point.min_det_F,
        n_negative=state.n_negative,
        approached=or_nan(jnp.ones_like(state.residual.size)),
        along_path=or_nan(jnp.ones_like(state.residual.size)),
        contacts=jnp.full((len(posed.contacts.touched), 5), jnp.nan, float),
        touched=posed.contacts.touched,
    )
    return solution, Linearisation(
        posed=posed,
        point=state.point,
        lambda_a=lambda_a,
        # Compiled only for inputs that move something held, and readings of forces.
        nodal=nodal_tangent(posed, u, lambda_a, tangent_values(quick.model, u)),
        system=state.factor.system,
        regular=state.factor.ok,
        near=True,
    )


class _QuickSteps(NamedTuple):
    """Full Newton steps from a guess, and chord steps on the last factor."""

    posed: Posed
    settings: NewtonSettings
    most: Int[Array, ""]
    precise: bool | Bool[Array, ""]
    rows: int

    @property
    def model(self) -> Model:
        return self.posed.model

    def start(self, guess: Nodal, before) -> _Quick:
        posed = self.posed
        rigid = posed.rigid(guess)
        held = posed.held_at(rigid)
        point = evaluate(self.posed, held)
        usable = point.finite & (point.min_det_F > 0.0)
        lambda_a = estimated_forces(posed, point)
        no, count = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
        size = self.residual(point, lambda_a)
        # Along straight lines, as the guess was extrapolated.
        du = jnp.zeros_like(guess) if before is None else guess - before
        # After a support that the guess did not move, only the careful solve is safe.
        gap = jnp.max(jnp.abs(posed.motion(rigid, held)))
        usable = usable & (gap <= FORESEEN * jnp.max(jnp.abs(du)))
        still = ~jnp.any(du != 0.0)
        strains, exact = no_strains(self.model), (size <= NEAR) | still
        return _Quick(
            point=point,
            lambda_a=lambda_a,
            residual=Residual(jnp.full_like(size, jnp.inf), jnp.zeros_like(size)),
            steps=count,
            n_negative=count,
            converged=no,
            strains=strains,
            was_exact=~no,
            u=point.u if before is None else before,
            du=du,
            exact=exact,
            sharp=size <= SHARP,
            # Nothing yet, and not ok.
            factor=zeros_of(
                lambda: self.newton_step(point, lambda_a, strains, exact, None)[1]
            ),
            chord=no,
            arrived=no,
            done=~usable,
        )

    def residual(self, point: Point, lambda_a):
        """Compute the relative out-of-balance force, without gaps of actuators."""
        size = merit(self.posed, point, lambda_a, jnp.zeros_like(lambda_a))
        return relative(self.posed, point, size, jnp.zeros((), point.u.dtype)).size

    def newton_step(
        self, point: Point, lambda_a, strains, exact, near
    ) -> tuple[Step, Factor]:
        direction = newton_direction(
            self.posed,
            point,
            lambda_a,
            strains=strains,
            exact=exact,
            placed=True,
            near=near,
        )
        return direction.step, direction.factor

    def chord_step(self, s: _Quick) -> tuple[Step, Factor]:
        g, _ = unbalanced(self.posed, s.point, s.lambda_a)
        rhs = -self.posed.on_free(s.point.u, g)
        d = self.model.solver.solve_again(s.factor.system.values, rhs[None])[0]
        return Step(d, s.lambda_a, jnp.zeros_like(s.lambda_a)), s.factor

    def step(self, s: _Quick) -> _Quick:
        """Take a Newton step, with a new factor unless `arrived`, or a chord step."""
        posed, rtol, last = self.posed, self.settings.rtol, s.residual
        strains, usable = jax.lax.cond(
            s.exact,
            lambda: (s.strains, jnp.ones((), bool)),
            lambda: predict(self.model, s.u, s.du, s.strains, s.was_exact),
        )
        exact = s.exact | ~usable
        # Each solve has a right-hand side for each imposed displacement, too.
        solves = REFINEMENTS * (1 + self.rows + 2 * self.model.with_multiplier.size)
        near = s.arrived & (self.model.solver.solves_per_factor >= solves)
        newton_step = lambda: self.newton_step(
            s.point, s.lambda_a, strains, exact, near
        )
        if self.model.with_multiplier.size > 0:
            step, factor = newton_step()
        else:
            step, factor = jax.lax.cond(
                s.chord, lambda: self.chord_step(s), newton_step
            )
        # Negative eigenvalues are counted when a new matrix is factorized.
        counted = jnp.where(s.arrived, s.factor.n_negative, factor.n_negative)
        factor, anew = factor._replace(n_negative=counted), ~s.chord & ~s.arrived
        new = evaluate(posed, posed.move(s.point.u, step.d))
        new_lambda = step.lambda_a + step.d_lambda
        size = merit(posed, new, new_lambda, factor.gap_stiffness)
        residual = relative(posed, new, size, factor.stiffness)
        # Without that count, the guess is an equilibrium or the step is wasted.
        stable = factor.ok & (factor.n_negative <= 0) & (new.min_det_F > 0.0)
        sound = stable & jnp.isfinite(new.energy) & jnp.isfinite(residual.size)
        sound = sound & ~posed.passes_through(s.point.u, new.u)
        arrived = sound & residual.settled(rtol)
        falls = residual.size <= last.size
        steps = s.steps + anew.astype(s.steps.dtype)
        contracts = s.chord | (sound & falls & (steps < self.most))
        # The residual says nothing of gaps that actuators still have to close.
        sharp = s.sharp & anew & (self.model.with_multiplier.size == 0)
        done = s.arrived | (arrived & (sharp | ~jnp.asarray(self.precise)))
        taken = sound & (falls | anew)
        # Extrapolate the fall of the residual: will a few chord steps be enough?
        rate = residual.size / last.size
        to_come = residual._replace(size=residual.size * rate**MOST_CHORDS)
        close = jnp.where(s.chord, to_come.settled(rtol), residual.size <= CHORDS_FROM)
        size = self.residual(new, new_lambda)
        old = s.point, s.lambda_a, last, s.steps, s.n_negative, s.converged
        moved = new, new_lambda, residual, steps, factor.n_negative, arrived
        pick = lambda a, b: jnp.where(taken, a, b)
        return _Quick(
            *jax.tree.map(pick, moved, old),
            strains=strains,
            was_exact=exact,
            u=s.point.u,
            du=posed.scatter(s.point.u, step.d),
            exact=~taken | (size <= NEAR),
            sharp=taken & (size <= SHARP),
            factor=factor,
            chord=taken & ~arrived & close,
            arrived=arrived,
            done=done | ~(arrived | contracts),
        )
