"""HTML in which every text is escaped, and the frame of a page with its last parts."""

import base64
import hashlib
import html
import os
import re
import shlex
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from softcal_jax._process import installed_version
from softcal_jax._text import escaped
from softcal_jax._text_table import TextTable, text_table
from softcal_jax.plotting import PictureStyle
from softcal_jax.report import _verdict

MOST_PICTURES = 3_400_000  # bytes of pictures; base64 adds a third, still below 5 MB
CHART = PictureStyle(width_mm=150.0, font_size=10.0)
REPEATED = "repeated"  # folder that the command to repeat a run writes to
_LARGE = 3  # most values that are written in large type
_KINDS = {
    ".vtu": "for ParaView",
    ".pvd": "all configurations for ParaView",
    ".png": "picture",
    ".svg": "picture",
    ".pdf": "picture",
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


Part = str | TextTable
"""What a page shows: HTML, a table, or a sentence."""


class Section(NamedTuple):
    """A part of a page with a heading; links lead to its id.

    A `folded` one shows only its heading until it is opened, and what is `viewed` hides
    where the view of the robot runs.
    """

    id: str
    title: str
    content: Sequence[Part]
    folded: bool = False
    viewed: bool = False

    @property
    def html(self) -> Html:
        head, more = node("h2", self.title), joined(parts_html(self.content))
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
    return Html(f"{start}{_body(content)}</{name}>")


def _body(content: Iterable[str]) -> Html:
    parts = (part if isinstance(part, Html) else _safe(part) for part in content)
    return Html("".join(parts))


def _safe(text: str) -> str:
    return html.escape(escaped(text))


def resource(name: str) -> str:
    """Read a file that pages are made of."""
    return files("softcal_jax.report").joinpath(name).read_text("utf-8")


def template(file: str, /, **parts: str | Iterable[str]) -> Html:
    """Fill a frame of HTML, without its indents; escaping is that of `node`."""
    frame = Template(re.sub(r"\n\s*", "", resource(file)))
    every = {k: [v] if isinstance(v, str) else v for k, v in parts.items()}
    return Html(frame.substitute({k: _body(v) for k, v in every.items()}))


def joined(parts: Iterable[Html]) -> Html:
    """Put pieces of HTML one after the other."""
    return Html("\n".join(parts))


def bullets(lines: Iterable[str]) -> Html:
    """Make a list of sentences, or nothing if there are none."""
    items = [node("li", line) for line in lines]
    return node("ul", *items) if items else Html("")


def parts_html(parts: Iterable[Part]) -> list[Html]:
    """Write parts: a sentence as a paragraph, and an empty one not at all."""
    drawn = (table_html(p) if isinstance(p, TextTable) else p for p in parts)
    shown = (part for part in drawn if part or isinstance(part, Html))
    return [p if isinstance(p, Html) else node("p", p) for p in shown]


def table_html(table: TextTable) -> Html:
    """Write a table that scrolls by itself where the page is too narrow for it."""
    kinds = ["w" if table.holds_words(k) else "n" for k in range(len(table.columns))]
    heads = zip(table.columns, kinds, strict=True)
    head = (node("th", column, scope="col", class_=kind) for column, kind in heads)
    rows = []
    for first, *others in table.rows:
        cells = zip(others, kinds[1:], strict=True)
        drawn = (node("td", c.text, class_=f"{kind} {c.tone}") for c, kind in cells)
        rows.append(node("tr", node("th", first.text, scope="row"), *drawn))
    parts = [node("caption", table.title)]
    if any(table.columns):
        parts.append(node("thead", node("tr", *head)))
    drawn = node("table", *parts, node("tbody", *rows))
    about = {"role": "region", "aria_label": table.title, "tabindex": "0"}
    return node("div", drawn, class_="wide", **about)


def facts(title: str, values: Mapping[str, str]) -> TextTable:
    """Make a table of names and their values, without column headings."""
    return text_table(title, ("", ""), values.items(), words=[""])


def picture(path: Path, alt: str) -> Html:
    """Write a PNG or SVG file into the page, as an image, which runs no scripts."""
    kind = "svg+xml" if path.suffix == ".svg" else "png"
    content = base64.b64encode(path.read_bytes()).decode()
    return node("img", src=f"data:image/{kind};base64,{content}", alt=alt)


def chart(plot: Callable[[Path], Any], what: str, caption: str) -> Html:
    """Draw a chart of `plotting` into the page, with what it is in bold above it."""
    with tempfile.TemporaryDirectory() as folder:
        plot(path := Path(folder) / "chart.svg")
        drawn = node("div", picture(path, what), class_="chart")
    return figure(drawn, caption, title=what)


def figure(content: Html, caption: str, *, title: str = "") -> Html:
    """Make a figure with a caption below it and, if given, a title above it."""
    head = [node("p", node("strong", title))] if title else []
    return node("figure", *head, content, node("figcaption", caption))


def page(
    name: str,
    kind: str,
    verdict: _verdict.RunVerdict,
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
    links = (
        node("li", node("a", part.title, href=f"#{part.id}"))
        for part in shown
        if not (part.folded or part.viewed)
    )
    begins = _verdict_html(verdict) if first is None else first
    if robot is not None:
        begins = node("div", begins, node("div", robot), class_="first")
    whole = template(
        "page.html",
        policy=policy,
        name=name,
        kind=kind,
        done=kind.lower(),
        style=Html(resource("page.css")),
        first=begins,
        links=links,
        sections=(part.html for part in shown),
        version=installed_version("softcal-jax"),
        when=time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
        units=units,
        index=index,
        script=[node("script", Html(script))] if script else "",
    )
    return f"<!DOCTYPE html>\n{whole}\n"


def output(verdict: _verdict.RunVerdict, content: Iterable[Part]) -> Html:
    """Write what a cell of a notebook shows: a verdict, then the content."""
    return fragment([_verdict_html(verdict), *parts_html(content)])


def fragment(content: Iterable[Html]) -> Html:
    """Write a part of another page in the style of ours, whatever its own style is."""
    style = Html(f"@scope (.softcal) {{\n{resource('page.css')}}}")
    plain = "background: #fff; color: #1a1a1a; padding: .5rem 1rem; max-width: 62rem"
    return node("div", node("style", style), *content, class_="softcal", style=plain)


def _verdict_html(verdict: _verdict.RunVerdict, most: int | None = None) -> Html:
    """Write a verdict; reasons beyond the first `most` are folded."""
    shown = verdict.reasons[:most]
    said = [node("p", node("strong", verdict.sentence)), bullets(shown)]
    if more := verdict.reasons[len(shown) :]:
        summary = node("summary", f"and {len(more)} more")
        said.append(node("details", summary, bullets(more)))
    head = node("h2", "Verdict")
    return node("section", head, *said, class_=f"verdict {verdict.tone}")


def answer_html(answer: _verdict.Answer) -> Html:
    """Write the answer of a calibration, its values in large type."""
    values = [
        node("div", node("dt", name), node("dd", value, node("small", interval)))
        for name, value, interval in answer.values[: _verdict.MOST_VALUES]
    ]
    size = "values" if len(answer.values) <= _LARGE else "values many"
    content: list[Part] = [f"Possible mistake: {text}" for text in answer.mistakes]
    content.append(node("dl", *values, class_=size))
    left = len(answer.values) - _verdict.MOST_VALUES
    if left > 0:
        content.append(node("p", node("a", f"and {left} more", href="#parameters")))
    content.append(_verdict_html(answer.verdict, _verdict.MOST_REASONS))
    content += [*answer.held_out, f"Next: {answer.next_step}"]
    content.append(node("p", answer.scope, class_="kind"))
    return node("div", *parts_html(content), class_="answer")


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
    content: list[Part]
    content = ["This result was made in Python, so no command repeats it."]
    if named:
        words = ["softcal", command, *(file["file"] for file in named), *options]
        code = node("code", shlex.join([*words, "-o", out]))
        content = ["In the folder of this page:", node("pre", code)]
    for source in known if files is None else ():
        if source["changes"]:
            rows = [(key, repr(value)) for key, value in source["changes"].items()]
            of = f" of {source['project']['file']}" if len(known) > 1 else ""
            columns = "key of the project file", "value"
            text = (
                "Some values in the project file were overridden when it was loaded. "
                "Set them in the file, or pass them to load_project(changes=...):"
            )
            content += [text, text_table(f"Changes{of}", columns, rows)]
    read = [*(files or ()), *(file for source in known for file in _files_of(source))]
    if read:
        rows = dict.fromkeys((file["file"], file["sha256"]) for file in read)
        content.append(text_table("Input files", ("file", "SHA-256"), rows))
    return [
        Section("repeat", "How to repeat this run", content, folded=True),
        Section("made", "Settings, versions and times", _made(data), folded=True),
    ]


def _files_of(source: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """List a project file and the files that it names, relative to the results."""
    project = source["project"]
    folder = os.path.dirname(project["file"])
    place = lambda file: Path(os.path.normpath(os.path.join(folder, file))).as_posix()
    return [project, *({**f, "file": place(f["file"])} for f in source["files"])]


def _made(data: Mapping[str, Any]) -> list[Part]:
    """Tabulate settings, versions, times and files."""
    parts = {
        "Settings": dict(_flat(data.get("settings", {}))),
        "Versions": data.get("versions", {}),
        "Times": {k: f"{v:.2f} s" for k, v in data.get("timing_s", {}).items()},
        "Files": {name: _KINDS.get(Path(name).suffix, "") for name in data["files"]},
    }
    return [
        facts(title, {name: str(value) for name, value in rows.items()})
        for title, rows in parts.items()
        if rows
    ]


def _flat(settings: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Name nested settings by their path, like newton.rtol."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", "none" if value is None else value
