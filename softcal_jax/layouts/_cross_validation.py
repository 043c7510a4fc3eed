"""Layouts of control points judged by what they predict (Sec. V-C)."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration import (
    CalibrationProblem,
    CalibrationSettings,
    Evaluation,
    Evaluator,
    Run,
    best_of,
    build_problem,
    check_starts,
    default_starts,
    images_of,
    linear_model,
    random_starts,
    run_start,
)
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings, Workers
from softcal_jax.fields import (
    ControlPoints,
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
)
from softcal_jax.identifiability import identifiability
from softcal_jax.inference import whitened
from softcal_jax.layouts._comparison import FoldScore, LayoutComparison, ModelScore

MakeParameters = Callable[[ControlPoints], ParameterSpace | Entry | Sequence[Entry]]


FOR_PREDICTION = CalibrationSettings(tol=1e-4, max_steps=200)
"""Settings of the fits: loose, since 0.01 % of a modulus changes no prediction.

Along directions that the data hardly see a fit creeps. A layout with many points has
such directions, so more steps are allowed.
"""


class _Fold(NamedTuple):
    """Configurations of one fit, and whether they count: all but one, in the last all.

    In place of the held-out configuration another one is repeated with weight zero: so
    all fits share their shapes and programs, and what is held out cannot affect the
    fit, not even by having no equilibrium.
    """

    lanes: Int[HostArray, " n_c"]
    counts: Bool[HostArray, " n_c"]


class _Fit(NamedTuple):
    """End of a fit, and the evaluation of all configurations with its parameters."""

    run: Run
    after: Evaluation


def _folds(n_c: int) -> list[_Fold]:
    every = np.arange(n_c)
    held_out = [
        _Fold(np.where(every == i, (i + 1) % n_c, every), every != i) for i in every
    ]
    return [*held_out, _Fold(every, np.ones(n_c, bool))]


def _fold_problem(problem: CalibrationProblem, fold: _Fold) -> CalibrationProblem:
    """Return the calibration of one fold, without what is held out."""
    take = lambda leaf: np.asarray(leaf)[fold.lanes]
    fitted = jax.tree.map(take, problem.configurations)
    weight = np.where(fold.counts[:, None, None], fitted.effectors.inverse_std, 0.0)
    fitted = eqx.tree_at(lambda c: c.effectors.inverse_std, fitted, weight)
    return eqx.tree_at(lambda p: p.configurations, problem, fitted)


def _fit(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    starts: Float[Array, "n_starts n_p"],
) -> list[_Fit]:
    """Fit all folds, side by side."""
    images = images_of(problem.space, mirror=True)

    def fit(whole: Evaluator, fold: _Fold) -> _Fit:
        own = Evaluator(_fold_problem(problem, fold), whole.workers)
        runs = [
            run_start(own, settings, start, images=images)
            for start in map(jnp.asarray, np.asarray(starts))
        ]
        cost = np.array([run.cost for run in runs])
        run = runs[best_of(cost, np.array([run.converged for run in runs]))]
        return _Fit(run, whole.from_rest(jnp.asarray(run.z)))

    n_c = len(problem.configurations.gravity)
    with Workers(problem.model, n_c * (n_c + 1)) as workers:
        whole = Evaluator(problem, workers)
        return workers.side_by_side(partial(fit, whole, fold) for fold in _folds(n_c))


def compare_layouts(
    model: Model,
    layouts: Mapping[str, ControlPoints],
    configurations: Configuration | Sequence[Configuration],
    *,
    make_parameters: MakeParameters,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    uncertain: Uncertain | None = None,
) -> LayoutComparison:
    """Find the layout of control points that best predicts what it was not fitted to.

    Leave-one-configuration-out cross-validation (Stone, J. R. Stat. Soc. B 36, 1974):
    every configuration is held out once and predicted from a fit to the others. Too few
    control points misfit both; too many fit the noise, along directions that the data
    are blind to, and predict worse: the trade-off of Sec. V-C.

    The mean squared prediction error in units of the noise decides. Layouts within one
    standard error of the best are not clearly worse; of these the one with the fewest
    parameters is preferred (Breiman et al., Classification and Regression Trees, 1984;
    Hastie et al., The Elements of Statistical Learning, 2009, sec. 7.10).

    Each number of parameters is compiled once, which takes far longer than all fits on
    a small mesh.

    Args:
        model: The body.
        layouts: Control points by the name of the layout.
        configurations: Measured configurations, at least two.
        make_parameters: The parameters of a layout, like
            `lambda points: ControlPointParameters("E", points, ...)`.
        settings: Settings of the outer loop; by default `FOR_PREDICTION`.
        newton: Settings of the equilibrium.
        starts: Number of starts of each fit: that of the parameters, and random ones
            within the bounds; by default see `default_starts`.
        seed: Seed of the random starts.
        uncertain: How well everything is known that is not calibrated, of which the
            offsets of recordings belong to the noise; by default nothing is uncertain.

    Returns:
        The layouts, the best first. A fold that did not converge, or whose
        configuration cannot be predicted, is named and counts in no average; a layout
        with such a fold ranks behind all that have none.

    Raises:
        ValueError: If fewer than two configurations or no layout is given, or an input
            is wrong; the text names the layout.
    """
    if not layouts:
        raise ValueError("at least one layout is needed, got none.")
    if isinstance(configurations, Configuration):
        configurations = (configurations,)
    check_folds(len(configurations), starts)
    problems = {}
    # All are built before the first fit, so that a wrong layout is found at once.
    for name, points in layouts.items():
        try:
            space = as_space(make_parameters(points))
            problems[name] = build_problem(
                model, space, configurations, newton, uncertain=uncertain
            )
        except ValueError as error:
            raise ValueError(f"layout {name!r}: {error}") from error
    scores = cross_validated(
        problems,
        configurations,
        settings=settings,
        starts=starts,
        seed=seed,
        n_points={name: len(points.names) for name, points in layouts.items()},
    )
    return LayoutComparison.ranked(scores)


def check_folds(n: int, starts: int | None) -> None:
    """Raise ValueError unless there is something to hold out and to start from."""
    if n < 2:
        raise ValueError(
            f"cross-validation fits all configurations but one and predicts that one: "
            f"at least 2 are needed, got {n}."
        )
    if starts is not None:
        check_starts(starts)


def cross_validated(
    problems: Mapping[str, CalibrationProblem],
    configurations: Sequence[Configuration],
    *,
    settings: CalibrationSettings | None,
    starts: int | None,
    seed: int,
    n_points: Mapping[str, int] = MappingProxyType({}),
    progress: Callable[[str], None] = lambda _: None,
) -> list[ModelScore]:
    """Fit all folds of models, one model after the other, and score them.

    Args:
        problems: Calibrations to all configurations, by name of the model.
        configurations: The configurations.
        settings: Settings of the outer loop; by default `FOR_PREDICTION`.
        starts: Number of starts of each fit; None for `default_starts`.
        seed: Seed of the random ones.
        n_points: Control points of each model, if layouts are compared.
        progress: Called with the name of each model before it is fitted.
    """
    scores = []
    for name, problem in problems.items():
        progress(name)
        start = problem.space.admissible(problem.space.start())[None]
        n = default_starts(problem.space) if starts is None else starts
        if n > 1:
            others = random_starts(problem.space, n - 1, seed=seed)
            start = jnp.concatenate([start, others])
        fits = _fit(problem, settings or FOR_PREDICTION, start)
        scores.append(
            _score(name, n_points.get(name, 0), problem, configurations, fits)
        )
    return scores


def _score(
    name: str,
    control_points: int,
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    fits: list[_Fit],
) -> ModelScore:
    """Score the folds of one model and the fit to all configurations."""
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    effectors, noise = problem.configurations.effectors, problem.noise
    A = np.zeros((weight.size, 0))
    if noise is not None:
        A = noise.on_host(effectors)[:, : noise.n_common]
    A = A.reshape(*weight.shape, A.shape[1])
    # Distances are of points; turns and forces count in units of the noise.
    n_points = problem.configurations.effectors.nodes.shape[-2]
    every = np.arange(len(configurations))

    def rms(
        fit: _Fit, failure: str, fold: _Fold, lanes: Int[HostArray, " n"]
    ) -> tuple[float, float]:
        """Return the distance of points [m], and coordinates over the noise [-].

        Offsets of attachments are known from the fitted configurations alone.
        """
        if failure:
            return np.nan, np.nan
        error, of_lanes = np.asarray(fit.after.delta_e), weight[lanes]
        if noise is not None:
            error = noise.without_attachments(effectors, error, fold.counts)
        error = error[lanes]
        squares = np.sum(error[:, :n_points] ** 2, axis=2)
        there = np.any(of_lanes[:, :n_points] > 0.0, axis=2)
        own = A[lanes].reshape(of_lanes.size, A.shape[-1])
        over_noise = whitened(own, np.ravel(of_lanes * error))
        over_noise = over_noise[of_lanes.ravel() > 0.0]
        mean = lambda squares: float(np.sqrt(np.mean(squares)))
        return mean(squares[there]), mean(over_noise**2)

    *held_out_folds, whole = _folds(len(configurations))
    folds = []
    for i, fold in enumerate(held_out_folds):
        fit, failure = fits[i], _failure(fits[i], i)
        distance, over_noise = rms(fit, failure, fold, every[i : i + 1])
        fitted, _ = rms(fit, failure, fold, every[fold.counts])
        folds.append(
            FoldScore(configurations[i].name, distance, over_noise, fitted, failure)
        )
    last, failure = fits[-1], _failure(fits[-1], None)
    seen = None
    if np.all(last.after.equilibrium.converged):
        linear = linear_model(
            problem,
            configurations,
            z=jnp.asarray(last.run.z),
            W_ep=last.after.response.W_ep,
            ok=last.after.response.ok,
            delta_e=last.after.delta_e,
            rows=last.after.rows,
        )
        seen = identifiability(linear.with_scale(1.0), problem.space, last.run.z)
    distance, over_noise = rms(last, failure, whole, every)
    return ModelScore(
        name=name,
        n_points=control_points,
        n_parameters=len(problem.space.names),
        folds=tuple(folds),
        fit_rms=distance,
        fit_noise_rms=over_noise,
        fit_failure=failure,
        identifiability=seen,
    )


def _failure(fit: _Fit, held_out: int | None) -> str:
    """Say why a fit failed; empty if it did not."""
    if np.isinf(fit.run.cost):
        return "a fitted configuration has no equilibrium at the start"
    if not fit.run.converged:
        return "the fit did not converge"
    there = np.asarray(fit.after.equilibrium.converged)
    if held_out is not None and not there[held_out]:
        return "with the fitted parameters it has no equilibrium"
    if held_out is None and not there.all():
        return "a configuration lost its equilibrium after the fit"
    return ""
