"""Laws, meshes and layouts of control points judged by what they predict.

They are fitted to all configurations but one, and predict that one (Sec. V-C).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import unstacked
from softcal_jax._process import progress_line
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration import (
    Begun,
    CalibrationSettings,
    Evaluation,
    Evaluator,
    Run,
    best_of,
    build_problem,
    images_of,
    known_optima,
    number_of_starts,
    run_start,
)
from softcal_jax.configurations import Configuration, earlier_lanes
from softcal_jax.equilibrium import Model, NewtonSettings, Workers
from softcal_jax.fields import (
    ControlPoints,
    Parameters,
    Uncertain,
    random_starts,
)
from softcal_jax.identifiability import identifiability
from softcal_jax.layouts._model_comparison import (
    FoldScore,
    ModelComparison,
    ModelScore,
    root_mean_square,
)
from softcal_jax.unknowns import Problem

FOR_PREDICTION = CalibrationSettings(tol=1e-5, max_steps=200)
"""Settings of the fits: loose, since 0.001 % of a modulus changes no prediction.

Along directions that the data hardly see a fit creeps. A layout with many points has
such directions, so more steps are allowed.
"""


class _Fit(NamedTuple):
    """End of a fit, and the evaluation of all configurations with its parameters.

    `fitted` flags the configurations that count: all but one, or all in the last fit.
    """

    fitted: Bool[HostArray, " n_c"]
    run: Run
    after: Evaluation

    @property
    def failure(self) -> str:
        """Why it failed; empty if it did not."""
        if np.isinf(self.run.cost):
            return "a fitted configuration has no equilibrium at the start"
        if not self.run.converged:
            return "the fit did not converge"
        asked = self.fitted if self.fitted.all() else ~self.fitted
        if np.all(np.asarray(self.after.equilibrium.converged)[asked]):
            return ""
        return "no equilibrium with the fitted parameters"


def _fold_problem(problem: Problem, fitted: Bool[HostArray, " n_c"]) -> Problem:
    """Return the calibration of one fold, without the held-out configuration.

    In its place another one is repeated with weight zero: so all fits share their
    shapes and programs, and the held-out configuration cannot affect the fit, not even
    by having no equilibrium. One that others follow stays, with weight zero.
    """
    every, earlier = np.arange(len(fitted)), earlier_lanes([*problem.configurations])
    stays = fitted | np.isin(every, [p for p in earlier if p is not None])
    lanes = np.where(stays, every, (every + 1) % len(fitted))
    taken = jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], problem.configurations)
    weight = np.where(fitted[:, None, None], taken.effectors.inverse_std, 0.0)
    taken = eqx.tree_at(lambda c: c.effectors.inverse_std, taken, weight)
    return eqx.tree_at(lambda p: p.lanes.arrays, problem, taken)


def _fit(
    problem: Problem,
    settings: CalibrationSettings,
    starts: Sequence[Float[Array, " n_p"]],
    progress: Callable[[str], None] = lambda _: None,
) -> list[_Fit]:
    """Fit all configurations but each one, side by side, and all; these come last.

    The fit to all comes first, and searches from every start. Each fold begins where it
    ended, and at the other optima that it found, near which its own lie; it goes on to
    its own end. One that does not get there searches from every start, too.
    """
    n_c = len(problem.poses)

    def fit(
        fitted: Bool[HostArray, " n_c"],
        starts: Sequence[Array | HostArray],
        *,
        mirror: bool,
    ) -> tuple[_Fit, list[HostArray]]:
        """Return the best fit from some starts; its end, then others, lowest first."""
        evaluator = Evaluator(_fold_problem(problem, fitted), workers)
        images, ended = images_of(problem.space, mirror=mirror), list[Begun]()
        for z in map(jnp.asarray, starts):
            known = known_optima(ended, images)
            ended.append(run_start(evaluator, settings, z, images=images, known=known))
        runs = [begun.best for begun in ended]
        cost = np.array([run.cost for run in runs])
        run = runs[best_of(cost, np.array([run.converged for run in runs]))]
        after = whole.from_rest(jnp.asarray(run.z))
        optima = sorted(known_optima(ended, images), key=lambda optimum: optimum.cost)
        ends = [run.z, *(optimum.z for optimum in optima)]
        return _Fit(fitted, run, after), ends

    def without(pose: int) -> _Fit:
        fitted = np.arange(n_c) != pose
        fold, _ = fit(fitted, ends or starts, mirror=not ends)
        if ends and not fold.run.converged:
            fold, _ = fit(fitted, starts, mirror=True)
        done.append(pose)
        progress(f"{len(done)} of {n_c} fits to all configurations but one")
        return fold

    done: list[int] = []
    with Workers(problem.model, n_c * n_c) as workers:
        whole = Evaluator(problem, workers)
        progress("fit to all configurations")
        last, ends = fit(np.ones(n_c, bool), starts, mirror=True)
        ends = ends if np.isfinite(last.run.cost) else []
        folds = workers.side_by_side(partial(without, pose) for pose in range(n_c))
    return [*folds, last]


def _score(name: str, problem: Problem, fits: list[_Fit]) -> ModelScore:
    """Score the folds of one model and the fit to all configurations."""
    effectors, noise = problem.configurations.effectors, problem.noise
    weight = np.asarray(effectors.inverse_std)
    assert noise is not None
    # In the errors these offsets are subtracted, so the noise has none.
    known = eqx.tree_at(lambda n: n.attached.std, noise, np.zeros(0))
    # Only points have distances; turns and forces count in units of the noise alone.
    n_points = effectors.nodes.shape[-2]

    def rms(fit: _Fit, lanes: Bool[HostArray, " n_c"]) -> tuple[float, float]:
        """Return rms distance of points [m], and rms error over the noise [-].

        Offsets of attachments are known from the fitted configurations alone.
        """
        if fit.failure:
            return np.nan, np.nan
        error = noise.without_attachments(effectors, fit.after.delta_e, fit.fitted)
        z, on_device = jnp.asarray(fit.run.z), jax.device_put(error)
        after = replace(fit.after, delta_e=on_device)
        linear = after.linear(problem.with_noise(known), z)
        linear = linear.only(lanes[linear.pose])
        squares = np.sum(error[lanes, :n_points] ** 2, axis=2)
        measured = np.any(weight[lanes, :n_points] > 0.0, axis=2)
        distances = np.sqrt(squares[measured])
        return root_mean_square(distances), root_mean_square(linear.whiten(linear.r))

    *held_out, last = fits
    folds = []
    for pose, fit in zip(problem.names, held_out, strict=True):
        errors, (fitted, _) = rms(fit, ~fit.fitted), rms(fit, fit.fitted)
        folds.append(FoldScore(pose, *errors, fitted, fit.failure))
    seen = None
    if np.all(last.after.equilibrium.converged):
        z = jnp.asarray(last.run.z)
        linear = last.after.linear(problem, z)
        linear, model = linear.with_scale(1.0), problem.model
        seen = identifiability(linear, problem.space, last.run.z, model=model)
    distance, over_noise = rms(last, last.fitted)
    return ModelScore(
        name=name,
        n_parameters=len(problem.space.names),
        folds=tuple(folds),
        fit_rms=distance,
        fit_noise_rms=over_noise,
        fit_failure=last.failure,
        identifiability=seen,
    )


def compare_layouts(
    model: Model,
    layouts: Mapping[str, ControlPoints],
    configurations: Configuration | Sequence[Configuration],
    *,
    make_parameters: Callable[[ControlPoints], Parameters],
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    uncertain: Uncertain | None = None,
    progress: Callable[[str], None] | Literal[False] | None = None,
) -> ModelComparison:
    """Find the layout of control points that best predicts what it was not fitted to.

    Too few control points misfit all configurations; too many fit the noise, along
    directions that the data are blind to, and predict worse: the trade-off of Sec. V-C.
    Of layouts that the data cannot distinguish from the best, the verdict names the one
    with the fewest parameters.

    `make_parameters` gives the parameters of a layout, like
    `lambda points: ControlPointParameters("E", points, ...)`; the arguments after it
    are those of `compare_laws`.

    Raises:
        ValueError: If fewer than two configurations or no layout is given, or an input
            is wrong; the text names the layout.
    """
    return compare_laws(
        {name: (model, make_parameters(points)) for name, points in layouts.items()},
        configurations,
        settings=settings,
        newton=newton,
        starts=starts,
        seed=seed,
        uncertain=uncertain,
        progress=progress,
    )


def compare_laws(
    laws: Mapping[str, tuple[Model, Parameters]],
    configurations: Configuration | Sequence[Configuration],
    *,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    uncertain: Uncertain | None = None,
    progress: Callable[[str], None] | Literal[False] | None = None,
) -> ModelComparison:
    """Find the law, or the mesh, that best predicts what it was not fitted to.

    Leave-one-configuration-out cross-validation (Stone, J. R. Stat. Soc. B 36, 1974):
    each model is fitted to all configurations but one and predicts that one, in turn.
    Its mean squared prediction error in units of the noise decides. Whether the data
    can tell two models apart is judged by the differences of their errors on the same
    configurations, and by the scatter of these differences.

    Example:
        Two laws on one mesh::

            comparison = sc.compare_laws({
                "neo-hookean": (sc.build_model(mesh, NeoHookean(2e5, 0.499), ...), E),
                "yeoh": (sc.build_model(mesh, Yeoh(3e4, 0.0, 10.0), ...), [c10, c30]),
            }, poses)
            print(comparison)

    Args:
        laws: Model and parameters by name. Models may differ in law and mesh.
        configurations: Measured configurations, at least two; every model must have the
            groups that they name.
        settings: Settings of the outer loop; by default `FOR_PREDICTION`.
        newton: Settings of the equilibrium.
        starts: Number of starts of each fit: the start of the parameters, then random
            ones within the bounds; by default see `default_starts`.
        seed: Seed of the random starts.
        uncertain: How well everything that is not calibrated is known; offsets of
            recordings belong to the noise. By default nothing is uncertain.
        progress: Called with what is under way, as fits begin or end. By default, on a
            terminal and in notebooks, a line says it; False switches it off.

    Returns:
        The models, the best first, and what sets them apart. A fold that did not
        converge, or whose configuration cannot be predicted, is named and counts in no
        average; a model with such a fold ranks behind all that have none.

    Raises:
        ValueError: If fewer than two configurations or no law is given, or an input is
            wrong; the text names the law.
    """
    # All problems are built before the first fit, so that a wrong one is found at once.
    problems = {}
    for name, (model, parameters) in laws.items():
        try:
            problems[name] = build_problem(
                model, parameters, configurations, newton, uncertain=uncertain
            )
        except ValueError as error:
            raise ValueError(f"{name!r}: {error}") from error
    return compare_models(
        problems, settings=settings, starts=starts, seed=seed, progress=progress
    )


def compare_models(
    problems: Mapping[str, Problem],
    *,
    settings: CalibrationSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | Literal[False] | None = None,
) -> ModelComparison:
    """Compare calibrations of any models to the same data, see `compare_laws`.

    Raises:
        ValueError: If there is no model, fewer than two configurations, or the models
            are not fitted to the same measurements; the text names the model.
    """
    if not problems:
        raise ValueError("at least one model is needed, got none.")
    n_c = min(len(problem.poses) for problem in problems.values())
    if n_c < 2:
        raise ValueError(
            "cross-validation fits all configurations but one and predicts that one: "
            f"at least 2 are needed, got {n_c}."
        )
    _check_same_data(problems)
    scores = []
    with progress_line(wanted=progress is None) as line:
        tell = progress or line or (lambda _: None)
        for name, problem in problems.items():
            space, n = problem.space, number_of_starts(problem.space, starts, None)
            begin = [space.admissible(space.start())]
            if n > 1:
                begin += unstacked(random_starts(space, n - 1, seed=seed))
            of_name = lambda text, name=name: tell(f"{name}: {text}")
            fits = _fit(problem, settings or FOR_PREDICTION, begin, of_name)
            scores.append(_score(name, problem, fits))
    return ModelComparison.ranked(scores)


def _check_same_data(problems: Mapping[str, Problem]) -> None:
    """Raise ValueError unless all models have the same measurements and noise."""
    data = {}
    for name, problem in problems.items():
        effectors = problem.configurations.effectors
        weight, measured = map(np.asarray, (effectors.inverse_std, effectors.measured))
        data[name] = np.where(weight > 0.0, measured, 0.0), weight
    first = next(iter(data))
    close = partial(np.allclose, rtol=1e-9, atol=1e-12, equal_nan=True)
    for name in data:
        pairs = zip(data[name], data[first], strict=True)
        if not all(a.shape == b.shape and close(a, b) for a, b in pairs):
            raise ValueError(
                f"{name!r} is not fitted to the same measurements as {first!r}, so "
                "that their errors cannot be compared; give both the same "
                "configurations with the same measured values and standard deviations."
            )
