"""Figures: their files, colours and symbols, and what is drawn around a body."""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text
else:  # imported for a picture only, since that takes a while
    Axes = Figure = Legend = Text = Any

INCH = 25.4  # [mm]
PICTURES = ".png", ".svg", ".pdf"
"""Endings of files that a picture can be written to."""

_DPI, _WORDS = 100.0, 15.0  # of what is laid out: pixels per inch, size of words [pt]
_LEAST_WIDTH = 5.0  # of a picture, over the size of its words [mm/pt]


@dataclass(frozen=True)
class PictureStyle:
    """Size of a picture on paper or on a screen, and where a body is seen from.

    Attributes:
        width_mm: Its width [mm].
        font_size: Size of its words [pt]; lines, symbols and margins go with it.
        dpi: Pixels per inch of a .png, and of what is an image in a .pdf or .svg.
        seen_from: Direction from a body towards the viewer, like (1, -1, 0.5); by
            default across its longest axis and its motion.

    Raises:
        ValueError: If one is not positive, the words are too large for the width, or
            `seen_from` is no direction.
    """

    width_mm: float = 88.0
    font_size: float = 8.0
    dpi: float = 300.0
    seen_from: tuple[float, float, float] | None = None

    def __post_init__(self):
        least = _LEAST_WIDTH * self.font_size
        if not (self.width_mm >= least > 0.0 and self.dpi > 0.0):
            raise ValueError(
                "width_mm must be at least 5 times font_size, and font_size and dpi "
                f"above 0; got width_mm={self.width_mm}, font_size={self.font_size}, "
                f"dpi={self.dpi}."
            )
        seen = (0.0, 0.0, 1.0) if self.seen_from is None else self.seen_from
        if np.shape(seen) != (3,) or not 0.0 < np.linalg.norm(seen) < np.inf:
            raise ValueError(f"seen_from must be a direction in space, got {seen}.")

    @property
    def pixels(self) -> int:
        """Width as it is laid out: in pixels, beside words of 15 points."""
        return round(self.width_mm / INCH * _DPI * _WORDS / self.font_size)


COLUMN = PictureStyle()
"""A column of a journal that has two."""

SCREEN = PictureStyle(16.0 * INCH, _WORDS, _DPI)
"""1600 pixels, as pages show them."""


@contextmanager
def printed(
    path: str | Path,
    style: PictureStyle = COLUMN,
    *,
    height: float,
    software: str = "softcal_jax",
) -> Iterator[Figure]:
    """Make a figure to draw into, and write it as PNG, SVG or PDF when the block ends.

    The same figure gives the same file: without a date, and with the same ids. The file
    names the software that drew it. Words in SVG and PDF are text, in fonts that
    journals take. The height is given over the width.

    Raises:
        ValueError: If the path ends in something else.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    suffix = Path(path).suffix.lower()
    if suffix not in PICTURES:
        raise ValueError(
            f"{path} ends in {Path(path).suffix!r}; expected a picture, "
            f"{', '.join(PICTURES)}."
        )
    about: dict[str, Any] = {"Creator": software, "Date": None}
    if suffix == ".pdf":
        about = {"Creator": software, "CreationDate": None}
    elif suffix == ".png":
        about = {"Software": software}
    look: Any = {"font.size": style.font_size, **_STYLE}
    look |= {length: share * style.font_size for length, share in _LENGTHS.items()}
    with mpl.rc_context(look):
        inches = style.width_mm / INCH
        tall = round(inches * height * style.dpi) / style.dpi  # of whole pixels
        look = {"dpi": _DPI / in_points(1.0), "facecolor": "white"}
        figure = Figure((inches, tall), **look, layout="constrained")
        yield figure
        figure.savefig(path, dpi=style.dpi, format=suffix[1:], metadata=about)


_STYLE = {
    **dict.fromkeys(("axes.labelsize", "axes.titlesize", "legend.fontsize"), "medium"),
    **{"svg.fonttype": "none", "svg.hashsalt": "softcal_jax", "pdf.fonttype": 42},
}
_LENGTHS = {"lines.linewidth": 0.13, "lines.markersize": 0.5, "axes.linewidth": 0.08}
"""Lengths of charts, over the size of words."""


def in_points(length: float) -> float:
    """Convert a length beside words of 15 points to one beside those of today [pt]."""
    import matplotlib as mpl

    return length * mpl.rcParams["font.size"] / _WORDS


def add_axes(figure: Figure, *box: float) -> Axes:
    """Add axes in a box of pixels: its left, bottom, width and height."""
    figure.set_layout_engine("none")
    x, y = figure.dpi * figure.get_size_inches()
    left, bottom, width, height = box
    return figure.add_axes((left / x, bottom / y, width / x, height / y))


def add_view(figure: Figure, *box: float, scale: float) -> Axes:
    """Add axes in metres around the centre of a view; the scale is in pixels per m."""
    axes = add_axes(figure, *box)
    w, h = 0.5 * box[2] / scale, 0.5 * box[3] / scale
    axes.set(xlim=(-w, w), ylim=(-h, h))
    axes.set_axis_off()
    return axes


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

PRESSURE_MAP = "Reds"
"""Colour map of the pressure of contact."""

# What is drawn beside the soft body.
CABLE, WALL, MOTOR = "#d95f02", "#0b5fa5", "#7b3294"
FORCE, RIGID, OBSTACLE = "#1b7837", "#b4b4b4", "#9aa0a6"

# How the body is held, and its weight.
SUPPORT, GRAVITY = "#8c510a", "#4d4d4d"
FIBRE = "#5e3c99"

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

MARKS = {name: style.get("mec") or style["color"] for name, style in SYMBOLS.items()}
MARKS["frame of a rigid body"] = GRAVITY  # which no picture draws
"""Colours by what they mark, for a page that draws by itself."""


def symbol(name: str, **changes: Any) -> dict[str, Any]:
    """Return a style of `SYMBOLS` for words of this size."""
    style = {**SYMBOLS[name], **changes}
    return {
        k: in_points(v) if k in ("ms", "mew", "lw") else v for k, v in style.items()
    }


WARNING_HEIGHT, _TOP = 60, 130  # of bands above a body: a warning, titles [pixels]
_CORNER, _LENGTH = 130, 260  # of the axes below it, and of the bar of a length [pixels]
_COLUMNS = 5  # most columns of its legend
_MOST_NAMES = 16  # markers that are named; more names would cover each other


def halo(width: float):
    """Make a white rim for lines and text, so that they show on any background."""
    from matplotlib import patheffects

    return [patheffects.withStroke(linewidth=in_points(width), foreground="white")]


def draw_name(axes: Axes, text: str, place, offset, **style) -> None:
    """Write a name beside a place, at an offset in points beside words of 15."""
    style = {"color": TEXT, "path_effects": halo(4.0), **style}
    where = {"xytext": tuple(map(in_points, offset)), "textcoords": "offset points"}
    axes.annotate(text, place, **where, **style, parse_math=False)


def separate_names(axes: Axes) -> None:
    """Move names up or down until none covers another, and into the axes."""
    frame, placed = axes.get_window_extent(), []
    length = 72.0 / axes.figure.dpi
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
        text.xyann = (x - length * over, y + length * ways[best])
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
            axes.plot(*np.transpose(pair), **symbol("distance"))
    for name, marked in (("measured", measured), ("simulated", simulated)):
        if len(marked):
            axes.plot(*marked.T, path_effects=halo(5.0), **symbol(name))
    if len(names) > _MOST_NAMES:
        return
    places = measured if len(measured) else simulated
    for name, place in zip(names, places, strict=False):
        if np.isfinite(place).all():
            draw_name(axes, name, place, (13, 10))


def shrink(text: Text, room: float) -> None:
    """Make a text smaller until it fits a width [pixels]."""
    size = float(text.get_fontsize())
    # Step by step: hinting rounds letters, so width is not linear in size.
    while size > 1.0 and text.get_window_extent().width > room:
        size *= 0.95
        text.set_fontsize(size)


def draw_colour_scale(
    axes: Axes,
    largest: float,
    label: str = "displacement [mm]",
    colour_map: str = DISPLACEMENT_MAP,
) -> None:
    """Draw a colour scale from 0 to the largest value, in the unit of the label."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    colours = ScalarMappable(Normalize(0.0, largest or 1.0), colour_map)
    axes.figure.colorbar(colours, cax=axes, label=label)
    axes.set_title(f"max {largest:.3g}", color=TEXT, pad=in_points(10.0))


def draw_triad(axes: Axes, view: View) -> None:
    """Draw the directions of the axes x, y, z."""
    tips = np.stack([view.right, view.up], axis=1)
    low, high = np.minimum(tips.min(axis=0), 0.0), np.maximum(tips.max(axis=0), 0.0)
    half, middle = 0.5 * np.max(high - low) + 0.45, 0.5 * (low + high)
    axes.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    axes.set_axis_off()
    for i in np.argsort(view.towards):  # draw what points away first
        tip, colour = tips[i], ("#c0392b", "#1e8449", "#1f4fa0")[i]
        draw_arrow(axes, np.zeros(2), tip, colour, width=2.5, head=14.0)
        length = np.linalg.norm(tip)
        away = tip / length * (length + 0.28) if length > 0.1 else np.full(2, 0.2)
        style = {"color": colour, "weight": "bold"}
        axes.text(away[0], away[1], "xyz"[i], ha="center", va="center", **style)


def draw_length_scale(axes: Axes, width: float) -> None:
    """Draw a bar of a round length; `width` is that of the axes [m]."""
    axes.set(xlim=(0, width), ylim=(0, 1))
    axes.set_axis_off()
    power = 10.0 ** np.floor(np.log10(0.6 * width))
    length = max(s * power for s in (1, 2, 5) if s * power <= 0.6 * width)
    right = 0.97 * width
    axes.plot([right - length, right], [0.25, 0.25], color=TEXT, lw=in_points(3.0))
    for x in (right - length, right):
        axes.plot([x, x], [0.12, 0.38], color=TEXT, lw=in_points(3.0))
    middle, text = right - 0.5 * length, f"{1e3 * length:g} mm"
    axes.text(middle, 0.5, text, color=TEXT, ha="center")


def legend_of(drawn: Container[str], labels: Mapping[str, str] = {}) -> list[Any]:
    """List what explains the drawn `SYMBOLS`; `labels` replace some names."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], label=labels.get(name, name), **symbol(name))
        for name in SYMBOLS
        if name in drawn
    ]


def draw_faces(
    axes: Axes,
    view: View,
    corners: Float[HostArray, "n_faces 3 3"],
    colours: Float[HostArray, "n_faces 3"],
) -> None:
    """Draw faces in their order, with edges a little darker; as pixels in any file."""
    look = {"facecolors": colours, "edgecolors": 0.85 * colours}
    draw_patch(axes, view, corners, **look, rasterized=True)


def draw_patch(
    axes: Axes, view: View, corners: Float[HostArray, "n_faces 3 3"], **look: Any
) -> None:
    """Draw faces in their order, with edges of 0.4 points beside words of 15."""
    from matplotlib.collections import PolyCollection

    shapes = list(view.project(corners))
    axes.add_collection(PolyCollection(shapes, lw=in_points(0.4), **look))


def draw_arrow(
    axes: Axes, start, end, colour: str, *, width: float = 3.0, head: float = 20.0
) -> None:
    """Draw the arrow of a force, of gravity or of an axis."""
    look = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    look |= {"lw": in_points(width), "mutation_scale": in_points(head)}
    axes.annotate("", tuple(end), tuple(start), arrowprops=look)


def draw_grid(axes: Axes) -> Axes:
    """Draw a faint grid behind all else."""
    axes.grid(True, color="#dddddd", lw=axes.spines["left"].get_linewidth())
    axes.set_axisbelow(True)
    return axes


def draw_control_points(axes: Axes, places: Float[HostArray, "n 2"]) -> None:
    """Mark control points by their numbers, from 1."""
    axes.plot(*places.T, **symbol("control point"), clip_on=False, zorder=5)
    style = {"ha": "center", "va": "center", "fontsize": in_points(10.0), "color": TEXT}
    for i, (x, y) in enumerate(places, start=1):
        axes.text(x, y, str(i), **style, zorder=6)


def draw_frame(
    figure: Figure,
    view: View,
    handles: Sequence[Any],
    *,
    scale: float,
    title: str = "",
    subtitle: str = "",
    warning: str = "",
) -> None:
    """Make room around a body: titles above, legend, axes and a length below.

    So far the figure is as high as the body's part. `scale` is in pixels per metre.
    """
    from matplotlib.patches import Rectangle

    width, height = figure.dpi * figure.get_size_inches()
    length = min(_LENGTH, 0.4 * width)
    legend = add_legend(figure, handles, width - 1.2 * (_CORNER + length))
    place, bottom = (1.2 * _CORNER, 0.5 * _CORNER), _CORNER
    if legend.get_window_extent().height > _CORNER:  # it needs a band of its own
        legend.remove()
        legend = add_legend(figure, handles, width)
        bottom += math.ceil(legend.get_window_extent().height)
        place = 0.0, 0.5 * (_CORNER + bottom)
    above = WARNING_HEIGHT * bool(warning)
    top = above + _TOP * bool(title or subtitle)
    total = top + height + bottom
    drawn = [(axes, axes.get_position().bounds) for axes in figure.axes]
    figure.set_size_inches(width / figure.dpi, total / figure.dpi)
    for axes, (left, low, w, h) in drawn:
        low, h = (bottom + low * height) / total, h * height / total
        axes.set_position((left, low, w, h))
    if warning:
        band = Rectangle((0.0, 1.0), 1.0, -WARNING_HEIGHT / total, color=BAD, lw=0)
        figure.add_artist(band)
    bold = {"weight": "bold", "color": TEXT}
    for words, down, font, look in (
        (warning, 0.5 * WARNING_HEIGHT, 20.0, {**bold, "color": "white"}),
        (title, above + 40, 23.0, bold),
        (subtitle, above + 90, 18.0, {"color": TEXT}),
    ):
        fixed: Any = {"fontsize": in_points(font), "va": "center", "parse_math": False}
        text = figure.text(24 / width, 1.0 - down / total, words, **look, **fixed)
        shrink(text, width - 48)
    draw_triad(add_axes(figure, 20, 5, _CORNER - 15, _CORNER - 15), view)
    corner = width - length - 20, 20, length, 70
    draw_length_scale(add_axes(figure, *corner), length / scale)
    legend.set_loc("center left")
    place = place[0] / width, place[1] / total
    legend.set_bbox_to_anchor(place, figure.transFigure)


def add_legend(
    figure: Figure, handles: Sequence[Any], room: float, loc: str = "center left"
) -> Legend:
    """Add a legend with as many columns as there is room for [pixels], or one."""
    look = {"handles": handles, "loc": loc, "frameon": False, "labelcolor": TEXT}
    for columns in range(_COLUMNS, 1, -1):
        legend = figure.legend(**look, ncols=columns)
        if legend.get_window_extent().width <= room:
            break
        legend.remove()
    else:
        legend = figure.legend(**look)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name may hold a dollar sign
    return legend
