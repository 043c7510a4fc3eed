"""The pages of what is judged without a calibration: data to come, and models."""

from collections.abc import Mapping
from typing import Any

from softcal_jax._text_table import text_table
from softcal_jax.identifiability import (
    Identifiability,
    Ranking,
    RunVerdict,
    Tone,
    percent,
)
from softcal_jax.layouts import ModelComparison
from softcal_jax.report._calibration import (
    TONES,
    correlation_table,
    singular_value_table,
)
from softcal_jax.report._charts import outlook_chart
from softcal_jax.report._html import (
    Html,
    Section,
    bullets,
    node,
    page,
    sentences,
    table_html,
)
from softcal_jax.report._provenance import closing_of


def identifiability_page(
    found: Identifiability | None, ranking: Ranking | None, data: Mapping[str, Any]
) -> str:
    """Write the page of what data would tell, from the content of its index."""
    verdict = RunVerdict("There is nothing to judge.", "plain")
    if found is not None:
        verdict = RunVerdict(found.headline, TONES[found.verdict])
    elif ranking is not None:
        verdict = RunVerdict(ranking.headline, "plain")
    sections = [
        Section("next", "What to measure next", next_html(found, ranking)),
        *([] if found is None else outlook_sections(found)),
        *closing_of("identify", data, [data["source"]]),
    ]
    index = "identifiability.json"
    return page(data["name"], "Identifiability", verdict, sections, index=index)


def next_html(found: Identifiability | None, ranking: Ranking | None) -> list[Html]:
    """Show which candidate to measure, or what else to do."""
    if ranking is None:
        return sentences(found.advice if found else ())
    content = [node("p", ranking.headline)]
    if ranking.gains:
        content += [table_html(ranking.tabulated), node("p", ranking.legend)]
    return [*content, bullets(map(str, ranking.unranked))]


def outlook_sections(found: Identifiability) -> list[Section]:
    """Show what the data would tell of parameters and of their combinations."""
    blind = found.blind[::-1]
    unknown = [
        f"Errors of the {cause} are not among these: their size is not known here."
        for cause in found.unknown
    ]
    sight = "No combination of the parameters is hidden from the data."
    if blind:
        sight = (
            f"The data hardly see {len(blind)} of {found.n_parameters} directions of "
            "the parameters, the worst first (standard error over the asked one):"
        )
    words = bullets(f"{d.words} ({percent(d.ratio)})" for d in blind)
    inner = [singular_value_table(found)] if found.n_data else []
    if found.n_parameters > 1:
        inner.append(correlation_table(found))
    known = [table_html(found.tabulated), *sentences([found.scale, *unknown])]
    directions = [node("p", sight), words]
    if found.n_data:
        directions.append(node("p", str(found.conditioning).splitlines()[0]))
    return [
        Section("parameters", "Parameters", [*outlook_chart(found), *known]),
        Section("directions", "What the data are blind to", directions),
        Section("inner", "Correlation and singular values", [*map(table_html, inner)]),
    ]


def comparison_page(comparison: ModelComparison, data: Mapping[str, Any]) -> str:
    """Write the page of a comparison of models, from the content of its index."""
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
    columns = "configuration", *(model.name for model in comparison.models)
    cells: dict[str, list[str]] = {}
    for model in comparison.models:
        for fold in model.folds:
            text = "failed" if fold.failure else f"{1e3 * fold.rms:.4g} mm"
            cells.setdefault(fold.held_out, [fold.held_out]).append(text)
    held_out = text_table(
        "Error of each configuration, held out", columns, cells.values()
    )
    sections = [
        Section("failures", "What failed", [bullets(comparison.failures)]),
        Section("models", "Models", [table_html(comparison.tabulated)]),
        Section("folds", "Held-out configurations", [table_html(held_out)]),
        *closing_of("compare", data, data["sources"].values()),
    ]
    verdict = RunVerdict(comparison.verdict, tone)
    index = "comparison.json"
    return page(data["name"], "Comparison of models", verdict, sections, index=index)
