"""Newton's method on the potential energy, with line search and load stepping.

Minimises Pi(x) = sum_e V_e psi(F_e) - t (f_ext . u + lambda_a . delta_a) over the free
unknowns, while the load factor t goes from 0 to 1 (paper Eqs. 1-3; equilibrium is a
minimum of Pi when forces are imposed), by steps of a single `while_loop`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import KINDS
from softcal_jax.equilibrium._assembly import no_strains, predict
from softcal_jax.equilibrium._balance import (
    Point,
    Residual,
    at_rest,
    estimated_forces,
    evaluate,
    merit,
    relative,
)
from softcal_jax.equilibrium._direction import line_search, newton_direction
from softcal_jax.equilibrium._element import Strains
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed, turned_by_motors

_HELD_TURN = 1.0
"""Longest rotation of a held body in one load step from rest [rad].

In longer steps Newton's method spends more iterations on crushed tets than it saves.
"""

NEAR = 1e-3
"""Relative residual below which a step hardly moves the tangent.

Negative eigenvalues of the tangent then tell of stability.
"""

STRAIGHT = 0.1
"""Relative residual below which the next step takes the strains of u.

It hardly turns the body: strains of their own would save no iteration, and an assembly
with them takes half as long again.
"""

_PROBE = 0.05
"""Load increment of a last, strict attempt that tells a limit point, if it fails [-].

Closer to a limit point, iterates hardly lose stability; full steps further off do so
for other reasons.
"""

_MOST = np.iinfo(np.int32).max  # largest number of iterations that can be counted

Number = float | Float[Array | HostArray, ""]
Count = int | Int[Array | HostArray, ""]


class NewtonSettings(Module):
    """Settings of the equilibrium solve.

    Attributes:
        rtol: Residual at which Newton stops, relative to the larger of external and
            internal force; it also stops where rounding leaves more [-].
        max_steps: Newton iterations for one configuration, all load steps together.
        max_steps_per_load: Newton iterations after which a load step is cut, unless
            the last one reduced the residual tenfold.
        smallest_load_step: Load increment below which load stepping gives up [-].
        strict_below: Load increment below which the line search is strict [-].
        max_backtracks: Halvings of a Newton step before it counts as failed.
    """

    rtol: Number = eqx.field(default=1e-8, metadata=key(""))
    max_steps: Count = 200
    max_steps_per_load: Count = 20
    smallest_load_step: Number = eqx.field(default=1e-3, metadata=key(""))
    strict_below: Number = 0.01
    max_backtracks: Count = 12

    def __check_init__(self):
        if not 0.0 < self.rtol < 1.0:
            raise ValueError(f"rtol must lie in (0, 1), got {self.rtol}.")
        for name in ("max_steps", "max_steps_per_load", "max_backtracks"):
            if not 1 <= getattr(self, name) <= _MOST:
                raise ValueError(
                    f"{name} must lie between 1 and {_MOST}, got {getattr(self, name)}."
                )
        for name in ("smallest_load_step", "strict_below"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(
                    f"{name} is a share of the load and must lie in (0, 1], got "
                    f"{getattr(self, name)}."
                )

    def as_arrays(self) -> "NewtonSettings":
        """Return the settings as arrays, so that one compiled program serves all."""
        whole = lambda value: np.issubdtype(np.result_type(value), np.integer)
        kind = lambda value: np.int32 if whole(value) else float
        host = jax.tree.map(lambda value: np.asarray(value, kind(value)), self)
        return jax.device_put(host)


class NewtonState(NamedTuple):
    """State of the loop.

    `ok` and `*_ok` belong to the last equilibrium on the load path. `strains` are
    those of the Newton step, unless `exact`; everything else, including the stopping
    rule, takes those of u, and so do the first step at a load and the one after held
    bodies moved, since a chord would crush what turns with them. `turned`: the last
    trial step inverted a tet. `stray` is the displacement at which the load was last
    cut. `probing`: the last attempt, see `_PROBE`.
    `lost` is the fewest negative eigenvalues of any unstable iterate at this load,
    `limit` the fewest at loads that count as beyond a limit point; 0 if all are stable.
    `merit_before` is the norm of the residual one step ago; inf at the start of a load
    step, None if the line search always uses the potential.
    """

    point: Point
    strains: Strains
    exact: Bool[Array, ""]
    lambda_a: Float[Array, " n_a"]
    ok: Point
    lambda_ok: Float[Array, " n_a"]
    load: Float[Array, ""]
    load_ok: Float[Array, ""]
    increment: Float[Array, ""]
    step: Int[Array, ""]
    step_in_load: Int[Array, ""]
    load_steps: Int[Array, ""]
    merit_before: Float[Array, ""] | None
    residual: Residual
    n_negative: Int[Array, ""]
    lost: Int[Array, ""]
    limit: Int[Array, ""]
    any_singular: Bool[Array, ""]
    turned: Bool[Array, ""]
    stray: Nodal
    probing: Bool[Array, ""]
    result: RESULTS
    done: Bool[Array, ""]


@dataclass(frozen=True, eq=False)  # JAX caches its methods by identity
class NewtonLoop:
    """Newton's method for a configuration, posed at full load and solved there first.

    If that does not lead to a solution, load stepping starts from rest, as it does at
    once where a held body turns far and there is no guess.
    """

    posed: Posed
    settings: NewtonSettings

    @property
    def model(self) -> Model:
        return self.posed.model

    def strict(self, s: NewtonState):
        """Tell whether only steps that lower Pi are taken."""
        if not self.model.solver.counts_negative:
            # Full steps could end in an unstable state unnoticed.
            return jnp.ones((), bool)
        return s.probing | (s.increment < self.settings.strict_below)

    @property
    def driven(self) -> bool:
        """Whether motors drive the robot: then steps always take the strains of u.

        The parallel robot stands at its working point, but buckles on the way there,
        and predicted strains lead some of its poses to no equilibrium.
        """
        return any(body >= 0 for body in self.model.mechanism.actuators.motor_body)

    @property
    def longest(self) -> Float[Array, ""]:
        """Longest load increment on the way from rest [-].

        A held body turns by at most `_HELD_TURN` in it: in a longer one, the first step
        is a linear motion that crushes the tets beside the body. Bodies that motors
        turn about their axes do not count: the parallel robot stands at its working
        point, but buckles at two thirds of the way there.
        """
        states = self.posed.states
        if states is None:
            return jnp.ones(())
        held = jnp.asarray(states.kind) == KINDS.index("held")
        turns = jnp.linalg.norm(jnp.asarray(states.rotation), axis=1)
        turn = jnp.max(jnp.where(held & ~turned_by_motors(self.model), turns, 0.0))
        return 1.0 / jnp.ceil(jnp.maximum(turn / _HELD_TURN, 1.0))

    def remembered(self, merit):
        if self.model.conservative and self.model.with_multiplier.size == 0:
            return None  # the line search uses the potential
        return jnp.asarray(merit)

    def step(self, s: NewtonState) -> NewtonState:
        """Do one Newton iteration, then keep, raise or cut the load."""
        posed, strict = self.posed.at_load(s.load), self.strict(s)
        exact = self.driven or strict | s.exact
        direction = newton_direction(
            posed,
            s.point,
            s.lambda_a,
            strains=s.strains,
            exact=exact,
            tamed=s.residual.size > NEAR,
        )
        factor = direction.factor
        downhill = jnp.ones((), bool)
        if self.model.conservative:  # otherwise it always descends the residual
            saddle = jnp.any(posed.by_multiplier)
            downhill = direction.moving | (direction.slope <= 0.0) | ~strict | saddle
        before = merit(posed, s.point, direction.step.lambda_a, factor.gap_stiffness)
        larger = jax.tree.map(lambda old: jnp.maximum(old, before), s.merit_before)
        rtol, most = self.settings.rtol, self.settings.max_backtracks
        tried = line_search(
            posed, s.point, direction, strict=strict, reference=larger, backtracks=most
        )
        good = tried.good & factor.ok & downhill
        residual = relative(posed, tried.point, tried.merit, factor.stiffness)
        residual = residual._replace(size=jnp.where(good, residual.size, jnp.inf))
        before_step = s.residual
        s = s._replace(
            step=s.step + 1,
            step_in_load=s.step_in_load + 1,
            n_negative=factor.n_negative,
            lost=_fewest(s.lost, factor.n_negative),
            any_singular=~factor.ok,
            # A singular tangent gives no step; keep the flag of the step before.
            turned=jnp.where(factor.ok, tried.point.min_det_F <= 0.0, s.turned),
        )
        # A single step that converges, as in a strut under an axial force, leaves the
        # tangent of another state: factorize once more at this state without moving.
        near = before <= NEAR * jnp.linalg.norm(tried.point.force)
        near = (near & exact) | (factor.n_negative < 0)
        stay = s.residual.settled(rtol) & (s.step_in_load > 1)
        good, near = good | (stay & factor.ok), near | stay
        residual = _select(stay, s.residual, residual)
        tried = _select(stay, tried._replace(point=s.point, lambda_a=s.lambda_a), tried)
        u = s.point.u
        # Along straight lines, as the step foresaw: bodies turned meanwhile.
        du = posed.scatter(u, tried.share * direction.step.d)
        # Where the next step takes the strains of u, none are predicted.
        exact_next = direction.moving | (residual.size <= STRAIGHT)
        strains, sound = s.strains, jnp.ones((), bool)
        if not self.driven:
            strains, sound = jax.lax.cond(
                strict | exact_next,
                lambda: (strains, sound),
                lambda: predict(self.model, u, du, s.strains, s.exact),
            )
        good = good & sound
        moved = s._replace(
            point=tried.point,
            lambda_a=tried.lambda_a,
            merit_before=self.remembered(before),
            residual=residual,
            strains=strains,
            exact=exact_next | ~sound,
        )
        settled = residual.settled(rtol)
        astray = settled & near & self.suspicious(s, tried.point.min_det_F)
        good, converged = good & ~astray, settled & near & ~astray
        # Do not cut the load while the residual still falls tenfold.
        closing = residual.size < 0.1 * before_step.size
        out_of_steps = s.step_in_load >= self.settings.max_steps_per_load
        failed = ~good | (~settled & out_of_steps & ~closing)
        s = _select(good, moved, s)
        s = _select(converged, self.next_load(s), s)
        return jax.lax.cond(failed, self.back, lambda s: s, s)

    def run(self, s: NewtonState, most: Count) -> NewtonState:
        keep_going = lambda s: ~s.done & (s.step < most)
        return jax.lax.while_loop(keep_going, self.step, s)

    def suspicious(self, s: NewtonState, det):
        """Tell whether full steps may have left the load path, so the load is cut.

        They may have jumped to a saddle, shown by negative eigenvalues, or past an
        inverted tet, which some laws survive.
        """
        jumped = det <= 0.0
        if self.model.conservative:
            jumped = jumped | ((s.n_negative > 0) & ~self.strict(s))
        return jumped

    def next_load(self, s: NewtonState) -> NewtonState:
        longest = jnp.minimum(2.0 * s.increment, self.longest)
        increment = jnp.minimum(longest, 1.0 - s.load)
        finished = s.load >= 1.0
        sound = s.point.min_det_F > 0.0
        outcome = RESULTS.where(sound, RESULTS.converged, RESULTS.inverted)
        outcome = RESULTS.where(s.n_negative > 0, RESULTS.unstable, outcome)
        return s._replace(
            ok=s.point,
            lambda_ok=s.lambda_a,
            load_ok=s.load,
            load=jnp.minimum(s.load + increment, 1.0),
            increment=increment,
            merit_before=self.remembered(jnp.inf),
            step_in_load=jnp.zeros_like(s.step),
            load_steps=s.load_steps + 1,
            lost=jnp.zeros_like(s.lost),
            limit=jnp.zeros_like(s.limit),
            exact=jnp.ones((), bool),
            probing=jnp.zeros((), bool),
            result=RESULTS.where(finished, outcome, RESULTS.max_steps),
            done=finished,
        )

    def back(self, s: NewtonState) -> NewtonState:
        """Return to the last equilibrium and halve the load increment.

        A load that is only a little higher and whose steps lose stability, but invert
        no tet, is beyond a limit point, even if the iterations end before the smallest
        increment is tried. Without such evidence, one larger increment is tried last.
        """
        smallest = self.settings.smallest_load_step
        last = 0.5 * s.increment < smallest
        known = s.any_singular | s.turned | s.probing | (smallest >= _PROBE)
        probing = last & ~known
        give_up = (last & ~probing) | s.probing
        increment = jnp.where(probing, _PROBE, 0.5 * s.increment)
        beyond = (s.lost > 0) & self.strict(s) & self.model.conservative & ~s.turned
        why = RESULTS.where(
            s.any_singular, RESULTS.singular, RESULTS.load_step_too_small
        )
        why = RESULTS.where(s.turned, RESULTS.inverted, why)
        so_far = RESULTS.where(beyond, RESULTS.limit_point, s.result)
        limit = so_far == RESULTS.limit_point
        why = RESULTS.where(limit, RESULTS.limit_point, why)
        return s._replace(
            point=s.ok,
            stray=s.point.u,
            exact=jnp.ones((), bool),
            lambda_a=s.lambda_ok,
            load=jnp.minimum(s.load_ok + increment, 1.0),
            increment=increment,
            merit_before=self.remembered(jnp.inf),
            step_in_load=jnp.zeros_like(s.step),
            limit=jnp.where(beyond, _fewest(s.limit, s.lost), s.limit),
            lost=jnp.zeros_like(s.lost),
            probing=probing,
            result=RESULTS.where(give_up, why, so_far),
            done=give_up,
        )

    def start(self, u0: Nodal | None = None) -> NewtonState:
        """Begin at rest, or at a guess `u0` with its bodies made rigid."""
        rest, count = at_rest(self.posed), jnp.zeros((), jnp.int32)
        zero, point, load = jnp.zeros(()), rest, self.longest
        lambda_a = jnp.zeros_like(rest.delta_a)
        if u0 is not None:
            guess = evaluate(self.posed, self.posed.rigid(u0))
            # Rest is a better start than inverted tets or infinite energy, and making
            # bodies rigid leaves rounding: ask the guess itself whether it is rest.
            usable = guess.finite & (guess.min_det_F > 0.0)
            warm = usable & jnp.any(u0 != 0.0)
            point = _select(warm, guess, rest)
            load = jnp.where(warm, jnp.ones(()), load)
            lambda_a = jnp.where(warm, estimated_forces(self.posed, point), 0.0)
        return NewtonState(
            point=point,
            strains=no_strains(self.model),
            exact=jnp.ones((), bool),
            lambda_a=lambda_a,
            ok=rest,
            lambda_ok=jnp.zeros_like(lambda_a),
            load=load,
            load_ok=zero,
            increment=load,
            step=count,
            step_in_load=count,
            load_steps=count,
            merit_before=self.remembered(jnp.full_like(zero, jnp.inf)),
            residual=Residual(jnp.full_like(zero, jnp.inf), zero),
            n_negative=count,
            lost=count,
            limit=count,
            any_singular=jnp.zeros((), bool),
            turned=jnp.zeros((), bool),
            stray=rest.u,
            probing=jnp.zeros((), bool),
            result=RESULTS.max_steps,
            done=jnp.zeros((), bool),
        )


def _fewest(old: Int[Array, ""], new: Int[Array, ""]) -> Int[Array, ""]:
    """Return the smaller of two counts of negative eigenvalues; 0 stands for no count.

    Newton's iterates beyond a limit point wander off to ever less stable states: those
    that are closest to the path have the fewest negative eigenvalues.
    """
    new = jnp.maximum(new, 0)
    both = (old > 0) & (new > 0)
    return jnp.where(both, jnp.minimum(old, new), jnp.maximum(old, new))


def _select(flag, new, old):
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)
