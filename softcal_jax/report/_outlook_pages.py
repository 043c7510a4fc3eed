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
from softcal_jax.report._html import Html, Section, bullets, node, page, table_html
from softcal_jax.report._provenance import made_html, repeat_html


def identifiability_page(
    found: Identifiability | None, ranking: Ranking | None, data: Mapping[str, Any]
) -> str:
    """Write the page of what data would tell.

    Args:
        found: What the configurations tell; None if there are none.
        ranking: What candidates would add; None if there are none.
        data: The content of `identifiability.json`, with its files.
    """
    verdict = RunVerdict("There is nothing to judge.", "plain")
    if found is not None:
        verdict = RunVerdict(found.headline, TONES[found.verdict])
    elif ranking is not None:
        verdict = RunVerdict(ranking.headline, "plain")
    sections = [
        Section("next", "What to measure next", next_html(found, ranking)),
        *([] if found is None else outlook_sections(found)),
        Section(
            "repeat", "Repeat it", repeat_html("identify", "outlook", [data["source"]])
        ),
        Section("made", "Settings, versions and times", made_html(data)),
    ]
    index = "identifiability.json"
    return page(data["name"], "Identifiability", verdict, sections, index=index)


def next_html(found: Identifiability | None, ranking: Ranking | None) -> list[Html]:
    """Show which candidate to measure, or what else to do."""
    if ranking is None:
        return [node("p", line) for line in (found.advice if found else ())]
    content = [node("p", ranking.headline)]
    if ranking.gains:
        content += [
            table_html(ranking.tabulated),
            node("p", ranking.legend),
        ]
    if ranking.unranked:
        content.append(bullets(map(str, ranking.unranked)))
    return content


def outlook_sections(found: Identifiability) -> list[Section]:
    """Show what the data would tell of parameters and of their combinations."""
    blind = found.blind[::-1]
    unknown = [
        f"Errors of the {cause} are not among these: their size is not known here."
        for cause in found.unknown
    ]
    words = [f"{d.words} ({percent(d.ratio)})" for d in blind]
    sight = "No combination of the parameters is hidden from the data."
    if blind:
        sight = (
            f"The data hardly see {len(blind)} of {found.n_parameters} directions of "
            "the parameters, the worst first (standard error over the asked one):"
        )
    inner = [singular_value_table(found)] if found.n_data else []
    if found.n_parameters > 1:
        inner.append(correlation_table(found))
    parameters = [
        *outlook_chart(found),
        table_html(found.tabulated),
        node("p", found.scale),
        *(node("p", line) for line in unknown),
    ]
    directions = [node("p", sight), *([bullets(words)] if words else [])]
    if found.n_data:
        directions.append(node("p", str(found.conditioning).splitlines()[0]))
    return [
        Section("parameters", "Parameters", parameters),
        Section("directions", "What the data are blind to", directions),
        Section(
            "inner",
            "Correlation and singular values",
            [table_html(own) for own in inner],
        ),
    ]


def comparison_page(comparison: ModelComparison, data: Mapping[str, Any]) -> str:
    """Write the page of a comparison of models.

    Args:
        comparison: The comparison.
        data: The content of `comparison.json`, with its files.
    """
    # The best of several may still predict badly, so there is no tone of success.
    tone: Tone = "bad"
    if comparison.best is not None:
        tone = "doubtful" if comparison.undecided else "plain"
    columns = "configuration", *(model.name for model in comparison.models)
    names = [fold.held_out for fold in comparison.models[0].folds]
    of_models = [
        {fold.held_out: fold for fold in model.folds} for model in comparison.models
    ]
    rows = []
    for name in names:
        folds = [own[name] for own in of_models]
        cells = ("failed" if f.failure else f"{1e3 * f.rms:.4g} mm" for f in folds)
        rows.append((name, *cells))
    held_out = text_table("Error of each configuration, held out", columns, rows)
    failures = comparison.failures
    sections = [
        Section("failures", "What failed", [bullets(failures)] if failures else []),
        Section("models", "Models", [table_html(comparison.tabulated)]),
        Section("folds", "Held-out configurations", [table_html(held_out)]),
        Section(
            "repeat",
            "Repeat it",
            repeat_html("compare", "comparison", list(data["sources"].values())),
        ),
        Section("made", "Settings, versions and times", made_html(data)),
    ]
    verdict = RunVerdict(comparison.verdict, tone)
    index = "comparison.json"
    return page(data["name"], "Comparison of models", verdict, sections, index=index)
