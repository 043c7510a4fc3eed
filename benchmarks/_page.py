"""One page of plots of any record: its goals, its other figures, its samples."""

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from benchmarks._problem import Goal, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNITS = {
    "s": "time [s]",
    "ms": "time [ms]",
    "us": "time [us]",
    "mb": "memory [MB]",
    "gb": "memory [GB]",
    "kb": "memory [kB]",
    "bytes": "memory [bytes]",
    "m": "length [m]",
    "mm": "length [mm]",
    "deg": "angle [deg]",
    "percent": "share [%]",
    "kPa": "modulus [kPa]",
}
"""Titles of panels, by the last word of a name."""

_ROW = 0.27
"""Height of a line of a panel [inch]."""

_MOST_ROWS = 30
"""More lines than this go into a panel of their own."""

_FARTHEST = 10.0
"""Where what is farther from its goal than the axis goes is drawn [-]."""

_DECADES = 1.5
"""Positive values that span more powers of ten than this get a log axis."""


def plot_page(content: Mapping[str, Any], path: Path) -> None:
    """Draw the page of one problem.

    Args:
        content: The record.
        path: PNG file; replaced if it exists.
    """
    from matplotlib.figure import Figure as Drawing

    from softcal_jax.plotting._figure import TEXT

    head, panels = _head(content), _panels(content)
    heights = [1.0 + _ROW * len(panel.values) for panel in panels]
    top = 0.75 + 0.2 * len(head)
    total = top + sum(heights)
    drawing = Drawing(figsize=(13.0, total), dpi=100)
    drawing.text(0.02, 1 - 0.3 / total, content["name"], fontsize=18, va="center")
    drawing.text(
        0.02, 1 - 0.55 / total, "\n".join(head), fontsize=10, va="top", color=TEXT
    )
    at = top
    for panel, height in zip(panels, heights, strict=True):
        bottom = 1 - (at + height - 0.55) / total
        axes = drawing.add_axes((0.36, bottom, 0.61, (height - 0.9) / total))
        panel.draw(axes, panel.values)
        axes.set_title(panel.title, fontsize=12, loc="left")
        _finish(axes, list(panel.values))
        at += height
    drawing.savefig(path, dpi=100, format="png")


class _Panel(NamedTuple):
    """A diagram with one line per name."""

    title: str
    values: Mapping[str, Any]
    draw: "Callable[[Axes, Mapping[str, Any]], None]"


def _panels(content: Mapping[str, Any]) -> list[_Panel]:
    """Figures with goals, other figures by unit, samples by unit."""
    goals = {
        name: (content["figures"][name], Goal.read(goal["goal"]))
        for name, goal in content["goals"].items()
        if not isinstance(content["figures"][name], str)
    }
    figures = {
        name: value
        for name, value in content["figures"].items()
        if name not in goals and not isinstance(value, str)
    }
    samples = {k: v for k, v in content["samples"].items() if len(v) > 1}
    panels = [_Panel("goals: how many times better than asked", goals, _draw_goals)]
    panels += _by_unit("figures", figures, _draw_figures)
    panels += _by_unit("samples", samples, _draw_samples)
    return [panel for panel in panels if panel.values]


def _head(content: Mapping[str, Any]) -> list[str]:
    """Machine, versions, and figures that are words."""
    machine, versions = content["hardware"], content["versions"]
    load = machine.get("load_before")
    lines = [
        f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB, "
        f"{machine['os']}" + ("" if load is None else f", load before {load:.1f}"),
        f"softcal_jax {versions['softcal_jax']} ({versions['commit']}), Python "
        f"{versions['python']}, JAX {versions['jax']}",
    ]
    for name, value in content["figures"].items():
        if isinstance(value, str):
            asked = content["goals"].get(name)
            goal = f" (goal {asked['goal']}: missed)" if asked else ""
            lines.append(f"{name}: {value}{goal}")
    return lines


def _by_unit(kind: str, named: Mapping[str, Any], draw) -> list[_Panel]:
    """Panels of what has one unit; numbers by the last word of the name."""
    words = [unit_of(name) for name in named]
    groups: dict[str, dict[str, Any]] = {}
    for (name, value), word in zip(named.items(), words, strict=True):
        what = f"..._{word} [-]" if words.count(word) > 1 else "others [-]"
        title = UNITS.get(word, what)
        groups.setdefault(title, {})[name] = value
    panels = []
    for title, members in groups.items():
        names = list(members)
        for i in range(0, len(names), _MOST_ROWS):
            part = {name: members[name] for name in names[i : i + _MOST_ROWS]}
            panels.append(_Panel(f"{kind}: {title}", part, draw))
    return panels


def _draw_goals(axes: "Axes", goals: Mapping[str, tuple[float, Goal]]) -> None:
    """How far each figure is beyond its goal, or short of it, on a log axis."""
    from softcal_jax.plotting._figure import BAD, FAINT, GOOD

    axes.set_xscale("log")
    axes.set_xlim(0.8 / _FARTHEST, 4.0 * _FARTHEST)
    axes.axvline(1.0, color=FAINT, lw=1.5)
    for row, (value, goal) in enumerate(goals.values()):
        met = goal.met(value)
        colour, marker = (GOOD, "o") if met else (BAD, "X")
        at = _margin(value, goal)
        axes.plot([at], [row], marker, color=colour, ms=8)
        _number(axes, (at, row), f"{value:.4g}  (goal {goal})", colour)


def _margin(value: float, goal: Goal) -> float:
    """How many times better than its goal a figure is; within the axis [-]."""
    if goal.sense == "at least":
        over, under = value, goal.bound
    elif goal.sense == "at most":
        over, under = goal.bound, value
    else:
        over, under = min(value, goal.upper), max(value, goal.bound)
    if over == under or (goal.sense == "between" and goal.met(value)):
        return 1.0
    if over <= 0.0 or under <= 0.0:
        return _FARTHEST if goal.met(value) else 1.0 / _FARTHEST
    return min(max(over / under, 1.0 / _FARTHEST), _FARTHEST)


def _number(axes: "Axes", at: tuple[float, float], text: str, colour: str) -> None:
    axes.annotate(
        text,
        at,
        (9, 0),
        textcoords="offset points",
        va="center",
        fontsize=9,
        color=colour,
    )


def _draw_figures(axes: "Axes", figures: Mapping[str, float]) -> None:
    """A dot and a number per figure."""
    from softcal_jax.plotting._figure import SERIES

    _scale(axes, list(figures.values()))
    for row, value in enumerate(figures.values()):
        axes.plot([value], [row], "o", color=SERIES[0], ms=8)
        _number(axes, (value, row), f"{value:.4g}", SERIES[0])
    # The number stands beside the dot and needs room on the right.
    axes.margins(x=0.15)
    if axes.get_xscale() == "linear" and min(figures.values()) >= 0:
        axes.set_xlim(0.0, 1.2 * max(figures.values()) or 1.0)


def _draw_samples(axes: "Axes", samples: Mapping[str, Sequence[float]]) -> None:
    """Every repeat as a dot, and a line at the median."""
    from softcal_jax.plotting._figure import SERIES, TEXT

    _scale(axes, [value for values in samples.values() for value in values])
    for row, values in enumerate(samples.values()):
        axes.plot(values, [row] * len(values), "o", color=SERIES[0], ms=4, alpha=0.5)
        axes.plot([statistics.median(values)], [row], "|", color=TEXT, ms=13, mew=2)


def _scale(axes: "Axes", values: Sequence[float]) -> None:
    """A logarithmic axis for what spans powers of ten."""
    sizes = sorted(abs(value) for value in values if value)
    wide = bool(sizes) and math.log10(sizes[-1] / sizes[0]) > _DECADES
    if wide and min(values) > 0:
        axes.set_xscale("log")
    elif wide and min(values) < 0:
        axes.set_xscale("symlog", linthresh=sizes[len(sizes) // 4])


def _finish(axes: "Axes", names: Sequence[str]) -> None:
    from softcal_jax.plotting._figure import FAINT

    axes.set_yticks(range(len(names)), names, fontsize=9)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="x", labelsize=9)
    axes.grid(True, axis="x", color=FAINT, alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
