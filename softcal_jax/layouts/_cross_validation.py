"""Layouts of control points judged by what they predict (Sec. V-C)."""

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration import (
    CalibrationProblem,
    CalibrationSettings,
    build_problem,
    evaluate,
    first_guess,
    random_starts,
    run_starts,
    without_names,
)
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    ControlPoints,
    Entry,
    ParameterSpace,
    as_space,
)
from softcal_jax.identifiability import Identifiability, identifiability
from softcal_jax.layouts._comparison import FoldScore, LayoutComparison, LayoutScore

MakeParameters = Callable[[ControlPoints], ParameterSpace | Entry | Sequence[Entry]]


FOR_PREDICTION = CalibrationSettings(tol=1e-4, max_steps=200)
"""Settings of the fits: 0.01 % of a modulus does not show in a prediction.

Along directions that the data hardly see a fit creeps, and a layout with many points
has such directions: it needs more steps, and need not take the last ones.
"""


class _Folds(eqx.Module):
    """What each fit needs to know: one lane per fold, the last fits everything.

    Attributes:
        lanes: Configurations that are fitted.
        counts: Whether a lane's markers count. A fold has one configuration less, and
            repeats another without weight: so all fits have one shape and are one
            compiled program, and what is held out cannot touch the fit, not even by
            having no equilibrium.
    """

    lanes: Int[Array, "n_folds n_c"]
    counts: Bool[Array, "n_folds n_c"]


class _Fits(eqx.Module):
    """Ends of the fits, and all configurations with their parameters.

    Attributes:
        z: Scaled parameters [-].
        cost: Half the sum of squared errors in noise units; infinite if the start has
            no equilibrium [-].
        converged: Whether lambda_p vanished, to the tolerance of the settings.
        there: Which configurations have an equilibrium.
        error: Simulated minus measured positions; 0 where not measured [m].
        W: Compliances of all configurations in units of the noise [-].
    """

    z: Float[Array, "*folds n_p"]
    cost: Float[Array, " *folds"]
    converged: Bool[Array, " *folds"]
    there: Bool[Array, "*folds n_c"]
    error: Float[Array, "*folds n_c n_markers 3"]
    W: Float[Array, "*folds n_e n_p"]


def _folds(n_c: int) -> _Folds:
    lanes = np.tile(np.arange(n_c), (n_c + 1, 1))
    counts = np.ones((n_c + 1, n_c), bool)
    held_out = np.arange(n_c)
    lanes[held_out, held_out] = (held_out + 1) % n_c
    counts[held_out, held_out] = False
    return _Folds(jnp.asarray(lanes), jnp.asarray(counts))


def _fold_problem(
    problem: CalibrationProblem, lanes: Int[Array, " n_c"], counts: Bool[Array, " n_c"]
) -> CalibrationProblem:
    """The calibration of one fold: what is held out is not in it."""
    fitted = jax.tree.map(lambda leaf: leaf[lanes], problem.configurations)
    weight = jnp.where(counts[:, None, None], fitted.effectors.inverse_std, 0.0)
    fitted = eqx.tree_at(lambda c: c.effectors.inverse_std, fitted, weight)
    return eqx.tree_at(lambda p: p.configurations, problem, fitted)


@eqx.filter_jit
def _fit(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    starts: Float[Array, "n_starts n_p"],
    folds: _Folds,
) -> _Fits:
    def fold(one: tuple[Int[Array, " n_c"], Bool[Array, " n_c"]]) -> _Fits:
        runs = run_starts(_fold_problem(problem, *one), settings, starts)
        # The lowest of the converged; of all where none is.
        cost = jnp.where(runs.converged, runs.cost, jnp.inf)
        cost = jnp.where(jnp.any(runs.converged), cost, runs.cost)
        best = jnp.argmin(cost)
        z = runs.z[best]
        after = evaluate(problem, z, first_guess(problem, z))
        return _Fits(
            z,
            runs.cost[best],
            runs.converged[best],
            after.equilibrium.converged,
            after.delta_e,
            after.W_ep,
        )

    return jax.lax.map(fold, (folds.lanes, folds.counts))


def compare_layouts(
    model: Model,
    layouts: Mapping[str, ControlPoints],
    configurations: Configuration | Sequence[Configuration],
    *,
    make_parameters: MakeParameters,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int = 1,
    seed: int = 0,
) -> LayoutComparison:
    """Which layout of control points predicts best what it was not fitted to.

    Leave-one-configuration-out cross-validation (Stone, J. R. Stat. Soc. B 36, 1974):
    every configuration is held out once, the others are fitted and predict it. Too few
    control points misfit both; too many follow the noise of what is fitted, along
    directions that the data are blind to, and predict worse: the trade-off of Sec. V-C.

    The mean squared prediction error in units of the noise decides. Layouts within one
    standard error of the best are not worse for certain; of these the one with the
    fewest parameters is preferred (Breiman et al., Classification and Regression Trees,
    1984; Hastie et al., The Elements of Statistical Learning, 2009, sec. 7.10).

    Layouts with as many parameters share one compiled program; another number is
    another program, whose compilation takes far longer than all fits on a small mesh.

    Args:
        model: The body.
        layouts: Control points by the name of the layout.
        configurations: Measured configurations, at least two.
        make_parameters: The parameters of a layout, like
            `lambda points: ControlPointParameters("E", points, ...)`.
        settings: Settings of the outer loop; by default `FOR_PREDICTION`.
        newton: Settings of the equilibrium.
        starts: From how many starts each fit looks for its optimum: that of the
            parameters, and random ones in the whole bounds.
        seed: Seed of the random starts.

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
    if len(configurations) < 2:
        raise ValueError(
            f"cross-validation fits all configurations but one and predicts that one: "
            f"at least 2 are needed, got {len(configurations)}."
        )
    if starts < 1:
        raise ValueError(f"starts must be at least 1, got {starts}.")
    problems = {}
    # All of them before the first fit, so that a wrong layout is found at once.
    for name, points in layouts.items():
        try:
            space = as_space(make_parameters(points))
            problems[name] = build_problem(model, space, configurations, newton)
        except ValueError as error:
            raise ValueError(f"layout {name!r}: {error}") from error
    settings = settings or FOR_PREDICTION
    names = [c.name for c in configurations]
    scores = []
    for name, problem in problems.items():
        start = problem.space.admissible(problem.space.start())[None]
        if starts > 1:
            others = random_starts(problem.space, starts - 1, seed=seed)
            start = jnp.concatenate([start, others])
        fits = _fit(without_names(problem), settings, start, _folds(len(names)))
        scores.append(_score(name, layouts[name], problem, names, fits))
    return LayoutComparison.ranked(scores)


def _score(
    name: str,
    points: ControlPoints,
    problem: CalibrationProblem,
    names: list[str],
    fits: _Fits,
) -> LayoutScore:
    """The folds of one layout, the fit of everything, and what the data see then."""
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    error = np.asarray(fits.error)
    # Distances are of points; turns and forces count in units of the noise.
    points_of = slice(0, problem.configurations.effectors.nodes.shape[-2])
    every = range(len(names))
    folds = []
    for held_out, configuration in enumerate(names):
        others = [i for i in every if i != held_out]
        failure = _failure(fits, held_out, held_out)
        if failure:
            folds.append(FoldScore(configuration, np.nan, np.nan, np.nan, failure))
            continue
        now = error[held_out]
        folds.append(
            FoldScore(
                configuration,
                _rms(now[:, points_of], weight[:, points_of], [held_out]),
                _noise_rms(now, weight, [held_out]),
                _rms(now[:, points_of], weight[:, points_of], others),
            )
        )
    failure = _failure(fits, len(names), None)
    return LayoutScore(
        name,
        len(points.names),
        len(problem.space.names),
        tuple(folds),
        np.nan
        if failure
        else _rms(error[-1][:, points_of], weight[:, points_of], list(every)),
        np.nan if failure else _noise_rms(error[-1], weight, list(every)),
        failure,
        _seen(problem, fits),
    )


def _seen(problem: CalibrationProblem, fits: _Fits) -> Identifiability | None:
    """What the data see where the fit of everything ended, with the stated noise."""
    if not bool(jnp.all(fits.there[-1])):
        return None
    measured = int(np.sum(problem.configurations.effectors.inverse_std > 0.0))
    W, z = np.asarray(fits.W[-1]), np.asarray(fits.z[-1])
    return identifiability(W, problem.space, z, n_data=measured)


def _failure(fits: _Fits, fold: int, held_out: int | None) -> str:
    """Why a fit tells nothing; empty if it does."""
    if np.isinf(float(fits.cost[fold])):
        return "a fitted configuration has no equilibrium at the start"
    if not bool(fits.converged[fold]):
        return "the fit did not converge"
    if held_out is not None and not bool(fits.there[fold, held_out]):
        return "with the fitted parameters it has no equilibrium"
    if not bool(jnp.all(fits.there[fold])) and held_out is None:
        return "a configuration lost its equilibrium after the fit"
    return ""


def _rms(
    error: Float[HostArray, "n_c n_markers 3"],
    weight: Float[HostArray, "n_c n_markers 3"],
    lanes: list[int],
) -> float:
    """Root mean square of the distances of the points that are measured [m]."""
    there = np.any(weight[lanes] > 0.0, axis=2)
    squares = np.sum(error[lanes] ** 2, axis=2)
    return float(np.sqrt(np.mean(squares[there])))


def _noise_rms(
    error: Float[HostArray, "n_c n_markers 3"],
    weight: Float[HostArray, "n_c n_markers 3"],
    lanes: list[int],
) -> float:
    """Root mean square of the measured coordinates, in units of the noise [-]."""
    measured = weight[lanes] > 0.0
    return float(np.sqrt(np.mean((weight * error)[lanes][measured] ** 2)))
