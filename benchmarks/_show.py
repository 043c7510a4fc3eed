"""Tables of outcomes and comparisons on the terminal."""

import sys

from rich.console import Console
from rich.table import Table

from benchmarks._compare import Change, Comparison
from benchmarks._problem import Figure, Outcome

_STYLES = {"worse": "bold red", "gone": "bold red", "better": "green"}


def show_outcome(name: str, outcome: Outcome) -> None:
    """Print the tables of a problem, then its figures beside their goals."""
    console = _console()
    for given in outcome.tables:
        table = Table(title=given.title, title_justify="left")
        for i, column in enumerate(given.columns):
            table.add_column(column, justify="right" if i else "left")
        for row in given.rows:
            table.add_row(*row)
        console.print(table)
    figures = Table(title=f"{name}: figures", title_justify="left")
    figures.add_column("figure")
    figures.add_column("value", justify="right")
    if outcome.goals:
        figures.add_column("goal")
    for figure, value in outcome.figures.items():
        goal = outcome.goals.get(figure)
        verdict = "" if goal is None else f"{goal}: {_verdict(goal.met(value))}"
        figures.add_row(figure, _shown(value), *([verdict] if outcome.goals else []))
    console.print(figures)


def show_comparison(comparison: Comparison) -> None:
    """Print every figure then and now, with its ratio and what it means."""
    console = _console()
    table = Table(title=f"{comparison.name}: now over record", title_justify="left")
    table.add_column("figure")
    for column in ("record", "now", "ratio", "noise"):
        table.add_column(column, justify="right")
    table.add_column("better")
    table.add_column("verdict")
    for change in comparison.changes:
        table.add_row(*_row(change), style=_STYLES.get(change.verdict))
    console.print(table)
    for warning in comparison.warnings:
        console.print(f"warning: {warning}", markup=False, highlight=False)


def _row(change: Change) -> list[str]:
    return [
        change.figure,
        _shown(change.before),
        _shown(change.now),
        "" if change.ratio is None else f"{change.ratio:.3g}",
        f"{100 * change.allowed:.0f} %" if change.allowed else "",
        "" if change.better == "either" else change.better,
        "" if change.verdict == "same" else change.verdict,
    ]


def _shown(value: Figure | None) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.4g}"


def _console() -> Console:
    # In a file or a pipe, a name that is cut helps no one.
    return Console(width=None if sys.stdout.isatty() else 120)


def _verdict(met: bool) -> str:
    return "met" if met else "MISSED"
