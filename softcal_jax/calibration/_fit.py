"""One fit, stage by stage: start, search, descend, predict, judge.

    Problem -> Start -> Weighed -> Predicted -> result

The result is judged twice: by the noise alone, which is the answer so far, and with the
errors of everything that is held fixed.

One batch holds all configurations, the fitted ones first. Those held out are solved
after the fit, as many of them would slow every step down, and have no weight in it.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._process import Clock
from softcal_jax._typing import Array, Float
from softcal_jax.calibration._checked_intervals import Fitted
from softcal_jax.calibration._checkpoint import HistoryEntry, Journal
from softcal_jax.calibration._evaluation import (
    Evaluator,
    check_cost,
    check_sensitive,
    effector_errors,
)
from softcal_jax.calibration._notes import (
    ResidualChecks,
    fit_notes,
    residual_checks,
    result_notes,
)
from softcal_jax.calibration._prediction import Predicted, predict
from softcal_jax.calibration._problem import FitOptions
from softcal_jax.calibration._result import (
    CalibrationResult,
    MultiStartResult,
    parameter_estimates,
)
from softcal_jax.calibration._runs import admissible
from softcal_jax.calibration._starts import (
    FROM_ANYWHERE,
    SearchProgress,
    Start,
    begin,
    random_starts,
    search,
)
from softcal_jax.calibration._step import initial_state
from softcal_jax.calibration._weighing import SoughtNoise, Weighed, weighed_fit
from softcal_jax.configurations import check_numbers
from softcal_jax.equilibrium import EquilibriumProgress, Workers, reports_of
from softcal_jax.fields import asked_errors
from softcal_jax.inference import (
    ErrorColumns,
    LinearModel,
    Uncertainty,
    error_budget,
    recording_estimates,
    uncertainty,
)
from softcal_jax.unknowns import (
    CorrelatedNoise,
    Problem,
    compile_considered,
    considered_errors,
    independent_recordings,
)

BUDGET, INTERVALS = "the error budget", "the intervals"  # come after the answer so far


Event = str | HistoryEntry | SearchProgress | EquilibriumProgress | CalibrationResult
"""What a fit tells while it runs.

What is computed next, in words; a step of the fit, of a search, or of equilibria that
are solved from rest; and once, before the error budget, the result so far.
"""

Watch = Callable[[Event], None]


class Resume(NamedTuple):
    """Where a fit goes on; its result still reports the start of the task."""

    z: Float[Array, " n_p"]
    noise: CorrelatedNoise
    history: tuple[HistoryEntry, ...]


class _Solved(NamedTuple):
    """A fit and its predictions, before they are judged."""

    options: FitOptions
    start: Start
    search: MultiStartResult | None
    weighed: Weighed
    predicted: Predicted
    journal: Journal
    clock: Clock


def fit(
    problem: Problem,
    options: FitOptions,
    watch: Watch | None,
    *,
    answers: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Resume | None = None,
) -> Fitted:
    """Calibrate as `calibrate` does, without intervals, or go on from a `resume`.

    With `answers`, the watch is told the result so far, which takes a moment.
    """
    tell = watch or (lambda _: None)
    # A checkpoint is of one set of starts and one noise.
    first = () if options.start is None else tuple(options.start.tolist())
    estimated = problem.uncertain.estimated
    mark = (options.starts, options.seed, *first, options.noise, *estimated)
    fitted = problem.fitted
    journal = Journal(
        fitted,
        options.settings,
        checkpoint,
        tell,
        search=mark,
        history=() if resume is None else resume.history,
    )
    most = options.starts * max(problem.n_fitted, 2 * problem.n_held_out)
    with journal, Clock() as clock, Workers(problem.model, most) as workers:
        start = _start(fitted, options, watch, workers)
        place, search = _place(options, tell, start, journal, resume)
        weighed = _descended(options, start, place, journal)
        z = weighed.state.z
        if not journal.interrupted:
            compile_considered(workers, problem, z)
        held_out = problem.names[problem.n_fitted :]
        if held_out:
            tell(f"predicting {', '.join(held_out)}")
        report = reports_of(watch, held_out)
        predicted = predict(problem, start, weighed, report)
        journal.interrupted |= predicted.interrupted
        solved = _Solved(options, start, search, weighed, predicted, journal, clock)
        open_ = (BUDGET,) if options.intervals is None else (BUDGET, INTERVALS)
        so_far = cache(lambda: replace(_result(solved), left_out=open_))
        if answers:
            tell(so_far())
        if journal.interrupted:
            result = so_far()
        else:
            result = _with_budget(tell, solved, workers, so_far)
    return Fitted(result, fitted.with_noise(weighed.noise), weighed.state.evaluation)


def _with_budget(
    tell: Watch,
    solved: _Solved,
    workers: Workers,
    so_far: Callable[[], CalibrationResult],
) -> CalibrationResult:
    """Judge with the considered errors, too; Ctrl-C leaves the answer so far."""
    taken, problem = solved.journal.history[-1].seconds, solved.predicted.problem
    z, solution = solved.weighed.state.z, solved.predicted.response.equilibrium
    try:
        tell(f"{BUDGET} (the fit took {taken:.0f} s)")
        considered = considered_errors(
            workers,
            problem,
            z=z,
            equilibrium=solution,
            without_forces=Evaluator(problem, workers).without_forces(z, solution),
        )
        return _result(solved, considered)
    except KeyboardInterrupt:
        notes = (*so_far().notes, f"Interrupted before {BUDGET} was known.")
        return replace(so_far(), notes=notes, interrupted=True)


def _judged(
    solved: _Solved, considered: ErrorColumns | None
) -> tuple[LinearModel, Uncertainty, ResidualChecks]:
    """Make the linear model of all configurations at the optimum, and judge by it."""
    options, weighed, predicted = solved.options, solved.weighed, solved.predicted
    problem, z, n = predicted.problem, weighed.state.z, predicted.problem.n_fitted
    whole = replace(
        weighed.state.evaluation,
        response=predicted.response,
        delta_e=effector_errors(problem, predicted.response.effectors),
    )
    linear = whole.linear(problem, z, considered=considered)
    spread = uncertainty(linear.with_scale(1.0), options.noise, weighed.scale)
    scale = spread.noise_scale if np.isfinite(spread.noise_scale) else 1.0
    linear = linear.with_scale(scale)
    checks = residual_checks(
        linear.of_fit(),
        problem.poses[:n],
        effectors=problem.fitted.configurations.effectors,
        spread=spread,
        fits=predicted.fits[:n],
    )
    # A held-out configuration of a recording that is fitted, too, is no witness.
    names = independent_recordings(problem.poses)
    witnesses = [*names[:n], *(None if k in names[:n] else k for k in names[n:])]
    asked = asked_errors(problem.space, z, model=predicted.model)
    more = {"space": problem.space, "z": z, "asked": asked, "spread": spread}
    recordings = recording_estimates(linear, witnesses, **more)
    return linear, spread, replace(checks, recordings=recordings)


def _result(
    solved: _Solved, considered: ErrorColumns | None = None
) -> CalibrationResult:
    """Make the result of a fit, judged by its linear model at the optimum."""
    options, start, search, weighed, predicted, journal, clock = solved
    state, problem = weighed.state, predicted.problem
    space, z = problem.space, state.z
    linear, spread, checks = _judged(solved, considered)
    fits = predicted.fits
    if options.noise == "stated":
        fits = tuple(fit.with_considered(linear) for fit in fits)
    known = bool(np.isfinite(spread.noise_scale))
    more = {"noise_is_known": known, "uncertain": problem.uncertain}
    budget = error_budget(linear.of_fit(), space, z, **more)
    notes = result_notes(problem.fitted, predicted.fits, z, spread)
    first = start.z if start.notes else options.start
    return CalibrationResult(
        converged=bool(state.converged),
        parameters=parameter_estimates(space, spread, budget, first),
        uncertainty=spread,
        budget=budget,
        configurations=fits,
        history=tuple(journal.history),
        space=space,
        model=predicted.model,
        z=z,
        linear=linear,
        settings=options.settings,
        newton=problem.newton,
        noise=weighed.noise,
        noise_settled=weighed.settled,
        checks=checks,
        timing_s=clock.seconds,
        notes=(*start.notes, *weighed.notes, *predicted.notes, *notes),
        starts=search,
        precision=options.precision,
        interrupted=journal.interrupted,
    )


def _start(
    problem: Problem, options: FitOptions, watch: Watch | None, workers: Workers
) -> Start:
    """Solve the first equilibria, with moduli raised where there are none."""
    space = problem.space
    z = space.start() if options.start is None else options.start
    if z.shape != (len(space.names),):
        raise ValueError(
            f"start must have one scaled value for each of the {len(space.names)} "
            f"parameters, got shape {z.shape}."
        )
    first = admissible(space.numbered, z)
    evaluate = Evaluator(problem, workers)
    start = begin(evaluate, first, watch)
    read = start.evaluation.response
    check_numbers(problem.names, problem.records, read.effectors, read.W_ep)
    check_cost(problem, start.evaluation)
    check_sensitive(problem, start.evaluation)
    return start


def _place(
    options: FitOptions,
    tell: Watch,
    start: Start,
    journal: Journal,
    resume: Resume | None,
) -> tuple[Start, MultiStartResult | None]:
    """Return where the steps begin: after a search, where one is asked for."""
    evaluate = start.evaluate
    if resume is not None:
        evaluate = evaluate.with_noise(resume.noise)
        return Start(evaluate, resume.z, evaluate.from_rest(resume.z), ()), None
    if options.starts == 1:
        return start, None
    space = evaluate.problem.space
    others = random_starts(space, options.starts - 1, seed=options.seed)
    runs = search(
        evaluate,
        FROM_ANYWHERE,
        jax.device_put(np.concatenate([np.asarray(start.z)[None], others])),
        mirror=True,
        journal=journal,
        progress=tell,
    )
    tell("equilibria at the best of the starts")
    z = jnp.asarray(runs.z[runs.best])
    return Start(evaluate, z, evaluate.from_rest(z), ()), runs


def _descended(
    options: FitOptions, start: Start, place: Start, journal: Journal
) -> Weighed:
    """Take steps to the optimum, or to an interruption, and weigh the data."""
    settings, problem = options.settings, start.evaluate.problem
    first = initial_state(settings, place.evaluation)
    state, noise = journal.begin(first, place.noise)
    shares = np.array([c.relative_std == "estimated" for c in problem.poses])
    offset = bool(problem.uncertain.estimated)
    sought = SoughtNoise(options.noise == "estimated", offset, shares)
    try:
        if journal.interrupted:  # in the search
            raise KeyboardInterrupt
        weighed = weighed_fit(
            start.evaluate.with_noise(noise),
            settings,
            state,
            sought=sought,
            motion=np.asarray(start.noise.motion),
            note=journal.note,
        )
        of_steps = fit_notes(weighed.state, settings)
    except KeyboardInterrupt:
        journal.interrupted, of_steps = True, []
        weighed = Weighed(*journal.last, sought, (journal.interruption,))
    return weighed._replace(notes=(*of_steps, *journal.notes, *weighed.notes))
