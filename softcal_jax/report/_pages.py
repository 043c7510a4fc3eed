"""The page of each kind of run, and the parts of it that notebooks show."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from softcal_jax._text_table import TextTable, Tone, text_table
from softcal_jax.calibration import CalibrationResult, SimulationResult
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.designs import DesignResult
from softcal_jax.identifiability import Assessment, Identifiability, Ranking, assess
from softcal_jax.layouts import ModelComparison
from softcal_jax.plotting import PICTURES
from softcal_jax.report import _tables
from softcal_jax.report._charts import budget_chart, error_charts
from softcal_jax.report._goals import (
    design_tables,
    design_verdict,
    inverse_parts,
    inverse_verdict,
)
from softcal_jax.report._html import (
    MOST_PICTURES,
    Html,
    Part,
    Section,
    answer_html,
    bullets,
    closing,
    facts,
    figure,
    node,
    output,
    page,
    picture,
)
from softcal_jax.report._outline import ROLES
from softcal_jax.report._verdict import (
    TONES,
    RunVerdict,
    answer_of,
    held_out_sentences,
    listed_fits,
    verdict_of,
)
from softcal_jax.report._view import PageView

REPORT = "report.html"  # name of the page in a results folder
_MARKED = "A triangle marks values that should not be used as they are."


def calibration_page(
    result: CalibrationResult,
    assessment: Assessment,
    charts: Sequence[list[Html]],
    data: Mapping[str, Any],
    folder: Path,
    view: PageView | None = None,
) -> str:
    """Write the page of a calibration from its index, its charts and a folder."""
    fits, outlook = result.configurations, assessment.identifiability
    agreement = result.checks.agreement if result.checks else ()
    known = _tables.outlook_table(assessment), _tables.outlook_legend(outlook)
    errors, budget, course = charts
    course = [*course, _tables.history_table(result)]
    sections = [
        Section("errors", "Residuals", [*_errors(result, assessment), *errors]),
        Section("parameters", "Parameters", _parameters(result, assessment) + budget),
        Section("data", "What the data determine", [*_blindness(outlook), *known]),
        Section("agreement", "Each recording fitted alone", [bullets(agreement)]),
        Section("notes", "Notes", [bullets(data["notes"])]),
        *pictures_of(data, folder, view),
        Section("robot", "Robot", _tables.robot_tables(listed_fits(fits))),
        Section("fit", "Course of the fit", course, folded=True),
        Section("subject", "What was calibrated", [_subject(result, assessment)], True),
        _inner(outlook),
        *closing("calibrate", data, [data["source"]]),
    ]
    answer = answer_of(result, assessment)
    about = {"index": "result.json", "first": answer_html(answer), **page_view(view)}
    return page(data["name"], "Calibration", answer.verdict, sections, **about)


def page_view(view: PageView | None) -> dict[str, Any]:
    """Return the view of the robot and its script, as arguments of `page`."""
    return {} if view is None else {"robot": view.content, "script": view.script}


def simulation_page(
    result: SimulationResult,
    data: Mapping[str, Any],
    folder: Path,
    view: PageView | None = None,
) -> str:
    """Write the page of a simulation; arguments as of `calibration_page`."""
    poses, values = result.configurations, data["calibration"]
    options = [] if values is None else ["--values", values["file"]]
    sections = [
        Section("notes", "Notes", [bullets(data["notes"])]),
        Section("errors", "Errors", held_out_sentences(poses)),
        Section("states", "States", _tables.simulation_tables(result)),
        *pictures_of(data, folder, view),
        Section("model", "Model", [f"{_tables.model_words(result.model)}."]),
        *closing("simulate", data, [data["source"]], options=options),
    ]
    about = {"index": "simulation.json", **page_view(view)}
    verdict = _simulation_verdict(result)
    return page(data["name"], "Simulation", verdict, sections, **about)


def design_page(
    result: DesignResult, data: Mapping[str, Any], folder: Path, view: PageView | None
) -> str:
    """Write the page of a design."""
    ordered, *goals, worth = design_tables(result)
    sections = [
        Section("notes", "Notes", [bullets(data["notes"])]),
        Section("goals", "Goals", goals),
        Section("ordered", "As ordered", [ordered]),
        Section("worth", "What it is worth", [worth]),
        *pictures_of(data, folder, view),
        *closing("design", data, [data["source"]]),
    ]
    about = {"index": "design.json", "units": "SI", **page_view(view)}
    return page(data["name"], "Design", design_verdict(result), sections, **about)


def _simulation_verdict(result: SimulationResult) -> RunVerdict:
    tone = "doubtful" if result.doubts else "good"
    return RunVerdict(
        result.headline, tone if result.converged else "bad", result.doubts
    )


def _subject(result: CalibrationResult, assessment: Assessment) -> TextTable:
    """Tabulate what was calibrated, and from what."""
    of_role = lambda role: [f.name for f in result.configurations if f.role == role]
    spread = result.uncertainty
    noise = "as stated"
    if spread.noise == "estimated":
        noise = "estimated from the residuals"
        if spread.has_noise:
            noise += f": {spread.noise_scale:.3g} times the stated standard deviations"
    rows = {
        "model": _tables.model_words(result.model),
        "parameters": ", ".join(q.name for q in result.parameters),
        "fitted configurations": ", ".join(of_role("calibration")),
        "held-out configurations": ", ".join(of_role("validation")) or "none",
        "measured coordinates": str(assessment.identifiability.n_data),
        "noise": noise,
        "solver": result.model.solver.name,
    }
    return facts("Calibration", rows)


def _errors(result: CalibrationResult, assessment: Assessment) -> list[Part]:
    """Show how far the model is off, before and after."""
    fits = result.configurations
    tables = _tables.error_tables(fits, result.checks)
    return [*held_out_sentences(fits), assessment.prediction or "", *tables]


def _parameters(result: CalibrationResult, assessment: Assessment) -> list[Part]:
    values = _tables.parameter_table(result, assessment.identifiability)
    marked = any(cell.tone == "bad" for row in values.rows for cell in row)
    tables = [values, *_tables.interval_tables(result), _tables.budget_table(result)]
    starts = [] if result.starts is None else [node("pre", str(result.starts))]
    return [_MARKED if marked else "", *tables, *starts]


def _blindness(outlook: Identifiability) -> list[Part]:
    first, *directions = _tables.blindness(outlook)
    return [first, bullets(directions)]


def _inner(outlook: Identifiability) -> Section:
    """Show the correlation of the parameters and the singular values of W_ep."""
    several = outlook.n_parameters > 1
    tables = [_tables.correlation_table(outlook)] if several else []
    if outlook.n_data:
        values = enumerate(outlook.conditioning.singular_values, 1)
        rows = [(str(k), f"{value:.3g}") for k, value in values]
        title = "Singular values of W_ep in units of the noise"
        tables.append(text_table(title, ("number", "singular value"), rows))
    return Section("inner", "Correlation and singular values", tables, folded=True)


def inverse_page(
    result: InverseResult | TrajectoryResult,
    options: Sequence[str],
    data: Mapping[str, Any],
    folder: Path,
    view: PageView | None,
) -> str:
    """Write the page of inverse control; `options` are words of its command."""
    search = []
    if isinstance(result, InverseResult) and result.attempts:
        rows = [(a.way, str(a.n_steps), f"{a.error:.3g}") for a in result.attempts]
        columns = "started from", "steps", "largest error, in standard deviations"
        search = [text_table("Descents", columns, rows)]
    loaded = [data["calibration"]] if data["calibration"] is not None else []
    sections = [
        Section("notes", "Notes", [bullets(data["notes"])]),
        Section("goals", "Goals and commands", inverse_parts(result)),
        *pictures_of(data, folder, view),
        Section("search", "Course of the search", search, folded=True),
        *closing("inverse", data, [data["source"]], files=loaded, options=options),
    ]
    about = {"index": "inverse.json", "units": "SI", **page_view(view)}
    verdict = inverse_verdict(result)
    return page(data["name"], "Inverse control", verdict, sections, **about)


def pictures_of(
    data: Mapping[str, Any], folder: Path, view: PageView | None
) -> list[Section]:
    """Show pictures of the configurations, as many as a page should hold.

    The view hides the pictures of what it shows, except in print or without scripts.
    """
    shown, hidden = [], []
    left = MOST_PICTURES - (0 if view is None else 3 * view.size // 4)  # as base64
    for entry in data["configurations"]:
        posed, role = entry["name"], ROLES.get(entry.get("role", ""), "simulated")
        for path in (folder / name for name in entry["files"]):
            if path.suffix not in PICTURES:
                continue
            caption = f"{posed} ({role}): the deformed body, coloured by displacement"
            is_recording = path.stem.endswith("_recording")
            if is_recording:
                caption = f"{posed}: the recording of the markers over time"
            left -= path.stat().st_size
            if left < 0 or path.suffix == ".pdf":  # which no page can show
                link = node("a", path.name, href=path.name)
                text = "this picture is a separate file, "
                drawn = node("p", f"{caption}; {text}", link, ".")
            else:
                drawn = figure(picture(path, caption), f"{caption}.")
            viewed = view is not None and posed in view.names and not is_recording
            shown.append(node("div", drawn, class_="viewed") if viewed else drawn)
            hidden.append(viewed)
    return [Section("pictures", "Pictures", shown, viewed=all(hidden))]


def identifiability_page(
    outlook: Identifiability | None, ranking: Ranking | None, data: Mapping[str, Any]
) -> str:
    """Write the page on what data would tell, from the content of its index."""
    verdict = RunVerdict("There is nothing to assess.", "plain")
    sections = [Section("next", "What to measure next", _next(outlook, ranking))]
    if outlook is not None:
        verdict = RunVerdict(outlook.headline, TONES[outlook.verdict])
        blind = _blindness(outlook)
        sections += [
            Section("parameters", "Parameters", _verdicts(outlook)),
            Section("directions", "What the data do not determine", blind),
            _inner(outlook),
        ]
    elif ranking is not None:
        verdict = RunVerdict(ranking.headline, "plain")
    sections += closing("identify", data, [data["source"]])
    index = "identifiability.json"
    return page(data["name"], "Identifiability", verdict, sections, index=index)


def _next(outlook: Identifiability | None, ranking: Ranking | None) -> list[Part]:
    """Show which candidate to measure, or what else to do."""
    if ranking is None:
        return list(outlook.advice if outlook else ())
    table = [ranking.tabulated] if ranking.gains else []
    unranked = bullets(map(str, ranking.unranked))
    return [ranking.headline, *table, unranked, ranking.reached]


def _verdicts(outlook: Identifiability) -> list[Part]:
    """Show what the data would tell of the parameters."""
    return [outlook.tabulated, _tables.outlook_legend(outlook)]


def comparison_page(comparison: ModelComparison, data: Mapping[str, Any]) -> str:
    """Write the page of a comparison of models, from the content of its index."""
    columns = "configuration", *(model.name for model in comparison.models)
    cells: dict[str, list[str]] = {}
    for model in comparison.models:
        for fold in model.folds:
            text = "failed" if fold.failure else f"{1e3 * fold.rms:.4g} mm"
            cells.setdefault(fold.held_out, [fold.held_out]).append(text)
    title = "Held-out error of each configuration"
    held_out = text_table(title, columns, cells.values())
    sections = [
        Section("failures", "What failed", [bullets(comparison.failures)]),
        Section("models", "Models", [comparison.tabulated]),
        Section("folds", "Held-out configurations", [held_out]),
        *closing("compare", data, data["sources"].values()),
    ]
    verdict, index = _comparison_verdict(comparison), "comparison.json"
    return page(data["name"], "Comparison of models", verdict, sections, index=index)


def _comparison_verdict(comparison: ModelComparison) -> RunVerdict:
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
    return RunVerdict(comparison.verdict, tone)


def notebook_html(result: object) -> Html:
    """Write a result as the output of a cell: verdict, tables and a picture.

    It is HTML that needs no other file; `write_results` writes the whole page.

    Raises:
        TypeError: If there is no output for such a result.
    """
    match result:
        case CalibrationResult():
            assessment = assess(result)
            values = _tables.parameter_table(result, assessment.identifiability)
            charts = [*error_charts(result.configurations), *budget_chart(result)]
            errors = [*_errors(result, assessment), *charts]
            content = [values, *errors, bullets(result.notes)]
            return output(verdict_of(assessment), content)
        case Assessment():
            outlook = result.identifiability
            provided = "If the model is right:" if result.contradicted else ""
            known = [provided, outlook.headline, *_known(outlook)]
            return output(verdict_of(result), [*known, result.prediction or ""])
        case Identifiability():
            verdict = RunVerdict(result.headline, TONES[result.verdict])
            return output(verdict, _known(result))
        case Ranking():
            _, *content = _next(None, result)  # the first repeats the verdict
            return output(RunVerdict(result.headline, "plain"), content)
        case SimulationResult():
            tables = _tables.simulation_tables(result)
            return output(_simulation_verdict(result), tables)
        case DesignResult():
            return output(design_verdict(result), design_tables(result))
        case ModelComparison():
            return output(_comparison_verdict(result), [result.tabulated])
        case InverseResult() | TrajectoryResult():
            return output(inverse_verdict(result), inverse_parts(result))
    raise TypeError(f"a {type(result).__name__} has no output for notebooks.")


def _known(outlook: Identifiability) -> list[Part]:
    """Show what is known of the parameters, what is not, and what to do."""
    return [*_verdicts(outlook), *_blindness(outlook), *_next(outlook, None)]
