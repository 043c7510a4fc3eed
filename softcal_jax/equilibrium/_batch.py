"""Equilibria of a batch, on all cores, with their progress."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import stacked, unstacked
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable_values
from softcal_jax.configurations import (
    ConfigurationArrays,
    earlier_lanes,
    following_each_other,
    in_order,
)
from softcal_jax.equilibrium._assembly import tet_states
from softcal_jax.equilibrium._continuation import (
    Known,
    approach,
    detours,
    distances,
    unloaded,
)
from softcal_jax.equilibrium._load_steps import LoadState
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._newton import NewtonSettings
from softcal_jax.equilibrium._path import trace_equilibria
from softcal_jax.equilibrium._robot_state import effector_values
from softcal_jax.equilibrium._solve import (
    EquilibriumSolution,
    begin_newton,
    continue_newton,
    loads_work,
    resumed,
    with_cause,
    without_readings,
)
from softcal_jax.equilibrium._workers import Program, Workers

STEPS_BETWEEN = 2  # Newton iterations of a configuration between two reports

_CUT = 1.0 / 8.0
"""Share of what is left of the load down to which three cuts lead."""

Report = Callable[[int, float, int, str], None]
"""Takes the index of a configuration, the share of its load, its iterations, and what
is hard about it, in words."""


class EquilibriumProgress(NamedTuple):
    """Progress of an equilibrium from rest: Newton iterations so far.

    `load` is the share of the load that is carried, `stiffer` the factor on the moduli
    of the start [-], `trouble` what is hard about it, in words.
    """

    configuration: str
    load: float
    steps: int
    stiffer: float
    trouble: str = ""

    def __str__(self) -> str:
        """Write it in one line."""
        text = (
            f"equilibrium of {self.configuration}: {100.0 * self.load:.0f} % of the "
            f"load, step {self.steps}"
        )
        if self.stiffer > 1.0:
            text += f", moduli {self.stiffer:g} times the start"
        return f"{text}, {self.trouble}" if self.trouble else text


def reports_of(
    progress: Callable[[EquilibriumProgress], None] | None,
    names: Sequence[str],
    factor: float = 1.0,
) -> Report | None:
    """Return a report for `equilibria`, which knows configurations by index alone."""
    if progress is None:
        return None

    def report(c: int, load: float, steps: int, trouble: str = "") -> None:
        progress(EquilibriumProgress(names[c], load, steps, factor, trouble))

    return report


def equilibria(
    workers: Workers,
    model: Model,
    configurations: Iterable[ConfigurationArrays],
    newton: NewtonSettings,
    *,
    guess: Float[Array, "n_c n_points 3"] | None = None,
    known: Sequence[Known] = (),
    arc_length: bool = False,
    report: Report | None = None,
    ended: Callable[[int, EquilibriumSolution], None] = lambda *_: None,
) -> EquilibriumSolution:
    """Solve the equilibria of all configurations on all cores.

    The program is compiled once for any number of lanes. Inside a program a `vmap` of
    `solve_equilibrium` solves a batch; `Evaluator` adds the errors and compliances of a
    calibration.

    With a `guess`, each solve begins there; one that is not finite counts as rest. By
    default it begins at rest. Where that does not lead to the full load in one step,
    `approach` leads there from the nearest equilibrium: of another configuration, of
    one that is `known`, or rest; straight, or by `detours`. If that fails there are
    load steps from rest and, with `arc_length`, `trace_equilibria`. With rigid bodies
    each begins at the nearest equilibrium, because poses of a robot lie near each other
    and far from its state before mounting. One that comes `after` another, which may be
    `known`, follows it.

    `report` is called after every few iterations of a configuration, from its thread;
    `ended` with the index and solution of each that has ended.
    """
    lanes = _Lanes(workers, model, configurations, newton, report)
    each, solutions = lanes.each, {}
    known = [k._replace(configuration=without_readings(k.configuration)) for k in known]
    begun: dict[int, LoadState | None] = dict.fromkeys(range(len(each)))

    def end(c: int, solution: EquilibriumSolution) -> None:
        solutions[c] = solution
        begun.pop(c)
        ended(c, solution)

    def tried(c: int, new: tuple[LoadState, EquilibriumSolution]) -> None:
        begun[c] = new[0]
        if new[1].converged:
            end(c, new[1])

    if guess is not None:
        _from_guesses(lanes, unstacked(guess), solutions, end)
    elif model.mechanism.bodies.n_bodies == 0:
        workers.side_by_side((partial(lanes.begin, c) for c in range(len(each))), tried)
        known += [Known(each[c], solutions[c].displacement) for c in solutions]
        known += [unloaded(each[c]) for c in begun]
    if begun:
        _from_nearest(lanes, begun, known, end, arc_length=arc_length)
    return stacked([solutions[c] for c in range(len(each))])


def _from_guesses(
    lanes: "_Lanes",
    guesses: Sequence[Nodal],
    solutions: Mapping[int, EquilibriumSolution],
    end: Callable[[int, EquilibriumSolution], None],
) -> None:
    """Solve all lanes from guesses; those that follow others go after these."""
    earlier = earlier_lanes(lanes.each)
    for group in in_order(earlier):
        calls: list[Callable[[], EquilibriumSolution]] = []
        for c in group:
            calls.append(partial(lanes.solve, c, guesses[c]))
            if (p := earlier[c]) is not None and not solutions[p].converged:
                calls[-1] = lanes.after(c, solutions[p])
            elif p is not None:
                lanes.follow(c, Known(lanes.each[p], solutions[p].displacement))
        ended = lambda k, solution, group=group: end(group[k], solution)
        lanes.workers.side_by_side(calls, ended)


def _from_nearest(
    lanes: "_Lanes",
    begun: dict[int, LoadState | None],
    known: Sequence[Known],
    end: Callable[[int, EquilibriumSolution], None],
    *,
    arc_length: bool,
) -> None:
    """Solve the lanes of `begun` from the nearest equilibrium.

    Those go side by side that have no other to wait for: one that is nearer to what is
    known, and nearer to them than that. So the order does not depend on the cores. At
    last come those that follow others, from the equilibria of these.
    """
    states, lane_at = dict(enumerate(known)), dict(enumerate(begun, len(known)))
    every = [state.configuration for state in known]
    every += [lanes.each[c] for c in lane_at.values()]
    apart, earlier = distances(every), earlier_lanes(every)
    failed: dict[int, EquilibriumSolution] = {}

    def run(calls: dict[int, Callable[[], EquilibriumSolution]]) -> None:
        solutions = lanes.workers.side_by_side(calls.values())
        for row, solution in zip(calls, solutions, strict=True):
            c = lane_at.pop(row)
            if arc_length and earlier[row] is None and not solution.converged:
                solution = lanes.along_path(c, solution)
            if solution.converged:
                states[row] = Known(lanes.each[c], solution.displacement)
            else:
                failed[row] = solution
            end(c, solution)

    while waiting := [row for row in lane_at if earlier[row] is None]:
        to_known = apart[np.ix_([*states], waiting)]
        nearest = np.min(to_known, axis=0, initial=np.inf)
        beside = apart[np.ix_(waiting, waiting)]
        waits = (nearest[:, None] < nearest) & (beside < nearest)
        calls = {}
        for k in np.flatnonzero(~waits.any(axis=0) & np.isfinite(nearest)):
            near = states[[*states][int(np.argmin(to_known[:, k]))]]
            c = lane_at[waiting[k]]
            calls[waiting[k]] = partial(lanes.from_known, c, near, begun[c])
        if not calls:  # none holds and imposes the same: the last one is a guess
            last = [*states.values()][-1].displacement if states else None
            calls[waiting[0]] = partial(lanes.solve, lane_at[waiting[0]], last)
        run(calls)
    while lane_at:
        ends, each = failed | states, [*lane_at.items()]
        before = {row: ends[p] for row, _ in each if (p := earlier[row]) in ends}
        run({row: lanes.after(c, before[row]) for row, c in each if row in before})


class _Lanes:
    """The configurations of a batch, and ways to solve one of them."""

    def __init__(
        self,
        workers: Workers,
        model: Model,
        configurations: Iterable[ConfigurationArrays],
        newton: NewtonSettings,
        report: Report | None,
    ):
        configurations = list(configurations)
        self.workers, self.each = workers, list(map(without_readings, configurations))
        settings = newton.as_arrays()
        self._with_cause = partial(with_cause, model)
        self._trouble = partial(_trouble, model) if report else lambda *_: ""
        self._trace = lambda c: trace_equilibria(
            model, configurations[c], settings=newton, check=workers.check
        )
        self._most, self._say = int(newton.max_steps), report or (lambda *_: None)
        most = self._most if report is None else STEPS_BETWEEN
        steps = jax.device_put(np.array(most, np.int32))
        # It ends where the first step fails, in place of going back to rest.
        at_once = replace(newton, smallest_load_step=1.0).as_arrays()
        self._from_anywhere, self._at_once = (
            (
                Program(begin_newton, model, settings),
                Program(continue_newton, model, settings, steps),
            )
            for settings in (settings, at_once)
        )

    def follow(self, c: int, before: Known) -> None:
        """Let a lane come after an equilibrium."""
        self.each[c] = jax.device_put(self.each[c].following(*before))

    def after(
        self, c: int, before: Known | EquilibriumSolution
    ) -> Callable[[], EquilibriumSolution]:
        """Return what solves a lane after an equilibrium, or fails as that did."""
        if not isinstance(before, Known):
            return lambda: before
        self.follow(c, before)
        return partial(self.from_known, c, before, None)

    def begin(self, c: int) -> tuple[LoadState, EquilibriumSolution]:
        """Take the full load from rest in one step."""
        begin, go_on = self._at_once
        (state,) = self.workers.map(begin, [(self.each[c], None)])
        return self._run(go_on, self.each[c], state, partial(self._say, c))

    def solve(
        self,
        c: int,
        u: Nodal | None = None,
        *,
        begun: LoadState | None = None,
        taken: int = 0,
    ) -> EquilibriumSolution:
        """Solve a lane by load steps, from a guess, rest, or what `begin` returned.

        Iterations that were `taken` before leave fewer, but half of them at least.
        """
        begin, go_on = self._from_anywhere
        if begun is None:
            (state,) = self.workers.map(begin, [(self.each[c], u)])
        else:
            state = resumed(begun)
        if taken:
            state = state._replace(step=state.step + min(taken, self._most // 2))
        ended = self._run(go_on, self.each[c], state, partial(self._say, c))
        return self._with_cause(self.each[c], *ended)

    def from_known(
        self, c: int, near: Known, begun: LoadState | None
    ) -> EquilibriumSolution:
        """Solve a lane from an equilibrium; failing that, by load steps from rest."""
        before = 0 if begun is None else int(begun.step)
        taken, led = before, 0.0

        def at_once(lane: ConfigurationArrays, u: Nodal) -> EquilibriumSolution:
            (state,) = self.workers.map(self._at_once[0], [(lane, u)])
            return self._run(self._at_once[1], lane, state)[1]

        from_rest = not np.any(near.displacement)  # where `begin` has tried it
        say = lambda share, steps: self._say(c, share, taken + steps, "")
        for stops in ([self.each[c]], *detours(near.configuration, self.each[c])):
            end = approach(
                at_once,
                near,
                stops,
                first=0.5 if from_rest else 1.0,
                most=self._most - taken,
                report=say,
            )
            taken, led = taken + end.steps, max(led, end.share)
            if end.solution is not None:
                self._say(c, 1.0, taken, "")
                return _with_steps(end.solution, taken)
        solution = self.solve(c, begun=begun, taken=taken - before)
        return eqx.tree_at(lambda s: s.approached, solution, jnp.asarray(led))

    def along_path(self, c: int, failed: EquilibriumSolution) -> EquilibriumSolution:
        """Follow the path of a lane along its load, and solve it from the end."""
        path = self._trace(c)
        share = min(float(np.max(path.load)), 1.0)
        if share == 1.0:
            end = self.solve(c, jnp.asarray(path.displacement[-1]))
            if end.converged:
                return _with_steps(end, int(failed.steps) + int(end.steps))
        return eqx.tree_at(lambda s: s.along_path, failed, jnp.asarray(share))

    def _run(
        self,
        go_on: Program,
        lane: ConfigurationArrays,
        state: LoadState,
        say: Callable[[float, int, str], None] = lambda *_: None,
    ) -> tuple[LoadState, EquilibriumSolution]:
        """Iterate until Newton's method is done, or out of steps."""
        while True:
            ((state, solution),) = self.workers.map(go_on, [(lane, state)])
            say(float(state.load_ok), int(state.step), self._trouble(lane, state))
            if bool(state.done) or int(state.step) >= self._most:
                return state, solution


def _trouble(model: Model, lane: ConfigurationArrays, state: LoadState) -> str:
    """Say which load the body resists, and where, after three cuts of the load."""
    if state.fell:
        return "no load holds it where it is: it moves until what it touches does"
    if not 0.0 < float(state.increment) <= _CUT * (1.0 - float(state.load_ok)):
        return ""
    det = np.linalg.det(tet_states(model, state.stray).F).min(axis=1)
    corners = np.asarray(model.mesh.tets)[np.argmin(det), :4]
    place = np.asarray(model.mesh.points)[corners].mean(axis=0).tolist()
    works, actuators = loads_work(model, lane, state.stray), model.mechanism.actuators
    each = zip(actuators.kinds, actuators.names, strict=True)
    names = "weight", "dead load", *(f"{kind.noun} {name!r}" for kind, name in each)
    most = int(np.argmax(works))
    by = f"{names[most]} does most of the work; " if works[most] > 0.0 else ""
    return (
        f"load steps cut to {100.0 * float(state.increment):.2g} % ({by}tets at "
        f"{readable_values(place, 'm', digits=3)} deform most)"
    )


def _with_steps(solution: EquilibriumSolution, steps: int) -> EquilibriumSolution:
    return replace(solution, steps=jnp.asarray(steps, solution.steps.dtype))


compiled_effectors = eqx.filter_jit(effector_values)  # one program for all callers


def effectors_on_all_cores(
    workers: Workers,
    model: Model,
    configurations: Iterable[ConfigurationArrays],
    solution: EquilibriumSolution,
) -> Float[Array, "n_c n_rows 3"]:
    """Compute the effector coordinates of a batch, on all cores."""
    states = [*map(np.asarray, (solution.displacement, solution.multipliers))]
    configurations = following_each_other([*configurations], states[0])
    lanes = zip(configurations, *states, strict=True)
    return stacked(workers.map(Program(compiled_effectors, model), lanes))
