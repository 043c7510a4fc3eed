"""What each kind of result says: the only place with its words."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from softcal_jax import plotting
from softcal_jax._module import Result
from softcal_jax._text import listed
from softcal_jax._tree import Chart, Column, Section, Table, Tone
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import number, readable
from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    MultiStartResult,
    SimulationResult,
)
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.export import headline, plain
from softcal_jax.identifiability import (
    LOST,
    Assessment,
    Identifiability,
    Ranking,
    assess,
)
from softcal_jax.inference import BLIND_FROM, Difference, Estimate, difference
from softcal_jax.layouts import ModelComparison
from softcal_jax.project import Project
from softcal_jax.report import _goals
from softcal_jax.report._goals import design_sections, inverse_sections
from softcal_jax.report._html import output
from softcal_jax.report._sweep import sweep_sections
from softcal_jax.report._verdict import (
    TONES,
    answer,
    end_of,
    held_out_sentences,
    listed_fits,
    verdict,
    verdict_of,
)
from softcal_jax.sweeps import SweepResult


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


MOST_PARAMETERS = 7  # parameters whose course is drawn
MOST_BARS = 24  # rows of a chart
MOST_DIRECTIONS = 8  # blind directions that are listed; the others are only counted


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


def _calibration(
    result: CalibrationResult, assessment: Assessment | None = None
) -> tuple[Section, ...]:
    assessment = assessment or assess(result)
    fits, outlook = result.configurations, assessment.identifiability
    tables = (
        _goals.parameter_table(result, outlook),
        _goals.interval_table(result),
        _goals.budget_table(result.budget),
        _goals.optima_table(result.starts),
    )
    errors = tuple(_goals.error_tables(fits, result.checks))
    predicted = tuple(filter(None, [assessment.prediction]))
    tone = _goals.outlook_tone(outlook.verdict, assessment)
    data, known = _blindness(outlook), (_goals.outlook_table(assessment),)
    agreement = result.checks.agreement if result.checks else ()
    robot = tuple(_goals.robot_tables(listed_fits(fits)))
    course = (_goals.history_table(result),), course_charts(result)
    subject = (_subject(result, outlook),)
    return (
        *answer(result, assessment),
        Section("parameters", "Parameters", (), tables, budget_chart(result)),
        Section("errors", "Residuals", predicted, errors, error_charts(fits)),
        Section("robot", "Robot", (), robot),
        Section("data", "What the data determine", data, known, tone=tone),
        Section("agreement", "Each recording fitted alone", agreement),
        Section("notes", "Notes", result.notes, tone="doubtful"),
        Section("fit", "Course of the fit", (), *course, folded=True),
        Section("subject", "What was calibrated", (), subject, folded=True),
        _inner(outlook),
    )


def _search(result: MultiStartResult) -> tuple[Section, ...]:
    optima = _goals.optima_table(result)._replace(note="")
    return (
        verdict(headline(result), "plain"),
        Section("optima", "Optima", (), (optima,)),
    )


def _subject(result: CalibrationResult, outlook: Identifiability) -> Table:
    """Tabulate what was calibrated, and from what."""
    of_role = lambda role: [f.name for f in result.configurations if f.role == role]
    spread = result.uncertainty
    noise = "as stated"
    if spread.noise == "estimated":
        noise = "estimated from the residuals"
        if spread.has_noise:
            noise += f": {spread.noise_scale:.3g} times the stated standard deviations"
    rows = {
        "model": _goals.model_words(result.model),
        "parameters": ", ".join(q.name for q in result.parameters),
        "fitted configurations": ", ".join(of_role("calibration")),
        "held-out configurations": ", ".join(of_role("validation")) or "none",
        "measured coordinates": str(outlook.n_data),
        "noise": noise,
        "solver": result.model.solver.name,
    }
    return Table.of("Calibration", " | ", rows.items())


def _simulation(result: SimulationResult) -> tuple[Section, ...]:
    tone = "doubtful" if result.doubts else "good"
    poses = result.configurations
    errors = tuple(held_out_sentences(poses))
    tables = _goals.simulation_table(result), *_goals.robot_tables(poses)
    words = (f"{_goals.model_words(result.model)}.",)
    return (
        verdict(headline(result), tone if result.converged else "bad", result.doubts),
        Section("states", "States", (), tables),
        Section("errors", "Errors", errors),
        Section("model", "Model", words, folded=True),
    )


def _assessment(assessment: Assessment) -> tuple[Section, ...]:
    _, *known = _outlook(assessment.identifiability)
    provided = ("If the model is right:",) * assessment.contradicted
    said = assessment.held_fixed, assessment.prediction
    outlook = headline(assessment.identifiability)
    return (
        verdict_of(assessment),
        Section("outlook", "What the data determine", (*provided, outlook)),
        *known,
        Section("prediction", "Prediction", tuple(filter(None, said))),
    )


def _outlook(
    outlook: Identifiability | None, ranking: Ranking | None = None
) -> tuple[Section, ...]:
    """Write what data tell, or would tell, and which candidates tell more."""
    tree = []
    if outlook is not None:
        tables = [_outlook_table(outlook)]
        if outlook.budget is not None and outlook.n_data:
            tables.append(_goals.budget_table(outlook.budget))
        unseen = _blindness(outlook)
        tree = [
            verdict(headline(outlook), TONES[outlook.verdict]),
            Section("parameters", "Parameters", (), tuple(tables)),
            Section("directions", "Combinations of the parameters", unseen),
        ]
    advice = outlook.advice if outlook else ()
    if ranking is not None:
        rows = [(gain.name, gain.effect) for gain in ranking.gains]
        tables = (Table.of("Candidates", "candidate | what falls most", rows),)
        said = (headline(ranking),) if outlook else ()
        tree += [] if outlook else [verdict(headline(ranking), "plain")]
        tree.append(Section("candidates", "What candidates would add", said, tables))
        left = ranking.unranked.items()
        advice = [f"Not ranked: {name!r}: {reason}." for name, reason in left]
        advice.append(ranking.reached)
    tree.append(Section("next", "What to measure next", advice))
    return *tree, *([] if outlook is None else [_inner(outlook)])


def _outlook_table(outlook: Identifiability) -> Table:
    """Tabulate what is known of each parameter."""
    rows, shares = [], []
    for p in outlook.parameters:
        far = p.relative is not None and p.relative > BLIND_FROM
        share = math.nan if p.relative is None or far else 100.0 * p.relative
        alone = [p.data_only] if outlook.has_prior else []
        sizes = np.inf if far else p.standard_error, *alone, p.asked
        known = ("blind" if np.isinf(size) else size for size in sizes)
        rows.append((p.name, p.value, *known, p.verdict))
        shares.append(f"({number(share, 2)} %)" if math.isfinite(share) else "")
    heads = "parameter | value [*] | standard error [*] | "
    heads += "from the data alone [*] | " * outlook.has_prior + "target [*] | verdict"
    units, legend = (
        [p.unit for p in outlook.parameters],
        _goals.outlook_legend(outlook),
    )
    about = {"value": {"digits": 4}, "standard error": {"notes": shares}}
    more = {"note": legend, "units": units, "digits": 3, "about": about}
    return Table.of("Predicted standard errors", heads, rows, **more)


def _blindness(outlook: Identifiability) -> tuple[str, ...]:
    """Say how many directions the data hardly see, then list them, the worst first."""
    blind = outlook.blind[::-1]
    if not blind:
        return ("The data determine every combination of the parameters.",)
    by = "the prior and the start" if outlook.has_prior else "the start"
    lines = [
        f"The data leave {len(blind)} of {outlook.n_parameters} directions of the "
        f"parameters undetermined; along these, the result depends on {by}. "
        "Worst first (standard error / target):"
    ]
    lines += [f"{d.words} ({_percent(d.ratio)})" for d in blind[:MOST_DIRECTIONS]]
    if len(blind) > MOST_DIRECTIONS:
        lines.append(f"and {len(blind) - MOST_DIRECTIONS} more.")
    return tuple(lines)


def _percent(ratio: float) -> str:
    return readable(ratio, "percent") if ratio <= LOST else "blind"


def _inner(outlook: Identifiability) -> Section:
    """Show the correlation of the parameters and the singular values of W_ep."""
    tables = tuple(_goals.inner_tables(outlook))
    title = "Correlation and singular values"
    return Section("inner", title, tables=tables, folded=True)


def _comparison(comparison: ModelComparison) -> tuple[Section, ...]:
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
    models, rows, errors = comparison.models, [], []
    for model, worse in zip(models, (None, *comparison.differences), strict=True):
        n, failed = len(model.folds), len(model.failed)
        failed = f"{failed} of {n}" if failed else "none"
        sizes = model.held_out_rms, model.held_out_noise_rms
        excess = None if worse is None or math.isnan(worse.difference) else worse
        more = excess and excess.difference, model.fit_rms, failed
        rows.append((model.name, model.n_parameters, *sizes, *more))
        width = math.inf if excess is None else excess.half_width
        errors.append(width if math.isfinite(width) else math.nan)
    heads = "model | parameters | held-out error [m] | error / noise [correlation]"
    beyond = "excess over best, in noise^2"
    heads += f" | {beyond} | fit [m] | failed folds"
    table = Table.of("Models", heads, rows, about={beyond: {"errors": errors}})
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


def _failures(result: ModelComparison) -> list[str]:
    """Say which fits failed and why, one sentence each."""
    lines = []
    for model in result.models:
        lines += [
            f"{model.name!r}, {fold.held_out} held out: {fold.failure}."
            for fold in model.failed
        ]
        if model.fit_failure:
            lines.append(
                f"{model.name!r}, all configurations fitted: {model.fit_failure}."
            )
    return lines


def _transfer(result: Transfer) -> tuple[Section, ...]:
    d, lost = result.difference, f"was found for {listed(result.lost)}."
    lost = (f"With the values of A, no equilibrium {lost}",) * bool(result.lost)
    values = (
        Column("parameter", d.names),
        Column("from A", d.of_a, d.units, errors=d.std_a.tolist()),
        Column("from B", d.of_b, d.units, errors=d.std_b.tolist()),
        Column("smallest detectable difference", d.unseen, d.units, digits=2),
    )
    heads = "pose of B | motion [m] | error, fitted to B [m] | error, values of A [m]"
    errors = result.motion, result.rms_own, result.rms_of_a
    rows = zip(result.poses, *errors, strict=True)
    poses = Table.of("Prediction", heads, rows)
    return (
        verdict(headline(d), "plain", lost),
        Section("values", "Values", (), (Table("Values", values), poses)),
    )


def error_charts(fits: Sequence[ConfigurationResult]) -> tuple[Chart, ...]:
    """Draw errors before and after beside the motion; of many poses, where they are."""
    listed = listed_fits(fits)
    rows = sum(math.isfinite(fit.rms_after) for fit in listed)
    if not rows:
        return ()
    caption = "Root mean square distance between simulated and measured markers."
    draw = partial(plotting.draw_errors, fits=listed)
    charts = [_chart("Errors of the markers", draw, caption, rows)]
    if len(listed) < len(fits):
        caption = (
            "Each circle is at the mean position of the points of a configuration."
        )
        draw = partial(plotting.draw_workspace, fits=fits)
        charts.append(_chart("Errors over the workspace", draw, caption))
    return tuple(charts)


def budget_chart(result: CalibrationResult) -> tuple[Chart, ...]:
    """Draw the share of each cause in the variance of each parameter."""
    total = np.sum([std**2 for std in result.budget.by_cause().values()], axis=0)
    rows = min(int(np.sum(np.isfinite(total) & (total > 0.0))), MOST_BARS)
    caption = "The source with the longest bar is the first to measure better."
    draw = partial(plotting.draw_budget, result=result, most=MOST_BARS)
    title = "Sources of the standard errors"
    return (_chart(title, draw, caption, rows),) if rows else ()


def course_charts(result: CalibrationResult) -> tuple[Chart, ...]:
    """Draw the fit, the size of the step and the parameters against the steps."""
    fitted = [fit for fit in result.configurations if fit.role == "calibration"]
    # Lengths, angles or forces alone have no distance.
    charts = {"rms" if any(fit.points for fit in fitted) else "cost": ""}
    if len(result.history) > 1:
        charts["lambda_p"] = end_of(result)
    for q in result.parameters[:MOST_PARAMETERS]:
        bounds = f"{readable(q.lower, q.unit)} to {readable(q.upper, q.unit)}"
        at_bound = ", on a bound" if q.at_bound else ""
        charts[q.name] = f"Ends at {q}{at_bound}; bounds {bounds}."
    course = partial(plotting.draw_course, result=result)
    return tuple(
        _chart(name, partial(course, name=name), words)
        for name, words in charts.items()
    )


def _chart(
    title: str, draw: Callable[..., Any], caption: str, rows: int | None = None
) -> Chart:
    """Make a chart, as high as its rows need where it has any."""
    lines = None if rows is None else 2.0 + 1.6 * rows
    plot = partial(plotting.plot_panels, drawn=[draw], lines=lines)
    return Chart(title, plot, caption)


def notebook_html(result: object) -> str:
    """Write a result as the output of a cell: verdict, tables and charts.

    It is HTML that needs no other file; `write_results` writes the whole page.

    Raises:
        TypeError: If there is no output for such a result.
    """
    return output(sections(result))


_SECTIONS: dict[type, Callable[..., tuple[Section, ...]]] = {
    CalibrationResult: _calibration,
    MultiStartResult: _search,
    SimulationResult: _simulation,
    DesignResult: design_sections,
    InverseResult: inverse_sections,
    TrajectoryResult: inverse_sections,
    Assessment: _assessment,
    Identifiability: _outlook,
    Ranking: lambda ranking: _outlook(None, ranking),
    ModelComparison: _comparison,
    Transfer: _transfer,
    SweepResult: sweep_sections,
}
