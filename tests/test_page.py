"""`report.html`, read as a browser would: well formed, self-contained, and right."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from export.handmade import (
    axis_model,
    axis_space,
    make_fit,
    make_history,
    make_ranking,
    make_result,
    make_simulation_result,
    small_model,
)
from wording import says

from softcal_jax.calibration import (
    ParameterEstimate,
    ParameterInterval,
    ProjectSource,
    SourceFile,
)
from softcal_jax.equilibrium import NewtonSettings
from softcal_jax.fields import field_standard_errors
from softcal_jax.identifiability import identifiability
from softcal_jax.inference import independent
from softcal_jax.layouts import FoldScore, ModelComparison, ModelScore
from softcal_jax.results import (
    Made,
    _html,
    _write,
    headline,
    write_results,
)
from softcal_jax.results._view import body_view

HOSTILE = "<img src=x onerror=alert(1)> & \"q\" 'a' </title>\x1b\u202e"
"""A name that breaks out of texts, attributes and terminals, if it can."""

VOID = {"br", "img", "input", "meta"}

DATA = {"type": "application/json", "id": "view-data"}
"""Attributes of what a view draws, which runs nothing."""

pytestmark = pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")


@pytest.fixture(autouse=True)
def no_opengl(request, monkeypatch):
    """Pictures cost seconds; most pages need none."""
    if "pictures" not in request.fixturenames:
        monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")


class Read(HTMLParser):
    """A page as lists of what it holds; raises where elements do not nest."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.tables, self.texts = [], [], {}, []
        self.styles, self.scripts = "", []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        keys = [key for key, _ in attributes]
        assert len(set(keys)) == len(keys), attributes
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "caption":
            self.title = ""
        elif tag == "tr":
            self.tables[self.title].append([])
        elif tag in ("td", "th"):
            self.tables[self.title][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "caption":
            assert self.title not in self.tables
            self.tables[self.title] = []

    def handle_data(self, data):
        inner = self.open[-1] if self.open else ""
        if inner == "style":
            self.styles += data
            return
        if inner == "script":
            self.scripts.append(data)
            return
        self.texts.append(data)
        if inner == "caption":
            self.title += data
        elif inner in ("td", "th"):
            self.tables[self.title][-1][-1] += data

    def of(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def text(self):
        return " ".join("".join(f"{t} " for t in self.texts).split())


def written(folder, result, **options):
    """The page of a calibration, read, and its result.json."""
    write_results(result, folder, **options)
    text = (folder / "report.html").read_text(encoding="utf-8")
    return Read(text), json.loads((folder / "result.json").read_text())


def check_page(folder):
    """What holds for every page; returns it read."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert len(text.encode()) < 5e6
    assert text.startswith("<!DOCTYPE html>\n<html")
    page = Read(text)
    assert page.of("html") == [{"lang": "en"}]
    viewports = [meta for meta in page.of("meta") if meta.get("name") == "viewport"]
    assert viewports[0]["content"].startswith("width=device-width")
    assert len(page.of("h1")) == len(page.of("main")) == len(page.of("title")) == 1
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(set(ids)) == len(ids)
    files = {path.name for path in folder.iterdir()}
    for tag, attrs in page.elements:
        assert tag not in ("link", "iframe", "object", "base", "form")
        assert not [key for key in attrs if key.startswith("on")]
        if "src" in attrs:
            assert re.match(r"data:image/(png|svg\+xml);base64,", attrs["src"])
        if "href" in attrs:
            target = attrs["href"]
            assert target[1:] in ids if target.startswith("#") else target in files
        for value in attrs.values():
            for name in re.findall(r"url\(#(\w+)\)", value or ""):
                assert name in ids
        if tag == "th":
            assert attrs["scope"] in ("row", "col")
        if tag == "img":
            assert attrs["alt"].strip()
        if attrs.get("role") in ("img", "region"):
            assert attrs["aria-label"].strip()
    policy = next(meta for meta in page.of("meta") if "http-equiv" in meta)["content"]
    assert policy.startswith("default-src 'none'; img-src data:; style-src")
    code = [tag for tag in page.of("script") if tag != DATA]
    assert len(code) == policy.count("script-src") == policy.count("'sha256-") <= 1
    if code:
        assert code == [{}]
        digest = hashlib.sha256(page.scripts[-1].encode()).digest()
        assert f"script-src 'sha256-{base64.b64encode(digest).decode()}'" in policy
    scripts = "".join(page.scripts)
    assert not re.findall(r"https?:|\bfetch\b|\bimport\b|XMLHttp", scripts)
    assert "http" not in page.styles
    assert "url(" not in page.styles
    assert "nan" not in re.findall(r"\w+", page.text)
    assert all(len({len(row) for row in rows}) == 1 for rows in page.tables.values())
    data = json.loads(next(folder.glob("*.json")).read_text())
    assert "report.html" in data["files"]
    return page


def number(text):
    """The first number of a cell."""
    return float(re.match(r"[-+]?[\d.]+(e[-+]?\d+)?", text).group())


def history_of(*names):
    """The steps of the handmade calibration, with other names of the parameters."""
    return tuple(
        replace(step, values=dict(zip(names, step.values.values(), strict=True)))
        for step in make_history()
    )


def interval_of_E():
    ends = (0.95, 2.3e5, 2.5e5, "likelihood", "likelihood", "Pa", "first-order")
    return ParameterInterval("E", *ends)


def test_the_numbers_are_those_of_result_json(tmp_path):
    """Each is read back from the page, and rounded as it is shown there."""
    result = make_result(intervals=[interval_of_E()], history=make_history((2,)))
    page, data = written(tmp_path / "out", result, name="beam")
    check_page(tmp_path / "out")
    rows = {row[0]: row for row in page.tables["Parameters"]}
    for param, unit in zip(data["parameters"], (1e3, 1.0), strict=True):
        _, value, start, bounds = rows[param["name"]]
        assert number(value) == pytest.approx(param["value"] / unit)
        assert number(start) == pytest.approx(param["start"] / unit)
        ends = [number(end) * FACTOR[end[-3:]] for end in bounds.split(" to ")]
        assert ends == pytest.approx([param["lower"], param["upper"]])
        assert ("on a bound" in value) == param["at_bound"]
    assert rows["E"][1] == "240.0 ± 6.0 kPa"
    assert data["parameters"][0]["standard_error"] == pytest.approx(6e3)
    (span,) = data["intervals"]
    low, high = re.findall(r"[\d.]+", page.tables["Intervals"][1][1])
    assert [1e3 * float(low), 1e3 * float(high)] == [span["lower"], span["upper"]]

    keys = ("rms_before_mm", "rms_after_mm", "motion_mm", "rms_after_percent_of_motion")
    _, *rows = page.tables["Residuals of the markers, rms"]
    for row, pose in zip(rows, data["configurations"], strict=True):
        assert row[:2] == [pose["name"], pose["role"]]
        shown = [number(cell) for cell in row[2:]]
        np.testing.assert_allclose(shown, [pose[key] for key in keys], atol=0.05)
        texts = [f"{pose[key]:.2f} mm" for key in keys[:3]]
        assert says(page.text, f"{texts[0]} before ... {texts[1]} after ... {texts[2]}")

    sentences = dict(page.tables["Standard errors by cause"][1:])
    for param in data["budget"]["parameters"]:
        if param["standard_error"] is None:
            assert sentences[param["name"]] == "no standard error"
            continue
        value = data["parameters"][0]["value"]
        for cause, std in param["by_cause"].items():
            (percent,) = re.findall(rf"{cause} ([\d.]+) %", sentences[param["name"]])
            assert float(percent) == pytest.approx(100.0 * std / value, rel=0.05)

    _, *rows = page.tables["Steps of the fit"]
    for row, step in zip(rows, data["history"], strict=True):
        assert number(row[1]) == pytest.approx(step["cost"], rel=1e-3)
        assert number(row[2]) == pytest.approx(step["rms_mm"], rel=1e-3)
        assert row[4] == ("taken" if step["accepted"] else "refused")
    inner = data["identifiability"]
    singular = [float(row[1]) for row in page.tables[SINGULAR][1:]]
    values = inner["conditioning"]["singular_values"]
    np.testing.assert_allclose(singular, values, rtol=5e-3)
    correlations = [list(map(float, row[1:])) for row in page.tables["Correlation"][1:]]
    np.testing.assert_allclose(correlations, inner["correlation"], atol=5e-3)
    _, *rows = page.tables["What the data determine"]
    for row, param in zip(rows, inner["parameters"], strict=True):
        assert row[2] == param["verdict"]
        assert number(row[1]) == pytest.approx(100.0 * param["ratio"], rel=5e-3)
    versions = dict(page.tables["Versions"])
    assert versions == data["versions"]
    settings = dict(page.tables["Settings"])
    assert settings["newton.rtol"] == str(data["settings"]["newton"]["rtol"])
    assert [row[0] for row in page.tables["Files"]] == data["files"]


FACTOR = {"kPa": 1e3, "MPa": 1e6, "0.3": 1.0, ".44": 1.0}
"""Units at the ends of bounds; those of nu have none."""

SINGULAR = "Singular values of W_ep in units of the noise"


@pytest.mark.filterwarnings("ignore:Glyph")  # no font has control characters
def test_hostile_names_stay_text(tmp_path):
    """In every place of the page: heading, tables, charts, notes, attributes."""
    fits = [make_fit(small_model().mesh, HOSTILE)]
    names = (HOSTILE, "nu")
    kept = make_result().parameters
    result = make_result(
        fits=fits,
        parameters=tuple(
            replace(q, name=name) for q, name in zip(kept, names, strict=True)
        ),
        history=history_of(*names),
        notes=(HOSTILE,),
    )
    page, _ = written(tmp_path / "out", result, name=HOSTILE)
    check_page(tmp_path / "out")
    shown = HOSTILE.replace("\x1b", "\\x1b").replace("\u202e", "\\u202e")
    assert page.texts.count(shown) >= 5
    for image in page.of("img"):
        content = base64.b64decode(image["src"].partition(",")[2])
        words = "".join(ElementTree.fromstring(content).itertext())
        assert not {"\x1b", "\u202e"} & {*words}
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "<img src=x" not in text


def colours(page):
    """Class of the verdict."""
    (css,) = (a["class"] for a in page.of("section") if "verdict" in a.get("class", ""))
    return css.removeprefix("verdict ")


def test_success_only_where_the_package_grants_it(tmp_path):
    kept = tuple(
        ParameterEstimate(*row, False)
        for row in (
            ("E", 2.4e5, 6e3, 2e5, 1e5, 1e6, "Pa"),
            ("nu", 0.4, 0.001, 0.4, 0.3, 0.44, ""),
        )
    )
    model = small_model(order=2)
    fits = (make_fit(model.mesh),)
    good = make_result(parameters=kept, model=model, fits=fits, notes=())
    for name, result, colour, sentence in (
        ("good", good, "good", "Trust"),
        ("bound", make_result(), "doubtful", "with care"),
        ("lost", replace(good, converged=False), "bad", "Do not use"),
    ):
        page, data = written(tmp_path / name, result)
        assert (data["assessment"]["outcome"] == "trust") == (colour == "good")
        assert colours(page) == colour
        text = (tmp_path / name / "report.html").read_text(encoding="utf-8")
        assert "<h2>Verdict</h2>" in text
        assert sentence in page.text
        assert ("every check passed" in page.text) == (colour == "good")
        if colour == "doubtful":
            for reason in data["assessment"]["reasons"]:
                assert reason in page.text


def test_blind_directions_and_what_to_do_are_in_words(tmp_path):
    """The data see a modulus, and not the angle."""
    values = np.deg2rad([-33.94, 0.123, 10.0, -90.0, 90.0])
    result = make_result(
        model=axis_model(),
        parameters=(
            ParameterEstimate("E_t", 5e5, 9e3, 2e5, 1e5, 1e6, "Pa", False),
            ParameterEstimate("theta", *map(float, values), "rad", False),
        ),
        history=history_of("E_t", "theta"),
        space=axis_space(),
        z=axis_space().start(),
        linear=independent(np.array([[100.0, 0.0]]), ("E_t", "theta"), scale=1.5),
    )
    page, _ = written(tmp_path / "out", result)
    check_page(tmp_path / "out")
    assert says(page.text, "1 of 2 directions")
    assert "theta (blind)" in page.text
    assert says(page.text, "lack at least 1 measured coordinate")
    assert "-33.94 ± 0.12 deg" in page.text


def test_command_and_hashes(tmp_path):
    """The project file of the folder above, and what stands beside it."""
    files = {"my project.toml": "aa", "data/markers.csv": "bb"}
    project, markers = (SourceFile(tmp_path / n, s) for n, s in files.items())
    result = replace(make_result(), source=ProjectSource(project, (markers,), {}))
    page, data = written(tmp_path / "out", result)
    check_page(tmp_path / "out")
    assert "softcal calibrate '../my project.toml' -o repeated" in page.text
    assert page.tables["Input files"][1:] == [
        ["../my project.toml", data["source"]["project"]["sha256"]],
        ["../data/markers.csv", data["source"]["files"][0]["sha256"]],
    ]
    changed = ProjectSource(project, (), {"material.nu": 0.4})
    page, _ = written(tmp_path / "changed", replace(result, source=changed))
    assert page.tables["Changes"][1:] == [["material.nu", "0.4"]]
    page, _ = written(tmp_path / "none", make_result())
    assert says(page.text, "made in Python")


@pytest.mark.parametrize("command", ["simulate", "identify", "compare"])
def test_command_and_hashes_of_the_other_runs(tmp_path, command):
    """One mechanism: what was solved is named as it is of a calibration."""
    model = small_model()
    of = lambda name: Made(
        model,
        {"newton": NewtonSettings(rtol=1e-7)},
        ProjectSource(
            SourceFile(tmp_path / f"{name}.toml", f"aa{name}"),
            (SourceFile(tmp_path / "body.msh", "bb"),),
            {},
        ),
    )
    folder, named = tmp_path / "out", {"a": of("a")}
    setting = "newton.rtol"
    if command == "simulate":
        write_results(make_simulation_result(model), folder, made=of("a"))
    elif command == "identify":
        write_results(make_ranking(), folder, made=of("a"))
    else:
        named, setting = {"a": of("a"), "b": of("b")}, "b.newton.rtol"
        models = [score(name, [1.0, 1.1, 0.9]) for name in ("b", "a")]
        write_results(ModelComparison.ranked(models), folder, made=named)
    page = check_page(folder)
    files = [f"../{name}.toml" for name in named]
    assert f"softcal {command} {' '.join(files)} -o repeated" in page.text
    rows = dict(page.tables["Input files"][1:])
    assert rows == {
        **{f"../{name}.toml": f"aa{name}" for name in named},
        "../body.msh": "bb",
    }
    assert dict(page.tables["Settings"])[setting] == "1e-07"
    data = json.loads(next(folder.glob("*.json")).read_text())
    assert dict(page.tables["Versions"]) == data["versions"] != {}


def drawn(page):
    """The pictures of bodies, which are no charts."""
    return [img for img in page.of("img") if img["src"].startswith("data:image/png")]


def test_pictures_are_in_the_page_as_far_as_they_fit(tmp_path, monkeypatch):
    """One that would make the page too large stays beside it, with a link."""

    def draw(model, fit, path, **options):
        from PIL import Image

        Image.new("RGB", (40, 30), "white").save(path)

    monkeypatch.setattr(_write, "rendering_problem", lambda: None)
    monkeypatch.setattr(_write, "render_configuration", draw)
    page, _ = written(tmp_path / "out", make_result())
    check_page(tmp_path / "out")
    first, second = drawn(page)
    assert says(first["alt"], "droop (fitted)")
    assert says(second["alt"], "held out (held out)")
    size = (tmp_path / "out" / "droop.png").stat().st_size
    # The view takes its share of the room.
    shown = make_result()
    estimate = shown.space, shown.z, shown.budget.covariance
    errors = field_standard_errors(shown.model, *estimate)
    size += 3 * body_view(shown, errors).size // 4
    monkeypatch.setattr("softcal_jax.results._write.MOST_PICTURES", size)
    page, _ = written(tmp_path / "small", make_result())
    check_page(tmp_path / "small")
    assert len(drawn(page)) == 1
    assert {"href": "held_out.png"} in page.of("a")


def test_a_page_of_the_user_is_not_replaced(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text('{"files": []}')
    (tmp_path / "out" / "report.html").write_text("mine")
    with pytest.raises(FileExistsError, match=r"earlier results"):
        write_results(make_result(), tmp_path / "out", force=True)
    assert (tmp_path / "out" / "report.html").read_text() == "mine"


def test_page_of_a_simulation(tmp_path):
    write_results(make_simulation_result(small_model()), tmp_path / "out")
    page = check_page(tmp_path / "out")
    data = json.loads((tmp_path / "out" / "simulation.json").read_text())
    assert says(page.text, "1 of 2 configurations")
    assert colours(page) == "bad"
    _, *rows = page.tables["Simulation"]
    for row, pose in zip(rows, data["configurations"], strict=True):
        assert (row[0], row[3]) == (pose["name"], pose["outcome"])
        assert int(row[2]) == pose["newton_steps"]
    largest = data["configurations"][0]["largest_displacement_mm"]
    assert rows[0][1] == f"{largest:.2f} mm"
    result = make_simulation_result(small_model(), (True, True))
    write_results(result, tmp_path / "all")
    page = check_page(tmp_path / "all")
    assert says(page.text, "2 configurations")
    assert colours(page) == "good"


def score(name, squares, failed=()):
    """A model with squared errors on held-out poses, in units of the noise."""
    folds = (
        FoldScore(f"pose {i}", np.nan, np.nan, np.nan, "no equilibrium")
        if i in failed
        else FoldScore(f"pose {i}", 2e-3 * s**0.5, s**0.5, 1e-3)
        for i, s in enumerate(squares)
    )
    return ModelScore(name, 2, tuple(folds), 1e-3, 1.0, "", None)


def test_page_of_a_comparison(tmp_path):
    best, other = score("neo", [1.0, 1.1, 0.9]), score(HOSTILE, [9.0, 9.2, 8.9], (1,))
    comparison = ModelComparison.ranked([other, best])
    write_results(comparison, tmp_path / "out", name=HOSTILE)
    page = check_page(tmp_path / "out")
    data = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert data["verdict"] in page.text
    assert says(page.text, "pose 1 ... no equilibrium")
    _, *rows = page.tables["Models"]
    assert rows[0][0] == data["best"] == "neo"
    for row, model in zip(rows, data["models"], strict=True):
        assert number(row[2]) == pytest.approx(model["held_out_rms_mm"], rel=1e-3)
        assert number(row[5]) == pytest.approx(model["fit_rms_mm"])
    _, *rows = page.tables["Held-out error of each configuration"]
    for k, model in enumerate(data["models"]):
        for row, fold in zip(rows, model["folds"], strict=True):
            assert row[0] == fold["held_out"]
            if fold["failure"]:
                assert row[k + 1] == "failed"
            else:
                assert number(row[k + 1]) == pytest.approx(fold["rms_mm"], rel=1e-3)
    colours_of = []
    for models in ([best, score("b", [1.0, 1.0, 1.1])], [best, score("c", [9, 9, 9])]):
        name = f"{len(colours_of)}"
        write_results(ModelComparison.ranked(models), tmp_path / name)
        colours_of.append(colours(check_page(tmp_path / name)))
    assert colours_of == ["doubtful", "plain"]


def test_page_of_what_data_would_tell(tmp_path):
    """The second row sees the angle to the asked 10 degrees or so, or not at all."""
    for angle, colour in ((100.0, "good"), (20.0, "doubtful"), (0.0, "bad")):
        space = axis_space()
        rows = np.array([[100.0, 0.0], [0.0, angle]])
        outlook = identifiability(
            independent(rows, tuple(space.names)), space, space.start()
        )
        out = tmp_path / colour
        write_results(outlook, out, known=make_ranking(), name="beam")
        page = check_page(out)
        data = json.loads((out / "identifiability.json").read_text())
        assert colours(page) == colour
        assert headline(outlook) in page.text
        assert says(page.text, "'turned' tells most: expected error of theta")
        assert "Not ranked: 'crushed': inverted." in page.text
        _, *rows = page.tables["Predicted standard errors"]
        for row, q in zip(rows, data["identifiability"]["parameters"], strict=True):
            assert (row[0], row[-1]) == (q["name"], q["verdict"])
        assert number(rows[0][1]) == pytest.approx(500.0)
        std = data["identifiability"]["parameters"][0]["standard_error"]
        assert number(rows[0][2]) == pytest.approx(1e-3 * std, rel=5e-3)
        assert ("leave 1 of 2" in page.text) == (colour == "bad")
    write_results(outlook, tmp_path / "alone")
    assert says(check_page(tmp_path / "alone").text, "Add a configuration")
    write_results(make_ranking(), tmp_path / "ranking")
    assert colours(check_page(tmp_path / "ranking")) == "plain"


def brightness(colour):
    """Relative luminance of WCAG 2, of a colour like "#1a2b3c"."""
    if len(colour) == 4:
        colour = "#" + "".join(2 * c for c in colour[1:])
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, two):
    low, high = sorted([brightness(one), brightness(two)])
    return (high + 0.05) / (low + 0.05)


def test_contrast():
    """Texts against their paper as WCAG 2 asks, 4.5; each verdict on its own."""
    assert contrast("#fff", "#000000") == pytest.approx(21.0)
    style = (Path(_html.__file__).parent / "page.css").read_text()
    named = dict(re.findall(r"--(\w+): (#\w+);", style))
    for name in ("ink", "faint", "good", "doubtful", "bad", "blue"):
        assert contrast(named[name], "#fff") >= 4.5
    papers = re.findall(r"\.verdict\.(\w+) {.*background: (#\w+)", style)
    assert {name for name, _ in papers} == {"good", "doubtful", "bad"}
    for name, paper in papers:
        for ink in (named[name], named["ink"], named["faint"]):
            assert contrast(ink, paper) >= 4.5
