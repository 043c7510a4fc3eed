"""Figures: their files, colours and symbols, and what is drawn around a body."""

from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text
else:  # imported for a picture only, since that takes a while
    Axes = Figure = Text = Any

DPI = 100  # pixels per inch of figures and of the images within them


def pixel_figure(width: float, height: float) -> Figure:
    """Make a white figure of a size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")


def add_axes(figure: Figure, *box: float) -> Axes:
    """Add axes in a box of pixels: its left, bottom, width and height."""
    x, y = DPI * figure.get_size_inches()
    left, bottom, width, height = box
    return figure.add_axes((left / x, bottom / y, width / x, height / y))


def add_view(figure: Figure, *box: float, scale: float) -> Axes:
    """Add axes in metres around the centre of a view; the scale is in pixels per m."""
    axes = add_axes(figure, *box)
    w, h = 0.5 * box[2] / scale, 0.5 * box[3] / scale
    axes.set(xlim=(-w, w), ylim=(-h, h))
    axes.set_axis_off()
    return axes


def save(figure: Figure, path: str | Path, software: str = "softcal_jax") -> None:
    """Write a figure as PNG or SVG, according to the ending of the file's name.

    The same figure gives the same file: without a date, and with the same ids. The file
    names the software that drew it.

    Raises:
        ValueError: If the name ends in something else.
    """
    import matplotlib as mpl

    suffix = Path(path).suffix.lower()
    if suffix not in (".png", ".svg"):
        raise ValueError(
            f"{path} ends in {Path(path).suffix!r}; expected a picture, .png or .svg."
        )
    about = {"Software": software}
    if suffix == ".svg":
        about = {"Creator": software, "Date": None}
    with mpl.rc_context({"svg.hashsalt": "softcal_jax"}):
        figure.savefig(path, dpi=DPI, format=suffix[1:], metadata=about)


MEASURED = "#e3001b"
SIMULATED = "#000000"
OUTLINE = "#8a8a8a"
TEXT = "#1a1a1a"
FAINT = "#6b6b6b"
GOOD = "#1b7837"
BAD = "#c00000"

SERIES = ("#0b5fa5", "#d95f02", "#1b9e77", "#7570b3", "#a6761d", "#e7298a", "#444444")
"""Colours of the lines of a diagram, in order."""

DISPLACEMENT_MAP = "viridis"
"""Colour map that is perceptually uniform and avoids the markers' black and red."""

# What is drawn beside the soft body.
CABLE, WALL, MOTOR = "#d95f02", "#0b5fa5", "#7b3294"
FORCE, RIGID, OBSTACLE = "#1b7837", "#b4b4b4", "#9aa0a6"

# How the body is held, and its weight.
SUPPORT, GRAVITY = "#8c510a", "#4d4d4d"
FIBRE = "#5e3c99"

MARKS = {
    "measured": MEASURED,
    "simulated": SIMULATED,
    "at rest": OUTLINE,
    "cable": CABLE,
    "wall": WALL,
    "motor": MOTOR,
    "force": FORCE,
    "load": FORCE,
    "gravity": GRAVITY,
    "rigid": RIGID,
    "obstacle": OBSTACLE,
    "frame": GRAVITY,
    "fibre": FIBRE,
}
"""Colours by what they mark, for a page that draws by itself."""

_POINT = {"ls": "none", "ms": 13, "mew": 2.5}

SYMBOLS: dict[str, dict[str, Any]] = {
    "measured": _POINT | {"marker": "o", "mec": MEASURED, "mfc": "none"},
    "simulated": _POINT | {"marker": "+", "mec": SIMULATED},
    "distance": {"color": MEASURED, "lw": 2.5},
    "at rest": {"color": OUTLINE, "lw": 2.5},
    "point at rest": _POINT | {"marker": "+", "mec": SIMULATED},
    "control point": _POINT | {"marker": "o", "ms": 16, "mec": TEXT, "mfc": "white"},
    "fibre": {"color": FIBRE, "lw": 1.6},
    "support": {"marker": "s", "ms": 9, "ls": "none", "color": SUPPORT, "alpha": 0.7},
    "load": {"color": FORCE, "lw": 3.0, "marker": "v", "ms": 8},
    "gravity": {"color": GRAVITY, "lw": 3.0, "marker": "v", "ms": 8},
    "sensor's axes": {"color": SIMULATED, "lw": 2.2},
    "rigid body": {"color": RIGID, "lw": 9.0},
    "obstacle": {"color": OBSTACLE, "lw": 9.0, "alpha": 0.5},
    "cable": {"color": CABLE, "lw": 3.0},
    "wall under pressure": {"color": WALL, "lw": 9.0, "alpha": 0.5},
    "motor": {"color": MOTOR, "lw": 2.5, "ls": "-.", "marker": "o"},
    "force": {"color": FORCE, "lw": 3.0, "marker": ">"},
}
"""Styles of lines and points by what they mark, in the order of the legend."""

WARNING_HEIGHT = 60  # of the band above the title [pixels]
_MOST_NAMES = 16  # markers that are named; more names would cover each other


def halo(width: float):
    """Make a white rim for lines and text, so that they show on any background."""
    from matplotlib import patheffects

    return [patheffects.withStroke(linewidth=width, foreground="white")]


def draw_name(axes: Axes, text: str, place, offset, **style) -> None:
    """Write a name beside a place, at an offset in points."""
    style = {"fontsize": 15, "color": TEXT, "path_effects": halo(4.0), **style}
    where = {"xytext": offset, "textcoords": "offset points"}
    axes.annotate(text, place, **where, **style, parse_math=False)


def separate_names(axes: Axes) -> None:
    """Move names up or down until none covers another, and into the axes."""
    frame, placed = axes.get_window_extent(), []
    points = 72.0 / axes.figure.dpi
    from matplotlib.text import Annotation

    for text in axes.texts:
        if not text.get_text() or not isinstance(text, Annotation):
            continue
        box = text.get_window_extent()
        over = max(box.x1 - frame.x1, 0.0) + min(box.x0 - frame.x0, 0.0)
        x, y = text.xyann
        room = box.height
        ways = [0.0, *(sign * k * room for k in (1, 2, 3) for sign in (1, -1))]
        boxes = [box.translated(-over, way) for way in ways]
        free = (i for i, b in enumerate(boxes) if not any(map(b.overlaps, placed)))
        best = next(free, 0)
        text.xyann = (x - points * over, y + points * ways[best])
        placed.append(boxes[best])


def draw_markers(
    axes: Axes,
    measured: Float[HostArray, "n_measured 2"],
    simulated: Float[HostArray, "n_simulated 2"],
    names: Sequence[str],
) -> None:
    """Draw rings where markers were measured, crosses where they are simulated."""
    if len(measured) and len(simulated):
        for pair in zip(measured, simulated, strict=True):
            axes.plot(*np.transpose(pair), **SYMBOLS["distance"])
    for name, points in (("measured", measured), ("simulated", simulated)):
        if len(points):
            axes.plot(*points.T, path_effects=halo(5.0), **SYMBOLS[name])
    if len(names) > _MOST_NAMES:
        return
    places = measured if len(measured) else simulated
    for name, place in zip(names, places, strict=False):
        if np.isfinite(place).all():
            draw_name(axes, name, place, (13, 10))


def draw_title(axes: Axes, title: str, subtitle: str, warning: str) -> None:
    """Draw a title and a line below it, and a warning as a band above."""
    width, height = axes.get_window_extent().size
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    top = 0
    if warning:
        axes.axhspan(0, WARNING_HEIGHT, color=BAD, lw=0)
        _line(axes, 0.5 * WARNING_HEIGHT, warning, 20, weight="bold", color="white")
        top = WARNING_HEIGHT
    _line(axes, top + 40, title, 23, weight="bold", color=TEXT)
    _line(axes, top + 90, subtitle, 18, color=TEXT)


def _line(axes: Axes, y: float, text: str, size: float, **style):
    """Draw one line of text, as large as given or as fits the width."""
    style = {"fontsize": size, "va": "center", "parse_math": False, **style}
    shrink(axes.text(24, y, text, **style), axes.get_xlim()[1] - 48)


def shrink(text: Text, room: float) -> None:
    """Make a text smaller until it fits a width [pixels]."""
    size = float(text.get_fontsize())
    # Step by step: hinting rounds letters, so width is not linear in size.
    while size > 1.0 and text.get_window_extent().width > room:
        size *= 0.95
        text.set_fontsize(size)


def draw_colour_scale(axes: Axes, largest_mm: float) -> None:
    """Draw the colour scale of the body's displacement."""
    import matplotlib
    from matplotlib.cm import ScalarMappable
    from matplotlib.colorbar import Colorbar
    from matplotlib.colors import Normalize

    colours = ScalarMappable(
        Normalize(0.0, largest_mm or 1.0), matplotlib.colormaps[DISPLACEMENT_MAP]
    )
    bar = Colorbar(axes, colours)
    bar.set_label("displacement [mm]", fontsize=17, color=TEXT)
    bar.ax.tick_params(labelsize=15)
    bar.ax.set_title(f"max {largest_mm:.3g}", fontsize=15, color=TEXT, pad=10)


def draw_triad(axes: Axes, view: View) -> None:
    """Draw the directions of the axes x, y, z."""
    tips = np.stack([view.right, view.up], axis=1)
    low, high = np.minimum(tips.min(axis=0), 0.0), np.maximum(tips.max(axis=0), 0.0)
    half, middle = 0.5 * np.max(high - low) + 0.45, 0.5 * (low + high)
    axes.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    axes.set_axis_off()
    for i in np.argsort(view.towards):  # draw what points away first
        tip, colour = tips[i], ("#c0392b", "#1e8449", "#1f4fa0")[i]
        arrow = {"arrowstyle": "-|>", "lw": 2.5, "mutation_scale": 14, "color": colour}
        arrow |= {"shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (tip[0], tip[1]), (0.0, 0.0), arrowprops=arrow)
        length = np.linalg.norm(tip)
        away = tip / length * (length + 0.28) if length > 0.1 else np.full(2, 0.2)
        style = {"fontsize": 15, "color": colour, "weight": "bold"}
        axes.text(away[0], away[1], "xyz"[i], ha="center", va="center", **style)


def draw_length_scale(axes: Axes, width: float) -> None:
    """Draw a bar of a round length; `width` is that of the axes [m]."""
    axes.set(xlim=(0, width), ylim=(0, 1))
    axes.set_axis_off()
    power = 10.0 ** np.floor(np.log10(0.6 * width))
    length = max(s * power for s in (1, 2, 5) if s * power <= 0.6 * width)
    right = 0.97 * width
    axes.plot([right - length, right], [0.25, 0.25], color=TEXT, lw=3)
    for x in (right - length, right):
        axes.plot([x, x], [0.12, 0.38], color=TEXT, lw=3)
    middle, text = right - 0.5 * length, f"{1e3 * length:g} mm"
    axes.text(middle, 0.5, text, fontsize=15, color=TEXT, ha="center")


def draw_legend(
    figure: Figure, drawn: Container[str], height: float, labels: Mapping[str, str]
) -> None:
    """Explain the drawn `SYMBOLS`, at a height [-]; `labels` replace some names."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], label=labels.get(name, name), **style)
        for name, style in SYMBOLS.items()
        if name in drawn
    ]
    place = {"loc": "center left", "bbox_to_anchor": (0.12, height)}
    style = {"fontsize": 15, "frameon": False, "labelcolor": TEXT, "columnspacing": 1.6}
    figure.legend(handles=handles, ncols=min(len(handles), 5), **place, **style)


def draw_faces(
    axes: Axes,
    view: View,
    corners: Float[HostArray, "n_faces 3 3"],
    colours: Float[HostArray, "n_faces 3"],
) -> None:
    """Draw faces in their order, with edges a little darker; as pixels in SVG."""
    look = {"facecolors": colours, "edgecolors": 0.85 * colours, "lw": 0.4}
    draw_patch(axes, view, corners, **look, rasterized=True)


def draw_patch(
    axes: Axes, view: View, corners: Float[HostArray, "n_faces 3 3"], **look: Any
) -> None:
    """Draw faces in their order."""
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(view.project(corners)), **look))


def draw_arrow(axes: Axes, start, end, colour: str) -> None:
    """Draw the arrow of a force or of gravity."""
    look = {"arrowstyle": "-|>", "color": colour, "lw": 3.0, "mutation_scale": 20}
    look |= {"shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(end), tuple(start), arrowprops=look)


def draw_control_points(axes: Axes, places: Float[HostArray, "n 2"]) -> None:
    """Mark control points by their numbers, from 1."""
    axes.plot(*places.T, **SYMBOLS["control point"], clip_on=False, zorder=5)
    style = {"ha": "center", "va": "center", "fontsize": 10, "color": TEXT}
    for i, (x, y) in enumerate(places, start=1):
        axes.text(x, y, str(i), **style, zorder=6)


def draw_frame(
    figure: Figure,
    view: View,
    *,
    scale: float,
    top: int,
    bottom: int,
    title: str,
    subtitle: str = "",
    warning: str = "",
) -> None:
    """Draw what is around a body: titles above, axes and a length below.

    `scale` is in pixels per metre, the heights above and below in pixels.
    """
    width, height = DPI * figure.get_size_inches()
    heading = add_axes(figure, 0, height - top, width, top)
    draw_title(heading, title, subtitle, warning)
    draw_triad(add_axes(figure, 20, 5, bottom - 15, bottom - 15), view)
    draw_length_scale(add_axes(figure, width - 280, 20, 260, 70), 260 / scale)
