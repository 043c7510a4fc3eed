"""The calibration loop: from configurations and measurements to parameters."""

from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._clock import Clock
from softcal_jax.calibration._notes import (
    fit_notes,
    mesh_notes,
    misfit_notes,
    uncertainty_notes,
    warn_if_locking,
    warn_if_too_few_data,
)
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    at_rest,
    evaluate,
    simulate,
)
from softcal_jax.calibration._result import (
    CalibrationResult,
    HistoryEntry,
    configuration_fits,
    parameter_estimates,
)
from softcal_jax.calibration._step import (
    CalibrationSettings,
    CalibrationState,
    decide,
    initial_state,
    propose,
)
from softcal_jax.calibration._uncertainty import uncertainty
from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import Model, NewtonSettings, check_converged
from softcal_jax.fields import (
    Parameter,
    ParameterSpace,
    as_space,
    check_parameters,
)

# Three programs instead of one per step: `evaluate`, which takes seconds to compile,
# serves the start and every step.
_evaluate = eqx.filter_jit(evaluate)
_propose = eqx.filter_jit(propose)
_decide = eqx.filter_jit(decide)
_simulate = eqx.filter_jit(simulate)


def build_problem(
    model: Model,
    parameters: ParameterSpace | Parameter | Sequence[Parameter],
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
        The problem, for `evaluate`, `calibration_step` and `calibrate`.

    Raises:
        ValueError: If a configuration has no measurement, or a parameter no field.
    """
    configurations = _as_sequence(configurations)
    for configuration in configurations:
        if configuration.measured is None:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`."
            )
    space = as_space(parameters)
    check_parameters(model, space)
    warn_if_locking(model, space)
    return CalibrationProblem(
        model,
        space,
        configuration_arrays(model.mesh, configurations),
        newton or NewtonSettings(),
    )


def calibrate(
    model: Model,
    parameters: ParameterSpace | Parameter | Sequence[Parameter],
    configurations: Configuration | Sequence[Configuration],
    *,
    validation: Configuration | Sequence[Configuration] = (),
    noise: Literal["estimated", "stated"] = "estimated",
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    progress: Callable[[HistoryEntry], None] | None = None,
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
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        progress: Called after the first evaluation and after each step.

    Returns:
        The result; `result.converged` says whether lambda_p vanished.

    Raises:
        ValueError: If an input is wrong.
        RuntimeError: If a fitted configuration has no equilibrium at the start; the
            text names it. Later failures only shorten the step, and a held-out
            configuration without equilibrium is left out with a note.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    settings = settings or CalibrationSettings()
    configurations = _as_sequence(configurations)
    validation = _as_sequence(validation)
    problem = build_problem(model, parameters, configurations, newton)
    # Built now, so that a wrong held-out configuration is found before the fit.
    held_out = (
        build_problem(model, parameters, validation, newton) if validation else None
    )
    names = [c.name for c in (*configurations, *validation)]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"configuration {name!r} is named more than once.")
    warn_if_too_few_data(problem)

    with Clock() as clock:

        def note(state):
            history.append(_entry(state, problem, clock.elapsed()))
            if progress:
                progress(history[-1])

        history: list[HistoryEntry] = []
        start = problem.space.start()
        before = _evaluate(problem, start, at_rest(problem))
        names = tuple(c.name for c in configurations)
        check_converged(before.equilibrium, names)
        state = initial_state(settings, start, before)
        note(state)
        while not (state.converged or state.stalled) and (
            len(history) <= settings.max_steps
        ):
            proposal = _propose(problem, state)
            tried = _evaluate(problem, proposal.z, proposal.guess)
            state = _decide(problem, settings, state, proposal, tried)
            note(state)
        after = state.evaluation
        fits = configuration_fits(
            configurations,
            "calibration",
            before.positions,
            after.positions,
            after.equilibrium,
        )
        missing: tuple[str, ...] = ()
        if held_out is not None:
            predicted, missing = _predict(held_out, validation, state.z)
            fits += predicted
    notes = (*fit_notes(problem, state, settings), *missing, *misfit_notes(fits))
    return _result(problem, noise, settings, state, history, fits, notes, clock)


def _predict(problem: CalibrationProblem, validation, z: Float[Array, " n_p"]):
    """The held-out configurations with the start and the calibrated parameters.

    One that has no equilibrium is left out, with a note: it must neither pass for a
    prediction nor cost the user the fit.
    """
    guess = at_rest(problem)
    first, before = _simulate(problem, problem.space.start(), guess)
    last, after = _simulate(problem, z, guess)
    # A pose that only the start parameters cannot hold has no "before".
    before = jnp.where(first.converged[:, None, None], before, jnp.nan)
    lanes = np.flatnonzero(np.asarray(last.converged))
    notes = [
        f"{c.name} is not predicted: with the calibrated parameters it has no "
        "equilibrium. `softcal simulate` or `solve_equilibrium` tells why."
        for lane, c in enumerate(validation)
        if lane not in lanes
    ]
    kept = [validation[lane] for lane in lanes]
    solution = jax.tree.map(lambda leaf: leaf[lanes], last)
    fits = configuration_fits(kept, "validation", before[lanes], after[lanes], solution)
    return fits, tuple(notes)


def _result(
    problem, noise, settings, state, history, fits, notes, clock
) -> CalibrationResult:
    z = np.asarray(state.z)
    lower, upper = np.asarray(problem.space.lower()), np.asarray(problem.space.upper())
    at_bound = (z - lower <= 1e-9) | (upper - z <= 1e-9)
    n_measured = int(np.sum(problem.configurations.effectors.inverse_std > 0))
    spread = uncertainty(
        np.asarray(state.evaluation.W_ep),
        np.asarray(state.evaluation.error),
        n_measured,
        at_bound,
        noise,
    )
    return CalibrationResult(
        converged=bool(state.converged),
        parameters=parameter_estimates(problem.space, state.z, spread),
        uncertainty=spread,
        configurations=fits,
        history=tuple(history),
        model=problem.space.apply(problem.model, state.z),
        z=state.z,
        W_ep=np.asarray(state.evaluation.W_ep),
        settings=settings,
        newton=problem.newton,
        timing_s=clock.seconds,
        notes=(*notes, *uncertainty_notes(problem, spread), *mesh_notes(problem)),
    )


def _as_sequence(configurations) -> tuple[Configuration, ...]:
    if isinstance(configurations, Configuration):
        return (configurations,)
    return tuple(configurations)


def _entry(
    state: CalibrationState, problem: CalibrationProblem, seconds: float
) -> HistoryEntry:
    evaluation = state.evaluation
    weight = problem.configurations.effectors.inverse_std
    squares = jnp.sum(jnp.where(weight > 0, evaluation.delta_e, 0.0) ** 2)
    markers = max(int(jnp.sum(jnp.any(weight > 0, axis=-1))), 1)
    p = problem.space.from_scaled(state.z)
    return HistoryEntry(
        step=int(state.step),
        cost=float(evaluation.cost),
        rms=float(jnp.sqrt(squares / markers)),
        lambda_p=tuple(float(v) for v in state.lambda_p),
        step_bound=float(state.step_bound),
        accepted=bool(state.accepted),
        kkt_residual=float(state.kkt_residual),
        newton_steps=tuple(int(n) for n in evaluation.equilibrium.steps),
        values={n: float(v) for n, v in zip(problem.space.names, p, strict=True)},
        seconds=seconds,
    )
