"""What pages take from the code, so that it is never out of date.

Directives: `message` (of a member of an enumeration of
outcomes), `refusal` (what a project file with a mistake is answered), `raised` (classes
of errors and warnings), `names` (those that `softcal_jax` offers, with links), `shown`
(a command of the README), `licences` (of all that is installed with the package),
`keys` (of `result.json`).
"""

import contextlib
import dataclasses
import importlib
import inspect
import io
import os
import pkgutil
import re
import tempfile
from functools import partial
from importlib.metadata import Distribution, distribution
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, get_args

from docutils import nodes
from docutils.parsers.rst import Directive
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from sphinx.domains.python import PyObject
from sphinx.util.docutils import SphinxDirective

import softcal_jax
from softcal_jax.calibration import CalibrationResult
from softcal_jax.cli import main
from softcal_jax.configurations import EffectorRecord
from softcal_jax.identifiability import Assessment, Identifiability
from softcal_jax.project import ProjectError, load_project
from softcal_jax.results import KEYS
from softcal_jax.robots import ready_made_path

COARSE = ("cells = [14, 6, 6]", "cells = [6, 3, 3]")
"""The demo's mesh, and one that is made sooner."""

ARROW = "=>"
"""Between what stands in the demo's project file and what replaces it."""


class Refused(NamedTuple):
    """A project file with a mistake: its lines that differ, and what is said to it."""

    lines: list[str]
    message: str


def help_text(command: str) -> str:
    """Return what `softcal COMMAND --help` prints on 80 columns."""
    out, before = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "80"
    try:
        with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
            main([*command.split(), "--help"])
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    return out.getvalue().rstrip()


def readme_command(name: str) -> str:
    """Return the command of the README below `<!-- command: NAME -->`.

    Raises:
        ValueError: If it has none of that name.
    """
    readme = Path(__file__).parents[2].joinpath("README.md").read_text("utf-8")
    _, _, rest = readme.partition(f"<!-- command: {name} -->\n```sh\n")
    if not rest:
        raise ValueError(f"README.md has no command {name}")
    return rest.split("\n```")[0]


def refusal(change: str) -> Refused:
    """Return what is said to the demo's project file after a change `old => new`.

    Lines that differ are those that are there now, or those that are gone, as comments.

    Raises:
        ValueError: If the change does not apply, or the file is not refused.
    """
    path = ready_made_path("beam")
    right = path.read_text(encoding="utf-8").replace(*COARSE)
    old, new = (part.strip() for part in change.split(ARROW))
    if old not in right:
        raise ValueError(f"the demo's project file has no {old!r}")
    wrong = right.replace(old, new, 1)
    before, after = right.splitlines(), wrong.splitlines()
    lines = [line for line in after if line not in before]
    lines = lines or [f"# {line}" for line in before if line not in after]
    with tempfile.TemporaryDirectory() as folder:
        changed = Path(folder, "project.toml")
        changed.write_text(wrong, encoding="utf-8")
        table = path.with_name("markers.csv")
        Path(folder, table.name).write_bytes(table.read_bytes())
        try:
            load_project(changed)
        except (ProjectError, FileNotFoundError) as error:
            return Refused(lines, str(error).replace(f"{folder}{os.sep}", ""))
    raise ValueError("this project file is not refused")


def raised() -> list[type]:
    """Return the classes of errors and warnings of the public packages, by name."""
    found = {
        value
        for package in map(importlib.import_module, packages())
        for value in map(partial(getattr, package), public_names(package))
        if inspect.isclass(value)
        and issubclass(value, Exception)
        and value.__module__.startswith("softcal_jax")
    }
    return sorted(found, key=lambda kind: kind.__name__)


def required() -> dict[str, Distribution]:
    """Return what is installed with the package here, without extras, by name."""
    found: dict[str, Distribution] = {}
    open_ones = [("softcal-jax", frozenset[str]())]
    seen = set(open_ones)
    while open_ones:
        name, extras = open_ones.pop()
        own = found[name] = distribution(name)
        for text in own.requires or []:
            asked = Requirement(text)
            chosen = [{"extra": extra} for extra in ("", *extras)]
            if asked.marker is None or any(map(asked.marker.evaluate, chosen)):
                one = canonicalize_name(asked.name), frozenset(asked.extras)
                open_ones += [one] if one not in seen else []
                seen.add(one)
    del found["softcal-jax"]
    return dict(sorted(found.items()))


def stated_licence(own: Distribution) -> str:
    """Return the licence of a distribution in its own words.

    Those of its metadata in the order in which they can be relied on; a few have none,
    and there the first line of the text of the licence stands for it.
    """
    about = own.metadata
    named = [
        line.split(" :: ")[-1]
        for line in about.get_all("Classifier", [])
        if line.startswith("License") and not line.endswith("Proprietary License")
    ]
    expression, text = about.get("License-Expression"), about.get("License")
    stated = expression or ", ".join(named) or text
    if not stated:
        texts = [f for f in own.files or [] if f.name.upper().startswith("LICEN")]
        stated = texts[0].read_text() if texts else "not stated"
    return stated.strip().splitlines()[0]


def packages() -> list[str]:
    """Return the packages below `softcal_jax`, without the command line."""
    below = pkgutil.walk_packages(softcal_jax.__path__, "softcal_jax.")
    return [m.name for m in below if m.ispkg and m.name != "softcal_jax.cli"]


def public_names(package: ModuleType) -> list[str]:
    """List what a package offers: all but its modules and what begins with `_`."""
    return [
        name
        for name, value in vars(package).items()
        if not name.startswith("_") and not inspect.ismodule(value)
    ]


def home_of(name: str) -> str:
    """Return the package in which a name of `softcal_jax` is documented."""
    listed = {p: public_names(importlib.import_module(p)) for p in packages()}
    found = [package for package, names in listed.items() if name in names]
    return found[0] if found else "softcal_jax"


def _first_line(value: object) -> str:
    return (inspect.getdoc(value) or "").splitlines()[0]


def _quoted(message: str) -> nodes.container:
    """Show a message as it was printed, so that it is found by its words."""
    text = nodes.literal_block(message, message, language="text")
    return nodes.container("", text, classes=["message", "wrapped"])


class Message(Directive):
    """The message of an outcome: `softcal_jax.equilibrium.RESULTS.max_steps`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Quote it."""
        module, kind, member = self.arguments[0].rsplit(".", 2)
        outcomes: Any = getattr(importlib.import_module(module), kind)
        text = outcomes[getattr(outcomes, member)]
        return [_quoted(text)]


class Refusal(Directive):
    """A change of the demo's project file, and what is said to it."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Try it, and quote the lines and the message."""
        try:
            lines, said = refusal(" ".join(self.content))
        except ValueError as error:
            raise self.error(str(error)) from error
        shown = "\n".join(lines)
        # The file of one of them is no TOML, which is no error of the page.
        block = nodes.literal_block(shown, shown, language="toml", force=True)
        return [block, _quoted(said)]


class Raised(SphinxDirective):
    """A list of the classes of errors and warnings, with what each is for."""

    def run(self) -> list[nodes.Node]:
        """List them."""
        lines = [
            f"- {{py:obj}}`.{kind.__name__}`: {_first_line(kind)}" for kind in raised()
        ]
        return self.parse_text_to_nodes("\n".join(lines))


class Names(SphinxDirective):
    """The names of `softcal_jax`, with links to where each is documented."""

    def run(self) -> list[nodes.Node]:
        """List them."""
        lines = ["| name | what it is | in |", "|---|---|---|"]
        for name in softcal_jax.__all__:
            home, value = home_of(name), getattr(softcal_jax, name)
            own = "" if home == "softcal_jax" else home.removeprefix("softcal_jax.")
            lines.append(
                f"| {{py:obj}}`{name} <{home}.{name}>` | {_first_line(value)} | {own} |"
            )
        return self.parse_text_to_nodes("\n".join(lines))


class Licences(SphinxDirective):
    """A table of what is installed with the package, and its licences."""

    def run(self) -> list[nodes.Node]:
        """List it."""
        lines = ["| package | version | licence |", "|---|---|---|"]
        lines += [
            f"| {name} | {own.version} | {stated_licence(own)} |"
            for name, own in required().items()
        ]
        return self.parse_text_to_nodes("\n".join(lines))


WRITTEN = {
    "format": "Format of the file.",
    "name": "Name of the calibration.",
    "source": "The files that it was made from: `project`, `files` and `changes`.",
    "solver": "The sparse solver, law, formulation and size of the mesh.",
    "settings": "Settings of the calibration, of Newton's method and of the noise.",
    "budget": "The standard errors by cause, in SI units.",
    "budget.parameters": "`name`, `unit`, `standard_error`, `by_cause`, a `sentence`.",
    "budget.errors": "What is uncertain: `cause`, `name` and `deviations`.",
    "budget.covariance": "Covariance of the scaled parameters, by all causes.",
    "assessment": "Whether the values may be trusted.",
    "identifiability": "What the data tell; null stands for infinite values, too.",
    "versions": "Versions of Python and its packages, and the machine.",
    "timing_s": "Wall time per part [s].",
}
"""Keys of `result.json` that are no attributes of a calibration."""


def keys_of(kind: type, before: str = "") -> list[tuple[str, str]]:
    """List the keys of a class in `result.json`, and of those in it, in words."""
    rows = []
    if not before:
        rows = [*WRITTEN.items()]
        rows += keys_of(Assessment, "assessment.")
        rows += keys_of(Identifiability, "identifiability.")
    types = {own.name: own.type for own in dataclasses.fields(kind)}
    names = [own.name for own in dataclasses.fields(kind)]
    for name in KEYS[kind].split() if kind in KEYS else names:
        key, _, attribute = name.partition("=")
        attribute = attribute or key.removesuffix("_mm")
        words = _in_mm(key, words_of(kind, attribute))
        rows.append((f"{before}{key}", words))
        for one in KEYS.get(key, "").split():  # of effectors
            said = words_of(EffectorRecord, one.removesuffix("_mm"))
            rows.append((f"{before}{key}.{one}", _in_mm(one, said)))
        for inner in _classes(types.get(attribute)):
            if dataclasses.is_dataclass(inner):
                rows += keys_of(inner, f"{before}{key}.")
    return rows


def _in_mm(key: str, words: str) -> str:
    return words.replace("[m]", "[mm]") if key.endswith("_mm") else words


def _classes(annotation: Any) -> list[type]:
    """List the classes in an annotation."""
    if inspect.isclass(annotation) and not get_args(annotation):
        return [annotation]
    return [kind for part in get_args(annotation) for kind in _classes(part)]


def words_of(kind: type, name: str) -> str:
    """Return what the docstring of a class says of an attribute."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    found = re.search(rf"^    {name}: (.*(?:\n {{8}}.*)*)", section, re.MULTILINE)
    words = found[1] if found else inspect.getdoc(getattr(kind, name, None)) or ""
    return " ".join(words.split("\n\n")[0].split())


class KeysTable(SphinxDirective):
    """A table of the keys of `result.json`."""

    def run(self) -> list[nodes.Node]:
        """List them."""
        lines = ["| key | what it is |", "|---|---|"]
        lines += [
            f"| `{key}` | {words.replace('|', '&#124;')} |"
            for key, words in keys_of(CalibrationResult)
        ]
        return self.parse_text_to_nodes("\n".join(lines))


class Shown(Directive):
    """The command of the README below `<!-- command: NAME -->`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Show it."""
        try:
            text = readme_command(self.arguments[0])
        except ValueError as error:
            raise self.error(str(error)) from error
        block = nodes.literal_block(text, text, language="sh")
        return [nodes.container("", block, classes=["wrapped"])]


KEPT_OR_MARKED = re.compile(
    r"``[^`]*``|`[^`]*`"  # names and formulas
    r"|::\n(?:\n| {3,}.*\n)+"  # examples
    r"|(?<!\\)[*|]"  # what would begin emphasis or a substitution
)
"""What of a docstring is left as it is, and what has a meaning for Sphinx only."""


OWN_TYPE = re.compile(r"\bsoftcal_jax(?:\.\w+)*\._\w+\.[A-Z]\w*")
"""A type by the module that defines it, which is nothing to be read."""

ARRAY = re.compile(r"\bjaxlib\._jax\.Array\b")
"""An array of JAX, as Python calls it."""


def as_it_reads(
    app: Any, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Escape a docstring, in which `*` is a product and `|` an absolute value."""
    escaped = KEPT_OR_MARKED.sub(
        lambda found: f"\\{found[0]}" if found[0] in "*|" else found[0],
        "\n".join([*lines, ""]),
    )
    lines[:] = OWN_TYPE.sub(r"~\g<0>", ARRAY.sub("Array", escaped)).split("\n")


def short_signature(
    app: Any,
    what: str,
    name: str,
    obj: object,
    options: Any,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Call arrays as the code does."""
    short = lambda text: ARRAY.sub("Array", text) if text else text
    return short(signature), short(returns)


def short_types(app: Any, domain: str, objtype: str, content: nodes.Element) -> None:
    """Call arrays as the code does in the type of a property, too."""
    for text in [*content.parent.findall(nodes.Text)]:
        if text.parent and (short := ARRAY.sub("Array", text)) != text:
            text.parent.replace(text, nodes.Text(short))


def setup(app: Any) -> dict[str, bool]:
    """Register the directives, and the reader of docstrings after that of sections."""
    app.connect("autodoc-process-docstring", as_it_reads, priority=900)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("object-description-transform", short_types)
    for kind in PyObject.doc_field_types:
        if kind.name == "variable":
            kind.label = "Attributes"  # as docstrings call them, not "Variables"
    for directive in (Message, Refusal, Raised, Names, Licences, Shown):
        app.add_directive(directive.__name__.lower(), directive)
    app.add_directive("keys", KeysTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
