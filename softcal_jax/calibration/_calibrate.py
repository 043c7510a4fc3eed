"""The calibration: from configurations and measurements to parameters."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._begin import EquilibriumProgress
from softcal_jax.calibration._build import as_sequence
from softcal_jax.calibration._checked_intervals import (
    LEVEL,
    Fitted,
    check_level,
    with_intervals,
)
from softcal_jax.calibration._fit import Resume, Task, Watch, fit
from softcal_jax.calibration._result import (
    CalibrationResult,
    HistoryEntry,
)
from softcal_jax.calibration._search import (
    SearchProgress,
    check_starts,
    default_starts,
)
from softcal_jax.calibration._state import CalibrationSettings
from softcal_jax.configurations import (
    Configuration,
)
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    PRECISION,
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_precision,
)


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
    equilibrium_progress: Callable[[EquilibriumProgress], None] | None = None,
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
            resumes from it, with the same result. Where it cannot be written any more,
            as on a full disk, the calibration goes on with a warning and a note.
        progress: Called after the first evaluation and after each step.
        search_progress: Called when a run of a search from many starts has ended, see
            `multi_start`.
        equilibrium_progress: Called while the first equilibria are solved, every few
            Newton iterations of a configuration.
        profiling: Called with the result so far before profiles of the likelihood are
            computed, which takes a while.

    Returns:
        The result; `result.converged` says whether lambda_p vanished. Ctrl-C ends the
        steps, or the intervals, and returns what was found so far, with a note and
        `result.interrupted`; a second Ctrl-C, and one before the first step, raises.

    Raises:
        ValueError: If an input is wrong, nothing that is measured depends on a
            parameter, a standard deviation is so small that the cost is not finite, or
            the checkpoint is of another calibration.
        OSError: If the checkpoint cannot be written from the start, or another process
            is writing to it.
        RuntimeError: If a fitted configuration has no equilibrium at the start, nor
            with the moduli raised up to their bounds; the text names it. If raising
            them helps, the fit begins there, with a note. Later failures only shorten
            the step, and a held-out configuration without equilibrium is left out with
            a note.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    if starts is None:
        starts = 1 if start is not None else default_starts(as_space(parameters))
    check_starts(starts)
    check_precision(precision)
    if intervals is not None:
        check_level(intervals)
    task = Task(
        model=model,
        space=as_space(parameters),
        fitted=as_sequence(configurations),
        held_out=as_sequence(validation),
        noise=noise,
        uncertain=uncertain or Uncertain(),
        settings=settings or CalibrationSettings(),
        newton=newton or NewtonSettings(),
        precision=precision,
        starts=starts,
        seed=seed,
        start=start,
    )
    watch = Watch(checkpoint, progress, search_progress, equilibrium_progress)
    first = fit(task, watch)
    if intervals is None or first.result.interrupted:
        return first.result

    def go_on(done: Fitted, z: Float[Array, " n_p"]) -> Fitted:
        old, last = done.result, done.result.history[-1]
        assert old.noise is not None
        later = lambda entry: replace(
            entry,
            step=entry.step + last.step,
            seconds=entry.seconds + last.seconds,
        )

        def told(entry: HistoryEntry) -> None:
            if progress is not None and entry.step:
                progress(later(entry))

        again = Watch(progress=told)
        new = fit(task._replace(starts=1), again, Resume(z, old.noise))
        history = (*old.history, *map(later, new.result.history[1:]))
        timing = {k: s + new.result.timing_s[k] for k, s in old.timing_s.items()}
        changed = {"history": history, "starts": old.starts, "timing_s": timing}
        return new._replace(result=replace(new.result, **changed))

    try:
        return with_intervals(first, intervals, go_on, profiling)
    except KeyboardInterrupt:
        note = "Interrupted before the intervals of the parameters were known."
        notes = (*first.result.notes, note)
        return replace(first.result, notes=notes, interrupted=True)
