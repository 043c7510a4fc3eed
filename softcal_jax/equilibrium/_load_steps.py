"""Load steps around Newton's method, until the full load is carried.

The load factor t goes from 0 to 1 by steps of a single `while_loop`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.bodies import KINDS
from softcal_jax.equilibrium._balance import (
    Point,
    at_rest,
    estimated_forces,
    evaluate,
    unbalanced,
)
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._newton import (
    NEAR,
    Count,
    Iterate,
    Iteration,
    NewtonSettings,
    first_iterate,
    newton_iteration,
    select,
)
from softcal_jax.equilibrium._posed import Posed, turned_by_motors

_HELD_TURN = 1.0
"""Longest rotation of a held body in one load step from rest [rad].

In longer steps Newton's method spends more iterations on crushed tets than it saves.
"""

_PROBE = 0.05
"""Load increment of a last, strict attempt that tells a limit point, if it fails [-].

Closer to a limit point, iterates hardly lose stability; full steps further off do so
for other reasons.
"""


_FIRST_MOTION = 0.05
"""Motion of a free body on its first anchor, over the size of the robot [-]."""

_LOOSER, _FIRMER = 0.25, 4.0
"""Factors on the stiffness of an anchor, after an equilibrium and after a failure."""

_FIRMEST = 1e3  # largest stiffness of an anchor, over that of the first [-]


class LoadState(NamedTuple):
    """State of the loop.

    `ok` and `*_ok` belong to the last equilibrium on the load path. `stray` is the
    displacement at which the load was last cut. `probing`: the last attempt, see
    `_PROBE`. `lost` is the fewest negative eigenvalues of any unstable iterate at this
    load, `limit` the fewest at loads that count as beyond a limit point; 0 if all are
    stable. `anchor` has the stiffness of that to `ok`, negative before it is needed and
    0 after, and that of the first; None without obstacles [N/m].
    """

    iterate: Iterate
    ok: Point
    lambda_ok: Float[Array, " n_a"]
    load: Float[Array, ""]
    load_ok: Float[Array, ""]
    increment: Float[Array, ""]
    step: Int[Array, ""]
    load_steps: Int[Array, ""]
    lost: Int[Array, ""]
    limit: Int[Array, ""]
    stray: Nodal
    probing: Bool[Array, ""]
    result: RESULTS
    done: Bool[Array, ""]
    anchor: tuple[Float[Array, ""], Float[Array, ""]] | None

    @property
    def fell(self) -> bool:
        """Whether an anchor was taken; on the host."""
        return self.anchor is not None and float(self.anchor[0]) >= 0.0


@dataclass(frozen=True, eq=False)  # JAX caches its methods by identity
class LoadSteps:
    """Load steps of a configuration, posed at full load and solved there first.

    If that does not lead to a solution, load stepping starts from rest, as it does at
    once where a held body turns far and there is no guess. At each load it iterates by
    Newton's method, or by another `iteration`.

    A body that no load leaves where it is, like one above a table, moves at full load
    until an obstacle carries it: an anchor draws all nodes to where they were, then to
    where that let them go, ever more loosely: it moves as in a viscous fluid.
    """

    posed: Posed
    settings: NewtonSettings
    iteration: Iteration = newton_iteration

    @property
    def model(self) -> Model:
        return self.posed.model

    def strict(self, s: LoadState) -> Bool[Array, ""]:
        """Tell whether Newton's method takes only steps that lower Pi."""
        if not self.model.solver.counts_negative:
            # Other steps could end in an unstable state unnoticed. Where only friction
            # on obstacles has no potential, the last attempt takes them.
            rough = self.model.has_energy and not self.model.conservative
            return ~s.probing if rough else jnp.ones((), bool)
        return s.probing | (s.increment < self.settings.strict_below)

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

    def step(self, s: LoadState) -> LoadState:
        """Do one iteration, then keep, raise or cut the load."""
        posed = self.posed.at_load(s.load)
        if s.anchor is not None:
            stiffness = jnp.maximum(s.anchor[0], 0.0)
            posed = posed._replace(anchor=(stiffness, s.ok.u))
        now = self.iteration(posed, self.settings, s.iterate, self.strict(s))
        s = s._replace(
            iterate=now,
            step=s.step + now.step - s.iterate.step,
            lost=_fewest(s.lost, now.n_negative),
        )
        s = select(now.converged, self.onward(s), s)
        return jax.lax.cond(now.failed, self.back, lambda s: s, s)

    def run(self, s: LoadState, most: Count) -> LoadState:
        keep_going = lambda s: ~s.done & (s.step < most)
        return jax.lax.while_loop(keep_going, self.step, s)

    def onward(self, s: LoadState) -> LoadState:
        """Raise the load, or loosen the anchor."""
        if s.anchor is None:
            return self.next_load(s)
        (stiffness, first), now, norm = s.anchor, s.iterate, jnp.linalg.norm
        pull = norm(stiffness * (now.point.u - s.ok.u))
        free = pull <= NEAR * jnp.maximum(norm(self.posed.f_ext), norm(now.point.force))
        loosened = s._replace(
            iterate=now.restarted(now.point, now.lambda_a),
            ok=now.point,
            lambda_ok=now.lambda_a,
            anchor=(jnp.where(free, 0.0, _LOOSER * stiffness), first),
        )
        return select(stiffness > 0.0, loosened, self.next_load(s))

    def next_load(self, s: LoadState) -> LoadState:
        longest = jnp.minimum(2.0 * s.increment, self.longest)
        increment = jnp.minimum(longest, 1.0 - s.load)
        finished, now = s.load >= 1.0, s.iterate
        sound = now.point.min_det_F > 0.0
        outcome = RESULTS.where(sound, RESULTS.converged, RESULTS.inverted)
        outcome = RESULTS.where(now.n_negative > 0, RESULTS.unstable, outcome)
        return s._replace(
            iterate=now.restarted(now.point, now.lambda_a),
            ok=now.point,
            lambda_ok=now.lambda_a,
            load_ok=s.load,
            load=jnp.minimum(s.load + increment, 1.0),
            increment=increment,
            load_steps=s.load_steps + 1,
            lost=jnp.zeros_like(s.lost),
            limit=jnp.zeros_like(s.limit),
            probing=jnp.zeros((), bool),
            result=RESULTS.where(finished, outcome, RESULTS.max_steps),
            done=finished,
        )

    def back(self, s: LoadState) -> LoadState:
        """Return to the last equilibrium and halve the load increment.

        A load that is only a little higher and whose steps lose stability, but invert
        no tet, is beyond a limit point, even if the iterations end before the smallest
        increment is tried. Without such evidence, one larger increment is tried last.
        """
        smallest, now = self.settings.smallest_load_step, s.iterate
        last = 0.5 * s.increment < smallest
        known = now.singular | now.turned | s.probing | (smallest >= _PROBE)
        probing = last & ~known
        give_up = (last & ~probing) | s.probing
        increment = jnp.where(probing, _PROBE, 0.5 * s.increment)
        beyond = (s.lost > 0) & self.strict(s) & self.model.conservative & ~now.turned
        why = RESULTS.where(now.singular, RESULTS.singular, RESULTS.load_step_too_small)
        why = RESULTS.where(now.turned, RESULTS.inverted, why)
        so_far = RESULTS.where(beyond, RESULTS.limit_point, s.result)
        limit = so_far == RESULTS.limit_point
        why = RESULTS.where(limit, RESULTS.limit_point, why)
        cut = s._replace(
            iterate=now.restarted(s.ok, s.lambda_ok),
            stray=now.point.u,
            load=jnp.minimum(s.load_ok + increment, 1.0),
            increment=increment,
            limit=jnp.where(beyond, _fewest(s.limit, s.lost), s.limit),
            lost=jnp.zeros_like(s.lost),
            probing=probing,
            result=RESULTS.where(give_up, why, so_far),
            done=give_up,
        )
        return cut if s.anchor is None else self.anchored(s, cut, give_up, why)

    def anchored(
        self, s: LoadState, cut: LoadState, give_up: Bool[Array, ""], why: RESULTS
    ) -> LoadState:
        """Begin with an anchor where no load is carried, or take a firmer one."""
        assert s.anchor is not None
        stiffness, first = s.anchor
        before = stiffness < 0.0
        # Where the first load step is the smallest, that step alone is wanted.
        mobile = (s.load_ok == 0.0) & (self.settings.smallest_load_step < 1.0)
        begins = give_up & before & mobile & (first > 0.0)
        firmer = jnp.where(before, first, _FIRMER * stiffness)
        goes_on = begins | ((stiffness > 0.0) & (firmer <= _FIRMEST * first))
        moved = cut._replace(
            load=jnp.ones_like(s.load),
            stray=jnp.where(before, cut.stray, s.stray),
            probing=jnp.zeros((), bool),
            result=RESULTS.where(before, why, s.result),
            done=~goes_on,
            anchor=(firmer, first),
        )
        return select(begins | ~before, moved, cut)

    def start(self, u0: Nodal | None = None) -> LoadState:
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
            point = select(warm, guess, rest)
            load = jnp.where(warm, jnp.ones(()), load)
            lambda_a = jnp.where(warm, estimated_forces(self.posed, point), 0.0)
        anchor = None
        if self.posed.contacts.can_touch:
            g, _ = unbalanced(self.posed, rest, jnp.zeros_like(rest.delta_a))
            force = jnp.sum(jnp.abs(self.posed.on_free(rest.u, g)))
            motion = _FIRST_MOTION * self.model.mechanism.bodies.length
            anchor = (-jnp.ones(()), force / (motion * self.model.n_points))
        return LoadState(
            iterate=first_iterate(self.model, point, lambda_a),
            ok=rest,
            lambda_ok=jnp.zeros_like(lambda_a),
            load=load,
            load_ok=zero,
            increment=load,
            step=count,
            load_steps=count,
            lost=count,
            limit=count,
            stray=rest.u,
            probing=jnp.zeros((), bool),
            result=RESULTS.max_steps,
            done=jnp.zeros((), bool),
            anchor=anchor,
        )


def _fewest(old: Int[Array, ""], new: Int[Array, ""]) -> Int[Array, ""]:
    """Return the smaller of two counts of negative eigenvalues; 0 stands for no count.

    Newton's iterates beyond a limit point wander off to ever less stable states: those
    that are closest to the path have the fewest negative eigenvalues.
    """
    new = jnp.maximum(new, 0)
    both = (old > 0) & (new > 0)
    return jnp.where(both, jnp.minimum(old, new), jnp.maximum(old, new))
