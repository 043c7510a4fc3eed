"""Writing figures to files."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

DPI = 100
"""Pixels per inch of figures and of the images within them."""


def pixel_figure(width: float, height: float) -> "matplotlib.figure.Figure":
    """Make a white figure of a size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")


def add_axes(figure: "matplotlib.figure.Figure", *box: float) -> "matplotlib.axes.Axes":
    """Add axes in a box of pixels: its left, bottom, width and height."""
    x, y = DPI * figure.get_size_inches()
    left, bottom, width, height = box
    return figure.add_axes((left / x, bottom / y, width / x, height / y))


def add_view(
    figure: "matplotlib.figure.Figure", *box: float, scale: float
) -> "matplotlib.axes.Axes":
    """Add axes in metres around the centre of a view; the scale is in pixels per m."""
    axes = add_axes(figure, *box)
    w, h = 0.5 * box[2] / scale, 0.5 * box[3] / scale
    axes.set(xlim=(-w, w), ylim=(-h, h))
    axes.set_axis_off()
    return axes


def save(
    figure: "matplotlib.figure.Figure", path: str | Path, software: str = "softcal_jax"
) -> None:
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
