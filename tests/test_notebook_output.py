"""What notebooks show of a result: what its page says, and nothing from elsewhere."""

import functools

import pytest
from export.handmade import make_ranking, make_result, make_simulation_result
from test_page import Read
from wording import says

from softcal_jax.identifiability import assess
from softcal_jax.results import _write, notebook_html, write_results


@functools.cache
def outputs():
    result = make_result()
    verdict = assess(result)
    simulation = make_simulation_result(result.model)
    shown = (result, verdict, verdict.identifiability, make_ranking(), simulation)
    return {type(record).__name__: record for record in shown}


@pytest.mark.parametrize(
    "kind",
    [
        "CalibrationResult",
        "Assessment",
        "Identifiability",
        "Ranking",
        "SimulationResult",
    ],
)
def test_well_formed_and_small(kind):
    text = outputs()[kind]._repr_html_()
    page = Read(text)
    assert page.tables
    assert len(text) < 100_000
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")


@pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")
def test_the_verdict_and_the_numbers_are_those_of_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")
    result = make_result()
    folder = write_results(result, tmp_path / "out", name="beam")
    whole = Read((folder / "report.html").read_text("utf-8"))
    shown = Read(notebook_html(result))
    assert says(shown.text, "with care")
    for title, rows in shown.tables.items():
        assert whole.tables[title] == rows
    assert shown.of("img")


def test_print_is_text_in_a_notebook_too(monkeypatch):
    """There, rich shows what it prints by itself, and writes nothing to its file."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    text = str(outputs()["Ranking"])
    assert says(text, "'turned' tells most", "turned")


def test_other_objects_have_none():
    with pytest.raises(TypeError, match="dict is no result"):
        notebook_html({})
