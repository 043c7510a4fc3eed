"""HTML in which every text is escaped, and the frame of a page with its last parts."""

import base64
import hashlib
import html
import os
import shlex
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._process import installed_version
from softcal_jax._text import escaped
from softcal_jax._text_table import TextTable, text_table
from softcal_jax.report._verdict import (
    MOST_REASONS,
    MOST_VALUES,
    SCOPE,
    Answer,
    RunVerdict,
)

MOST_PICTURES = 3_400_000  # bytes of pictures; base64 adds a third, still below 5 MB
REPEATED = "repeated"  # folder that the command to repeat a run writes to
_LARGE = 3  # most values that are written in large type
_KINDS = {
    ".vtu": "for ParaView",
    ".pvd": "all configurations for ParaView",
    ".png": "picture",
    ".svg": "picture",
    ".csv": "table",
    ".txt": "text",
    ".html": "this page",
}

_VOID = {"br", "img", "input", "meta"}  # elements without content or an end
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a page may load: its own styles and pictures, and nothing by network.

The only script that it runs is that of its view, which it knows by the hash.
"""


class Html(str):
    """A text that is HTML already; any other text is escaped where it enters a page."""

    __slots__ = ()


class Section(NamedTuple):
    """A part of a page with a heading; links lead to its id.

    A `folded` one shows only its heading until it is opened, and what is `viewed` hides
    where the view of the robot runs.
    """

    id: str
    title: str
    content: Sequence[Html]
    folded: bool = False
    viewed: bool = False

    @property
    def html(self) -> Html:
        head, more = node("h2", self.title), joined(self.content)
        if self.folded:
            return node("details", node("summary", head), more, id=self.id)
        kind = {"class_": "viewed"} if self.viewed else {}
        return node("section", head, more, id=self.id, **kind)


def node(name: str, *content: str, **attributes: str) -> Html:
    """Make an element.

    Content that is a `str` and no `Html` is escaped. Names of attributes have "_" for
    "-"; one at the end, as in `class_`, is dropped.
    """
    texts = (
        f' {key.rstrip("_").replace("_", "-")}="{_safe(value)}"'
        for key, value in attributes.items()
    )
    start = f"<{name}{''.join(texts)}>"
    if name in _VOID:
        return Html(start)
    body = "".join(part if isinstance(part, Html) else _safe(part) for part in content)
    return Html(f"{start}{body}</{name}>")


def _safe(text: str) -> str:
    return html.escape(escaped(text))


def joined(parts: Iterable[Html]) -> Html:
    """Put pieces of HTML one after the other."""
    return Html("\n".join(parts))


def bullets(lines: Iterable[str]) -> Html:
    """Make a list of sentences, or nothing if there are none."""
    items = [node("li", line) for line in lines]
    return node("ul", *items) if items else Html("")


def sentences(lines: Iterable[str]) -> list[Html]:
    """Make a paragraph of each sentence; empty ones are left out."""
    return [node("p", line) for line in lines if line]


def table_html(table: TextTable) -> Html:
    """Write a table that scrolls by itself where the page is too narrow for it."""
    kinds = ["w" if table.holds_words(k) else "n" for k in range(len(table.columns))]
    head = (
        node("th", column, scope="col", class_=kind)
        for column, kind in zip(table.columns, kinds, strict=True)
    )
    rows = []
    for first, *others in table.rows:
        cells = (
            node("td", cell.text, class_=f"{kind} {cell.tone}")
            for cell, kind in zip(others, kinds[1:], strict=True)
        )
        rows.append(node("tr", node("th", first.text, scope="row"), *cells))
    parts = [node("caption", table.title)]
    if any(table.columns):
        parts.append(node("thead", node("tr", *head)))
    drawn = node("table", *parts, node("tbody", *rows))
    about = {"role": "region", "aria_label": table.title, "tabindex": "0"}
    return node("div", drawn, class_="wide", **about)


def facts_html(title: str, facts: Mapping[str, str]) -> Html:
    """Write names and their values as a table without column headings."""
    return table_html(text_table(title, ("", ""), facts.items(), words=[""]))


def picture(path: Path, alt: str) -> Html:
    """Write a PNG or SVG file into the page, as an image, which runs no scripts."""
    kind = "svg+xml" if path.suffix == ".svg" else "png"
    content = base64.b64encode(path.read_bytes()).decode()
    return node("img", src=f"data:image/{kind};base64,{content}", alt=alt)


def figure(content: Html, caption: str, *, title: str = "") -> Html:
    """Make a figure with a caption below it and, if given, a title above it."""
    head = [node("p", node("strong", title))] if title else []
    return node("figure", *head, content, node("figcaption", caption))


def page(
    name: str,
    kind: str,
    verdict: RunVerdict,
    sections: Sequence[Section],
    *,
    index: str,
    units: str = "SI and mm",
    script: str = "",
    first: Html | None = None,
    robot: Html | None = None,
) -> str:
    """Write a whole page.

    `kind` is what was done, like "Calibration". Sections without content are left out.
    `index` is the file with the same numbers in `units`. `script` is the text of the
    only script that the page may run. The page begins with what is `first`, which is by
    default the verdict, beside a picture of the `robot`.
    """
    policy = _POLICY
    if script:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        policy += f"; script-src 'sha256-{digest}'"
    shown = [part for part in sections if any(part.content)]
    head = node(
        "head",
        node("meta", charset="utf-8"),
        node("meta", http_equiv="Content-Security-Policy", content=policy),
        node("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        node("title", f"{name}: {kind.lower()}"),
        node("style", _style()),
    )
    links = (
        node("li", node("a", part.title, href=f"#{part.id}"))
        for part in shown
        if not (part.folded or part.viewed)
    )
    begins = _verdict(verdict) if first is None else first
    if robot is not None:
        begins = node("div", begins, node("div", robot), class_="first")
    when = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    body = node(
        "body",
        node("header", node("p", kind, class_="kind"), node("h1", name)),
        node(
            "main",
            begins,
            node("nav", node("ul", *links), aria_label="Contents"),
            *(part.html for part in shown),
        ),
        node(
            "footer",
            f"Written by softcal_jax {installed_version('softcal-jax')} on {when}. The "
            f"same numbers in machine-readable form, in {units}: ",
            node("a", index, href=index),
            ".",
        ),
        *([node("script", Html(script))] if script else []),
    )
    return f"<!DOCTYPE html>\n{node('html', head, body, lang='en')}\n"


def output(verdict: RunVerdict, content: Iterable[Html]) -> Html:
    """Write what a cell of a notebook shows: a verdict, then the content."""
    return fragment([_verdict(verdict), *content])


def fragment(content: Iterable[Html]) -> Html:
    """Write a part of another page in the style of ours, whatever its own style is."""
    style = Html(f"@scope (.softcal) {{\n{_style()}}}")
    plain = "background: #fff; color: #1a1a1a; padding: .5rem 1rem; max-width: 62rem"
    return node("div", node("style", style), *content, class_="softcal", style=plain)


def _style() -> Html:
    return Html(files("softcal_jax.report").joinpath("page.css").read_text("utf-8"))


def _verdict(verdict: RunVerdict) -> Html:
    said = node("p", node("strong", verdict.sentence)), bullets(verdict.reasons)
    head = node("h2", "Verdict")
    return node("section", head, *said, class_=f"verdict {verdict.tone}")


def answer_html(answer: Answer) -> Html:
    """Write the answer of a calibration, its values in large type."""
    values = [
        node("div", node("dt", name), node("dd", value, node("small", interval)))
        for name, value, interval in answer.values[:MOST_VALUES]
    ]
    size = "values" if len(answer.values) <= _LARGE else "values many"
    content = [node("dl", *values, class_=size)]
    left = len(answer.values) - MOST_VALUES
    if left > 0:
        content.append(node("p", node("a", f"and {left} more", href="#parameters")))
    sentence, tone, reasons = answer.verdict
    said = [node("p", node("strong", sentence)), bullets(reasons[:MOST_REASONS])]
    if len(reasons) > MOST_REASONS:
        more = node("summary", f"and {len(reasons) - MOST_REASONS} more")
        said.append(node("details", more, bullets(reasons[MOST_REASONS:])))
    head = node("h2", "Verdict")
    content.append(node("section", head, *said, class_=f"verdict {tone}"))
    content += sentences([f"Possible mistake: {text}" for text in answer.mistakes])
    content += sentences([*answer.held_out, f"Next: {answer.next_step}"])
    return node("div", *content, node("p", SCOPE, class_="kind"), class_="answer")


def closing(
    command: str,
    data: Mapping[str, Any],
    sources: Iterable[Mapping[str, Any] | None],
    *,
    files: Sequence[Mapping[str, str]] | None = None,
    options: Sequence[str] = (),
    out: str = REPEATED,
) -> list[Section]:
    """Write the last sections: the command that repeats a run, its files and settings.

    `sources` are the project files, as `source_dict` converts them; None is a model
    made in Python. The command reads them or, if given, `files`, and writes `out`.
    """
    every = list(sources)
    known = [source for source in every if source is not None]
    named = files or []
    if files is None and len(known) == len(every):
        named = [source["project"] for source in known]
    made_in_python = "This result was made in Python, so no command repeats it."
    content = [node("p", made_in_python)]
    if named:
        words = ["softcal", command, *(file["file"] for file in named), *options]
        code = node("code", shlex.join([*words, "-o", out]))
        content = [node("p", "In the folder of this page:"), node("pre", code)]
    for source in known if files is None else ():
        if source["changes"]:
            rows = [(key, repr(value)) for key, value in source["changes"].items()]
            of = f" of {source['project']['file']}" if len(known) > 1 else ""
            columns = "key of the project file", "value"
            text = (
                "Some values in the project file were overridden when it was loaded. "
                "Set them in the file, or pass them to load_project(changes=...):"
            )
            changes = text_table(f"Changes{of}", columns, rows)
            content += [node("p", text), table_html(changes)]
    read = [*(files or ()), *(file for source in known for file in _files_of(source))]
    if read:
        rows = dict.fromkeys((file["file"], file["sha256"]) for file in read)
        table = text_table("Input files", ("file", "SHA-256"), rows)
        content.append(table_html(table))
    return [
        Section("repeat", "How to repeat this run", content, folded=True),
        Section("made", "Settings, versions and times", _made_html(data), folded=True),
    ]


def _files_of(source: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """List a project file and the files that it names, relative to the results."""
    project = source["project"]
    files = [project]
    for file in source["files"]:
        path = os.path.normpath(
            os.path.join(os.path.dirname(project["file"]), file["file"])
        )
        files.append({**file, "file": Path(path).as_posix()})
    return files


def _made_html(data: Mapping[str, Any]) -> list[Html]:
    """Tabulate settings, versions, times and files."""
    parts = {
        "Settings": _flat(data.get("settings", {})),
        "Versions": data.get("versions", {}),
        "Times": {k: f"{v:.2f} s" for k, v in data.get("timing_s", {}).items()},
        "Files": {name: _KINDS.get(Path(name).suffix, "") for name in data["files"]},
    }
    return [
        facts_html(title, {name: str(value) for name, value in rows.items()})
        for title, rows in parts.items()
        if rows
    ]


def _flat(settings: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Name nested settings by their path, like newton.rtol."""
    flat = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[f"{before}{key}"] = "none" if value is None else value
    return flat
