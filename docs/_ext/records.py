"""The committed benchmark records as a page: what each measures, plots, figures.

Directives `goals`, a table of them, and `records`, a section for each. The plots are
those of `python -m benchmarks plot`, drawn while the pages are built, so that neither
they nor the tables are older than the records.
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

import benchmarks
from benchmarks._compare import RECORDS, read_record
from benchmarks._page import plot_page
from benchmarks._problem import Goal, discover


def committed() -> dict[str, dict[str, Any]]:
    """Return the records by name."""
    return {path.stem: read_record(path) for path in sorted(RECORDS.glob("*.json"))}


def goals_of(content: Mapping[str, Any]) -> str:
    """Say how many goals of a record are met."""
    met = [goal["met"] for goal in content["goals"].values()]
    return f"{sum(met)} of {len(met)}" if met else "none set"


def shown(value: float | str) -> str:
    """Write a figure as the plots do."""
    return value if isinstance(value, str) else f"{value:.4g}"


def rows(content: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, value, goal and verdict of each figure, those with a goal first."""
    goals = content["goals"]
    for name in sorted(content["figures"], key=lambda name: name not in goals):
        value = content["figures"][name]
        if name not in goals:
            yield name, shown(value), "", ""
            continue
        goal = Goal.read(goals[name]["goal"])
        yield name, shown(value), str(goal), "met" if goal.met(value) else "**missed**"


def machine_of(content: Mapping[str, Any]) -> str:
    """Say what a record was measured on, and with what."""
    machine, versions = content["hardware"], content["versions"]
    text = (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB; "
        f"commit {versions['commit']}, Python {versions['python']}, "
        f"JAX {versions['jax']}"
    )
    for part, source in content.get("renewed", {}).items():
        text += f" (part {part} at commit {source['versions']['commit']})"
    return text


class Goals(SphinxDirective):
    """A table of all committed records."""

    def run(self) -> list[nodes.Node]:
        """Link to the section of each."""
        about = discover(benchmarks)
        lines = ["| benchmark | what it measures | goals met |", "|---|---|---|"]
        for name, content in committed().items():
            link = f"{{ref}}`{name} <record-{name}>`"
            what = about[name].replace("|", r"\|")
            lines.append(f"| {link} | {what} | {goals_of(content)} |")
        return self.parse_text_to_nodes("\n".join(lines))


class Records(SphinxDirective):
    """A section for each committed record."""

    def run(self) -> list[nodes.Node]:
        """Draw them and write the sections."""
        about, lines = discover(benchmarks), []
        for name, content in committed().items():
            self.env.note_dependency(str(RECORDS / f"{name}.json"))
            lines += self._section(name, about[name], content)
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)

    def _section(self, name: str, about: str, content: Mapping[str, Any]) -> list[str]:
        goals = content["goals"]
        alt = f"Plots of {name}: a line per figure with its value and its goal"
        head = [
            f"(record-{name})=",
            f"## {name}",
            "",
            f"{about} `python -m benchmarks run {name}`",
            "",
            f"Goals met: {goals_of(content)}. {machine_of(content)}.",
            "",
            ":::{container} record",
            f"```{{image}} {self._plot(name, content)}",
            f":alt: {alt}",
            "```",
            ":::",
            "",
            f"<details><summary>All {len(content['figures'])} figures</summary>",
            "",
            "| figure | value | goal | |" if goals else "| figure | value |",
            "|---|---|---|---|" if goals else "|---|---|",
        ]
        width = 4 if goals else 2
        table = [
            f"| {' | '.join((f'`{row[0]}`', *row[1:])[:width])} |"
            for row in rows(content)
        ]
        return [*head, *table, "", "</details>", ""]

    def _plot(self, name: str, content: Mapping[str, Any]) -> str:
        """Draw the plots of a record, and return the way there from this page."""
        folder = Path(self.env.doctreedir, "records")
        folder.mkdir(exist_ok=True)
        plot_page(content, folder / f"{name}.png")
        here = Path(self.env.doc2path(self.env.docname)).parent
        return Path(os.path.relpath(folder / f"{name}.png", here)).as_posix()


def setup(app: Any) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("goals", Goals)
    app.add_directive("records", Records)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
