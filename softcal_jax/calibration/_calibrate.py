"""The calibration loop: from configurations and measurements to parameters."""

import warnings
from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._clock import Clock
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    at_rest,
    effector_errors,
    evaluate,
    simulate,
)
from softcal_jax.calibration._result import (
    CalibrationResult,
    ConfigurationFit,
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
from softcal_jax.fields import Parameter, ParameterSpace, as_space

# Three programs instead of one per step: `evaluate`, which takes seconds to compile,
# serves the start and every step.
_evaluate = eqx.filter_jit(evaluate)
_propose = eqx.filter_jit(propose)
_decide = eqx.filter_jit(decide)
_simulate = eqx.filter_jit(simulate)


class CalibrationWarning(UserWarning):
    """Something about a calibration that its user should know."""


def build_problem(
    model: Model,
    parameters: ParameterSpace | Sequence[Parameter],
    configurations: Sequence[Configuration],
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
    for configuration in configurations:
        if configuration.measured is None:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`."
            )
    space = as_space(parameters)
    space.apply(model, space.start())  # finds unknown fields before any work is done
    return CalibrationProblem(
        model,
        space,
        configuration_arrays(model.mesh, configurations),
        newton or NewtonSettings(),
    )


def calibrate(
    model: Model,
    parameters: ParameterSpace | Sequence[Parameter],
    configurations: Sequence[Configuration],
    *,
    validation: Sequence[Configuration] = (),
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
        RuntimeError: If a configuration has no equilibrium at the start; the text names
            it. Later failures only shorten the step.
    """
    if noise not in ("estimated", "stated"):
        raise ValueError(f'noise must be "estimated" or "stated", got {noise!r}.')
    settings = settings or CalibrationSettings()
    problem = build_problem(model, parameters, configurations, newton)
    if validation:  # found wrong now, not after the fit
        build_problem(model, parameters, validation, newton)
    names = [c.name for c in (*configurations, *validation)]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"configuration {name!r} is named more than once.")
    _warn_if_too_few_data(problem)

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
        while not state.converged and len(history) <= settings.max_steps:
            proposal = _propose(problem, state)
            tried = _evaluate(problem, proposal.z, proposal.guess)
            state = _decide(settings, state, proposal, tried)
            note(state)
        after = state.evaluation
        fits = configuration_fits(
            configurations,
            "calibration",
            before.positions,
            after.positions,
            after.equilibrium,
        )
        if validation:
            fits += _predict(model, parameters, validation, newton, state)
    return _result(problem, noise, settings, state, history, fits, clock)


def _predict(
    model, parameters, validation, newton, state
) -> tuple[ConfigurationFit, ...]:
    """The held-out configurations with the start and the calibrated parameters."""
    problem = build_problem(model, parameters, validation, newton)
    names = tuple(c.name for c in validation)
    guess = at_rest(problem)
    positions = []
    for z in (problem.space.start(), state.z):
        solution, simulated = _simulate(problem, z, guess)
        check_converged(solution, names)
        positions.append(simulated)
    return configuration_fits(validation, "validation", *positions, solution)


def _result(problem, noise, settings, state, history, fits, clock) -> CalibrationResult:
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
        notes=_notes(problem, state, spread, settings),
    )


def _notes(problem, state, spread, settings) -> tuple[str, ...]:
    notes = []
    if not state.converged:
        notes.append(
            f"Not converged: after {int(state.step)} steps lambda_p is still "
            f"{float(jnp.max(jnp.abs(state.lambda_p))):.1e} (tol {settings.tol:g}). Do "
            "not use these values; raise max_steps or look at the history."
        )
    if problem.model.mesh.order == 1:
        notes.append(
            "Linear tets lock in bending: the calibrated moduli are effective numbers "
            "of this mesh, not properties of the material. Use quadratic tets "
            "(to_quadratic) to compare with data sheets."
        )
    for name, flag in zip(problem.space.names, spread.at_bound, strict=True):
        if flag:
            notes.append(
                f"{name} ended on a bound: widen it, or the model cannot match the "
                "data. It has no standard error."
            )
    if spread.noise == "estimated":
        notes.append(
            "Standard errors rest on the noise estimated from the residuals "
            f"({spread.degrees_of_freedom} degrees of freedom), which holds model "
            "error as well."
        )
    return tuple(notes)


def _warn_if_too_few_data(problem: CalibrationProblem) -> None:
    measured = int(np.sum(problem.configurations.effectors.inverse_std > 0))
    wanted = len(problem.space.names)
    if wanted > measured:
        warnings.warn(
            f"{wanted} parameters but only {measured} measured coordinates: at least "
            f"{wanted - measured} more are missing (another marker gives 3, another "
            "configuration as many as it has markers times 3). The fit is not unique.",
            CalibrationWarning,
            stacklevel=3,
        )


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


def levenberg_marquardt(
    problem: CalibrationProblem,
    *,
    rtol: float = 1e-10,
    atol: float = 1e-10,
    max_steps: int = 100,
) -> tuple[Float[Array, " n_p"], bool]:
    """Fit by `optimistix.least_squares`, the second, independent optimiser.

    Levenberg-Marquardt on the same stacked errors, with the Jacobian by autodiff
    through the implicit derivative of the equilibrium. It knows no bounds.

    Args:
        problem: The calibration.
        rtol: Relative tolerance of optimistix.
        atol: Absolute tolerance of optimistix.
        max_steps: Steps after which it gives up.

    Returns:
        Scaled parameters, and whether it converged inside the bounds.
    """
    import optimistix as optx

    guess = at_rest(problem)
    weight = problem.configurations.effectors.inverse_std

    def errors(z, problem):
        solution, positions = simulate(problem, z, guess)
        delta_e = effector_errors(problem, positions)
        # A configuration without equilibrium makes the step cost infinitely much.
        ok = solution.converged[:, None, None]
        return jnp.where(ok, weight * delta_e, jnp.inf).ravel()

    solution = optx.least_squares(
        errors,
        optx.LevenbergMarquardt(rtol=rtol, atol=atol),
        problem.space.start(),
        args=problem,
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    z = solution.value
    inside = jnp.all((z >= problem.space.lower()) & (z <= problem.space.upper()))
    return z, bool(inside & (solution.result == optx.RESULTS.successful))
