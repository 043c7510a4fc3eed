"""The calibration loop: from configurations and measurements to parameters."""

import os
from collections.abc import Callable, Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._budget import error_budget
from softcal_jax.calibration._checkpoint import Journal
from softcal_jax.calibration._clock import Clock
from softcal_jax.calibration._descent import descend
from softcal_jax.calibration._evaluator import Evaluator
from softcal_jax.calibration._fits import configuration_results, parameter_estimates
from softcal_jax.calibration._notes import (
    fit_notes,
    mesh_notes,
    misfit_notes,
    order_notes,
    uncertainty_notes,
    unscoped_notes,
    warn_if_locking,
    warn_if_too_few_data,
)
from softcal_jax.calibration._problem import CalibrationProblem, configurations_at
from softcal_jax.calibration._result import CalibrationResult, HistoryEntry
from softcal_jax.calibration._search import (
    FROM_ANYWHERE,
    SearchProgress,
    search,
)
from softcal_jax.calibration._starts import random_starts
from softcal_jax.calibration._state import (
    CalibrationSettings,
    CalibrationState,
    initial_state,
)
from softcal_jax.calibration._uncertainty import Uncertainty, uncertainty
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    configuration_lanes,
    spring_names,
)
from softcal_jax.equilibrium import Model, NewtonSettings, Workers, check_converged
from softcal_jax.fields import (
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_parameters,
    check_scopes,
)


def build_problem(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    newton: NewtonSettings | None = None,
) -> CalibrationProblem:
    """Stack a calibration into arrays.

    Args:
        model: The body.
        parameters: What is calibrated.
        configurations: Posed robots; each with markers and measured positions.
        newton: Settings of the equilibrium.

    Returns:
        The problem, for `evaluate` and `multi_start`.

    Raises:
        ValueError: If a configuration has no measurement, or a parameter no field.
    """
    configurations = as_sequence(configurations)
    springs = spring_names(configurations)
    return _build(model, parameters, configurations, springs, newton)[0]


def _build(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Sequence[Configuration],
    springs: tuple[str, ...],
    newton: NewtonSettings | None,
) -> tuple[CalibrationProblem, ConfigurationLanes]:
    """Stack a calibration into arrays, and return its lanes with effector records."""
    for configuration in configurations:
        if not configuration.is_measured:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`, or `effectors` with measured values."
            )
    space = as_space(parameters)
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism, springs)
    check_parameters(model, space, jax.tree.map(lambda leaf: leaf[0], lanes.arrays))
    warn_if_locking(model, space)
    newton = newton or NewtonSettings()
    return CalibrationProblem(model, space, lanes.arrays, newton), lanes


def calibrate(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    *,
    validation: Configuration | Sequence[Configuration] = (),
    noise: Literal["estimated", "stated"] = "estimated",
    uncertain: Uncertain | None = None,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int = 1,
    seed: int = 0,
    start: Float[Array, " n_p"] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[HistoryEntry], None] | None = None,
    search_progress: Callable[[SearchProgress], None] | None = None,
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
            takes their ratios and finds the level from the residuals.
        uncertain: How well everything is known that is not calibrated; by default see
            `Uncertain`. It widens the standard errors, and `result.budget` splits them.
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        starts: Number of starts of the search: that of the parameters, and random ones
            within the bounds; see `multi_start`. The fit then continues from the best.
        seed: Seed of the random starts.
        start: Scaled parameters to start from, instead of the start of the parameters;
            priors stay centred on the latter [-].
        checkpoint: File in which the state is saved: after every step, and in a search
            from many starts after every image of a run. If it exists, the calibration
            resumes from it, with the same result.
        progress: Called after the first evaluation and after each step.
        search_progress: Called when a run of a search from many starts has ended, see
            `multi_start`.

    Returns:
        The result; `result.converged` says whether lambda_p vanished.

    Raises:
        ValueError: If an input is wrong, or the checkpoint is of another calibration.
        RuntimeError: If a fitted configuration has no equilibrium at the start; the
            text names it. Later failures only shorten the step, and a held-out
            configuration without equilibrium is left out with a note.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    if starts < 1:
        raise ValueError(f"starts must be at least 1, got {starts}.")
    settings = settings or CalibrationSettings()
    configurations = as_sequence(configurations)
    validation = as_sequence(validation)
    springs = spring_names((*configurations, *validation))
    problem, lanes = _build(model, parameters, configurations, springs, newton)
    check_scopes(problem.space, configurations)
    # Built now, so that a wrong held-out configuration is found before the fit.
    held_out = None
    if validation:
        held_out = _build(model, parameters, validation, springs, newton)
    _check_names(configurations, validation)
    warn_if_too_few_data(problem)

    given = start
    mark = (starts, seed) if given is None else (starts, seed, *given.tolist())
    journal = Journal(problem, settings, checkpoint, progress, search=mark)
    journal.load()
    evaluate, names = Evaluator(problem), tuple(c.name for c in configurations)
    most = starts * max(len(configurations), 2 * len(validation))
    with Clock() as clock, Workers(model, most) as workers:
        first = _admissible(problem.space, given)
        before = workers.end_of(evaluate.from_rest(first))
        check_converged(before.equilibrium, names)
        begin, found = first, None
        if starts > 1:
            found = search(
                workers,
                evaluate,
                FROM_ANYWHERE,
                _all_starts(first, problem, starts, seed),
                mirror=True,
                journal=journal,
                progress=search_progress,
            )
            begin = jnp.asarray(found.z[found.best])
        there = before if found is None else workers.end_of(evaluate.from_rest(begin))
        state = journal.begin(initial_state(settings, begin, there))
        state = workers.end_of(descend(evaluate, settings, state, journal.note))
        after = state.evaluation
        fits = configuration_results(
            problem.space.model_at(model, state.z),
            configurations,
            lanes._replace(arrays=configurations_at(problem, state.z)),
            role="calibration",
            before=before.effectors,
            after=after.effectors,
            solution=after.equilibrium,
        )
        spread = _spread(problem, state, noise)
        budget = workers.end_of(
            error_budget(
                evaluate,
                configurations,
                uncertain or Uncertain(),
                z=state.z,
                at=after,
                spread=spread,
            )
        )
        missing: tuple[str, ...] = ()
        if held_out is not None:
            predicted, missing = _predict(
                workers,
                Evaluator(held_out[0]),
                validation,
                held_out[1],
                first,
                state.z,
            )
            fits += predicted
    notes = (*fit_notes(problem, state, settings), *missing, *misfit_notes(fits))
    return CalibrationResult(
        converged=bool(state.converged),
        parameters=parameter_estimates(problem.space, state.z, spread, budget, given),
        uncertainty=spread,
        budget=budget,
        configurations=fits,
        history=tuple(journal.history),
        space=problem.space,
        model=problem.space.model_at(problem.model, state.z),
        z=state.z,
        W_ep=np.asarray(after.W_ep),
        settings=settings,
        newton=problem.newton,
        timing_s=clock.seconds,
        notes=(
            *notes,
            *order_notes(problem.space, state.z),
            *uncertainty_notes(problem, spread),
            *mesh_notes(problem),
        ),
        starts=found,
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
    return space.admissible(start)


def _all_starts(start, problem: CalibrationProblem, n: int, seed: int):
    """Return the user's start and n - 1 random ones."""
    others = random_starts(problem.space, n - 1, seed=seed)
    return jnp.concatenate([start[None], others])


def _predict(
    workers: Workers,
    evaluate: Evaluator,
    validation,
    lanes: ConfigurationLanes,
    start: Float[Array, " n_p"],
    z: Float[Array, " n_p"],
):
    """Predict held-out configurations with the start and the calibrated parameters.

    Uses the program of the fit, which is compiled already; its compliances are ignored.
    A configuration without equilibrium is left out with a note: it must neither count
    as a prediction nor cost the user the fit.
    """
    problem = evaluate.problem
    first, last = workers.ends(evaluate.from_rest(p) for p in (start, z))
    # A pose that only the start parameters cannot hold has no "before".
    held = first.equilibrium.converged[:, None, None]
    before = jnp.where(held, first.effectors, jnp.nan)
    ok = np.asarray(last.equilibrium.converged)
    notes = [
        f"{c.name} is not predicted: with the calibrated parameters it has no "
        "equilibrium. `softcal simulate` or `solve_equilibrium` tells why."
        for lane, c in enumerate(validation)
        if not ok[lane]
    ]
    notes += unscoped_notes(problem.space, validation)
    model = problem.space.model_at(problem.model, z)
    fits = configuration_results(
        model,
        validation,
        lanes._replace(arrays=configurations_at(problem, z)),
        role="validation",
        before=before,
        after=last.effectors,
        solution=last.equilibrium,
    )
    return fits, tuple(notes)


def _spread(problem: CalibrationProblem, state: CalibrationState, noise) -> Uncertainty:
    """Return the uncertainty by the noise at the end of the fit."""
    down, up = map(np.asarray, problem.space.room(state.z))
    return uncertainty(
        np.asarray(state.evaluation.W_ep),
        np.asarray(state.evaluation.error),
        int(np.sum(problem.configurations.effectors.inverse_std > 0)),
        (down >= -1e-9) | (up <= 1e-9),
        noise,
        np.asarray(problem.space.prior_weights()),
    )


def _check_names(configurations, validation) -> None:
    names = [c.name for c in (*configurations, *validation)]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"configuration {name!r} is named more than once.")


def as_sequence(
    configurations: Configuration | Sequence[Configuration],
) -> tuple[Configuration, ...]:
    """Return configurations as a tuple; a single one may be given by itself."""
    if isinstance(configurations, Configuration):
        return (configurations,)
    return tuple(configurations)
