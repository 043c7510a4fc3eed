"""Laws, meshes and layouts of control points judged by what they predict."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from softcal_jax.calibration import (
    CalibrationProblem,
    CalibrationSettings,
    build_problem,
)
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    ControlPoints,
    Entry,
    ParameterSpace,
    Uncertain,
    check_starts,
)
from softcal_jax.layouts._cross_validation import FOR_PREDICTION, cross_validated
from softcal_jax.layouts._model_comparison import ModelComparison

Parameters = ParameterSpace | Entry | Sequence[Entry]


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
) -> ModelComparison:
    """Find the layout of control points that best predicts what it was not fitted to.

    Too few control points misfit all configurations; too many fit the noise, along
    directions that the data are blind to, and predict worse: the trade-off of Sec. V-C.
    Of layouts within one standard error of the best, `preferred` has the fewest
    parameters.

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

    Returns:
        The models, the best first, and what sets them apart. A fold that did not
        converge, or whose configuration cannot be predicted, is named and counts in no
        average; a model with such a fold ranks behind all that have none.

    Raises:
        ValueError: If fewer than two configurations or no law is given, or an input is
            wrong; the text names the law.
    """
    if isinstance(configurations, Configuration):
        configurations = (configurations,)
    problems = {}
    # All problems are built before the first fit, so that a wrong one is found at once.
    for name, (model, parameters) in laws.items():
        try:
            problems[name] = build_problem(
                model, parameters, configurations, newton, uncertain=uncertain
            )
        except ValueError as error:
            raise ValueError(f"{name!r}: {error}") from error
    return compare_models(
        problems, configurations, settings=settings, starts=starts, seed=seed
    )


def compare_models(
    problems: Mapping[str, CalibrationProblem],
    configurations: Sequence[Configuration],
    *,
    settings: CalibrationSettings | None = None,
    starts: int | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> ModelComparison:
    """Compare calibrations of any models to the same data, see `compare_laws`.

    `progress` is called with the name of each model before it is fitted.

    Raises:
        ValueError: If there is no model, fewer than two configurations, or the models
            are not fitted to the same measurements; the text names the model.
    """
    if not problems:
        raise ValueError("at least one model is needed, got none.")
    if len(configurations) < 2:
        raise ValueError(
            "cross-validation fits all configurations but one and predicts that one: "
            f"at least 2 are needed, got {len(configurations)}."
        )
    if starts is not None:
        check_starts(starts)
    _check_same_data(problems)
    scores = []
    for name, problem in problems.items():
        progress(name)
        how = (settings or FOR_PREDICTION, starts, seed)
        scores.append(cross_validated(name, problem, configurations, *how))
    return ModelComparison.ranked(scores)


def _check_same_data(problems: Mapping[str, CalibrationProblem]) -> None:
    """Raise ValueError unless all models have the same measurements and noise."""
    (first, expected), *others = ((name, _data(p)) for name, p in problems.items())
    close = partial(np.allclose, rtol=1e-9, atol=1e-12, equal_nan=True)
    for name, data in others:
        pairs = zip(data, expected, strict=True)
        if not all(a.shape == b.shape and close(a, b) for a, b in pairs):
            raise ValueError(
                f"{name!r} is not fitted to the same measurements as {first!r}, so "
                "that their errors cannot be compared; give both the same "
                "configurations with the same measured values and standard deviations."
            )


def _data(problem: CalibrationProblem) -> list[np.ndarray]:
    effectors = problem.configurations.effectors
    weight, measured = map(np.asarray, (effectors.inverse_std, effectors.measured))
    return [np.where(weight > 0.0, measured, 0.0), weight]
