"""The view of `report.html` in headless Chromium: what a person sees and does."""

import io

import numpy as np
import pytest
from export.handmade import make_result, small_model
from PIL import Image
from test_page_view import fits_of
from wording import says

from benchmarks import _browser
from softcal_jax.results import _write, write_results

pytestmark = pytest.mark.slow

SETTLE = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
STAGE = "#view .stage"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Two configurations, one twice as far as the other, each with a picture."""
    try:
        _browser.browser()
    except _browser.NoBrowser as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("page") / "out"
    model = small_model(order=2)
    draw = lambda model, fit, path, **_: Image.new("RGB", (40, 30)).save(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_write, "rendering_problem", lambda: None)
        patch.setattr(_write, "render_configuration", draw)
        write_results(make_result(model=model, fits=fits_of(model)), folder)
    return folder / "report.html"


def seen(tab):
    """What the drawing area shows."""
    tab.ask(SETTLE)
    image = Image.open(io.BytesIO(tab.screenshot(STAGE))).convert("RGB")
    return np.asarray(image, int)


def choose(tab, name, k):
    tab.ask(
        f"(own => {{ own.selectedIndex = {k}; "
        "own.dispatchEvent(new Event('change')) })"
        f"(document.getElementById('view-{name}'))"
    )


def press(tab, key):
    tab.ask(
        "document.getElementById('view-area').dispatchEvent("
        f"new KeyboardEvent('keydown', {{key: '{key}'}}))"
    )


def shown(tab, selector):
    return tab.ask(f"document.querySelector('{selector}').checkVisibility()")


def share_of_changed_pixels(a, b, least=30):
    return np.mean(np.abs(a - b).max(axis=-1) > least)


def test_it_draws_what_is_chosen_and_turns_by_keys(page):
    with _browser.opened(page) as tab:
        assert tab.loaded == _browser.Visit((), ())
        tab.resize(1200)
        assert shown(tab, "#view")
        assert not shown(tab, ".viewed img")
        first = seen(tab)
        # The body is in colours, on white.
        assert 0.1 < np.mean(np.ptp(first, axis=-1) > 40) < 0.9
        choose(tab, "configuration", 1)
        other = seen(tab)
        assert share_of_changed_pixels(first, other) > 0.05
        choose(tab, "field", 0)
        said = tab.ask("document.getElementById('view-area').ariaLabel")
        assert says(said, "held out (held out) ... displacement")
        assert "8.00 mm before" in tab.ask(
            "document.getElementById('view-words').innerText"
        )
        n = tab.ask("document.getElementById('view-field').length")
        pictures = []
        for k in range(n):
            choose(tab, "field", k)
            pictures.append(seen(tab))
        texts = tab.ask(
            "[...document.getElementById('view-field').options].map(own => own.text)"
        )
        # Values that do not vary look alike: there is one colour.
        varied = [
            p for p, text in zip(pictures, texts, strict=True) if text != "nu [-]"
        ]
        for i, one in enumerate(varied):
            for two in varied[:i]:
                # Stretch and stress of this shape grow alike along the beam.
                assert share_of_changed_pixels(one, two, 5) > 0.02
        choose(tab, "field", 0)
        still = seen(tab)
        press(tab, "ArrowRight")
        turned = seen(tab)
        assert share_of_changed_pixels(still, turned) > 0.02
        press(tab, "Home")
        assert np.array_equal(seen(tab), still)
        tab.ask("document.getElementById('view-left').click()")
        assert share_of_changed_pixels(still, seen(tab)) > 0.02
        choose(tab, "direction", 6)
        assert share_of_changed_pixels(still, seen(tab)) > 0.02


def test_the_field_is_the_one_of_the_colour_bar(page):
    """The end that moves most has the last colour of the map, the clamp the first."""
    with _browser.opened(page) as tab:
        tab.resize(1200)
        for name in ("markers", "names", "rest"):
            tab.ask(f"document.getElementById('view-{name}').click()")
        choose(tab, "field", 0)
        choose(tab, "direction", 3)  # from +y, so that x points to the left
        pixels = seen(tab)
        rows, columns = np.nonzero(np.ptp(pixels, axis=-1) > 40)
        left = pixels[
            rows[columns < columns.min() + 6], columns[columns < columns.min() + 6]
        ]
        right = pixels[
            rows[columns > columns.max() - 6], columns[columns > columns.max() - 6]
        ]
        ticks = tab.ask(
            "[...document.getElementById('view-ticks').children].map(e => e.innerText)"
        )
        assert ticks[0] == "0.0"
        assert float(ticks[-1]) == pytest.approx(20.4, abs=0.05)
        # Yellow, and dark violet.
        assert np.median(left, axis=0)[0] > 150 > np.median(left, axis=0)[2]
        assert np.median(right, axis=0).max() < 110


@pytest.mark.parametrize("width", [360, 1200])
def test_all_of_it_is_within_reach(page, width):
    """Nothing sticks out, and keys reach every control in the order of the page."""
    with _browser.opened(page) as tab:
        tab.resize(width)
        tab.ask(SETTLE)
        assert tab.ask("document.documentElement.scrollWidth") <= width
        sizes = tab.ask(
            "[...document.querySelectorAll('#view select, #view button')].map(own => "
            "own.getBoundingClientRect())"
            ".map(own => [own.width, own.height, own.right])"
        )
        for wide, high, right in sizes:
            assert wide >= 40
            assert high >= 40
            assert right <= width
        focusable = tab.ask(
            "[...document.querySelectorAll('#view *')].filter(own => own.tabIndex >= 0)"
            ".map(own => own.id)"
        )
        assert {"view-configuration", "view-area", "view-reset"} <= set(focusable)


def test_pictures_stand_for_it_in_print_and_without_webgl(page):
    with _browser.opened(page) as tab:
        tab.print()
        assert not shown(tab, "#view")
        assert shown(tab, ".viewed img")
        tab.print(False)
        assert shown(tab, "#view")
        # As when a driver ends.
        tab.ask(
            "document.getElementById('view-area').getContext('webgl2')"
            ".getExtension('WEBGL_lose_context').loseContext()"
        )
        tab.ask("new Promise(done => setTimeout(done, 500))")
        assert not shown(tab, "#view")
        assert shown(tab, ".viewed img")
    with _browser.opened(page, webgl=False) as tab:
        assert tab.loaded == _browser.Visit((), ())
        assert not shown(tab, "#view")
        assert shown(tab, ".viewed img")
