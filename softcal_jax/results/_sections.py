"""What each kind of result says: the only place with its words."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Result
from softcal_jax._text import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    MultiStartResult,
    SimulationResult,
)
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.identifiability import Assessment, Identifiability, Ranking
from softcal_jax.inference import Difference, Estimate, difference
from softcal_jax.layouts import ModelComparison
from softcal_jax.mesh import TetMesh
from softcal_jax.project import Project, QuantityAsRead
from softcal_jax.results._calibration import (
    assessment_sections,
    calibration_sections,
    outlook_sections,
    search_sections,
)
from softcal_jax.results._goals import (
    commanded_bodies,
    design_bodies,
    design_sections,
    inverse_sections,
    trajectory_sections,
)
from softcal_jax.results._outline import mesh_sections, project_sections
from softcal_jax.results._poses import simulation_sections
from softcal_jax.results._sweep import sweep_sections
from softcal_jax.results._tree import Column, Section, Table, Tone, Value, verdict
from softcal_jax.sweeps import SweepResult

_COARSE = 0.3
"""Difference over a value, or in rad, that must be seen if agreement is to say much."""


def sections(
    result: object,
    known: Assessment | Ranking | Sequence[QuantityAsRead] | None = None,
    **chosen: Any,
) -> tuple[Section, ...]:
    """Write what a result says, or a project or a mesh, as a tree.

    Sections without a title come first.

    Args:
        result: The result.
        known: What is known of it besides: the assessment of a calibration, candidates
            that are ranked beside an `Identifiability`, or the quantities of a project
            as they were typed.
        chosen: Of a sweep: axes to group trials `by`, the `figures` to show, and
            whether to list `every` trial.

    Raises:
        TypeError: If it is no result of this package.
        ValueError: If a sweep has no such axis or figure.
    """
    return tuple(_written(result, *([] if known is None else [known]), **chosen))


def headline(result: object) -> str:
    """Say what a result comes to, in a sentence or two: its verdict without reasons.

    It is empty for a project or a mesh.

    Raises:
        TypeError: If it is no result of this package.
    """
    verdicts = (s.text[0] for s in _written(result) if s.key == "verdict")
    return next(verdicts, "")


def _written(result: object, *known: object, **chosen: Any) -> Iterable[Section]:
    if type(result) not in RESULT_KINDS:
        raise TypeError(f"a {type(result).__name__} is no result that has sections.")
    return RESULT_KINDS[type(result)].sections(result, *known, **chosen)


def _comparison(comparison: ModelComparison) -> Iterator[Section]:
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
    yield verdict(_best_model(comparison), tone)
    yield Section("failures", "What failed", tuple(_failures(comparison)))
    models, rows = comparison.models, []
    for model, worse in zip(models, (None, *comparison.differences), strict=True):
        n, failed = len(model.folds), len(model.failed)
        failed = f"{failed} of {n}" if failed else "none"
        sizes = model.held_out_rms, model.held_out_noise_rms
        excess = Value(None)
        if worse is not None and not math.isnan(worse.difference):
            width = worse.half_width if math.isfinite(worse.half_width) else math.nan
            excess = Value(worse.difference, error=width)
        named = model.name, model.n_parameters
        rows.append((*named, *sizes, excess, model.fit_rms, failed))
    heads = "model | parameters | held-out error [m] | error / noise [correlation]"
    heads += " | excess over best, in noise^2 | fit [m] | failed folds"
    yield Section("models", "Models", (), (Table.of("Models", heads, rows),))
    errors_of = {m.name: {f.held_out: f.rms for f in m.good} for m in models}
    poses = [*dict.fromkeys(fold.held_out for m in models for fold in m.folds)]
    folds = (
        Column(name, [of.get(pose, "failed") for pose in poses], "m")
        for name, of in errors_of.items()
    )
    title = "Held-out error of each configuration"
    alone = Table(title, (Column("configuration", poses), *folds))
    yield Section("folds", "Held-out configurations", (), (alone,), folded=True)


def _best_model(result: ModelComparison) -> str:
    """Say which model is best, and from which others the data distinguish it."""
    best = result.best
    if best is None:
        return "No model predicts every configuration, so none can be preferred."
    size = readable_values([best.held_out_rms], "m", digits=3) + ", "
    first = (
        f"{best.name!r} has the smallest held-out error: "
        f"{size * bool(np.isfinite(best.held_out_rms))}"
        f"{best.held_out_noise_rms:.2f} times the noise."
    )
    rivals = [model for model in result.models[1:] if not model.failed]
    close = [model for model in rivals if model.name in result.undecided]
    worse = [model for model in rivals if model.name not in result.undecided]
    names = lambda models: listed([repr(model.name) for model in models])
    if not rivals:
        return f"{first} No other model predicts every configuration."
    if not close:
        return f"{first} The data distinguish it from {names(worse)}."
    text = f"{first} The data cannot distinguish it from {names(close)}"
    text += f", but can from {names(worse)}." if worse else "."
    fewest = min([best, *close], key=lambda m: (m.n_parameters, m.score))
    if fewest.n_parameters < best.n_parameters:
        text += f" Of these, {fewest.name!r} has the fewest parameters."
    return text


def _failures(result: ModelComparison) -> Iterator[str]:
    """Say which fits failed and why, one sentence each."""
    for model in result.models:
        for fold in model.failed:
            yield f"{model.name!r}, {fold.held_out} held out: {fold.failure}."
        if model.fit_failure:
            yield f"{model.name!r}, all configurations fitted: {model.fit_failure}."


class Transfer(Result):
    """Values of the material from a robot A, asked of a robot B.

    Attributes:
        difference: Of the values that both gave.
        poses: The configurations of B.
        motion: How far their points move [m].
        rms_own: How far they are off by the fit to B, rms [m].
        rms_of_a: The same with the values of A, and all others fitted to B [m].
        lost: Configurations of which no equilibrium was found with the values of A.
    """

    difference: Difference
    poses: tuple[str, ...]
    motion: Float[HostArray, " n_c"]
    rms_own: Float[HostArray, " n_c"]
    rms_of_a: Float[HostArray, " n_c"]
    lost: tuple[str, ...]


def transfer(a: Estimate, b: Project, result: CalibrationResult) -> Transfer:
    """Compare a calibration of robot A with that of robot B, and predict B with it.

    Args:
        a: What the calibration of A found.
        b: The project of B.
        result: Its calibration.

    Raises:
        ValueError: If no parameter of the material has a standard error in both.
    """
    apart = difference(a, result.estimate)
    with_a = _predicted(b, result, dict(zip(apart.names, apart.of_a, strict=True)))
    rms_of_b = {c.name: c.rms_after for c in result.configurations}
    return Transfer(
        difference=apart,
        poses=tuple(c.name for c in with_a),
        motion=np.array([c.motion for c in with_a]),
        rms_own=np.array([rms_of_b.get(c.name, np.nan) for c in with_a]),
        rms_of_a=np.array([c.rms_after for c in with_a]),
        lost=tuple(c.name for c in with_a if not c.converged),
    )


def _predicted(
    b: Project, result: CalibrationResult, of_a: dict[str, float]
) -> tuple[ConfigurationResult, ...]:
    """Solve B with values of A; its other parameters follow, to first order."""
    space, linear, z = result.space, result.linear, np.asarray(result.z)
    values = np.array(space.from_scaled(result.z))
    taken = np.isin(space.names, [*of_a])
    values[taken] = [of_a[name] for name in space.names if name in of_a]
    at_a = space.to_scaled(jnp.asarray(values))
    to_a = np.asarray(space.shorter(at_a - result.z))
    moved = replace(
        linear,
        r=linear.r + linear.W @ to_a,
        from_prior=linear.from_prior + linear.prior_weights * to_a,
        held=linear.held | taken,
    )
    others = jnp.asarray(z + np.nan_to_num(moved.step()))
    others = space.from_scaled(jnp.clip(others, space.lower(), space.upper()))
    values = np.where(taken, values, np.asarray(others))
    simulated, _ = b.simulate(dict(zip(space.names, values, strict=True)))
    return simulated.configurations


def _transfer(result: Transfer) -> Iterator[Section]:
    head, values = _difference(result.difference)
    if result.lost:
        lost = f"no equilibrium was found for {listed(result.lost)}."
        head = head._replace(text=(*head.text, f"With the values of A, {lost}"))
    yield head
    heads = "pose of B | motion [m] | error, fitted to B [m] | error, values of A [m]"
    errors = result.motion, result.rms_own, result.rms_of_a
    rows = zip(result.poses, *errors, strict=True)
    poses = Table.of("Prediction", heads, rows)
    yield values._replace(tables=(*values.tables, poses))


def _difference(d: Difference) -> Iterator[Section]:
    yield verdict(_agreement(d), "plain")
    each = zip(
        d.names, d.units, d.of_a, d.std_a, d.of_b, d.std_b, d.unseen, strict=True
    )
    rows = [
        (name, Value(a, u, std_a), Value(b, u, std_b), Value(unseen, u, digits=2))
        for name, u, a, std_a, b, std_b, unseen in each
    ]
    heads = "parameter | from A | from B | smallest detectable difference"
    yield Section("values", "Values", (), (Table.of("Values", heads, rows),))


def _agreement(d: Difference) -> str:
    """Say whether the values of two robots agree, or where they differ most."""
    chi2 = f"chi-squared {d.chi_squared:.3g} for {d.directions}"
    by = lambda i, sizes: (
        f"{d.names[i]} by {readable(float(f'{sizes[i]:.2g}'), d.units[i])}"
    )
    if d.contradicted:
        return (
            f"The model contradicts the data of {listed(d.contradicted)}: such "
            "values hold at most for the loads and shape that they were fitted to. "
            f"Between A and B: {chi2}."
        )
    if d.agree:
        size = np.where(np.array(d.units) == "rad", 1.0, np.abs(d.of_a))
        coarse = np.flatnonzero(d.unseen > _COARSE * size).tolist()
        hidden = [by(i, d.unseen) for i in coarse]
        text = f"Both agree within their errors ({chi2})"
        if hidden:
            return f"{text}, but a difference could hide: {listed(hidden)}."
        return f"{text}, as material properties would."
    largest = np.argsort(-np.abs(d.worst / d.unseen))[:4].tolist()
    changes = [by(i, d.worst) for i in largest]
    return (
        f"They do not agree ({chi2}): the values of at least one robot hold only "
        "for its loads and shape. From A to B they differ most in "
        f"{listed(changes)} ({d.worst_size:.1f} standard errors)."
    )


Bodies = CalibrationResult | SimulationResult
"""Results that have equilibria."""


class ResultKind(NamedTuple):
    """All that a kind of result is, to what writes it.

    Attributes:
        sections: What it says, section by section.
        words: What was done, as a page says it; empty for what has no page.
        command: The command that does it.
        format: Format of its JSON: the name of the file, and a version.
        bodies: Its equilibria; None for what has none.
    """

    sections: Callable[..., Iterable[Section]]
    words: str = ""
    command: str = ""
    format: str = ""
    bodies: Callable[[Any], Bodies | None] = lambda _: None

    @property
    def file(self) -> str:
        """Name of its JSON and its text, without the ending."""
        return self.format.partition("/")[0]


_INVERSE = "Inverse control", "inverse", "inverse/1", commanded_bodies
_IDENTIFY = "Identifiability", "identify", "identifiability/3"
_itself = lambda result: result

RESULT_KINDS: dict[type, ResultKind] = {
    CalibrationResult: ResultKind(
        calibration_sections, "Calibration", "calibrate", "result/2", _itself
    ),
    SimulationResult: ResultKind(
        simulation_sections, "Simulation", "simulate", "simulation/1", _itself
    ),
    DesignResult: ResultKind(
        design_sections, "Design", "design", "design/1", design_bodies
    ),
    InverseResult: ResultKind(inverse_sections, *_INVERSE),
    TrajectoryResult: ResultKind(trajectory_sections, *_INVERSE),
    Identifiability: ResultKind(outlook_sections, *_IDENTIFY),
    Ranking: ResultKind(lambda ranking: outlook_sections(None, ranking), *_IDENTIFY),
    ModelComparison: ResultKind(
        _comparison, "Comparison of models", "compare", "comparison/1"
    ),
    MultiStartResult: ResultKind(search_sections),
    Assessment: ResultKind(assessment_sections),
    Difference: ResultKind(_difference),
    Transfer: ResultKind(_transfer),
    SweepResult: ResultKind(sweep_sections),
    Project: ResultKind(project_sections),
    TetMesh: ResultKind(mesh_sections),
}
"""What is known of each kind of result; a new one is a row."""
