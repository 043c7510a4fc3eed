"""One fit, stage by stage: start, search, descend, predict, judge.

    Task -> Batch -> Start -> Place -> Weighed -> Predicted -> LinearModel -> result

One batch holds all configurations, the fitted ones first. The steps evaluate these
alone; those held out are solved once with what was found, by the same program, and are
rows without weight in the linear model.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._begin import Beginning, EquilibriumProgress, begin
from softcal_jax.calibration._build import build
from softcal_jax.calibration._checked_intervals import Fitted
from softcal_jax.calibration._checkpoint import Clock, Journal
from softcal_jax.calibration._checks import (
    check_cost,
    check_effects,
    check_sensitive,
)
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    configuration_results,
)
from softcal_jax.calibration._considered import ConsideredErrors, considered_errors
from softcal_jax.calibration._evaluation import (
    Evaluation,
    Evaluator,
    effector_errors,
    held_out_responses,
)
from softcal_jax.calibration._linear import linear_model
from softcal_jax.calibration._noise import (
    CorrelatedNoise,
    check_references,
    independent_recordings,
)
from softcal_jax.calibration._notes import (
    ResidualChecks,
    fit_notes,
    residual_checks,
    result_notes,
    warn_if_too_few_data,
)
from softcal_jax.calibration._offsets import attachment_offsets, with_offsets
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._result import (
    CalibrationResult,
    HistoryEntry,
    MultiStartResult,
    parameter_estimates,
)
from softcal_jax.calibration._runs import admissible
from softcal_jax.calibration._search import (
    FROM_ANYWHERE,
    SearchProgress,
    random_starts,
    search,
)
from softcal_jax.calibration._state import CalibrationSettings, initial_state
from softcal_jax.calibration._weighing import (
    SoughtNoise,
    Weighed,
    sought_noise,
    weighed_fit,
)
from softcal_jax.configurations import Configuration, ConfigurationLanes
from softcal_jax.equilibrium import Model, NewtonSettings, Workers
from softcal_jax.fields import ParameterSpace, Uncertain, check_scopes, unnamed
from softcal_jax.inference import (
    ErrorBudget,
    LinearModel,
    Uncertainty,
    error_budget,
    recording_estimates,
    uncertainty,
)
from softcal_jax.sensitivity import Response


class Task(NamedTuple):
    """What is to be calibrated, and how; as `calibrate` is told."""

    model: Model
    space: ParameterSpace
    fitted: tuple[Configuration, ...]
    held_out: tuple[Configuration, ...]
    noise: Literal["estimated", "stated"]
    uncertain: Uncertain
    settings: CalibrationSettings
    newton: NewtonSettings
    precision: float
    starts: int
    seed: int
    start: Float[Array, " n_p"] | None

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All of them, the fitted ones first."""
        return (*self.fitted, *self.held_out)


class Watch(NamedTuple):
    """Where a fit is saved and reported; see `calibrate`."""

    checkpoint: str | os.PathLike[str] | None = None
    progress: Callable[[HistoryEntry], None] | None = None
    search_progress: Callable[[SearchProgress], None] | None = None
    equilibrium_progress: Callable[[EquilibriumProgress], None] | None = None


class Resume(NamedTuple):
    """Where a loop goes on: scaled parameters, and the noise that weighs the data.

    What a result reports as its start is still that of the task.
    """

    z: Float[Array, " n_p"]
    noise: CorrelatedNoise


class _Batch(NamedTuple):
    """All configurations as arrays, and the calibration to those that are fitted."""

    everything: CalibrationProblem
    fitted: CalibrationProblem
    lanes: ConfigurationLanes


class _Start(NamedTuple):
    """The first equilibria: an evaluator of the fitted configurations, and where."""

    evaluate: Evaluator
    begun: Beginning


class _Place(NamedTuple):
    """Where the steps begin, the noise that weighs them, and the search before."""

    z: Float[Array, " n_p"]
    evaluation: Evaluation
    noise: CorrelatedNoise
    search: MultiStartResult | None


class _Predicted(NamedTuple):
    """All configurations with the calibrated parameters, and their noise."""

    problem: CalibrationProblem
    response: Response
    delta_e: Float[HostArray, "n_c n_rows 3"]
    fits: tuple[ConfigurationResult, ...]
    notes: tuple[str, ...]


class _Judged(NamedTuple):
    """What may be said of the values."""

    linear: LinearModel
    spread: Uncertainty
    budget: ErrorBudget
    checks: ResidualChecks
    notes: list[str]


def fit(task: Task, watch: Watch, resume: Resume | None = None) -> Fitted:
    """Calibrate as `calibrate` does, without intervals, or go on from a `resume`."""
    batch = _batch(task)
    journal = _journal(task, watch, batch)
    most = task.starts * max(len(task.fitted), 2 * len(task.held_out))
    with journal, Clock() as clock, Workers(task.model, most) as workers:
        start = _start(task, watch, batch, workers)
        place = _place(task, watch, start, journal, resume)
        weighed = _descended(task, start, place, journal)
        predicted = _predicted(task, batch, start, weighed)
        judged = _judged(task, weighed, predicted, workers)
    state, space = weighed.state, task.space
    spread, budget, begun = judged.spread, judged.budget, start.begun
    first = begun.z if begun.notes else task.start
    stages = begun, weighed, predicted, judged
    result = CalibrationResult(
        converged=bool(state.converged),
        parameters=parameter_estimates(space, state.z, spread, budget, first),
        uncertainty=spread,
        budget=budget,
        configurations=predicted.fits,
        history=tuple(journal.history),
        space=space,
        model=space.model_at(task.model, state.z),
        z=state.z,
        linear=judged.linear,
        settings=task.settings,
        newton=task.newton,
        noise=weighed.noise,
        noise_settled=weighed.settled,
        checks=judged.checks,
        timing_s=clock.seconds,
        notes=tuple(note for stage in stages for note in stage.notes),
        starts=place.search,
        precision=task.precision,
        interrupted=journal.interrupted,
    )
    problem = batch.fitted.with_noise(weighed.noise)
    return Fitted(result, problem, task.fitted, state.evaluation)


def _batch(task: Task) -> _Batch:
    """Stack all configurations, and check them before the first solve."""
    everything, lanes = build(
        task.model,
        task.space,
        task.configurations,
        task.newton,
        uncertain=task.uncertain,
    )
    fitted = everything.of_first(len(task.fitted))
    check_scopes(task.space, task.fitted)
    check_effects(fitted)
    check_references(task.configurations, lanes.effectors, fitted=task.fitted)
    names = [c.name for c in task.configurations]
    for c in task.held_out:
        if names.count(c.name) > 1:
            raise ValueError(f"configuration {c.name!r} is named more than once.")
    warn_if_too_few_data(fitted)
    return _Batch(everything, fitted, lanes)


def _journal(task: Task, watch: Watch, batch: _Batch) -> Journal:
    """Open the history; a checkpoint is of one set of starts and one noise."""
    start = () if task.start is None else tuple(task.start.tolist())
    mark = (task.starts, task.seed, *start, task.noise, task.uncertain.recordings)
    return Journal(
        batch.fitted, task.settings, watch.checkpoint, watch.progress, search=mark
    )


def _start(task: Task, watch: Watch, batch: _Batch, workers: Workers) -> _Start:
    """Solve the first equilibria, with moduli raised where there are none."""
    evaluate = Evaluator(batch.fitted, workers)
    z = task.space.start() if task.start is None else task.start
    if z.shape != (len(task.space.names),):
        raise ValueError(
            f"start must have one scaled value for each of the {len(task.space.names)} "
            f"parameters, got shape {z.shape}."
        )
    first = admissible(unnamed(task.space), z)
    names = [c.name for c in task.fitted]
    begun = begin(evaluate, first, names, watch.equilibrium_progress)
    check_cost(batch.fitted, begun.evaluation, names)
    check_sensitive(batch.fitted, begun.evaluation)
    return _Start(evaluate, begun)


def _place(
    task: Task,
    watch: Watch,
    start: _Start,
    journal: Journal,
    resume: Resume | None,
) -> _Place:
    """Return where the steps begin: after a search, where one is asked for."""
    evaluate, (first, evaluation, _) = start
    noise = evaluate.problem.noise
    assert noise is not None
    if resume is not None:
        evaluate = evaluate.with_noise(resume.noise)
        return _Place(resume.z, evaluate.from_rest(resume.z), resume.noise, None)
    if task.starts == 1:
        return _Place(first, evaluation, noise, None)
    others = random_starts(task.space, task.starts - 1, seed=task.seed)
    runs = search(
        evaluate,
        FROM_ANYWHERE,
        jnp.concatenate([first[None], others]),
        mirror=True,
        journal=journal,
        progress=watch.search_progress,
    )
    z = jnp.asarray(runs.z[runs.best])
    return _Place(z, evaluate.from_rest(z), noise, runs)


def _descended(task: Task, start: _Start, place: _Place, journal: Journal) -> Weighed:
    """Take steps to the optimum, and weigh the data by the noise that they show."""
    state, noise = journal.begin(
        initial_state(task.settings, place.z, place.evaluation), place.noise
    )
    sought = sought_noise(
        task.fitted,
        jitter=task.noise == "estimated",
        offset=task.uncertain.recordings == "estimated",
    )
    as_measured = start.evaluate.problem.noise
    assert as_measured is not None
    to_its_end = partial(
        weighed_fit,
        start.evaluate.with_noise(noise),
        task.settings,
        state,
        configurations=task.fitted,
        sought=sought,
        motion=np.asarray(as_measured.motion),
        note=journal.note,
    )
    weighed = _to_its_end(to_its_end, journal, sought)
    of_steps = [] if journal.interrupted else fit_notes(weighed.state, task.settings)
    return weighed._replace(notes=(*of_steps, *journal.notes, *weighed.notes))


def _to_its_end(
    run: Callable[[], Weighed], journal: Journal, sought: SoughtNoise
) -> Weighed:
    """Run a fit to its end, or to its last step before the user interrupts it."""
    if not journal.interrupted:
        try:
            return run()
        except KeyboardInterrupt:
            journal.interrupted = True
    assert journal.last is not None
    state, noise = journal.last
    assert noise is not None
    note = (
        f"Interrupted after step {journal.history[-1].step}: the values are those of "
        "that step, and the noise is that which weighed it. Do not use them as a "
        f"result.{journal.stands}"
    )
    return Weighed(
        state=state,
        noise=noise,
        sought=sought,
        scale=None,
        notes=(note,),
        settled=True,
    )


def _predicted(
    task: Task, batch: _Batch, start: _Start, weighed: Weighed
) -> _Predicted:
    """Describe all configurations at the optimum; solve those that were held out."""
    z, n_fitted, everything = weighed.state.z, len(task.fitted), batch.everything
    at, notes = weighed.state.evaluation, ()
    before, response = start.begun.evaluation.response.effectors, at.response
    if task.held_out:
        others = Evaluator(everything.without_first(n_fitted), start.evaluate.workers)
        held = held_out_responses(others, task.held_out, start=start.begun.z, z=z)
        join = lambda *parts: np.concatenate([*map(np.asarray, parts)])
        before, notes = join(before, held.before), held.notes
        response = jax.device_put(jax.tree.map(join, response, held.response))
    assert everything.noise is not None
    noise = weighed.of_all(everything.noise, task.configurations)
    problem = everything.with_noise(noise)
    offsets = attachment_offsets(
        batch.fitted, task.configurations, batch.lanes, at.delta_e
    )
    lanes = batch.lanes._replace(arrays=everything.at(z)[1])
    fits = configuration_results(
        task.space.model_at(task.model, z),
        task.configurations,
        with_offsets(task.configurations, lanes, offsets),
        n_fitted=n_fitted,
        before=before,
        response=response,
        noise=noise,
    )
    delta_e = np.asarray(effector_errors(problem, response.effectors))
    return _Predicted(problem, response, delta_e, fits, notes)


def _judged(
    task: Task, weighed: Weighed, predicted: _Predicted, workers: Workers
) -> _Judged:
    """Judge the values by the linear model at the optimum."""
    z, n_fitted, problem = weighed.state.z, len(task.fitted), predicted.problem
    doubts = considered_errors(
        workers,
        problem,
        task.configurations,
        task.uncertain,
        z=z,
        equilibrium=predicted.response.equilibrium,
    )
    linear = _linear(task, weighed, predicted, doubts)
    spread = uncertainty(linear.with_scale(1.0), task.noise, weighed.scale)
    noise_is_known = bool(np.isfinite(spread.noise_scale))
    linear = linear.with_scale(spread.noise_scale if noise_is_known else 1.0)
    budget = error_budget(
        linear.of_fit(),
        task.space,
        z,
        noise_is_known=noise_is_known,
        unknown=doubts.unknown(n_fitted),
    )
    checks = residual_checks(
        linear.of_fit(),
        task.fitted,
        effectors=problem.of_first(n_fitted).configurations.effectors,
        spread=spread,
        fits=predicted.fits[:n_fitted],
    )
    witnesses = _witnesses(task, doubts)
    recordings = recording_estimates(
        linear, witnesses, space=task.space, z=z, spread=spread
    )
    checks = replace(checks, recordings=recordings)
    notes = result_notes(problem.of_first(n_fitted), predicted.fits, z, spread)
    return _Judged(linear, spread, budget, checks, notes)


def _linear(
    task: Task, weighed: Weighed, predicted: _Predicted, doubts: ConsideredErrors
) -> LinearModel:
    """Make the linear model of all configurations at the optimum."""
    n_fitted, problem = len(task.fitted), predicted.problem
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    return linear_model(
        problem,
        task.configurations,
        z=weighed.state.z,
        W_ep=predicted.response.W_ep,
        ok=predicted.response.ok,
        delta_e=predicted.delta_e,
        rows=weighed.state.evaluation.rows,
        n_fitted=n_fitted,
        considered=doubts.in_std(n_fitted, weight),
    )


def _witnesses(task: Task, doubts: ConsideredErrors) -> list[str | None]:
    """Return the recording of each configuration that may be asked alone.

    None for those held out of a recording that is fitted, too, and where the error of
    the mesh, which counts elsewhere, is not known.
    """
    recordings = independent_recordings(task.configurations)
    n = len(task.fitted)
    known = [True] * len(recordings) if doubts.mesh is None else doubts.mesh.known
    counts = doubts.mesh is None or not np.all(doubts.mesh.known[:n])
    return [
        name if k < n or (name not in recordings[:n] and (counts or known[k])) else None
        for k, name in enumerate(recordings)
    ]
