"""What a calibration says, and what its data tell: values, verdict, what to do next."""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from softcal_jax import plotting
from softcal_jax._units import number, readable
from softcal_jax.calibration import (
    FLAT,
    NOT_TAKEN,
    CalibrationResult,
    MultiStartResult,
    ParameterEstimate,
)
from softcal_jax.identifiability import (
    LOST,
    Assessment,
    Identifiability,
    Ranking,
    assess,
)
from softcal_jax.inference import BLIND_FROM, ErrorBudget
from softcal_jax.results._poses import (
    chart_of,
    error_charts,
    error_tables,
    held_out_sentences,
    listed_fits,
    model_words,
    robot_tables,
)
from softcal_jax.results._tree import (
    Chart,
    Column,
    Section,
    Table,
    Tone,
    Value,
    verdict,
)

_SCOPE = (
    "The values hold for these loads and this shape. To test whether they are material "
    "properties, calibrate a second robot (softcal transfer)."
)
"""For what calibrated values hold."""
MOST_VALUES = 8  # parameters whose values stand in the first screen
MOST_OPTIMA = 5  # optima that are listed
MOST_PARAMETERS = 7  # parameters whose course is drawn
MOST_BARS = 24  # rows of a chart
MOST_DIRECTIONS = 8  # blind directions that are listed; the others are only counted
MOST_CORRELATED = 12  # parameters whose correlations are shown as a matrix
MOST_PAIRS = 20  # pairs of parameters listed where a matrix would be too large
_OUTCOMES: dict[str, str] = {
    "trust": "Trust these values: the fit converged, and every check passed.",
    "take with care": "Take these values with care:",
    "do not use": "Do not use these values:",
}
"""What may be done with the values; it ends with a colon where reasons follow."""

TONES: dict[str, Tone] = {
    "trust": "good",
    "take with care": "doubtful",
    "do not use": "bad",
    "identifiable": "good",
    "weakly identifiable": "doubtful",
    "not identifiable": "bad",
}
"""Tone of each outcome, and of each verdict on what the data tell of a parameter."""


def calibration_sections(
    result: CalibrationResult, assessment: Assessment | None = None
) -> Iterator[Section]:
    """Write what a calibration answers, and what that rests on."""
    assessment = assessment or assess(result)
    fits, outlook = result.configurations, assessment.identifiability
    yield from answer(result, assessment)
    tables = (
        parameter_table(result, outlook),
        interval_table(result),
        budget_table(result.budget),
        optima_table(result.starts),
    )
    yield Section("parameters", "Parameters", (), tables, budget_chart(result))
    predicted = tuple(filter(None, [assessment.prediction]))
    errors = error_tables(fits, result.checks)
    yield Section("errors", "Residuals", predicted, errors, error_charts(fits))
    yield Section("robot", "Robot", (), robot_tables(listed_fits(fits)))
    tone, known = outlook_tone(outlook.verdict, assessment), outlook_table(assessment)
    told = _blindness(outlook), (known,)
    yield Section("data", "What the data determine", *told, tone=tone)
    agreement = result.checks.agreement if result.checks else ()
    yield Section("agreement", "Each recording fitted alone", agreement)
    yield Section("notes", "Notes", result.notes, tone="doubtful")
    course = (history_table(result),), course_charts(result)
    yield Section("fit", "Course of the fit", (), *course, folded=True)
    subject = (_subject(result, outlook),)
    yield Section("subject", "What was calibrated", (), subject, folded=True)
    yield _inner(outlook)


def answer(result: CalibrationResult, assessment: Assessment) -> Iterator[Section]:
    """Say what a calibration answers, in the order in which it is read."""
    every = result.parameters
    shown, more = every[:MOST_VALUES], len(every) - MOST_VALUES
    rows = []
    for p in shown:
        level, interval = "", p.interval
        if interval is not None and interval.kind != "none":
            level = f"{100.0 * interval.level:g} % interval {interval}"
        rows.append((p.name, value_cell(p), level))
    note = f"and {more} more." if more > 0 else ""
    values = Table.of("", "parameter | value | interval", rows, note=note)
    mistakes = tuple(f"Possible mistake: {text}" for text in result.mistakes)
    yield Section("answer", "", mistakes, (values,))
    yield verdict_of(assessment)
    none = "Held-out error: unknown, because every pose was used in the fit."
    held_out = held_out_sentences(result.configurations) or [none]
    scope = " ".join(filter(None, [assessment.held_fixed, _SCOPE]))
    follows = *held_out, f"Next: {_next_step(result, assessment)}", scope
    yield Section("next", "", follows)


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
        "model": model_words(result.model),
        "parameters": ", ".join(q.name for q in result.parameters),
        "fitted configurations": ", ".join(of_role("calibration")),
        "held-out configurations": ", ".join(of_role("validation")) or "none",
        "measured coordinates": str(outlook.n_data),
        "noise": noise,
        "solver": result.model.solver.name,
    }
    return Table.of("Calibration", " | ", rows.items())


def value_cell(parameter: ParameterEstimate, tone: Tone = "plain") -> Value:
    """Show a value, its error where it may be shown, and what is on a bound."""
    p = parameter
    note = f"(with {', '.join(p.given)} on a bound)" if p.given else ""
    note = "(on a bound)" if p.at_bound else note
    error = p.standard_error if p.is_symmetric else math.nan
    return Value(p.value, p.unit, error, note, tone)


def verdict_of(assessment: Assessment) -> Section:
    """Say in one sentence whether the values of a calibration can be used."""
    outcome = assessment.outcome
    return verdict(_OUTCOMES[outcome], TONES[outcome], assessment.reasons)


def _next_step(result: CalibrationResult, assessment: Assessment) -> str:
    """Say what helps most: against what contradicts, is not seen, or errs most."""
    if not result.converged:
        return "raise max_steps under [settings], or start from other values."
    if result.mistakes:
        return "check whether this mistake was made, correct it, and calibrate again."
    outlook = assessment.identifiability
    worst = int(np.argmax([p.ratio for p in outlook.parameters]))
    step = result.budget.advice(result.budget.names[worst])
    if result.parameters[worst].at_bound:
        step = f"widen the bounds of {outlook.parameters[worst].name}."
    if outlook.advice and not np.isfinite(outlook.parameters[worst].ratio):
        step = outlook.advice[0][0].lower() + outlook.advice[0][1:]
    if assessment.contradicted:
        return f"check the points that the verdict lists; then {step}"
    return step


def end_of(result: CalibrationResult) -> str:
    """Say which criterion ended the fit, see `CalibrationSettings`."""
    if result.interrupted:
        return "The user interrupted the fit."
    if len(result.history) < 2:
        return "The fit ended before its first step."
    settings, last = result.settings, result.history[-1]
    size = max(abs(step) for step in last.lambda_p)
    if not result.converged and last.step >= settings.max_steps:
        why = f"at max_steps = {settings.max_steps}"
    elif not result.converged:
        why = "because every step was refused, although the cost still decreases"
    elif not last.accepted:
        why = "because steps were refused and the cost is flat: its slope vanishes to "
        why += f"within {FLAT:g}"
    elif size <= settings.tol:
        why = f"because |lambda_p| = {size:.1e} is below {settings.tol:g}"
    else:
        why = (
            f"because one more step, |lambda_p| = {size:.1e}, would reduce the cost by "
            f"less than {NOT_TAKEN**2:g} of its value"
        )
    return f"The fit ended {why}."


def parameter_table(result: CalibrationResult, outlook: Identifiability) -> Table:
    """Tabulate values, standard errors, starts and bounds."""
    blind = {p.name for p in outlook.parameters if p.verdict == "not identifiable"}
    rows = []
    for q in result.parameters:
        sound = result.converged and not (q.at_bound or q.name in blind)
        ends = (readable(end, q.unit) for end in (q.lower, q.upper))
        value = value_cell(q, "strong" if sound else "bad")
        rows.append((q.name, value, Value(q.start, q.unit), " to ".join(ends)))
    title = "Parameters" + ", ± not checked" * (not result.intervals)
    heads = "parameter | value ± standard error | start | bounds"
    return Table.of(title, heads, rows)


def budget_table(budget: ErrorBudget) -> Table:
    """Tabulate in words what the standard errors come from."""
    rows = [(name, budget.sentence(name)) for name in budget.names]
    heads = "parameter | relative standard error"
    return Table.of("Standard errors by cause", heads, rows)


def interval_table(result: CalibrationResult) -> Table:
    """Tabulate the intervals of the parameters, and how each was found."""
    every = result.intervals
    level = f"{100.0 * every[0].level:g} % interval" if every else "interval"
    rows = [
        (i.name, Value(str(i), tone="bad" if i.kind == "none" else "plain"), i.kind)
        for i in every
    ]
    return Table.of("Intervals", f"parameter | {level} | kind", rows)


def search_sections(result: MultiStartResult) -> Iterator[Section]:
    """Write how the runs of a search ended, and the distinct optima."""
    optima = optima_table(result)
    yield verdict(optima.note, "plain")
    yield Section("optima", "Optima", (), (optima._replace(note=""),))


def optima_table(starts: MultiStartResult | None) -> Table:
    """Tabulate the distinct optima of a search from many starts, the best first."""
    optima = () if starts is None else starts.optima[:MOST_OPTIMA]
    rows = [(one.cost, len(one.starts), one.words) for one in optima]
    heads = "cost [ratio] | starts that end there | values"
    return Table.of("Optima", heads, rows, note=_search_words(starts))


def _search_words(starts: MultiStartResult | None) -> str:
    """Say how the runs of a search ended."""
    if starts is None:
        return ""
    n, lost = len(starts.cost), np.isinf(starts.cost)
    unfinished = ~starts.converged & ~lost
    text = f"{n} starts, {starts.converged.sum()} converged, {len(starts.optima)} "
    text += "distinct optima."
    if starts.missed < 1.0:
        share = f"{100.0 * starts.missed:.0f} %"
        text += f" Of further starts, {share} are expected to end at others."
    if unfinished.any():
        lowest = starts.cost[unfinished].min()
        text += f" {unfinished.sum()} not converged, lowest cost {lowest:.3g}."
    if lost.any():
        text += f" {lost.sum()} without equilibrium at the start."
    return text


def history_table(result: CalibrationResult) -> Table:
    """Tabulate the steps of the fit."""
    taken, refused = Value("taken"), Value("refused", tone="doubtful")
    rows = []
    for s in result.history:
        size = max(map(abs, s.lambda_p)) if s.step else None
        rows.append((s.step, s.cost, s.rms, size, taken if s.accepted else refused))
    heads = "step | cost | rms marker distance [m] | largest lambda_p [step] | outcome"
    return Table.of("Steps of the fit", heads, rows)


def budget_chart(result: CalibrationResult) -> tuple[Chart, ...]:
    """Draw the share of each cause in the variance of each parameter."""
    total = np.sum([std**2 for std in result.budget.by_cause().values()], axis=0)
    rows = min(int(np.sum(np.isfinite(total) & (total > 0.0))), MOST_BARS)
    caption = "The source with the longest bar is the first to measure better."
    draw = partial(plotting.draw_budget, result=result, most=MOST_BARS)
    title = "Sources of the standard errors"
    return (chart_of(title, draw, caption, rows),) if rows else ()


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
        chart_of(name, partial(course, name=name), words)
        for name, words in charts.items()
    )


def assessment_sections(assessment: Assessment) -> Iterator[Section]:
    """Write whether values can be used, and what the data tell of each."""
    yield verdict_of(assessment)
    outlook, *known = outlook_sections(assessment.identifiability)
    provided = ("If the model is right:",) * assessment.contradicted
    yield Section("outlook", "What the data determine", (*provided, *outlook.text))
    yield from known
    said = assessment.held_fixed, assessment.prediction
    yield Section("prediction", "Prediction", tuple(filter(None, said)))


def outlook_sections(
    outlook: Identifiability | None, ranking: Ranking | None = None
) -> Iterator[Section]:
    """Write what data tell, or would tell, and which candidates tell more."""
    advice = ()
    if outlook is not None:
        advice, n_data, n_p = outlook.advice, outlook.n_data, outlook.n_parameters
        said = f"{outlook.verdict.capitalize()} at these values: {n_data} measured "
        said += f"coordinate{'s' * (n_data != 1)} for {n_p} parameter{'s' * (n_p != 1)}"
        yield verdict(f"{said}.", TONES[outlook.verdict])
        tables = [_outlook_table(outlook)]
        if outlook.budget is not None and outlook.n_data:
            tables.append(budget_table(outlook.budget))
        yield Section("parameters", "Parameters", (), tuple(tables))
        blindness = _blindness(outlook)
        yield Section("directions", "Combinations of the parameters", blindness)
    if ranking is not None:
        said = _best_candidate(ranking)
        if outlook is None:
            yield verdict(said, "plain")
        rows = [(gain.name, gain.effect) for gain in ranking.gains]
        tables = (Table.of("Candidates", "candidate | what falls most", rows),)
        said = (said,) if outlook else ()
        yield Section("candidates", "What candidates would add", said, tables)
        left = ranking.unranked.items()
        advice = [f"Not ranked: {name!r}: {reason}." for name, reason in left]
        advice.append(ranking.reached)
    yield Section("next", "What to measure next", advice)
    if outlook is not None:
        yield _inner(outlook)


def _best_candidate(ranking: Ranking) -> str:
    """Say which candidate tells most, if one tells anything."""
    if not ranking.gains:
        return "No candidate can be ranked."
    if not ranking.helps:
        return "No candidate lowers the errors: know what is held fixed better."
    best = ranking.gains[0]
    return f"Candidate {best.name!r} tells most: {best.effect}."


def _outlook_table(outlook: Identifiability) -> Table:
    """Tabulate what is known of each parameter."""
    rows = []
    for p in outlook.parameters:
        far = p.relative is not None and p.relative > BLIND_FROM
        sizes = [p.data_only] if outlook.has_prior else []
        error, *sizes = (
            Value("blind" if np.isinf(size) else size, p.unit)
            for size in (np.inf if far else p.standard_error, *sizes, p.asked)
        )
        if p.relative is not None and not far:
            error = error._replace(note=f"({number(100.0 * p.relative, 2)} %)")
        value = Value(p.value, p.unit, digits=4)
        rows.append((p.name, value, error, *sizes, p.verdict))
    heads = "parameter | value | standard error | "
    heads += "from the data alone | " * outlook.has_prior + "target | verdict"
    note = outlook_legend(outlook)
    return Table.of("Predicted standard errors", heads, rows, note=note, digits=3)


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
    for direction in blind[:MOST_DIRECTIONS]:
        seen = direction.ratio <= LOST
        size = readable(direction.ratio, "percent") if seen else "blind"
        lines.append(f"{direction.words} ({size})")
    if len(blind) > MOST_DIRECTIONS:
        lines.append(f"and {len(blind) - MOST_DIRECTIONS} more.")
    return tuple(lines)


def outlook_table(assessment: Assessment) -> Table:
    """Tabulate what the data tell about each parameter."""
    outlook = assessment.identifiability
    rows = []
    for p in outlook.parameters:
        seen = Value(
            assessment.seen(p.verdict), tone=outlook_tone(p.verdict, assessment)
        )
        rows.append((p.name, p.ratio if p.ratio <= LOST else "blind", seen))
    heads = "parameter | standard error / target [percent] | verdict"
    note = outlook_legend(outlook)
    return Table.of("What the data determine", heads, rows, note=note)


def outlook_tone(verdict: str, assessment: Assessment) -> Tone:
    """Return the tone of a verdict, at best doubtful if the assessment has doubts."""
    doubtful = verdict == "identifiable" and not assessment.identified
    return "doubtful" if doubtful else TONES[verdict]


def outlook_legend(outlook: Identifiability) -> str:
    """Say what the verdicts mean, and give the condition numbers."""
    words = [outlook.scale]
    if outlook.has_prior:
        n = outlook.n_parameters
        shares = f"{outlook.informed} of {n} direction{'s' * (n != 1)}"
        words.append(f"The data constrain {shares} more tightly than the prior.")
    if outlook.n_data:
        words.append(str(outlook.conditioning))
    return " ".join(words)


def _inner(outlook: Identifiability) -> Section:
    """Show the correlation of the parameters and the singular values of W_ep."""
    singular = outlook.conditioning.singular_values if outlook.n_data else ()
    title = "Singular values of W_ep in units of the noise"
    rows = enumerate(singular, 1)
    values = Table.of(title, "number | singular value [ratio]", rows)
    names, C = [p.name for p in outlook.parameters], outlook.correlation
    columns = [Column(name, C[:, k], "correlation") for k, name in enumerate(names)]
    table = Table("Correlation", (Column("parameter", names), *columns))
    if len(names) > MOST_CORRELATED:
        i, j = np.triu_indices(len(names), 1)
        strength = np.nan_to_num(np.abs(C[i, j]), nan=-1.0)
        first = np.argsort(-strength, kind="stable")[:MOST_PAIRS]
        pairs = zip(i[first], j[first], strict=True)
        rows = [(names[a], names[b], C[a, b]) for a, b in pairs]
        heads = "parameter | with | correlation [correlation]"
        table = Table.of(f"The {MOST_PAIRS} strongest correlations", heads, rows)
    tables, title = (table, values), "Correlation and singular values"
    return Section("inner", title, tables=tables[len(names) < 2 :], folded=True)
