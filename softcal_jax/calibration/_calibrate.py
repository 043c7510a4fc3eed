"""The calibration: from measured configurations to parameters and their intervals."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from softcal_jax._lanes import lane_of
from softcal_jax._process import check_process, progress_line
from softcal_jax._text import check_known, listed
from softcal_jax._typing import Array, Float
from softcal_jax.calibration._checked_intervals import (
    LEVEL,
    Fitted,
    check_level,
    whole_interval,
    with_intervals,
)
from softcal_jax.calibration._evaluation import evaluate
from softcal_jax.calibration._fit import Resume, Watch, fit
from softcal_jax.calibration._notes import (
    CalibrationWarning,
    warn_if_locking,
    warn_if_too_few_data,
)
from softcal_jax.calibration._problem import (
    CalibrationSettings,
    FitOptions,
    check_effects,
)
from softcal_jax.calibration._result import CalibrationResult, ParameterInterval
from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    check_converged,
)
from softcal_jax.fields import (
    PRECISION,
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_parameters,
    check_precision,
    check_scopes,
    check_starts,
    default_starts,
    exactly_known,
)
from softcal_jax.unknowns import Problem, check_references, correlated_noise, read_once


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
    watch: Watch | Literal[False] | None = None,
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
            takes their ratios and estimates the level from the residuals, by restricted
            maximum likelihood that accounts for offsets of recordings.
        uncertain: How well everything that is not calibrated is known. It widens the
            standard errors, and `result.budget` splits them. Offsets of recordings, and
            a `relative_std` of the configurations, weigh the data.
        precision: Standard error that verdicts ask for, relative to the value: 0.1 for
            10 %, and 0.1 rad of an axis [-].
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        starts: Most starts of a search: the start of the parameters, then random ones
            within the bounds; see `multi_start`. The fit then continues from the best.
            By default the number of `default_starts`, or 1 where `start` is given.
        seed: Seed of the random starts.
        start: Scaled parameters to start from, instead of the start of the parameters;
            priors stay centred on the latter [-].
        intervals: Confidence of the intervals of the parameters, or None for none [-].
            They take two evaluations for each parameter, and a few fits for each end
            where its standard error does not hold.
        checkpoint: File in which the state is saved after every step, and in a search
            after every image of a run. If it exists, the calibration resumes from it,
            with the same result. Where it cannot be written any more, as on a full
            disk, the calibration goes on with a warning and a note.
        watch: Called with what happens: a text says what is computed next; a
            `HistoryEntry`, a `SearchProgress` or an `EquilibriumProgress` is a step of
            the fit, of a search or of equilibria from rest (the last two in threads,
            one at a time); a `CalibrationResult` is the result so far, with standard
            errors by the noise alone, and its `left_out` says what is to come. By
            default, on a terminal and in notebooks, a line says what is under way;
            False switches it off.

    Returns:
        The result; `result.converged` says whether lambda_p vanished. Ctrl-C ends the
        steps, or what comes after, and returns what was found so far, with a note and
        `result.interrupted`; a second Ctrl-C, and one before the first step, raises.

    Raises:
        ValueError: If an input is wrong, nothing that is measured depends on a
            parameter, a standard deviation is so small that the cost is not finite, or
            the checkpoint is of another calibration.
        OSError: If the checkpoint cannot be written from the start, or another process
            is writing to it.
        RuntimeError: If a fitted configuration has no equilibrium at the start, nor
            with the moduli raised up to their bounds; the text names it. Later failures
            only shorten the step, and a held-out configuration without equilibrium is
            left out with a note.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    space = as_space(parameters)
    check_precision(precision)
    if intervals is not None:
        check_level(intervals)
    n_starts = number_of_starts(space, starts, start)
    problem, repeated = checked_problem(
        model,
        space,
        as_sequence(configurations),
        as_sequence(validation),
        newton=newton or NewtonSettings(),
        uncertain=uncertain or Uncertain(),
    )
    options = FitOptions(
        noise=noise,
        settings=settings or CalibrationSettings(),
        precision=precision,
        starts=n_starts,
        seed=seed,
        start=start,
        intervals=intervals,
    )
    with progress_line(wanted=watch is None) as line:
        told = watch or line
        first = fit(problem, options, told, answers=bool(watch), checkpoint=checkpoint)
        result = _with_intervals(problem, options, told, first)
    return replace(result, repeated=repeated)


def _with_intervals(
    problem: Problem, options: FitOptions, watch: Watch | None, first: Fitted
) -> CalibrationResult:
    """Find the intervals of the parameters after a first fit, if they are asked for."""
    intervals = options.intervals
    if intervals is None or first.result.interrupted:
        return first.result

    def go_on(done: Fitted, z: Float[Array, " n_p"]) -> Fitted:
        old = done.result
        assert old.noise is not None
        resume = Resume(z, old.noise, old.history)
        new = fit(problem, options._replace(starts=1), watch, resume=resume)
        timing = {k: s + new.result.timing_s[k] for k, s in old.timing_s.items()}
        result = replace(new.result, starts=old.starts, timing_s=timing)
        return new._replace(result=result)

    try:
        return with_intervals(first, intervals, go_on, watch or (lambda _: None))
    except KeyboardInterrupt:
        note = "Interrupted before the intervals of the parameters were known."
        notes = (*first.result.notes, note)
        return replace(first.result, notes=notes, interrupted=True)


def number_of_starts(
    space: ParameterSpace, starts: int | None, start: Float[Array, " n_p"] | None
) -> int:
    """Return `starts`, checked, or by default the number that `calibrate` takes."""
    if starts is None:
        starts = 1 if start is not None else default_starts(space)
    check_starts(starts)
    return starts


def checked_problem(
    model: Model,
    space: ParameterSpace,
    fitted: tuple[Configuration, ...],
    held_out: tuple[Configuration, ...] = (),
    *,
    newton: NewtonSettings,
    uncertain: Uncertain,
    goals: bool = False,
) -> tuple[Problem, str]:
    """Stack all configurations, and check them before the first solve.

    Returns them, and which readings stand in several configurations, if any do: a
    reading counts once, but `goals` may be alike.
    """
    poses = (*fitted, *held_out)
    problem, repeats = _problem(model, space, poses, newton, uncertain, goals)
    problem = replace(problem, n_held_out=len(held_out))
    for c in fitted:
        if c.after in {other.name for other in held_out}:
            raise ValueError(
                f"configuration {c.name!r} comes after {c.after!r}, which is held out: "
                "fit that one too. It need not be measured."
            )
    check_scopes(space, fitted)
    check_effects(problem.fitted)
    check_references(poses, problem.records, fitted=fitted)
    warn_if_too_few_data(problem.fitted)
    repeated = "; ".join(f"{k} has the readings of {of}" for k, of in repeats.items())
    if repeated:
        repeated += ", to the last digit: they count once. Check what each one reads."
    twice = [c.name for c in held_out if c.name in repeats]
    if twice:
        repeated += f" The error of {listed(twice)} is not held out."
    if len(twice) < len(repeats):
        warnings.warn(repeated, CalibrationWarning, stacklevel=3)
    return problem, repeated


def profile_intervals(
    result: CalibrationResult,
    *,
    parameters: str | Sequence[str] | None = None,
    level: float = LEVEL,
) -> tuple[ParameterInterval, ...]:
    """Find confidence intervals from the likelihood itself, not its linearisation.

    `calibrate` does so where a standard error does not hold; call this for another
    level, or to compare. A parameter is held away from the fit, all others are
    calibrated again, and the interval ends where the squared errors have risen as far
    as chance allows (Bates and Watts, Nonlinear Regression Analysis, 1988, sec. 6.1).
    It need not be symmetric, and may end at a bound that the data do not exclude.
    Errors of what is held fixed move each end outwards, in quadrature. The confidence
    is that of each interval alone; other optima are not searched for. Each end takes a
    few calibrations, and is nan if they do not converge.

    Args:
        result: A calibration that converged.
        parameters: Names of the parameters that get an interval; all by default.
        level: Confidence [-].

    Raises:
        ValueError: If the calibration did not converge, a parameter is unknown, the
            level is not between 0 and 1, or the noise was estimated from too few
            residuals.
        RuntimeError: If a configuration has no equilibrium with the fitted parameters.
        LowerCostFound: If a fit along the way has a lower cost than the calibration,
            which then is not in the best optimum; the error holds the parameters of
            that fit, from which to calibrate again.
    """
    space = result.space
    check_level(level)
    if not result.converged:
        raise ValueError(
            "the calibration did not converge, so it has no intervals: raise max_steps "
            "or look at its notes."
        )
    if isinstance(parameters, str):
        parameters = [parameters]
    names = list(space.names if parameters is None else parameters)
    check_known("parameter", space.names, *names)
    spread = result.uncertainty
    if spread.noise == "estimated" and spread.degrees_of_freedom < 1:
        raise ValueError(
            "the noise cannot be estimated without more measured coordinates than "
            'parameters: calibrate with noise = "stated", or add measurements.'
        )
    fitted = [f.posed for f in result.configurations if f.role == "calibration"]
    configurations = [posed for posed in fitted if posed is not None]
    problem = build_problem(result.model, space, configurations, result.newton)
    problem = problem.with_noise(result.noise)
    now = evaluate(problem, result.z)
    check_converged(now.equilibrium, problem.names)
    columns = [space.names.index(name) for name in names]
    ends = Fitted(result, problem, now).profile_ends(level, columns)
    return tuple(
        whole_interval(result, column, level, pair)
        for column, pair in zip(columns, ends, strict=True)
    )


def build_problem(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    newton: NewtonSettings | None = None,
    *,
    uncertain: Uncertain | None = None,
) -> Problem:
    """Stack a calibration into arrays, for `evaluate` and `multi_start`.

    By default everything that is not calibrated is exactly known. Offsets of recordings
    that are `uncertain` belong to the noise.

    Raises:
        ValueError: If a configuration has no measurement, a parameter no field, or
            `displacement_from` names no configuration with the same effectors.
    """
    posed, space = as_sequence(configurations), as_space(parameters)
    newton, uncertain = newton or NewtonSettings(), uncertain or exactly_known()
    problem, _ = _problem(model, space, posed, newton, uncertain)
    check_references(posed, problem.records)
    return problem


def _problem(
    model: Model,
    space: ParameterSpace,
    configurations: Sequence[Configuration],
    newton: NewtonSettings,
    uncertain: Uncertain,
    goals: bool = False,
) -> tuple[Problem, dict[str, str]]:
    """Stack a calibration into arrays; see `read_once` for what is repeated."""
    check_process()
    followed = {c.after for c in configurations}
    for configuration in configurations:
        if not configuration.is_measured and configuration.name not in followed:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`, or `effectors` with measured values."
            )
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    check_parameters(model, space, lane_of(lanes.arrays, 0))
    warn_if_locking(model, space)
    lanes, repeats = (lanes, {}) if goals else read_once(configurations, lanes)
    about = {"poses": configurations, "newton": newton, "uncertain": uncertain}
    problem = Problem(model, space, lanes, **about)
    return problem.with_noise(correlated_noise(problem)), repeats


def as_sequence(
    configurations: Configuration | Sequence[Configuration],
) -> tuple[Configuration, ...]:
    """Return configurations as a tuple; a single one may be given by itself."""
    one = isinstance(configurations, Configuration)
    return (configurations,) if one else tuple(configurations)
