"""README and docs: links, messages, examples, numbers; a slow test builds all pages."""

import functools
import importlib
import importlib.util
import inspect
import pydoc
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
import typing
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from export.handmade import make_result
from from_code import (
    ARROW,
    help_text,
    home_of,
    keys_of,
    raised,
    readme_command,
    refusal,
    required,
    stated_licence,
)
from messages import VALUE, anchor, messages
from packaging.requirements import Requirement
from project_keys import (
    COMMANDS,
    PAGE,
    commands_page,
    keys_page,
    rows as keys_in,
    sections,
)
from recorded import MARK, numbers, pages, renewed, written
from records import committed, goals_of, rows
from wording import says

import softcal_jax as sc
from softcal_jax.calibration import CalibrationResult
from softcal_jax.control import OUTCOMES
from softcal_jax.equilibrium import RESULTS
from softcal_jax.project import Table, _reading, load_project
from softcal_jax.results import result_dict

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if "build" not in page.parts]
TROUBLESHOOTING = DOCS / "reference/troubleshooting.md"


FIGURES = DOCS / "guide/figures"

MOST_BYTES = 100_000
"""Most bytes of a picture of the guide."""


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


@functools.cache
def sources():
    """Modules of the package and their files, but for the one that SOFA itself runs."""
    root = Path(sc.__file__).parent
    files = [p for p in root.rglob("*.py") if p.name not in ("__main__.py", "scene.py")]
    dotted = lambda path: ".".join(path.relative_to(root.parent).with_suffix("").parts)
    load = lambda path: importlib.import_module(dotted(path).removesuffix(".__init__"))
    return [(load(path), path) for path in sorted(files)]


def meant(module, name):
    """What a name means in a module: of it, of its classes, an argument, or public."""
    own = vars(module).values()
    packages = [m for m, path in sources() if path.name == "__init__.py"]
    functions = filter(inspect.isfunction, own)
    arguments = [inspect.signature(f).parameters for f in functions]
    fields = lambda home: getattr(home, "__dataclass_fields__", {})
    member = lambda home, part: getattr(home, part, None) or fields(home).get(part)
    homes = module, *filter(inspect.isclass, own), *packages
    found = [functools.reduce(member, name.split("."), home) for home in homes]
    found += [parameters.get(name) for parameters in arguments]
    found += [pydoc.locate(f"softcal_jax.{name.removeprefix('softcal_jax.')}")]
    return next((target for target in found if target is not None), None)


def test_what_docstrings_say_to_see_can_be_seen():
    """And is more than an alias of types, whose text nobody finds."""
    lost = [
        f"{path.name}: see `{name}`"
        for module, path in sources()
        for name in re.findall(r"\b[Ss]ee\s+`([A-Za-z_][\w.]*)`", path.read_text())
        if (target := meant(module, name)) is None or typing.get_origin(target)
    ]
    assert lost == []


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


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.stem)
def test_the_numbers_are_those_of_the_records(page):
    """Where they are not, `python docs/_ext/recorded.py` writes them."""
    for number in numbers(page.read_text()):
        assert number.typed == number.record, number.source


def test_numbers_of_the_records_are_found():
    texts = [page.read_text() for page in pages()]
    assert sum(len([*numbers(text)]) for text in texts) > 150
    # No comment is left that names a figure, but stands behind no number.
    named = r"<!-- (?:" + "|".join(committed()) + r")\."
    assert all(len(re.findall(named, t)) == len(MARK.findall(t)) for t in texts)


def test_a_number_that_is_not_that_of_the_record():
    text = "17<!-- paper_fig3.steps_4_configurations --> steps, 17 mm"
    (number,) = numbers(text)
    assert (number.typed, number.record) == ("17", "5")
    assert renewed(text) == text.replace("17", "5", 1)


@pytest.mark.parametrize(
    ("value", "like", "text"),
    [
        (538.3, "540", "540"),
        (1591.2, "1 200", "1 600"),
        (0.4494, "0.51", "0.45"),
        (8.009, "7.4", "8.0"),
        (-36.49, "-35.0", "-36.5"),
        (1.93e-9, "3e-9", "2e-9"),
        (1.16e-5, "1.3e-5", "1.2e-5"),
        (100, "30", "100"),
        (0, "3", "0"),
        (3, "0", "3"),
    ],
)
def test_numbers_are_written_to_the_digits_that_stand_there(value, like, text):
    assert written(value, like) == text


def test_goals_are_shown_with_their_verdict():
    content = {
        "figures": {"nodes": 525, "time_s": 2.0, "error_mm": 0.5, "solver": "PARDISO"},
        "goals": {
            "time_s": {"goal": "at most 1", "met": False},
            "error_mm": {"goal": "at most 1", "met": True},
        },
    }
    assert [*rows(content)] == [
        ("time_s", "2", "at most 1", "**missed**"),
        ("error_mm", "0.5", "at most 1", "met"),
        ("nodes", "525", "", ""),
        ("solver", "PARDISO", "", ""),
    ]
    assert goals_of(content) == "1 of 2"
    assert goals_of({"goals": {}}) == "none set"


def commands():
    """Commands of `softcal` in README and docs: subcommand and options, by page."""
    for page in [ROOT / "README.md", *PAGES]:
        blocks = re.findall(r"(?ms)^```sh$(.*?)^```$", page.read_text())
        lines = [line for block in blocks for line in block.splitlines()]
        lines += re.findall(r"`(softcal [^`]+)`", prose(page).replace("\n", " "))
        for line in lines:
            for part in re.split(r"&&|[>|;]", line):
                words = shlex.split(part, comments=True)
                if words and words[0].endswith("softcal"):
                    yield page.name, words[1:]


def test_the_commands_that_are_shown_exist_with_their_options():
    known = set(re.findall(r"(?m)^ {4}([a-z]\w*)(?: |$)", help_text("")))
    seen = set()
    for page, words in commands():
        if not words or words[0].startswith("-"):
            continue
        assert words[0] in known, (page, words)
        deeper = words[0] == "export" or words[:2] == ["sweep", "show"]
        command = " ".join(words[: 2 if deeper and len(words) > 1 else 1])
        seen.add(command)
        for option in (word for word in words if word.startswith("-")):
            name = option.partition("=")[0]
            assert re.search(rf"(?<![\w-]){name}(?![\w-])", help_text(command)), (
                page,
                words,
            )
    assert {"calibrate", "new", "sweep show", "export sofa"} <= seen


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.stem)
def test_the_names_that_are_shown_exist(page):
    """Like `sc.calibrate`, and `softcal_jax.fields.Uncertain`."""
    dotted_names = r"(?<![\w/.])((?:sc|softcal_jax)(?:\.[A-Za-z]\w*)+)"
    for dotted in re.findall(dotted_names, page.read_text()):
        names = dotted.split(".")[1:]
        if names in (["laws"], ["exporters"]):  # groups of entry points
            continue
        value = sc
        for i, name in enumerate(names, 1):
            if not hasattr(value, name):  # a package that is not imported yet
                importlib.import_module(".".join(["softcal_jax", *names[:i]]))
            value = getattr(value, name)


def test_the_loop_of_the_readme_is_that_of_the_code():
    text = (ROOT / "README.md").read_text()
    name, shown = re.findall(
        r"<!-- source: (\S+) -->\n```python\n(.*?)```", text, re.S
    )[0]
    module, _, function = name.rpartition(".")
    source = inspect.getsource(getattr(importlib.import_module(module), function))
    assert shown in textwrap.dedent(source[source.index("    while") :])


def test_the_pictures_of_the_guide_are_small_and_shown():
    page = (DOCS / "guide/verdict.md").read_text()
    shown = set(re.findall(r"(?:\]\(|:file: )figures/([\w.]+)", page))
    assert shown == {path.name for path in FIGURES.iterdir()}
    assert all(path.stat().st_size <= MOST_BYTES for path in FIGURES.iterdir())


@pytest.mark.slow
def test_the_pictures_of_the_guide_are_drawn(tmp_path):
    spec = importlib.util.spec_from_file_location("figures", DOCS / "figures.py")
    assert spec
    assert spec.loader
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    figures.draw(tmp_path)
    drawn = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(drawn) == set(figures.FIGURES) == {p.name for p in FIGURES.iterdir()}
    assert max(drawn.values()) <= MOST_BYTES


def test_errors_and_warnings_are_found():
    names = [kind.__name__ for kind in raised()]
    assert {"ProjectError", "ResultError", "CalibrationWarning"} <= set(names)


def test_every_command_has_its_help():
    """Those that `softcal --help` lists, and the kinds of `softcal export`."""
    page = (DOCS / "reference/commands.md").read_text()
    shown = set(re.findall(r"^## softcal ?(.*)$", page, re.M))
    named = lambda command: set(
        re.findall(r"(?m)^ {4}([a-z]\w*(?: show)?)(?: |$)", help_text(command))
    )
    exports = {f"export {kind}" for kind in named("export")}
    assert len(exports) == 4
    assert shown == {""} | (named("") - {"export"}) | exports
    assert "--checkpoint" in help_text("calibrate")


refused = functools.cache(refusal)

REFUSED = re.findall(r"(?m)^```\{refusal\}\n(.*)\n```$", TROUBLESHOOTING.read_text())


@pytest.mark.parametrize("change", REFUSED)
def test_project_files_with_a_mistake_are_refused_for_it(change):
    """By its line: where the message names no key, it quotes what was written."""
    lines, message = refused(change)
    assert len(lines) == 1
    assert message.startswith("project.toml")
    value = re.search(r'"([^"]+)"|= ([\w.]+)', lines[0])
    key = re.search(r"\w+", lines[0])
    assert value
    assert key
    assert any(word in message for word in (value[1] or value[2], key[0], "TOML"))


def test_every_message_has_an_anchor_of_its_own():
    listed = [message for group in messages().values() for message in group]
    assert len(listed) > 500
    assert len({anchor(message) for message in listed}) == len(listed)
    assert says(listed, "candidates: ... add [[candidates]]")


def test_what_a_project_file_is_told_is_among_the_messages():
    """But for keys that are unknown or missing, and kinds: those have a place above."""
    listed = [message for group in messages().values() for message in group]
    patterns = [
        re.compile(re.escape(m).replace(re.escape(VALUE), ".*"), re.S) for m in listed
    ]
    said = [refused(change).message for change in REFUSED]
    matched = [any(p.search(text) for p in patterns) for text in said]
    assert sum(matched) >= len(said) - 5


def test_the_project_file_that_is_changed_is_right():
    """Otherwise each of them might be refused for another reason."""
    assert len(REFUSED) >= 12
    with pytest.raises(ValueError, match="file is not refused"):
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
    ours = {(extra, about["name"]) for extra in asked}  # extras that hold other extras
    listed = [row[:2] for row in LICENCES]
    assert sorted(listed) == sorted(names - ours)


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
    stated = {name: stated_licence(package) for name, package in required().items()}
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
        "python3 -m venv --upgrade-deps .venv",
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
    recorded = (html / "evidence/records.html").read_text(encoding="utf-8")
    for name in committed():
        assert f'id="record-{name.replace("_", "-")}"' in recorded, name
        plot = re.search(rf'src="\.\./(_images/{name}\d*\.png)"', recorded)
        assert plot, name
        assert (html / plot[1]).is_file()
    theory = (html / "reference/theory.html").read_text(encoding="utf-8")
    assert "_static/mathjax/tex-chtml.js" in theory


def test_the_table_of_result_json_has_every_key():
    """Those of a result as it is written, and what each is where it is not plain."""
    keys = dict(keys_of(CalibrationResult))
    data = result_dict(make_result())
    assert {key for key in keys if "." not in key} == set(data)
    (marker, *_) = data["configurations"][0]["markers"]
    below = {key.split(".")[-1] for key in keys if ".markers." in key}
    assert below == set(marker)
    assert keys["history.lambda_p"] == "The QP step [-]."


def test_the_page_of_project_files_is_that_of_the_program():
    """Where it is not, `python docs/_ext/project_keys.py` writes it."""
    assert PAGE.read_text(encoding="utf-8") == keys_page()
    assert COMMANDS.read_text(encoding="utf-8") == commands_page()


def test_the_page_of_project_files_has_every_key():
    """Of each table that is written by hand, but for those that check no value."""
    listed = {}
    for section in sections():
        for table in section.table.__mro__:
            listed.setdefault(table, set()).update(row.key for row in keys_in(section))
    files = (ROOT / "softcal_jax/project").glob("_[a-z]*.py")
    modules = [importlib.import_module(f"softcal_jax.project.{f.stem}") for f in files]
    for table in [value for module in modules for value in vars(module).values()]:
        if isinstance(table, type) and issubclass(table, Table):
            if table not in (_reading.SharedTable, _reading.MeshTables):
                unlisted = set(table.model_fields) - listed.get(table, set())
                assert unlisted <= {"type", "law"}, table
