"""README and docs: links, messages and examples; a slow test builds all pages."""

import importlib
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from from_code import (
    ARROW,
    help_text,
    home_of,
    raised,
    readme_command,
    refusal,
    required,
    stated_licence,
)
from packaging.requirements import Requirement

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


LICENCES = re.findall(
    r"(?m)^\|(?: `(\w+)` \|)? \[([\w-]+)\]\(https://[^)]+\) \| ([^|]+) \| [^|]+ \|$",
    (DOCS / "reference/licences.md").read_text(),
)
"""Rows of both tables: extra or none, package, licence."""


def test_every_package_that_users_install_has_its_licence():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {"": about["dependencies"], **about["optional-dependencies"]}
    names = {
        (extra, Requirement(text).name)
        for extra, texts in asked.items()
        for text in texts
        if extra not in ("dev", "docs")
    }
    own = {(extra, about["name"]) for extra in asked}  # extras that hold other extras
    listed = [row[:2] for row in LICENCES]
    assert sorted(listed) == sorted(names - own)


ALSO_CALLED = {"psf": "python software foundation"}


@pytest.mark.parametrize(
    ("package", "licence"), sorted({row[1:] for row in LICENCES}), ids=lambda v: v
)
def test_the_licence_is_that_of_the_installed_package(package, licence):
    """By its family, which every version names in other words."""
    try:
        stated = stated_licence(distribution(package)).lower()
    except PackageNotFoundError:
        pytest.skip(f"{package} is not installed here")
    family = licence.split("-")[0].lower()
    assert re.search(rf"(?<![a-z]){family}|{ALSO_CALLED.get(family, family)}", stated)
    assert ("gpl" in stated) == ("gpl" in family), stated


def test_without_extras_nothing_is_under_the_gpl():
    """On x86; elsewhere KLU is, under the LGPL. The page builds its table so."""
    stated = {name: stated_licence(own) for name, own in required().items()}
    assert {"jax", "numpy", "wadler-lindig", "vtk"} <= set(stated)
    assert {name for name, text in stated.items() if "GPL" in text} <= {"klujax"}
    assert "not stated" not in stated.values()


NEEDED = "libegl1 libgl1-mesa-dri"
INSTALLED = ["apt-get update -q", f"apt-get install -y -q python3-venv {NEEDED}"]


@pytest.mark.parametrize(
    ("fails", "asked"),
    [
        ({}, []),
        ({"dpkg"}, INSTALLED),
        ({"python3 -c"}, INSTALLED),
        ({"dpkg", "apt-get"}, INSTALLED[:1]),
    ],
    ids=["all is there", "no OpenGL", "no venv", "no OpenGL, no root"],
)
def test_the_first_command_asks_for_root_only_where_it_must(tmp_path, fails, asked):
    """With programs that write down how they were called; it goes on in any case."""
    calls, programs, venv = (tmp_path / n for n in ("calls", "bin", ".venv/bin"))
    for name in ("dpkg", "apt-get", "python3", "pip", "softcal"):
        folder = venv if name in ("pip", "softcal") else programs
        folder.mkdir(parents=True, exist_ok=True)
        failing = "|".join(f'"{call}"*' for call in sorted(fails))
        case = f'case "{name} $*" in {failing}) exit 1;; esac' if fails else ""
        (folder / name).write_text(f'#!/bin/sh\necho "{name} $*" >> {calls}\n{case}\n')
        (folder / name).chmod(0o755)
    bash = shutil.which("bash")
    assert bash is not None
    command = [bash, "-uo", "pipefail", "-c", readme_command("demo")]
    done = subprocess.run(command, cwd=tmp_path, env={"PATH": str(programs)})
    assert done.returncode == 0
    called = calls.read_text().splitlines()
    assert [call for call in called if call.startswith("apt-get")] == asked
    assert [call.partition(" -q")[0] for call in called[-3:]] == [
        "python3 -m venv .venv",
        "pip install",
        "softcal demo -o demo_results",
    ]


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
