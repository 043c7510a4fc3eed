"""Every message that a wrong input can be answered with, each with an anchor.

Directive `messages`. They are read from the source of the package: the texts of what it
raises, with an ellipsis in the place of values. Errors about a project file name the
file and the key before such a text.
"""

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

import softcal_jax

VALUE = "\N{HORIZONTAL ELLIPSIS}"
"""What stands in the place of a value."""

LEAST_WORDS = 2
"""A message of fewer words of its own hands on that of another error."""


FIRST, LAST = "softcal_jax.project", "softcal_jax"
"""What most are looked for of, and what has those of no package."""


def messages() -> dict[str, list[str]]:
    """Return the messages by the package that raises them."""
    found: dict[str, list[str]] = {}
    root, anchors = Path(softcal_jax.__file__).parent, set()
    for path in sorted(root.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts = _texts(tree)
        for message in _raised(tree, texts):
            # The same words with and without quotes are one message to a reader.
            if (own := anchor(message)) not in anchors:
                anchors.add(own)
                folder = path.relative_to(root).parts[:-1]
                package = ".".join(["softcal_jax", *folder[:1]])
                found.setdefault(package, []).append(message)
    place = {FIRST: 0, LAST: 2}
    return dict(sorted(found.items(), key=lambda own: place.get(own[0], 1)))


def anchor(message: str) -> str:
    """Return the anchor of a message: its own words, and `x` for a value."""
    words = re.findall(r"[a-z0-9_]+", message.lower().replace(VALUE, " x "))
    return "-".join(["message", *words])


def _raised(tree: ast.Module, texts: Mapping[str, ast.expr]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in node.exc.args:
                text = _text(argument, texts)
                if len(re.findall(r"[a-z]{2,}", text)) >= LEAST_WORDS:
                    yield text


def _texts(tree: ast.Module) -> dict[str, ast.expr]:
    """Return texts that are given a name before they are raised."""
    return {
        target.id: node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def _text(node: ast.expr, texts: Mapping[str, ast.expr]) -> str:
    """Return a string as it is written, with `VALUE` for what it is given."""
    if isinstance(node, ast.Name) and isinstance(texts.get(node.id), ast.JoinedStr):
        node = texts[node.id]
    if isinstance(node, ast.Constant):
        return str(node.value)
    if not isinstance(node, ast.JoinedStr):
        return VALUE
    parts = [
        str(part.value) if isinstance(part, ast.Constant) else VALUE
        for part in node.values
    ]
    if len(parts) > 1 and parts[0] == VALUE and parts[1].startswith(": "):
        # The file, which all messages begin with.
        parts = [parts[1].removeprefix(": "), *parts[2:]]
    if len(parts) > 1 and parts[-1] == VALUE and parts[-2].endswith("."):
        parts.pop()  # a hint, where there is one
    return "".join(parts)


class Messages(SphinxDirective):
    """A section with a list for each package."""

    def run(self) -> list[nodes.Node]:
        """List them."""
        sections: list[nodes.Node] = []
        for package, own in messages().items():
            items = []
            for message in own:
                text = nodes.paragraph("", "", nodes.literal(message, message))
                items.append(nodes.list_item("", text, ids=[anchor(message)]))
            title = nodes.title(package, package)
            section = nodes.section("", title, nodes.bullet_list("", *items))
            section["ids"] = [f"messages-{package.rpartition('.')[2]}"]
            section["classes"] = ["messages"]
            sections.append(section)
        return sections


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("messages", Messages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
