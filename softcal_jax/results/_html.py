"""HTML in which every text is escaped, and the frame of a page with its last parts."""

import base64
import hashlib
import html
import re
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

from softcal_jax._process import installed_version
from softcal_jax._text import escaped
from softcal_jax.plotting import PictureStyle
from softcal_jax.results._made import COMMANDS
from softcal_jax.results._tree import MOST_REASONS, Chart, Section, Table, listed_texts

_CHART, _SMALL = (PictureStyle(width, font_size=10.0) for width in (150.0, 100.0))
_WIDE = 2  # most charts of a section that are as wide as the page
_LARGE = 3  # most values that are written in large type
_MARKED = "A triangle marks values that should not be used as they are."

_VOID = {"br", "img", "input", "meta"}  # elements without content or an end
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a page may load: its own styles and pictures, and nothing by network.

The only script that it runs is that of its view, which it knows by the hash.
"""


class Html(str):
    """A text that is HTML already; any other text is escaped where it enters a page."""

    __slots__ = ()


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
    return files("softcal_jax.results").joinpath(name).read_text("utf-8")


def template(file: str, /, **parts: str | Iterable[str]) -> Html:
    """Fill a frame of HTML, without its indents; escaping is that of `node`."""
    frame = Template(re.sub(r"\n\s*", "", resource(file)))
    every = {k: [v] if isinstance(v, str) else v for k, v in parts.items()}
    return Html(frame.substitute({k: _body(v) for k, v in every.items()}))


def joined(parts: Iterable[Html]) -> Html:
    """Put pieces of HTML one after the other."""
    return Html("\n".join(parts))


def section_html(section: Section) -> Html:
    """Write a section: texts, tables, charts."""
    texts = listed_texts(section.text)
    alone = [sentence for sentence, is_item in texts if not is_item]
    items = [sentence for sentence, is_item in texts if is_item]
    if len(alone) > 1 and not items:
        alone, items = [], alone
    content = [node("p", sentence) for sentence in alone]
    if section.key == COMMANDS:
        content += [node("pre", node("code", line)) for line in items]
    else:
        content.append(bullets(items))
    content += [table_html(table) for table in section.tables if table]
    style = _CHART if len(section.charts) <= _WIDE else _SMALL
    drawn = [chart_html(chart, style) for chart in section.charts]
    content += drawn if style is _CHART else [node("div", *drawn, class_="charts")]
    return framed(section, content)


def framed(section: Section, content: Iterable[Html]) -> Html:
    """Write the heading of a section around its content."""
    head, more = node("h2", section.title), joined(content)
    if section.folded:
        return node("details", node("summary", head), more, id=section.key)
    return node("section", head, more, id=section.key)


def bullets(lines: Iterable[str]) -> Html:
    """Make a list of sentences, or nothing if there are none."""
    items = [node("li", line) for line in lines]
    return node("ul", *items) if items else Html("")


def table_html(table: Table) -> Html:
    """Write a table that scrolls by itself where the page is too narrow for it."""
    words = [k == 0 or c.holds_words for k, c in enumerate(table.columns)]
    kinds = ["w" if is_words else "n" for is_words in words]
    heads = zip(table.columns, kinds, strict=True)
    head = (node("th", c.title, scope="col", class_=kind) for c, kind in heads)
    tones = [[cell.tone for cell in column.cells] for column in table.columns]
    rows, marked = [], False
    for texts, toned in zip(table.rows(), zip(*tones, strict=True), strict=True):
        (first, _, _), *others = zip(texts, toned, kinds, strict=True)
        cells = (node("td", t, class_=f"{kind} {tone}") for t, tone, kind in others)
        rows.append(node("tr", node("th", first, scope="row"), *cells))
        marked |= any(tone == "bad" and kind == "n" for _, tone, kind in others)
    parts = [node("caption", table.title)]
    if any(column.title for column in table.columns):
        parts.append(node("thead", node("tr", *head)))
    drawn = node("table", *parts, node("tbody", *rows))
    about = {"role": "region", "aria_label": table.title, "tabindex": "0"}
    notes = (node("p", note) for note in (_MARKED * marked, table.note) if note)
    return joined([node("div", drawn, class_="wide", **about), *notes])


def picture(path: Path, alt: str) -> Html:
    """Write a PNG or SVG file into the page, as an image, which runs no scripts."""
    kind = "svg+xml" if path.suffix == ".svg" else "png"
    content = base64.b64encode(path.read_bytes()).decode()
    return node("img", src=f"data:image/{kind};base64,{content}", alt=alt)


def chart_html(chart: Chart, style: PictureStyle = _CHART) -> Html:
    """Draw a chart into the page, with what it is in bold above it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chart.svg"
        chart.plot(path, style=style)
        drawn = node("div", picture(path, chart.title), class_="chart")
    return figure(drawn, chart.caption, title=chart.title)


def figure(content: Html, caption: str, *, title: str = "") -> Html:
    """Make a figure with a caption below it and, if given, a title above it."""
    head = [node("p", node("strong", title))] if title else []
    return node("figure", *head, content, node("figcaption", caption))


def page(
    name: str,
    kind: str,
    tree: Sequence[Section],
    *,
    index: str,
    units: str = "SI and mm",
    script: str = "",
    robot: Html | None = None,
    drawn: Mapping[str, Html] | None = None,
) -> str:
    """Write a whole page.

    `kind` is what was done, like "Calibration". Sections without content are left out;
    those without a title come first, beside a picture of the `robot`. `index` is the
    file with the same numbers in `units`. `script` is the text of the only script that
    the page may run. `drawn` are sections that were written already, by their keys.
    """
    policy = _POLICY
    if script:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        policy += f"; script-src 'sha256-{digest}'"
    ready = drawn or {}
    shown = [s for s in tree if s.title and (s or s.key in ready)]
    links = (
        node("li", node("a", section.title, href=f"#{section.key}"))
        for section in shown
        if not section.folded
    )
    first = joined(head_html([section for section in tree if not section.title]))
    if robot is not None:
        first = node("div", node("div", first), node("div", robot), class_="first")
    whole = template(
        "page.html",
        policy=policy,
        name=name,
        kind=kind,
        done=kind.lower(),
        style=Html(resource("page.css")),
        first=first,
        links=links,
        sections=(ready.get(s.key) or section_html(s) for s in shown),
        version=installed_version("softcal-jax"),
        when=time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
        units=units,
        index=index,
        script=[node("script", Html(script))] if script else "",
    )
    return f"<!DOCTYPE html>\n{whole}\n"


def head_html(head: Sequence[Section]) -> list[Html]:
    """Write what a result begins with: its verdict, and values in large type.

    Reasons beyond the first few are folded where there is more than a verdict.
    """
    most = MOST_REASONS if len(head) > 1 else None
    parts: list[Html] = []
    for section in head:
        if section.key == "verdict":
            parts.append(_verdict_html(section, most))
            continue
        parts += [node("p", sentence) for sentence in section.text]
        for table in filter(None, section.tables):
            rows = table.rows()
            values = (
                node("div", node("dt", name), node("dd", value, node("small", more)))
                for name, value, more in rows
            )
            size = "values" if len(rows) <= _LARGE else "values many"
            parts.append(node("dl", *values, class_=size))
            if table.note:
                link = node("a", table.note, href="#parameters")
                parts.append(node("p", link))
    return [node("div", *parts, class_="answer")] if len(head) > 1 else parts


def _verdict_html(verdict: Section, most: int | None) -> Html:
    sentence, *reasons = verdict.text
    shown = reasons[:most]
    said = [node("p", node("strong", sentence)), bullets(shown)]
    if more := reasons[len(shown) :]:
        summary = node("summary", f"and {len(more)} more")
        said.append(node("details", summary, bullets(more)))
    tone = f"verdict {verdict.tone}"
    return node("section", node("h2", "Verdict"), *said, class_=tone)
