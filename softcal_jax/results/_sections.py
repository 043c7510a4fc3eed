"""What each kind of result says: the only place with its words."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

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
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import GoalFit, InverseResult, TrajectoryResult
from softcal_jax.designs import LEVEL, DesignResult
from softcal_jax.fields import ControlPointParameters
from softcal_jax.identifiability import Assessment, Identifiability, Ranking
from softcal_jax.inference import Difference, Estimate, difference
from softcal_jax.layouts import ModelComparison
from softcal_jax.materials import youngs_moduli
from softcal_jax.project import Project
from softcal_jax.results._calibration import (
    assessment_sections,
    calibration_sections,
    outlook_sections,
    search_sections,
)
from softcal_jax.results._headlines import headline, missed_words, off_words
from softcal_jax.results._json import plain
from softcal_jax.results._poses import (
    MOVED,
    actuator_cells,
    effector_name,
    simulation_sections,
)
from softcal_jax.results._sweep import sweep_sections
from softcal_jax.results._tree import Column, Section, Table, Tone, Value, verdict
from softcal_jax.sweeps import SweepResult


def sections(
    result: object, known: Assessment | Ranking | None = None
) -> tuple[Section, ...]:
    """Write what a result says, as a tree; those without a title come first.

    Args:
        result: The result.
        known: What is known of it besides: the assessment of a calibration, or
            candidates that are ranked beside an `Identifiability`.

    Raises:
        TypeError: If it is no result of this package.
    """
    if type(result) not in _SECTIONS:
        raise TypeError(f"a {type(result).__name__} is no result that has sections.")
    write = _SECTIONS[type(result)]
    return write(result) if known is None else write(result, known)


def _design(result: DesignResult) -> tuple[Section, ...]:
    """Write fields as ordered, goals, commands, limits, and what less could do."""
    reasons = *missed_words(result), *_sentences_on_worth(result)
    goals = _designed(result), _commands(result), _limits(result)
    return (
        verdict(headline(result), "good" if result.met else "doubtful", reasons),
        Section("goals", "Goals", (), goals),
        Section("ordered", "As ordered", (), (_ordered(result),)),
        Section("worth", "What it is worth", (), (_worth(result),)),
    )


def _ordered(result: DesignResult) -> Table:
    """Tabulate what is ordered at each control point, with its foam."""
    values = result.values
    rows: dict[str, dict[str, float]] = {}
    of_unit: dict[str, str] = {}
    for entry in result.fit.space.entries:
        for q in entry.parameters:
            if q.name in values:
                at_points = isinstance(entry, ControlPointParameters)
                field = entry.field if at_points else ""
                point = q.name.removeprefix(f"{field} of ")
                rows.setdefault(point, {})[field] = values[q.name]
                of_unit[field] = q.unit
    columns = [
        Column(field or "value", [row.get(field) for row in rows.values()], unit)
        for field, unit in of_unit.items()
    ]
    foam, law = result.foam, result.fit.model.law
    names = [path.rpartition(".")[2] for path, _ in youngs_moduli(law)]
    moduli = [[row[n] for n in names if n in row] for row in rows.values()]
    if foam is not None and any(moduli):
        infill = [
            foam.find(np.array([min(m)]), np.array([max(m)])) if m else None
            for m in moduli
        ]
        density = [None if found is None else found.density[0] for found in infill]
        shape = [None if found is None else found.anisotropy[0] for found in infill]
        columns += [Column("density", density, "percent")]
        columns += [Column(foam.setting, shape, "ratio")]
    columns = Column("control point", [*rows]), *columns
    return Table("As ordered", columns)


def _designed(result: DesignResult) -> Table:
    rows = []
    for goal in result.goals:
        effector, met = goal.effector, "met" if goal.met else "missed"
        # What nothing that is printed moves has no spread.
        printed: list[Any] = [None, None, "-"]
        if goal.hangs_on:
            ends = (
                readable_values([e], effector.unit, digits=2) for e in goal.interval
            )
            share = f"{goal.hangs_on} ({readable(goal.share, 'percent')})"
            printed = [goal.expected, " to ".join(ends).rstrip(), share]
        rows.append(
            (
                goal.configuration,
                effector_name(effector),
                Value(met, tone="good" if goal.met else "bad"),
                Value(goal.error, effector.unit),
                Value(printed[0], effector.unit),
                *printed[1:],
            )
        )
    heads = "configuration | effector | goal | off by | printed, rms | "
    heads += f"{100 * LEVEL:g} % of prints | hangs on"
    return Table.of("Goals", heads, rows, digits=2)


def _commands(result: DesignResult) -> Table:
    actuators = result.fit.model.mechanism.actuators
    rows = []
    for configuration in result.configurations:
        for name, imposed in configuration.actuation.items():
            kind = actuators.kinds[actuators.names.index(name)]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            rows.append((configuration.name, name, Value(imposed.value, unit or "")))
    return Table.of("Commands", "configuration | actuator | imposed", rows)


def _limits(result: DesignResult) -> Table:
    """Tabulate what is largest anywhere in the body, where it has a limit."""
    rows = []
    for p in result.peaks:
        sizes = (Value(size, p.unit.strip("-")) for size in (p.value, p.limit))
        kept = Value("kept", tone="good") if p.kept else Value("exceeded", tone="bad")
        rows.append((p.configuration, p.name, *sizes, kept))
    heads = "configuration | anywhere in the body | value | limit | "
    return Table.of("Limits", heads, rows)


def _sentences_on_worth(result: DesignResult) -> Iterator[str]:
    """Say what the design is worth, one sentence for each alternative."""
    for a in result.alternatives:
        text, error = f"{a.error:.3g} tolerances off", f"{result.error:.3g}"
        if np.isfinite(a.expected):
            text += f", {a.expected:.3g} as printed"
            error += f" and {result.expected:.3g}"
        if not a.result.converged:
            text += " or less (its search did not converge)"
        yield f"With {a.name} the goals are {text}, with this design {error}."


def _worth(result: DesignResult) -> Table:
    rows: list[tuple[str, float, float | None]]
    rows = [("this design", result.error, result.expected)]
    for a in result.alternatives:
        lost = "" if a.result.converged else " (not converged)"
        rows.append((f"{a.name}{lost}", a.error, a.expected))
    heads = "with | error over all goals, in tolerances [ratio] | as printed [ratio]"
    return Table.of("What the design is worth", heads, rows)


def _inverse(result: InverseResult | TrajectoryResult) -> tuple[Section, ...]:
    """Write how closely goals are met, and what the actuators do for it."""
    if isinstance(result, TrajectoryResult):
        return _trajectory(result)
    inputs = (f"Commanded: {_commanded(result)}.",)
    reached = ("Active limits:", *result.active_limits) if result.active_limits else ()
    tried = [(a.way, a.n_steps, a.error) for a in result.attempts]
    heads = "started from | steps | largest error, in standard deviations [ratio]"
    search = (Table.of("Descents", heads, tried),)
    rows = []
    for state in result.actuators:
        commanded = state.name in result.configuration.actuation
        kind = f"{state.kind}{', not commanded' * (not commanded)}"
        rows.append((state.name, kind, *actuator_cells(state)))
    actuators = Table.of("Actuators", f"actuator | kind | {MOVED}", rows)
    tables = goal_table(result.goals), actuators
    return (
        verdict(headline(result), "good" if result.met else "doubtful", inputs),
        Section("goals", "Goals and commands", reached, tables),
        Section("search", "Course of the search", (), search, folded=True),
    )


def _commanded(result: InverseResult) -> str:
    """Say what is imposed on the commanded actuators, in words."""
    imposed = lambda a: (getattr(a, a.imposed), getattr(a, f"{a.imposed}_unit"))
    return ", ".join(
        f"{a.name} = {readable_values([value], unit or '')}"
        for a in result.actuators
        if a.name in result.configuration.actuation
        for value, unit in [imposed(a)]
    )


def _trajectory(result: TrajectoryResult) -> tuple[Section, ...]:
    points = result.points
    far = [headline(points[i]) for i in result.unmet]
    rows = [
        (i, _commanded(p), Value(headline(p), tone="good" if p.met else "bad"))
        for i, p in enumerate(points, 1)
    ]
    table = Table.of("Commands", "goal | inputs | outcome", rows)
    return (
        verdict(headline(result), "doubtful" if far else "good", far),
        Section("goals", "Goals and commands", (), (table,)),
    )


def goal_table(goals: Sequence[GoalFit]) -> Table:
    """Tabulate goals, and what is reached."""
    rows: list[Any] = []
    for fit in goals:
        both = [fit.effector.measured, fit.reached]
        worst = float(np.max(np.abs(fit.in_std), initial=0.0))
        pair = (_coordinates(fit, values, both) for values in both)
        rows.append((effector_name(fit.effector), *pair, off_words(fit), worst))
    heads = "effector | goal | reached | off by | standard deviations [step]"
    return Table.of("Goals", heads, rows)


def _coordinates(fit: GoalFit, values: Any, beside: Any) -> str:
    """Write the coordinates that have a goal, in the unit of all that stands beside.

    Axes are named if some have none.
    """
    seen = np.asarray(fit.effector.seen)
    if np.isnan(values[seen]).any():
        return "unknown"
    axes = "" if seen.all() else f"{', '.join(compress('xyz', seen))} = "
    known = np.concatenate(beside)
    text = readable_values(values[seen].tolist(), fit.effector.unit, beside=known)
    return f"{axes}{text.rstrip()}"


def _comparison(comparison: ModelComparison) -> tuple[Section, ...]:
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
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
    table = Table.of("Models", heads, rows)
    errors_of = {m.name: {f.held_out: f.rms for f in m.good} for m in models}
    poses = [*dict.fromkeys(fold.held_out for m in models for fold in m.folds)]
    folds = (
        Column(name, [of.get(pose, "failed") for pose in poses], "m")
        for name, of in errors_of.items()
    )
    title = "Held-out error of each configuration"
    alone = Table(title, (Column("configuration", poses), *folds))
    return (
        verdict(headline(comparison), tone),
        Section("failures", "What failed", tuple(_failures(comparison))),
        Section("models", "Models", (), (table,)),
        Section("folds", "Held-out configurations", (), (alone,), folded=True),
    )


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

    def as_dict(self) -> dict[str, Any]:
        """Return all of it for JSON, in SI; None where a number is not known."""
        d = self.difference
        judged = {key: getattr(d, key) for key in ("probability", "agree")}
        return {**plain(self), **judged, "verdict": self._words()}

    def _words(self) -> str:
        return headline(self.difference)


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


def _transfer(result: Transfer) -> tuple[Section, ...]:
    d, lost = result.difference, f"was found for {listed(result.lost)}."
    lost = (f"With the values of A, no equilibrium {lost}",) * bool(result.lost)
    each = zip(
        d.names, d.units, d.of_a, d.std_a, d.of_b, d.std_b, d.unseen, strict=True
    )
    rows = [
        (name, Value(a, u, std_a), Value(b, u, std_b), Value(unseen, u, digits=2))
        for name, u, a, std_a, b, std_b, unseen in each
    ]
    heads = "parameter | from A | from B | smallest detectable difference"
    values = Table.of("Values", heads, rows)
    heads = "pose of B | motion [m] | error, fitted to B [m] | error, values of A [m]"
    errors = result.motion, result.rms_own, result.rms_of_a
    rows = zip(result.poses, *errors, strict=True)
    poses = Table.of("Prediction", heads, rows)
    return (
        verdict(headline(d), "plain", lost),
        Section("values", "Values", (), (values, poses)),
    )


_SECTIONS: dict[type, Callable[..., tuple[Section, ...]]] = {
    CalibrationResult: calibration_sections,
    MultiStartResult: search_sections,
    SimulationResult: simulation_sections,
    DesignResult: _design,
    InverseResult: _inverse,
    TrajectoryResult: _inverse,
    Assessment: assessment_sections,
    Identifiability: outlook_sections,
    Ranking: lambda ranking: outlook_sections(None, ranking),
    ModelComparison: _comparison,
    Transfer: _transfer,
    SweepResult: sweep_sections,
}
