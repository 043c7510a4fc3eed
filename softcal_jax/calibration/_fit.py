"""One fit, stage by stage: start, search, descend, predict, judge.

    Task -> Batch -> Start -> Weighed -> Predicted -> result

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
from softcal_jax.calibration._noise import CorrelatedNoise, independent_recordings
from softcal_jax.calibration._notes import (
    ResidualChecks,
    fit_notes,
    residual_checks,
    result_notes,
)
from softcal_jax.calibration._prediction import Predicted, predict
from softcal_jax.calibration._problem import Batch, Task
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
from softcal_jax.unknowns import Setting, compile_considered, considered_errors

BUDGET, INTERVALS = "the error budget", "the intervals"  # come after the answer so far


class Watch(NamedTuple):
    """Where a fit is saved and reported; see `calibrate`."""

    checkpoint: str | os.PathLike[str] | None = None
    progress: Callable[[HistoryEntry], None] | None = None
    search_progress: Callable[[SearchProgress], None] | None = None
    equilibrium_progress: Callable[[EquilibriumProgress], None] | None = None
    answer: Callable[[CalibrationResult], None] | None = None
    stage: Callable[[str], None] = lambda _: None


class Resume(NamedTuple):
    """Where a fit goes on; its result still reports the start of the task."""

    z: Float[Array, " n_p"]
    noise: CorrelatedNoise
    history: tuple[HistoryEntry, ...]


class _Solved(NamedTuple):
    """A fit and its predictions, before they are judged."""

    start: Start
    search: MultiStartResult | None
    weighed: Weighed
    predicted: Predicted
    journal: Journal
    clock: Clock


def fit(task: Task, batch: Batch, watch: Watch, resume: Resume | None = None) -> Fitted:
    """Calibrate as `calibrate` does, without intervals, or go on from a `resume`."""
    # A checkpoint is of one set of starts and one noise.
    given = () if task.start is None else tuple(task.start.tolist())
    mark = (task.starts, task.seed, *given, task.noise, *task.uncertain.estimated)
    journal = Journal(
        batch.fitted,
        task.settings,
        watch.checkpoint,
        watch.progress,
        search=mark,
        history=() if resume is None else resume.history,
    )
    most = task.starts * max(len(task.fitted), 2 * len(task.held_out))
    with journal, Clock() as clock, Workers(task.model, most) as workers:
        start = _start(task, watch, batch, workers)
        place, search = _place(task, watch, start, journal, resume)
        weighed = _descended(task, start, place, journal)
        setting, z = batch.setting, weighed.state.z
        if not journal.interrupted:
            compile_considered(workers, setting, z)
        held_out = tuple(c.name for c in task.held_out)
        if held_out:
            watch.stage(f"predicting {', '.join(held_out)}")
        report = reports_of(watch.equilibrium_progress, held_out)
        predicted = predict(task, batch, start, weighed, report)
        journal.interrupted |= predicted.interrupted
        solved = _Solved(start, search, weighed, predicted, journal, clock)
        lanes = setting.lanes._replace(arrays=predicted.problem.configurations)
        setting = setting._replace(lanes=lanes)
        open_ = (BUDGET,) if task.intervals is None else (BUDGET, INTERVALS)
        so_far = cache(lambda: replace(_result(task, solved), left_out=open_))
        if watch.answer is not None:
            watch.answer(so_far())
        if journal.interrupted:
            result = so_far()
        else:
            result = _with_budget(task, watch, solved, setting, workers, so_far)
    problem = batch.fitted.with_noise(weighed.noise)
    result = replace(result, repeated=batch.repeated)
    return Fitted(result, problem, task.fitted, weighed.state.evaluation)


def _with_budget(
    task: Task,
    watch: Watch,
    solved: _Solved,
    setting: Setting,
    workers: Workers,
    so_far: Callable[[], CalibrationResult],
) -> CalibrationResult:
    """Judge with the considered errors, too; Ctrl-C leaves the answer so far."""
    taken, n_fitted = solved.journal.history[-1].seconds, len(task.fitted)
    z, solution = solved.weighed.state.z, solved.predicted.response.equilibrium
    try:
        watch.stage(f"{BUDGET} (the fit took {taken:.0f} s)")
        evaluate = Evaluator(solved.predicted.problem, workers)
        considered = considered_errors(
            workers,
            setting,
            z=z,
            equilibrium=solution,
            without_forces=evaluate.without_forces(z, solution),
            n_fitted=n_fitted,
        )
        return _result(task, solved, considered)
    except KeyboardInterrupt:
        notes = (*so_far().notes, f"Interrupted before {BUDGET} was known.")
        return replace(so_far(), notes=notes, interrupted=True)


def _judged(
    task: Task, weighed: Weighed, predicted: Predicted, considered: ErrorColumns | None
) -> tuple[LinearModel, Uncertainty, ResidualChecks]:
    """Make the linear model of all configurations at the optimum, and judge by it."""
    whole = replace(
        weighed.state.evaluation,
        response=predicted.response,
        delta_e=effector_errors(predicted.problem, predicted.response.effectors),
    )
    more = {"n_fitted": len(task.fitted), "considered": considered}
    poses, z = task.configurations, weighed.state.z
    linear = whole.linear(predicted.problem, poses, z, **more)
    spread = uncertainty(linear.with_scale(1.0), task.noise, weighed.scale)
    scale = spread.noise_scale if np.isfinite(spread.noise_scale) else 1.0
    linear = linear.with_scale(scale)
    checks = residual_checks(
        linear.of_fit(),
        task.fitted,
        effectors=predicted.problem.of_first(len(task.fitted)).configurations.effectors,
        spread=spread,
        fits=predicted.fits[: len(task.fitted)],
    )
    # A held-out configuration of a recording that is fitted, too, is no witness.
    names, n = independent_recordings(poses), len(task.fitted)
    witnesses = [*names[:n], *(None if k in names[:n] else k for k in names[n:])]
    asked = asked_errors(task.space, z, model=predicted.model)
    more = {"space": task.space, "z": z, "asked": asked, "spread": spread}
    recordings = recording_estimates(linear, witnesses, **more)
    return linear, spread, replace(checks, recordings=recordings)


def _result(
    task: Task, solved: _Solved, considered: ErrorColumns | None = None
) -> CalibrationResult:
    """Make the result of a fit, judged by its linear model at the optimum."""
    start, search, weighed, predicted, journal, clock = solved
    state, space, z = weighed.state, task.space, weighed.state.z
    linear, spread, checks = _judged(task, weighed, predicted, considered)
    fits = predicted.fits
    if task.noise == "stated":
        fits = tuple(fit.with_considered(linear) for fit in fits)
    known = bool(np.isfinite(spread.noise_scale))
    more = {"noise_is_known": known, "uncertain": task.uncertain}
    budget = error_budget(linear.of_fit(), space, z, **more)
    problem = predicted.problem.of_first(len(task.fitted))
    notes = result_notes(problem, predicted.fits, z, spread)
    first = start.z if start.notes else task.start
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
        settings=task.settings,
        newton=task.newton,
        noise=weighed.noise,
        noise_settled=weighed.settled,
        checks=checks,
        timing_s=clock.seconds,
        notes=(*start.notes, *weighed.notes, *predicted.notes, *notes),
        starts=search,
        precision=task.precision,
        interrupted=journal.interrupted,
    )


def _start(task: Task, watch: Watch, batch: Batch, workers: Workers) -> Start:
    """Solve the first equilibria, with moduli raised where there are none."""
    z = task.space.start() if task.start is None else task.start
    if z.shape != (len(task.space.names),):
        raise ValueError(
            f"start must have one scaled value for each of the {len(task.space.names)} "
            f"parameters, got shape {z.shape}."
        )
    first = admissible(task.space.numbered, z)
    names = tuple(c.name for c in task.fitted)
    evaluate = Evaluator(batch.fitted, workers)
    start = begin(evaluate, first, names, watch.equilibrium_progress, watch.stage)
    read = start.evaluation.response
    records = batch.setting.lanes.effectors
    check_numbers(names, records, read.effectors, read.W_ep)
    check_cost(batch.fitted, start.evaluation, names)
    check_sensitive(batch.fitted, start.evaluation)
    return start


def _place(
    task: Task, watch: Watch, start: Start, journal: Journal, resume: Resume | None
) -> tuple[Start, MultiStartResult | None]:
    """Return where the steps begin: after a search, where one is asked for."""
    evaluate = start.evaluate
    if resume is not None:
        evaluate = evaluate.with_noise(resume.noise)
        return Start(evaluate, resume.z, evaluate.from_rest(resume.z), ()), None
    if task.starts == 1:
        return start, None
    others = random_starts(task.space, task.starts - 1, seed=task.seed)
    runs = search(
        evaluate,
        FROM_ANYWHERE,
        jnp.concatenate([start.z[None], others]),
        mirror=True,
        journal=journal,
        progress=watch.search_progress or (lambda _: None),
    )
    watch.stage("equilibria at the best of the starts")
    z = jnp.asarray(runs.z[runs.best])
    return Start(evaluate, z, evaluate.from_rest(z), ()), runs


def _descended(task: Task, start: Start, place: Start, journal: Journal) -> Weighed:
    """Take steps to the optimum, or to an interruption, and weigh the data."""
    first = initial_state(task.settings, place.z, place.evaluation)
    state, noise = journal.begin(first, place.noise)
    shares = np.array([c.relative_std == "estimated" for c in task.fitted])
    offset = bool(task.uncertain.estimated)
    sought = SoughtNoise(task.noise == "estimated", offset, shares)
    try:
        if journal.interrupted:  # in the search
            raise KeyboardInterrupt
        weighed = weighed_fit(
            start.evaluate.with_noise(noise),
            task.settings,
            state,
            configurations=task.fitted,
            sought=sought,
            motion=np.asarray(start.noise.motion),
            note=journal.note,
        )
        of_steps = fit_notes(weighed.state, task.settings)
    except KeyboardInterrupt:
        journal.interrupted, of_steps = True, []
        weighed = Weighed(*journal.last, sought, (journal.interruption,))
    return weighed._replace(notes=(*of_steps, *journal.notes, *weighed.notes))
