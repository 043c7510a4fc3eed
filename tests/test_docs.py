"""README and docs: links, messages and examples; a slow test builds all pages."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from from_code import ARROW, help_text, home_of, raised, refusal

import softcal_jax as sc
from softcal_jax.control import OUTCOMES
from softcal_jax.equilibrium import RESULTS
from softcal_jax.project import load_project

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if "build" not in page.parts]
TROUBLESHOOTING = DOCS / "reference/troubleshooting.md"


def prose(page):
    """A page without its code."""
    return re.sub(r"(?ms)^```(?!\{toctree\}).*?^```$", "", page.read_text())


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 200


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.stem)
def test_links_lead_to_files(page):
    text = prose(page)
    targets = re.findall(r"\]\(([^)#\s]+)", text)
    targets += re.findall(r"\{download\}`[^`<]*<([^>]+)>`", text)
    targets += [f"{doc}.ipynb" for doc in re.findall(r"\{doc\}`[^`<]*<([^>]+)>`", text)]
    for target in targets:
        if not target.startswith("https://"):
            assert (page.parent / target).is_file(), target


def test_every_page_is_in_a_table_of_contents():
    listed = {DOCS / "index"}
    for page in PAGES:
        for tree in re.findall(r"(?ms)^```\{toctree\}$(.*?)^```$", page.read_text()):
            lines = [line for line in tree.split("\n") if line and line[0] != ":"]
            names = [re.sub(r".*<(.*)>", r"\1", line) for line in lines]
            listed |= {Path(page.parent, name).resolve() for name in names}
    notebooks = (ROOT / "notebooks").glob("*.ipynb")
    assert listed == {path.with_suffix("") for path in (*PAGES, *notebooks)}


@pytest.mark.parametrize(
    ("outcomes", "home"), [(RESULTS, "equilibrium"), (OUTCOMES, "control")]
)
def test_every_outcome_has_a_place_and_its_message(outcomes, home):
    """None is missing, none is left over."""
    text, kind = TROUBLESHOOTING.read_text(), outcomes.__name__
    label = kind.rstrip("S").lower()
    members = set(outcomes._name_to_item)
    quoted = re.findall(
        rf"^```{{message}} softcal_jax\.{home}\.{kind}\.(\w+)$", text, re.M
    )
    placed = re.findall(rf"^\({label}-([\w-]+)\)=$", text, re.M)
    assert set(quoted) == members
    assert {name.replace("-", "_") for name in placed} == members


def test_the_names_of_the_package_have_a_home():
    for name in sc.__all__:
        assert hasattr(importlib.import_module(home_of(name)), name)
    assert home_of("calibrate") == "softcal_jax.calibration"


def test_errors_and_warnings_are_found():
    names = [kind.__name__ for kind in raised()]
    assert {"ProjectError", "ResultError", "CalibrationWarning"} <= set(names)


def test_every_command_has_its_help():
    """Those that `softcal --help` lists, and the kinds of `softcal export`."""
    page = (DOCS / "reference/commands.md").read_text()
    shown = set(re.findall(r"^```\{help\}(?: (.+))?$", page, re.M))
    named = lambda command: set(
        re.findall(r"(?m)^ {4}([a-z]\w*(?: show)?)(?: |$)", help_text(command))
    )
    exports = {f"export {kind}" for kind in named("export")}
    assert len(exports) == 3
    assert shown == {""} | (named("") - {"export"}) | exports
    assert "--checkpoint" in help_text("calibrate")


REFUSED = re.findall(r"(?m)^```\{refusal\}\n(.*)\n```$", TROUBLESHOOTING.read_text())


@pytest.mark.parametrize("change", REFUSED)
def test_project_files_with_a_mistake_are_refused_for_it(change):
    """By its line: where the message names no key, it quotes what was written."""
    lines, message = refusal(change)
    assert len(lines) == 1
    assert message.startswith("project.toml")
    value = re.search(r'"([^"]+)"|= ([\w.]+)', lines[0])
    key = re.search(r"\w+", lines[0])
    assert value
    assert key
    assert any(word in message for word in (value[1] or value[2], key[0], "TOML"))


def test_the_project_file_that_is_changed_is_right():
    """Otherwise each of them might be refused for another reason."""
    assert len(REFUSED) >= 12
    with pytest.raises(ValueError, match="this project file is not refused"):
        refusal(f"nu = 0.499 {ARROW} nu = 0.498")
    with pytest.raises(ValueError, match=r"has no 'nu = 0\.7'"):
        refusal(f"nu = 0.7 {ARROW} nu = 0.498")


def test_the_project_file_of_the_readme(tmp_path):
    """As it stands, with a beam in place of the CAD model."""
    text = (ROOT / "README.md").read_text().split("<!-- fragment: finger -->")[1]
    text = text.split("```toml\n")[1].split("```")[0]
    for cad, beam in {
        'file = "finger.step", size = "3 mm"': (
            'beam = { size = "(100, 20, 20) mm", cells = [6, 2, 2] }'
        ),
        'face = { points = ["(0, 2, 2) mm"] }': (
            'plane = { point = "(0, 0, 0) mm", normal = [1, 0, 0] }'
        ),
    }.items():
        assert cad in text
        text = text.replace(cad, beam)
    (tmp_path / "project.toml").write_text(text)
    (tmp_path / "markers.csv").write_text(
        "pose,marker,x_mm,y_mm,z_mm\nhanging,tip,99,10,5\nweight,tip,97,10,0\n"
    )
    project = load_project(tmp_path / "project.toml")
    assert [c.name for c in project.calibration] == ["hanging", "weight"]
    (load,) = project.calibration[1].loads
    assert load.force == pytest.approx((0.0, 0.0, -0.5))


@pytest.mark.slow
def test_the_pages_build_without_a_warning_and_need_no_network(tmp_path):
    """Nothing that a page loads by itself comes from elsewhere."""
    build = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q"]
    html = tmp_path / "html"  # myst-nb keeps a folder beside it
    done = subprocess.run([*build, DOCS, html], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    # In _static the theme keeps a template, which is no page.
    pages = [p for p in html.rglob("*.html") if "_static" not in p.parts]
    assert len(pages) > len(PAGES)
    loads = r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=\"([^\"]+)\""
    for page in pages:
        for target in re.findall(loads, page.read_text(encoding="utf-8")):
            if target.startswith(("#", "data:")):
                continue
            assert not re.match(r"(https?:)?//", target), f"{page.name}: {target}"
            path = target.partition("?")[0].partition("#")[0]
            assert (page.parent / path).exists(), f"{page.name}: {target}"
    styles = [*html.rglob("*.css")]
    assert styles
    for style in styles:
        text = style.read_text(encoding="utf-8")
        assert not re.search(r"(@import|url\()\s*['\"]?(https?:)?//", text), style
    theory = (html / "reference/theory.html").read_text(encoding="utf-8")
    assert "_static/mathjax/tex-chtml.js" in theory
