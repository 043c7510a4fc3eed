"""Every page in Chromium: readable for all, on a phone too, silent, and by itself.

What axe-core finds counts, whichever rule it is: contrast of colours, names of regions,
order of headings, heads of tables.
"""

from importlib.resources import files
from pathlib import Path

import pytest
from export.handmade import (
    make_fit,
    make_ranking,
    make_result,
    make_simulation_result,
    small_model,
)
from test_page import score

from benchmarks._browser import NoBrowser, browser, opened
from softcal_jax.actuators import Cable, Guide
from softcal_jax.configurations import Centroid, Configuration, ImposedForce
from softcal_jax.control import ControlSettings, Limits, solve_inverse
from softcal_jax.equilibrium import build_model
from softcal_jax.identifiability import assess
from softcal_jax.layouts import ModelComparison
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam
from softcal_jax.results import (
    _write,
    write_results,
    write_sweep,
)
from softcal_jax.sweeps import Outcome, Range, run_sweep, sample

WIDTHS = (360, 1280)
"""Windows of a phone and of a desk [px]."""

_AXE = """\
axe.run(document, {resultTypes: ["violations"]}).then(found => found.violations.map(
  own => own.id + ": " + own.help + ": " + own.nodes.map(n => n.html).slice(0, 3)))"""

_TOO_WIDE = (
    "document.documentElement.scrollWidth - document.documentElement.clientWidth"
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning"),
]


@pytest.fixture(scope="module", autouse=True)
def chromium():
    try:
        browser()
    except NoBrowser as error:
        pytest.skip(str(error))


def calibrate(folder: Path) -> Path:
    long = "a configuration with quite a long name, as people give them"
    fits = (make_fit(small_model().mesh, long), *make_result().configurations)
    result = make_result(fits=fits, notes=("Take care.", "E ended on its bound."))
    return write_results(result, folder / "out") / "report.html"


def simulate(folder: Path) -> Path:
    result = make_simulation_result(small_model())
    return write_results(result, folder / "out") / "report.html"


def identify(folder: Path) -> Path:
    outlook = assess(make_result()).identifiability
    written = write_results(outlook, folder / "out", known=make_ranking())
    return written / "report.html"


def compare(folder: Path) -> Path:
    best, other = score("neo", [1.0, 1.1, 0.9]), score("gent", [9.0, 9.2, 8.9], (1,))
    comparison = ModelComparison.ranked([other, best])
    return write_results(comparison, folder / "out") / "report.html"


def sweep(folder: Path) -> Path:
    """Rows for words, a scatter for numbers, and trials that do not count."""

    def trial(point):
        E, few = point["material.E"], point["layout"] == "few"
        error = 1e-3 * (abs(E / 3e5 - 0.8) + 0.3 * few)
        figures = {"held-out rms [m]": error, "E [Pa]": E * (1.0 + 0.01 * few)}
        if E > 2.9e5:
            raise ArithmeticError("no equilibrium found: the load is too large")
        return Outcome(figures, E > 2.1e5, notes=["E ended on its bound."])

    axes = {"material.E": Range(2e5, 3e5), "layout": ["few", "many, evenly spread"]}
    rows = folder / "sweep"
    points = sample(axes, 24)
    result = run_sweep(trial, points, rows, name="stiffness", workers=0)
    return write_sweep(result, rows)


def inverse(folder: Path) -> Path:
    result = searched_arm()
    return write_results(result, folder / "out", notes=["Take care."]) / "report.html"


def searched_arm():
    """A goal that a cable and a motor miss, since one of the two may not move."""
    cable = Cable("cable", [Guide((0.0, 0.01, 0.03), "ground"), (0.1, 0.01, 0.02)])
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1), order=1)
    law = Corotational(Isotropic(2e5, 0.3))
    model = build_model(mesh, law, density=1000.0, actuators=[cable])
    start = Configuration(
        "pulled",
        "x_min",
        effectors=[Centroid("tip", "x_max", std=1e-3)],
        actuation={"cable": ImposedForce(0.1)},
    )
    goals, limits = {"tip": (0.1, 0.01, 0.05)}, {"cable": Limits(force=(0.0, 0.5))}
    settings = ControlSettings(other_starts=1)
    return solve_inverse(model, start, goals=goals, limits=limits, settings=settings)


PAGES = [calibrate, simulate, identify, compare, sweep, inverse]


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_a_page(make, tmp_path, monkeypatch):
    """Nothing is asked of the network, nothing fails, nothing is cut off."""
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")
    page = make(tmp_path)
    axe = files("axe_core_python").joinpath("axe.min.js").read_text("utf-8")
    with opened(page) as tab:
        assert tab.loaded == ((), ())
        tab.ask(f"{axe}; 0")
        for width in WIDTHS:
            tab.resize(width)
            assert tab.ask("innerWidth") == width
            assert tab.ask(_TOO_WIDE) <= 0
            assert tab.ask(_AXE) == []


def test_what_is_wrong_is_found(tmp_path):
    """Faint words, a table without heads, and more than the width of the phone."""
    page = tmp_path / "page.html"
    page.write_text(
        '<!DOCTYPE html><html><head><meta name="viewport" content="width=device-width">'
        "</head><body><p style='color: #bbb; background: #fff'>faint</p>"
        "<div style='width: 2000px'>wide</div><img src='data:,'></body></html>"
    )
    axe = files("axe_core_python").joinpath("axe.min.js").read_text("utf-8")
    with opened(page) as tab:
        tab.ask(f"{axe}; 0")
        tab.resize(WIDTHS[0])
        assert tab.ask(_TOO_WIDE) > 0
        violations = " ".join(tab.ask(_AXE))
    for rule in ("color-contrast", "document-title", "image-alt", "html-has-lang"):
        assert f"{rule}:" in violations
