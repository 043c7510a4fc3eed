"""One fit: search, loop, noise, error budget, checks and predictions."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._agreement import (
    Posed,
    errors_of_all,
    not_asked,
    single_recordings,
    that_stack_up,
)
from softcal_jax.calibration._begin import EquilibriumProgress, begin
from softcal_jax.calibration._budget import error_budget
from softcal_jax.calibration._build import as_sequence, build
from softcal_jax.calibration._checked_intervals import (
    Fitted,
)
from softcal_jax.calibration._checkpoint import Clock, Journal
from softcal_jax.calibration._configuration_result import (
    configuration_results,
)
from softcal_jax.calibration._evaluation import Evaluation, Evaluator
from softcal_jax.calibration._noise import CorrelatedNoise
from softcal_jax.calibration._notes import (
    fit_notes,
    result_notes,
    warn_if_too_few_data,
)
from softcal_jax.calibration._nothing_to_learn import (
    check_cost,
    check_effects,
    check_sensitive,
)
from softcal_jax.calibration._offsets import attachment_offsets, with_offsets
from softcal_jax.calibration._predict import predict
from softcal_jax.calibration._problem import CalibrationProblem, n_measured
from softcal_jax.calibration._references import check_references
from softcal_jax.calibration._residual_checks import residual_checks
from softcal_jax.calibration._result import (
    CalibrationResult,
    HistoryEntry,
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
from softcal_jax.calibration._uncertainty import Uncertainty, uncertainty
from softcal_jax.calibration._weighing import (
    Unknown,
    Weighed,
    unknown_noise,
    weighed_fit,
)
from softcal_jax.configurations import (
    Configuration,
    shared_names,
)
from softcal_jax.equilibrium import Model, NewtonSettings, Workers
from softcal_jax.fields import (
    Entry,
    ParameterSpace,
    Uncertain,
    check_scopes,
    unnamed,
)


class Resume(NamedTuple):
    """Where a loop goes on: scaled parameters, and the noise that weighs the data."""

    z: Float[Array, " n_p"]
    noise: CorrelatedNoise


def fit(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    *,
    validation: Configuration | Sequence[Configuration],
    noise: Literal["estimated", "stated"],
    uncertain: Uncertain | None,
    settings: CalibrationSettings | None,
    newton: NewtonSettings | None,
    precision: float,
    starts: int,
    seed: int,
    start: Float[Array, " n_p"] | None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[HistoryEntry], None] | None = None,
    search_progress: Callable[[SearchProgress], None] | None = None,
    equilibrium_progress: Callable[[EquilibriumProgress], None] | None = None,
    resume: Resume | None = None,
) -> Fitted:
    """Calibrate as `calibrate` does, without intervals.

    `resume` is where the loop begins; what is reported as start is still `start`.
    """
    settings, uncertain = settings or CalibrationSettings(), uncertain or Uncertain()
    configurations = as_sequence(configurations)
    validation = as_sequence(validation)
    shared = shared_names((*configurations, *validation))
    stack = partial(build, model, parameters, uncertain=uncertain)
    problem, lanes = stack(configurations, newton, shared)
    assert problem.noise is not None
    check_scopes(problem.space, configurations)
    check_effects(problem)
    # Built now, so that a wrong held-out configuration is found before the fit.
    held_out = None
    if validation:
        held_out = stack(validation, newton, shared)
    names = tuple(c.name for c in configurations)
    every = (*lanes.effectors, *(held_out[1].effectors if held_out else ()))
    check_references((*configurations, *validation), every, fitted=configurations)
    for c in validation:
        if c.name in names:
            raise ValueError(f"configuration {c.name!r} is named more than once.")
    warn_if_too_few_data(problem)

    given = () if start is None else tuple(start.tolist())
    mark = (starts, seed, *given, noise, uncertain.recordings)
    journal = Journal(problem, settings, checkpoint, progress, search=mark)
    most = starts * max(len(configurations), 2 * len(validation))
    with journal, Clock() as clock, Workers(model, most) as workers:
        evaluate = Evaluator(problem, workers)
        first = _admissible(problem.space, start)
        begun = begin(evaluate, first, names, equilibrium_progress)
        before = there = begun.evaluation
        if begun.notes:
            first = start = begun.z
        check_cost(problem, before, names)
        check_sensitive(problem, before)
        found, place, weights = None, first, problem.noise
        if resume is not None:
            place, weights = resume
            evaluate = evaluate.with_noise(weights)
            there = evaluate.from_rest(place)
        elif starts > 1:
            others = random_starts(problem.space, starts - 1, seed=seed)
            found = search(
                evaluate,
                FROM_ANYWHERE,
                jnp.concatenate([first[None], others]),
                mirror=True,
                journal=journal,
                progress=search_progress,
            )
            place = jnp.asarray(found.z[found.best])
            there = evaluate.from_rest(place)
        state, weights = journal.begin(initial_state(settings, place, there), weights)
        unknown = unknown_noise(
            configurations,
            jitter=noise == "estimated",
            offset=uncertain.recordings == "estimated",
        )
        to_its_end = partial(
            weighed_fit,
            evaluate.with_noise(weights),
            settings,
            state,
            unknown=unknown,
            motion=np.asarray(problem.noise.motion),
            note=journal.note,
        )
        weighed = _to_its_end(to_its_end, journal, unknown)
        begin_noise, state = problem.noise, weighed.state
        problem = problem.with_noise(weighed.noise)
        evaluation, (fitted, arrays) = state.evaluation, problem.at(state.z)
        offsets = attachment_offsets(problem, configurations, lanes, evaluation)
        fits = configuration_results(
            fitted,
            configurations,
            with_offsets(configurations, lanes._replace(arrays=arrays), offsets),
            role="calibration",
            before=before.effectors,
            after=evaluation.effectors,
            W_ep=evaluation.compliance,
            solution=evaluation.equilibrium,
            noise=weighed.noise,
        )
        spread = _uncertainty(problem, state.z, evaluation, noise, weighed.scale)
        predicted, missing, others = (), [], None
        if held_out is not None:
            other, records = held_out
            assert begin_noise is not None
            assert other.noise is not None
            weights = weighed.of_others(begin_noise, other.noise, validation)
            other = other.with_noise(weights)
            predicted, missing, others = predict(
                workers,
                validation,
                other,
                with_offsets(validation, records, offsets),
                start=first,
                z=state.z,
            )
        posed = Posed(configurations, problem, evaluation)
        parts = that_stack_up(posed, others)
        errors = errors_of_all(workers, parts, uncertain, state.z)
        budget = error_budget(
            problem,
            configurations,
            uncertain,
            errors.by_cause(len(configurations)),
            z=state.z,
            at=evaluation,
            spread=spread,
        )
        checks = residual_checks(
            problem,
            configurations,
            state=state,
            W_c=budget.W_c,
            spread=spread,
            fits=fits,
        )
        singles = single_recordings(parts, errors, z=state.z, spread=spread)
        checks = replace(checks, recordings=singles)
        fits += predicted
    result = CalibrationResult(
        converged=bool(state.converged),
        parameters=parameter_estimates(problem.space, state.z, spread, budget, start),
        uncertainty=spread,
        budget=budget,
        configurations=fits,
        history=tuple(journal.history),
        space=problem.space,
        model=fitted,
        z=state.z,
        W_ep=np.asarray(evaluation.W_ep),
        settings=settings,
        newton=problem.newton,
        noise=weighed.noise,
        noise_settled=weighed.settled,
        checks=checks,
        timing_s=clock.seconds,
        notes=(
            *begun.notes,
            *(() if journal.interrupted else fit_notes(state, settings)),
            *journal.notes,
            *weighed.notes,
            *missing,
            *(not_asked(posed, others) if spread.has_noise else ()),
            *result_notes(problem, fits, state.z, spread),
        ),
        starts=found,
        precision=precision,
        interrupted=journal.interrupted,
    )
    return Fitted(result, problem, evaluation)


def _to_its_end(
    run: Callable[[], Weighed], journal: Journal, unknown: Unknown
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
        unknown=unknown,
        scale=None,
        notes=(note,),
        settled=True,
    )


def _admissible(
    space: ParameterSpace, start: Float[Array, " n_p"] | None
) -> Float[Array, " n_p"]:
    """Return the first start, moved within bounds and order."""
    if start is None:
        start = space.start()
    if start.shape != (len(space.names),):
        raise ValueError(
            f"start must have one scaled value for each of the {len(space.names)} "
            f"parameters, got shape {start.shape}."
        )
    return admissible(unnamed(space), start)


def _uncertainty(
    problem: CalibrationProblem, z, at: Evaluation, noise, scale: float | None
) -> Uncertainty:
    return uncertainty(
        np.asarray(at.W_ep),
        np.asarray(at.error),
        n_measured=n_measured(problem),
        at_bound=problem.space.at_bound(z),
        noise=noise,
        prior_weights=np.asarray(problem.space.prior_weights()),
        scale=scale,
    )
