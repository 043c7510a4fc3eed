"""What a notebook shows of a result: the parts of its page that stand first."""

from functools import singledispatch

from softcal_jax.calibration import CalibrationResult, SimulationResult
from softcal_jax.control import InverseResult, TrajectoryResult
from softcal_jax.identifiability import (
    Assessment,
    Identifiability,
    Ranking,
    RunVerdict,
    Tone,
    assess,
    verdict_of,
)
from softcal_jax.layouts import ModelComparison
from softcal_jax.report._calibration import (
    TONES,
    error_tables,
    held_out_sentences,
    parameter_table,
)
from softcal_jax.report._charts import budget_chart, error_chart
from softcal_jax.report._html import Html, bullets, output, sentences, table_html
from softcal_jax.report._inverse import inverse_html, inverse_verdict
from softcal_jax.report._pages import next_html, outlook_sections
from softcal_jax.report._tables import simulation_tables


@singledispatch
def notebook_html(result: object) -> Html:
    """Write a result as the output of a cell: verdict, tables and a picture.

    It is HTML that needs nothing else; `write_results` writes the whole page.

    Raises:
        TypeError: If there is no output for such a result.
    """
    raise TypeError(f"a {type(result).__name__} has no output for notebooks.")


@notebook_html.register
def _calibration(result: CalibrationResult) -> Html:
    found, fits = assess(result), result.configurations
    content = [
        table_html(parameter_table(result, found.identifiability)),
        *error_chart(fits),
        *map(table_html, error_tables(fits, result.checks)),
        *sentences(held_out_sentences(fits)),
        *budget_chart(result),
        bullets(result.notes),
    ]
    return output(verdict_of(result, found), content)


@notebook_html.register
def _assessment(found: Assessment) -> Html:
    tone: Tone = "good" if found.identified else "doubtful"
    own = found.identifiability
    content = [*sentences([own.headline]), *_outlook(own)]
    content += sentences([found.prediction or ""])
    return output(RunVerdict(found.headline, tone, found.reasons), content)


@notebook_html.register
def _identifiability(found: Identifiability) -> Html:
    return output(RunVerdict(found.headline, TONES[found.verdict]), _outlook(found))


def _outlook(found: Identifiability) -> list[Html]:
    """Show what is known of the parameters, what is not, and what to do."""
    parameters, directions, *_ = outlook_sections(found)
    return [*parameters.content, *directions.content, *next_html(found, None)]


@notebook_html.register
def _ranking(ranking: Ranking) -> Html:
    _, *content = next_html(None, ranking)  # the first says what the verdict says
    return output(RunVerdict(ranking.headline, "plain"), content)


@notebook_html.register
def _simulation(result: SimulationResult) -> Html:
    verdict = RunVerdict(result.headline, "good" if result.converged else "bad")
    return output(verdict, map(table_html, simulation_tables(result)))


@notebook_html.register
def _comparison(comparison: ModelComparison) -> Html:
    tone: Tone = "bad" if comparison.best is None else "plain"
    models = table_html(comparison.tabulated)
    return output(RunVerdict(comparison.verdict, tone), [models])


@notebook_html.register(InverseResult)
@notebook_html.register(TrajectoryResult)
def _inverse(result: InverseResult | TrajectoryResult) -> Html:
    return output(inverse_verdict(result), inverse_html(result))
