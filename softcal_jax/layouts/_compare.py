"""Laws, meshes and layouts of control points judged by what they predict.

They are fitted to all configurations but one, and predict that one (Sec. V-C).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of, unstacked
from softcal_jax._process import progress_line
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration import (
    Basin,
    Begun,
    CalibrationSettings,
    CalibrationState,
    Evaluation,
    Evaluator,
    Proposal,
    Run,
    best_of,
    build_problem,
    descend,
    images_of,
    initial_state,
    known_optima,
    number_of_starts,
    propose,
    run_start,
)
from softcal_jax.configurations import Configuration
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

FOR_PREDICTION = CalibrationSettings(tol=1e-4, max_steps=200)
"""Settings of the fits: loose, since 0.01 % of a modulus changes no prediction.

Along directions that the data hardly see a fit creeps. A layout with many points has
such directions, so more steps are allowed.
"""

SHARE = 0.05
"""Change of a held-out error by a step, over the error, after which no other follows.

The step itself is taken. What is left out is less where steps shrink.
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


def _lanes(fitted: Bool[HostArray, " n_c"]) -> Int[HostArray, " n_c"]:
    """Return the lanes of a fold: another one is repeated for that held out."""
    every = np.arange(len(fitted))
    return np.where(fitted, every, (every + 1) % len(fitted))


def _fold_problem(problem: Problem, fitted: Bool[HostArray, " n_c"]) -> Problem:
    """Return the calibration of one fold, without the held-out configuration.

    In its place another one is repeated with weight zero: so all fits share their
    shapes and programs, and the held-out configuration cannot affect the fit, not even
    by having no equilibrium.
    """
    lanes = _lanes(fitted)
    taken = jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], problem.configurations)
    weight = np.where(fitted[:, None, None], taken.effectors.inverse_std, 0.0)
    taken = eqx.tree_at(lambda c: c.effectors.inverse_std, taken, weight)
    return eqx.tree_at(lambda p: p.lanes.arrays, problem, taken)


class _Fits(NamedTuple):
    """How one model is fitted; `tell` is told which fit is under way."""

    problem: Problem
    settings: CalibrationSettings
    starts: Sequence[Float[Array, " n_p"]]
    tell: Callable[[str], None]

    def of_all(self) -> tuple[_Fit, list[Evaluation]]:
        """Fit all configurations; return also all optima, unless the fit failed."""
        n_c = len(self.problem.poses)
        with Workers(self.problem.model, n_c) as workers:
            whole = Evaluator(self.problem, workers)
            run, optima = self._from_starts(whole, "all configurations")
            fit = _Fit(np.ones(n_c, bool), run, whole.from_rest(jnp.asarray(run.z)))
            known = [] if fit.failure else [jnp.asarray(end.z) for end in optima]
            return fit, [end for end in map(whole.from_rest, known) if end.ok]

    def of_folds(self, optima: Sequence[Evaluation], share: float) -> list[_Fit]:
        """Fit all configurations but each one, side by side: from `optima` of all."""
        n_c = len(self.problem.poses)

        def fit(fitted: Bool[HostArray, " n_c"]) -> _Fit:
            what = f"without {self.problem.names[int(np.argmin(fitted))]}"
            fold = Evaluator(_fold_problem(self.problem, fitted), workers)
            found = self._from_optima(fold, fitted, optima, share, what)
            if found is not None:
                run, near = found
                return _Fit(fitted, run, whole(jnp.asarray(run.z), near))
            run, _ = self._from_starts(fold, what)
            return _Fit(fitted, run, whole.from_rest(jnp.asarray(run.z)))

        with Workers(self.problem.model, n_c**2) as workers:
            whole, folds = Evaluator(self.problem, workers), ~np.eye(n_c, dtype=bool)
            return workers.side_by_side(partial(fit, fold) for fold in folds)

    def _from_starts(self, evaluate: Evaluator, what: str) -> tuple[Run, list[Basin]]:
        """Fit from all starts; return the best end, and the optima."""
        images, ended = images_of(self.problem.space, mirror=True), list[Begun]()
        for i, z in enumerate(self.starts):
            note = partial(self._note, f"{what}, start {i + 1} of {len(self.starts)}")
            more: Any = {"images": images, "known": known_optima(ended, images)}
            run = run_start(evaluate, self.settings, z, note_step=note, **more)
            ended.append(run)
        runs = [begun.best for begun in ended]
        cost = np.array([run.cost for run in runs])
        run = runs[best_of(cost, np.array([run.converged for run in runs]))]
        return run, known_optima(ended, images)

    def _note(self, what: str, *at: Any) -> None:
        """Tell the step of the state that comes last, if there is one yet."""
        self.tell(f"{what}, step {int(at[-1].step) if at[-1] is not None else 0}")

    def _from_optima(
        self,
        evaluate: Evaluator,
        fitted: Bool[HostArray, " n_c"],
        optima: Sequence[Evaluation],
        share: float,
        what: str,
    ) -> tuple[Run, Float[Array, "n_c n_points 3"]] | None:
        """Fit a fold from the optimum of all whose linear model foretells the least.

        The first step is the leave-one-out estimate of that model. Further ones follow
        until the held-out error changes by less than `share`, or to the end where the
        first leaves the trust region. Returns the end, and displacements nearby [m].

        None where that does not end, or the fold sees fewer directions than all do: it
        may not learn the rest from an optimum that knows the held-out configuration.
        """
        space, settings = evaluate.numbered.space, self.settings.as_arrays()

        def begun(optimum: Evaluation) -> tuple[Proposal, CalibrationState, Evaluation]:
            response = lane_of(optimum.response, _lanes(fitted))
            first = evaluate.weighed(optimum.z, response)
            state = initial_state(self.settings, first)
            return propose(space, settings, state), state, optimum

        if not optima:
            return None
        lowest = lambda each: float(each[0].cost)
        first, state, optimum = min(map(begun, optima), key=lowest)
        far = np.abs(first.qp.lambda_p).max() >= 0.99 * self.settings.step_bound
        linear = optimum.linear(self.problem, optimum.z)
        rows = fitted[linear.pose]
        rank = lambda model: model.solution.basis.shape[1]
        if rank(linear.only(rows)) < rank(linear):
            return None
        held_out, z, before = linear.only(~rows), state.z, np.inf

        def enough(state: CalibrationState) -> bool:
            nonlocal z, before
            z = propose(space, settings, state).z
            change, way = (np.asarray(space.shorter(z - o.z)) for o in (state, optimum))
            error = held_out.whiten(held_out.r + held_out.W @ way)
            moved = np.linalg.norm(held_out.whiten(held_out.W @ change))
            shrinks, before = 1.0 - moved / max(before, 1e-300), moved
            return not far and bool(moved <= share * shrinks * np.linalg.norm(error))

        note = partial(self._note, what)
        end = descend(evaluate, self.settings, state, note, enough)
        if end.stalled or int(end.step) >= self.settings.max_steps:
            return None
        z, cost = np.asarray(end.z if end.ended else z), float(end.evaluation.cost)
        run = Run(z, cost, int(end.step), converged=True, errors=np.zeros(0))
        return run, optimum.equilibrium.displacement


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

    The fit to all comes first, from all starts. The others begin at its optima, with
    the step of the linear model without the rows of one configuration (Eq. 10), which
    is the leave-one-out estimate to first order (Cook, Technometrics 19, 1977). Steps
    follow where that is in doubt: where it leaves the trust region, where it moves the
    prediction by more than `SHARE` of its error, or where two models are closer than
    that. A configuration without which fewer directions are seen is fitted anew from
    all starts.

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
        progress: Called with what is under way: the model, the fit and its step, in
            threads, one at a time. By default, on a terminal and in notebooks, a line
            says it; False switches it off.

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
    more: Any = {"settings": settings, "starts": starts, "seed": seed}
    return compare_models(problems, **more, progress=progress)


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
    fits: dict[str, _Fits] = {}
    with progress_line(wanted=progress is None) as line:
        tell = progress or line or (lambda _: None)
        for name, problem in problems.items():
            space, n = problem.space, number_of_starts(problem.space, starts, None)
            begin = [space.admissible(space.start())]
            if n > 1:
                begin += unstacked(random_starts(space, n - 1, seed=seed))
            said = lambda what, name=name: tell(f"{name}: {what}")
            fits[name] = _Fits(problem, settings or FOR_PREDICTION, begin, said)
        whole = {name: fit.of_all() for name, fit in fits.items()}

        def scored(name: str, share: float) -> ModelScore:
            last, optima = whole[name]
            folds = fits[name].of_folds(optima, share)
            return _score(name, problems[name], [*folds, last])

        scores = {name: scored(name, SHARE) for name in problems}
        for name in _in_doubt(ModelComparison.ranked([*scores.values()])):
            scores[name] = scored(name, 0.0)
    return ModelComparison.ranked([*scores.values()])


def _in_doubt(compared: ModelComparison) -> list[str]:
    """Return the models that the fits to first order may have ranked wrongly.

    Their difference to the best, or from what would tell it, is within `SHARE` of both
    errors, twice that of their squares.
    """
    (best, *others), names = compared.models, dict[str, None]()
    for model, pair in zip(others, compared.differences, strict=True):
        nearest = min(abs(pair.difference), abs(pair.difference - pair.half_width))
        if nearest <= 2.0 * SHARE * (best.score + model.score):
            names |= {best.name: None, model.name: None}
    return [*names]


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
