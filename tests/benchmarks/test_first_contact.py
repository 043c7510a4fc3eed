"""The browser of `first_contact` sees what a page does, and what it must not."""

import pytest

from benchmarks import _browser, first_contact
from benchmarks._problem import Options


@pytest.fixture
def page(tmp_path):
    try:
        _browser.browser()
    except _browser.NoBrowser as error:
        pytest.skip(str(error))
    return tmp_path / "page.html"


def test_a_page_that_asks_the_network_and_fails_is_found_out(page):
    page.write_text(
        "<!DOCTYPE html><link rel=icon href=data:,>"
        '<img src="http://127.0.0.1:9/a.png"><img src="data:image/png;base64,AA">'
        "<script>console.error('one'); throw new Error('two')</script>"
    )
    seen = _browser.visit(page)
    assert seen.requests == ("http://127.0.0.1:9/a.png",)
    errors = "\n".join(seen.errors)
    assert "one" in errors
    assert "Uncaught" in errors


def test_a_page_of_its_own_is_clean(page):
    page.write_text(
        "<!DOCTYPE html><title>a</title><p>b<script>console.log(1)</script>"
    )
    figures = first_contact.report_figures(page)
    assert figures.pop("report_mb") == page.stat().st_size / 1e6
    assert figures == {"report_requests": 0, "report_console_errors": 0}


def test_an_open_page_answers(page):
    viewport = "<meta name=viewport content=width=device-width>"
    page.write_text(f"<!DOCTYPE html>{viewport}<title>a</title><p>b")
    with _browser.opened(page) as tab:
        assert tab.ask("Promise.resolve([document.title, 1])") == ["a", 1]
        for width in (360, 1200):
            tab.resize(width)
            assert tab.ask("innerWidth") == width
        with pytest.raises(RuntimeError, match="could not answer: ReferenceError"):
            tab.ask("nowhere")


def test_parts_are_measured_alone(tmp_path):
    outcome = first_contact.run(Options(tmp_path, print, {"readme": 1}))
    assert list(outcome.figures) == ["readme_lines"]
    assert list(outcome.goals) == ["readme_lines"]
