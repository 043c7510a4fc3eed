"""The calibration loop: from configurations and measurements to parameters."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._agreement import Posed, single_recordings
from softcal_jax.calibration._budget import error_budget
from softcal_jax.calibration._checked_intervals import (
    LEVEL,
    Fitted,
    check_level,
    with_intervals,
)
from softcal_jax.calibration._checkpoint import Clock, Journal
from softcal_jax.calibration._configuration_result import (
    configuration_results,
)
from softcal_jax.calibration._noise import correlated_noise, measured_motion
from softcal_jax.calibration._notes import (
    fit_notes,
    result_notes,
    warn_if_locking,
    warn_if_too_few_data,
)
from softcal_jax.calibration._nothing_to_learn import check_effects, check_sensitive
from softcal_jax.calibration._predict import predict
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    Evaluation,
    Evaluator,
    lane_of,
)
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
    default_starts,
    random_starts,
    search,
)
from softcal_jax.calibration._state import CalibrationSettings, initial_state
from softcal_jax.calibration._uncertainty import Uncertainty, uncertainty
from softcal_jax.calibration._weighing import unknown_noise, weighed_fit
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    SharedNames,
    configuration_lanes,
    shared_names,
)
from softcal_jax.equilibrium import Model, NewtonSettings, Workers, check_converged
from softcal_jax.fields import (
    PRECISION,
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_parameters,
    check_precision,
    check_scopes,
    exactly_known,
    unnamed,
)


def build_problem(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    newton: NewtonSettings | None = None,
    *,
    uncertain: Uncertain | None = None,
) -> CalibrationProblem:
    """Stack a calibration into arrays, for `evaluate` and `multi_start`.

    Args:
        model: The body.
        parameters: What is calibrated.
        configurations: Posed robots; each with markers and measured positions.
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated, of which the
            offsets of recordings belong to the noise; by default nothing is uncertain.

    Raises:
        ValueError: If a configuration has no measurement, or a parameter no field.
    """
    posed, uncertain = as_sequence(configurations), uncertain or exactly_known()
    return _build(model, parameters, posed, newton, uncertain=uncertain)[0]


def _build(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Sequence[Configuration],
    newton: NewtonSettings | None,
    shared: SharedNames | None = None,
    *,
    uncertain: Uncertain,
) -> tuple[CalibrationProblem, ConfigurationLanes]:
    """Stack a calibration into arrays, and return its lanes with effector records."""
    for configuration in configurations:
        if not configuration.is_measured:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`, or `effectors` with measured values."
            )
    space = as_space(parameters)
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism, shared)
    check_parameters(model, space, lane_of(lanes.arrays, 0))
    warn_if_locking(model, space)
    newton = newton or NewtonSettings()
    effectors = lanes.arrays.effectors
    noise = correlated_noise(
        configurations,
        space=space,
        effectors=effectors,
        motion=measured_motion(lanes.effectors, effectors.measured.shape[1]),
        uncertain=uncertain,
    )
    return CalibrationProblem(model, space, lanes.arrays, newton, noise), lanes


def calibrate(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    *,
    validation: Configuration | Sequence[Configuration] = (),
    noise: Literal["estimated", "stated"] = "estimated",
    uncertain: Uncertain | None = None,
    precision: float = PRECISION,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    start: Float[Array, " n_p"] | None = None,
    intervals: float | None = LEVEL,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[HistoryEntry], None] | None = None,
    search_progress: Callable[[SearchProgress], None] | None = None,
    profiling: Callable[[CalibrationResult], None] = lambda _: None,
) -> CalibrationResult:
    """Find the parameters that make the simulation match the measured configurations.

    Repeats the bounded QP step on the stacked errors of all configurations until
    lambda_p vanishes (paper Eqs. 9 to 11), then predicts the configurations that were
    held out.

    Args:
        model: The body.
        parameters: What is calibrated, with start and bounds.
        configurations: Measured configurations that are fitted.
        validation: Measured configurations that are only predicted.
        noise: "stated" takes the markers' standard deviations as they are; "estimated"
            takes their ratios and finds the level from the residuals, by restricted
            maximum likelihood beside the offsets of recordings.
        uncertain: How well everything is known that is not calibrated; by default see
            `Uncertain`. It widens the standard errors, and `result.budget` splits them.
            Offsets of recordings, and a `relative_std` of the configurations, weigh the
            data.
        precision: Standard error that is asked for, relative to the value: 0.1 for
            10 %, and 0.1 rad of an axis. Verdicts compare with it, see `assess` [-].
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        starts: Number of starts of the search: that of the parameters, and random ones
            within the bounds; see `multi_start`. The fit then continues from the best.
            By default see `default_starts`; 1 where `start` is given.
        seed: Seed of the random starts.
        start: Scaled parameters to start from, instead of the start of the parameters;
            priors stay centred on the latter [-].
        intervals: Confidence of the intervals of the parameters, or None for none [-].
            They take two evaluations for each parameter; where these show that its
            standard error does not hold, a few fits for each of its ends.
        checkpoint: File in which the state is saved: after every step, and in a search
            from many starts after every image of a run. If it exists, the calibration
            resumes from it, with the same result.
        progress: Called after the first evaluation and after each step.
        search_progress: Called when a run of a search from many starts has ended, see
            `multi_start`.
        profiling: Called with the result so far before profiles of the likelihood are
            computed, which takes a while.

    Returns:
        The result; `result.converged` says whether lambda_p vanished.

    Raises:
        ValueError: If an input is wrong, nothing that is measured depends on a
            parameter, or the checkpoint is of another calibration.
        RuntimeError: If a fitted configuration has no equilibrium at the start; the
            text names it. Later failures only shorten the step, and a held-out
            configuration without equilibrium is left out with a note.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    if starts is None:
        starts = 1 if start is not None else default_starts(as_space(parameters))
    if starts < 1:
        raise ValueError(f"starts must be at least 1, got {starts}.")
    check_precision(precision)
    if intervals is not None:
        check_level(intervals)
    fit = partial(
        _fit,
        model,
        parameters,
        configurations,
        validation=validation,
        noise=noise,
        uncertain=uncertain,
        settings=settings,
        newton=newton,
        precision=precision,
        seed=seed,
        start=start,
    )
    first = fit(
        starts=starts,
        checkpoint=checkpoint,
        progress=progress,
        search_progress=search_progress,
    )
    if intervals is None:
        return first.result

    def go_on(done: Fitted, z: Float[Array, " n_p"]) -> Fitted:
        old, last = done.result, done.result.history[-1]
        later = lambda entry: replace(
            entry,
            step=entry.step + last.step,
            seconds=entry.seconds + last.seconds,
        )

        def told(entry: HistoryEntry) -> None:
            if progress is not None and entry.step:
                progress(later(entry))

        new = fit(starts=1, progress=told, begin=z)
        history = (*old.history, *map(later, new.result.history[1:]))
        timing = {k: s + new.result.timing_s[k] for k, s in old.timing_s.items()}
        changed = {"history": history, "starts": old.starts, "timing_s": timing}
        return new._replace(result=replace(new.result, **changed))

    return with_intervals(first, intervals, go_on, profiling)


def _fit(
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
    begin: Float[Array, " n_p"] | None = None,
) -> Fitted:
    """Calibrate as `calibrate` does, without intervals.

    `begin` is where the loop begins; what is reported as start is still `start`.
    """
    settings, uncertain = settings or CalibrationSettings(), uncertain or Uncertain()
    configurations = as_sequence(configurations)
    validation = as_sequence(validation)
    shared = shared_names((*configurations, *validation))
    build = partial(_build, model, parameters, uncertain=uncertain)
    problem, lanes = build(configurations, newton, shared)
    check_scopes(problem.space, configurations)
    check_effects(problem)
    # Built now, so that a wrong held-out configuration is found before the fit.
    held_out = None
    if validation:
        held_out = build(validation, newton, shared)
    names = tuple(c.name for c in configurations)
    for c in validation:
        if c.name in names:
            raise ValueError(f"configuration {c.name!r} is named more than once.")
    warn_if_too_few_data(problem)

    mark = (starts, seed) if start is None else (starts, seed, *start.tolist())
    journal = Journal(problem, settings, checkpoint, progress, search=mark)
    evaluate = Evaluator(problem)
    most = starts * max(len(configurations), 2 * len(validation))
    with Clock() as clock, Workers(model, most) as workers:
        first = _admissible(problem.space, start)
        before = there = workers.end_of(evaluate.from_rest(first))
        check_converged(before.equilibrium, names)
        check_sensitive(problem, before)
        found = None
        if begin is not None:
            there = workers.end_of(evaluate.from_rest(begin))
        elif starts > 1:
            others = random_starts(problem.space, starts - 1, seed=seed)
            found = search(
                workers,
                evaluate,
                FROM_ANYWHERE,
                jnp.concatenate([first[None], others]),
                mirror=True,
                journal=journal,
                progress=search_progress,
            )
            begin = jnp.asarray(found.z[found.best])
            there = workers.end_of(evaluate.from_rest(begin))
        begin = first if begin is None else begin
        state, weights = journal.begin(
            initial_state(settings, begin, there), problem.noise
        )
        weighed = workers.end_of(
            weighed_fit(
                evaluate.with_noise(weights),
                settings,
                state,
                unknown=unknown_noise(
                    configurations,
                    jitter=noise == "estimated",
                    offset=uncertain.recordings == "estimated",
                ),
                motion=problem.noise.motion,
                note=journal.note,
            )
        )
        begin_noise, state = problem.noise, weighed.state
        problem = problem.with_noise(weighed.noise)
        evaluate = evaluate.with_noise(weighed.noise)
        evaluation, (fitted, arrays) = state.evaluation, problem.at(state.z)
        fits = configuration_results(
            fitted,
            configurations,
            lanes._replace(arrays=arrays),
            role="calibration",
            before=before.effectors,
            after=evaluation.effectors,
            W_ep=evaluation.compliance,
            solution=evaluation.equilibrium,
            noise=weighed.noise,
        )
        spread = _uncertainty(problem, state.z, evaluation, noise, weighed.scale)
        budget = workers.end_of(
            error_budget(
                evaluate,
                configurations,
                uncertain,
                z=state.z,
                at=evaluation,
                spread=spread,
            )
        )
        checks = residual_checks(
            problem,
            configurations,
            state=state,
            W_c=budget.W_c,
            spread=spread,
            fits=fits,
        )
        missing, others = [], None
        if held_out is not None:
            other, records = held_out
            assert begin_noise is not None
            assert other.noise is not None
            weights = weighed.of_others(begin_noise, other.noise, validation)
            other = other.with_noise(weights)
            predicted, missing, others = predict(
                workers, validation, other, records, start=first, z=state.z
            )
            fits += predicted
        singles = workers.end_of(
            single_recordings(
                Posed(configurations, evaluate, evaluation),
                others,
                uncertain=uncertain,
                z=state.z,
                spread=spread,
                W_c=budget.W_c,
            )
        )
        checks = replace(checks, recordings=singles)
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
        checks=checks,
        timing_s=clock.seconds,
        notes=(
            *fit_notes(state, settings),
            *weighed.notes,
            *missing,
            *result_notes(problem, fits, state.z, spread),
        ),
        starts=found,
        precision=precision,
    )
    return Fitted(result, problem, evaluation)


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
    down, up = map(np.asarray, problem.space.room(z))
    return uncertainty(
        np.asarray(at.W_ep),
        np.asarray(at.error),
        n_measured=int(np.sum(problem.configurations.effectors.inverse_std > 0)),
        at_bound=(down >= -1e-9) | (up <= 1e-9),
        noise=noise,
        prior_weights=np.asarray(problem.space.prior_weights()),
        scale=scale,
    )


def as_sequence(
    configurations: Configuration | Sequence[Configuration],
) -> tuple[Configuration, ...]:
    """Return configurations as a tuple; a single one may be given by itself."""
    one = isinstance(configurations, Configuration)
    return (configurations,) if one else tuple(configurations)
