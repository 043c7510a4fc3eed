"""Where a fit starts: first equilibria, and the search from many starts."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import unstacked
from softcal_jax._process import check_process
from softcal_jax._text import listed
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration._checkpoint import Journal, from_scaled, marker_rms
from softcal_jax.calibration._evaluation import Evaluation, Evaluator
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._result import MultiStartResult, Optimum
from softcal_jax.calibration._runs import (
    Basin,
    Begun,
    admissible,
    images_of,
    known_optima,
    not_begun,
    run_start,
)
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.equilibrium import (
    EquilibriumProgress,
    EquilibriumSolution,
    Workers,
    no_equilibrium,
    reports_of,
)
from softcal_jax.fields import ParameterSpace, kind_of, random_starts
from softcal_jax.unknowns import CorrelatedNoise, Problem

STIFFER = 2.0
"""Factor by which moduli are raised until all configurations have an equilibrium."""

MOST_RAISES = 20  # most raises, a factor of a million in all
SAME_OPTIMUM = 1e-3  # largest difference of scaled parameters within one optimum [-]

FROM_ANYWHERE = CalibrationSettings(max_steps=12)
"""Settings of runs from many starts: few steps, as a good start converges quickly."""

GROUP = 4
"""Starts that run side by side, and know the optima of the groups before."""

ENOUGH = 0.1
"""Share of further starts that may end elsewhere, as after five that agree [-]."""

# One row at a time, so that the program does not depend on the number of rows.
_distance = eqx.filter_jit(lambda space, a, b: jnp.abs(space.shorter(a - b)))


class Start(NamedTuple):
    """Where a fit starts: scaled parameters, and how they had to be changed."""

    evaluate: Evaluator
    z: Float[Array, " n_p"]
    evaluation: Evaluation
    notes: tuple[str, ...]

    @property
    def noise(self) -> CorrelatedNoise:
        """The noise that weighs the data in the beginning."""
        assert self.evaluate.problem.noise is not None
        return self.evaluate.problem.noise


def begin(
    evaluate: Evaluator,
    z: Float[Array, " n_p"],
    watch: Callable[[EquilibriumProgress | str], None] | None = None,
) -> Start:
    """Evaluate a start, with moduli raised until every configuration is in equilibrium.

    A body that is too soft balloons, buckles or collapses under the measured loads, and
    a fit needs an equilibrium of every configuration to begin with. Where there is none
    within the bounds, the text of the error says what was reached.
    """
    problem, raised, factor = evaluate.problem, z, 1.0
    names = problem.names
    report = partial(reports_of, watch, names)
    tell = watch or (lambda _: None)
    solved = partial(tell, "how the poses depend on the parameters")
    first = evaluate.from_rest(z, report(), solved)
    solution = first.equilibrium
    if np.all(np.asarray(solution.converged)):
        return Start(evaluate, z, first, ())
    without = no_equilibrium(solution, names)
    note = f"No equilibrium at the start values. {_reached(solution, names)}"
    more = np.where(_moduli(problem), np.log(STIFFER), 0.0)
    for _ in range(MOST_RAISES):
        higher = jnp.asarray(np.asarray(raised) + more)
        stiffer = admissible(problem.space.numbered, higher)
        if np.array_equal(stiffer, raised):
            break
        raised, factor = stiffer, STIFFER * factor
        evaluation = evaluate.from_rest(raised, report(factor), solved)
        solution = evaluation.equilibrium
        if solution.converged.all():
            note += f" The fit began with stiffer moduli: {_values(problem, raised)}."
            return Start(evaluate, raised, evaluation, (note,))
    if raised is z:
        raise RuntimeError(without)
    raise RuntimeError(
        f"{without}\nNor is there one with stiffer moduli up to their bounds "
        f"({_values(problem, raised)}).\n{_reached(solution, names)}\nRaise the upper "
        "bounds, or check loads, units and supports."
    )


def _moduli(problem: Problem) -> Bool[HostArray, " n_p"]:
    """Flag the moduli: fields on a log scale that need no load to have an effect."""
    acts_alone = lambda q: not kind_of(problem.model, q.field).acts_by
    each = zip(problem.space.sets_fields, problem.space.parameters, strict=True)
    return np.array([sets and q.scale == "log" and acts_alone(q) for sets, q in each])


def _values(problem: Problem, z: Float[Array, " n_p"]) -> str:
    """Write the moduli, with their units."""
    space, moduli = problem.space, _moduli(problem)
    values = zip(space.parameters, space.from_scaled(z), moduli, strict=True)
    stated = [(q, float(value)) for q, value, is_modulus in values if is_modulus]
    return listed([f"{q.name} = {readable(value, q.unit)}" for q, value in stated])


def _reached(solution: EquilibriumSolution, names: tuple[str, ...]) -> str:
    """Say how far configurations without an equilibrium came."""
    load = np.asarray(solution.load_reached)
    lost = np.flatnonzero(~np.asarray(solution.converged))
    return " ".join(
        f"{names[c]} carries {100.0 * load[c]:.3g} % of its load." for c in lost
    )


class SearchProgress(NamedTuple):
    """A step of a search, from a start or from a mirror image of it or of its end.

    Attributes:
        start: Index of the start.
        starts: Number of starts at most.
        image: 0 from the start itself, else the number of the image.
        step: Number of the step from there; 0 before the first equilibria.
        rms: Root mean square of the marker distances after it, else nan [m].
    """

    start: int
    starts: int
    image: int
    step: int
    rms: float

    def __str__(self) -> str:
        """Write the step in one line."""
        image = f", mirror image {self.image}" if self.image else ""
        now = f"step {self.step}: rms {readable(self.rms, 'step of a fit')}"
        now = now if self.step else "first equilibria"
        return f"start {self.start + 1} of {self.starts}{image}, {now}"


def multi_start(
    problem: Problem,
    starts: int | Float[Array, "n_starts n_p"] = 30,
    *,
    seed: int = 0,
    settings: CalibrationSettings | None = None,
    mirror: bool = True,
    enough: float = ENOUGH,
) -> MultiStartResult:
    """Calibrate from many starts, side by side, and list the distinct optima.

    The first start runs alone, the others in groups of four. A run that is on its way
    to an optimum of an earlier group ends, with the best end of the run that found it;
    the search ends once the expected share of starts that lead elsewhere is small.
    Ctrl-C returns what was found so far, once a run has come to an end.

    Args:
        problem: The calibration, from `build_problem`.
        starts: Scaled parameters to start from, or the number of random ones.
        seed: Seed of the random starts.
        settings: Settings of the outer loop; by default `FROM_ANYWHERE`.
        mirror: Whether runs that end with an error continue from mirror images.
        enough: Share at which to end, see `MultiStartResult.missed`; 0 runs all starts.

    Raises:
        ValueError: If there are no starts, or they do not fit the parameters.
        RuntimeError: If no start has an equilibrium.
    """
    check_process()
    space = problem.space
    if isinstance(starts, int):
        starts = random_starts(space, starts, seed=seed)
    if starts.ndim != 2 or starts.shape[1] != len(space.names) or not len(starts):
        raise ValueError(
            f"starts must have the shape (number, {len(space.names)}), at least one; "
            f"got {starts.shape}."
        )
    settings = settings or FROM_ANYWHERE
    journal = Journal(problem, settings)
    lanes = min(len(starts), GROUP) * len(problem.configurations.gravity)
    with Workers(problem.model, lanes) as workers:
        evaluate = Evaluator(problem, workers)
        return search(
            evaluate, settings, starts, mirror=mirror, journal=journal, enough=enough
        )


def search(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    starts: Float[Array, "n_starts n_p"],
    *,
    mirror: bool,
    journal: Journal,
    enough: float = ENOUGH,
    progress: Callable[[SearchProgress], None] = lambda _: None,
) -> MultiStartResult:
    """Run the search of `multi_start`; the journal returns the runs saved before.

    The first start runs alone, the others in groups of `GROUP`: a run knows the optima
    of the groups before, however many cores there are. Ctrl-C ends it with the best
    ends so far and sets `journal.interrupted`. `progress` is called in threads, one at
    a time, and must not solve anything itself, since other runs occupy all cores.
    """
    space, images = evaluate.problem.space, images_of(evaluate.problem.space, mirror)
    rows, n = unstacked(starts), 0
    begun = [not_begun(settings, start, len(images)) for start in rows]
    begun = [journal.kept(f"run{i}", run) or run for i, run in enumerate(begun)]

    def keep(i: int, now: Begun) -> None:
        begun[i] = now
        journal.keep(f"run{i}", now)

    def report(i: int, image: int, state: CalibrationState | None) -> None:
        step, rms = 0, math.nan
        if state is not None:
            step, rms = int(state.step), marker_rms(evaluate.problem, state.evaluation)
        progress(SearchProgress(i, len(rows), image, step, rms))

    def run_from(known: Sequence[Basin], i: int) -> Begun:
        run = partial(run_start, evaluate, settings, rows[i], images=images)
        step = partial(report, i)
        return run(begun=begun[i], known=known, note=partial(keep, i), note_step=step)

    try:
        while n < len(rows):
            group = range(n, min(n + GROUP, len(rows)) if n else 1)
            n = group.stop
            run = partial(run_from, known_optima(begun[: group.start], images))
            evaluate.workers.side_by_side(partial(run, i) for i in group)
            if _result(space, rows[:n], begun[:n]).missed <= enough:
                break
    except KeyboardInterrupt:
        if not any(np.isfinite(run.best.cost) for run in begun):
            raise
        journal.interrupted = True
    result = _result(space, rows, begun)
    if not np.isfinite(result.cost).any():
        raise RuntimeError(
            f"none of {len(result.cost)} starts has an equilibrium in every "
            "configuration: check loads, units and bounds, or `softcal simulate`."
        )
    return result


def _result(
    space: ParameterSpace, starts: Sequence[Float[Array, " n_p"]], runs: Sequence[Begun]
) -> MultiStartResult:
    """List the ends of all runs that began, and the optima that they passed.

    Optima that runs only passed count, too: a mirror image may fit nearly as well.
    """
    begun = [i for i, run in enumerate(runs) if run.best.steps]
    starts, runs = [starts[i] for i in begun], [runs[i] for i in begun]
    numbered = space.numbered
    in_si = lambda z: np.array([from_scaled(numbered, row) for row in np.asarray(z)])
    best = [run.best for run in runs]
    z = np.stack([run.z for run in best])
    ends = [(run.cost, run.z, i) for i, run in enumerate(best) if run.converged]
    passed = [zip(run.cost, run.z, strict=True) for run in runs]
    ends += [(c, at, None) for each in passed for c, at in each if np.isfinite(c)]
    return MultiStartResult(
        names=tuple(space.names),
        starts=in_si(starts),
        values=in_si(z),
        z=z,
        cost=np.array([run.cost for run in best]),
        steps=np.array([run.steps for run in best]),
        converged=np.array([run.converged for run in best]),
        errors=np.stack([run.errors for run in best]),
        optima=_optima(space, ends),
    )


def _optima(
    space: ParameterSpace, ends: Sequence[tuple[float, HostArray, int | None]]
) -> tuple[Optimum, ...]:
    """Group ends of runs by where they are, the lowest cost first.

    Each has cost, scaled parameters, and its start; None if a run only passed it.
    """
    groups: list[list[tuple[float, HostArray, int | None]]] = []
    numbered = space.numbered
    for end in sorted(ends, key=lambda end: end[0]):
        for group in groups:
            # The distance wraps: an angle just below 90 deg is close to one above -90.
            apart = np.asarray(_distance(numbered, end[1], group[0][1]))
            if np.max(apart) <= SAME_OPTIMUM:
                group.append(end)
                break
        else:
            groups.append([end])
    values = lambda z: np.asarray(from_scaled(numbered, z)).tolist()
    return tuple(
        Optimum(
            float(group[0][0]),
            dict(zip(space.names, values(group[0][1]), strict=True)),
            tuple(sorted(start for *_, start in group if start is not None)),
        )
        for group in groups
    )
