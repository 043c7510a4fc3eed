"""The printed tags and the board: patterns, corners, and sheets to scale as a PDF.

The tags are those of the family AprilTag 36h11 (Olson, ICRA 2011): a black border, one
cell wide, around 6 x 6 cells. The frame of a tag has its origin in the middle, x to the
right of the print, y up and z out of the paper.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._text import check_known
from softcal_jax._typing import Bool, Float, HostArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CELLS = 8  # cells along a side of a tag, with its border
N_TAGS = 587  # tags of the family, numbered from 0

BOARD_SHAPE, BOARD_IDS = (5, 7), range(500, 535)
"""Columns and rows of the board, and the numbers of its tags, row by row."""

BOARD_TAG, BOARD_GAP = 24e-3, 10e-3
"""Side of a tag of the board, and the gap to the next one [m]."""

INCH = 25.4e-3

PAPERS = {"a4": (0.210, 0.297), "letter": (8.5 * INCH, 11.0 * INCH)}
"""Width and height of sheets [m]."""

_MARGIN, _HEAD, _LABEL = 12e-3, 24e-3, 5e-3
"""What printers leave free, then room for the title and below a tag [m]."""

_SCALE = 0.1  # length of the scale [m]


def opencv() -> Any:
    """Import OpenCV with its tags."""
    try:
        import cv2

        cv2.aruco.ArucoDetector  # noqa: B018
    except (ImportError, AttributeError) as error:
        raise ImportError(
            "tags need OpenCV with its contributed modules: "
            "pip install 'softcal-jax[camera]'."
        ) from error
    return cv2


def dictionary() -> Any:
    """Return the family of tags, for OpenCV."""
    cv2 = opencv()
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def check_tag(number: int) -> None:
    """Raise ValueError unless there is a tag with a number."""
    if not 0 <= number < N_TAGS:
        raise ValueError(f"there is no tag {number}: they go from 0 to {N_TAGS - 1}.")


def tag_cells(number: int) -> Bool[HostArray, "8 8"]:
    """Return which cells of a tag are white, from its top row down.

    Raises:
        ValueError: If there is no such tag.
        ImportError: If OpenCV is not installed.
    """
    check_tag(number)
    image = opencv().aruco.generateImageMarker(dictionary(), number, CELLS)
    return np.asarray(image) > 127


def tag_corners(size: float) -> Float[HostArray, "4 3"]:
    """Return the corners of a tag of a size, from the top left one clockwise [m]."""
    return 0.5 * size * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])


def board_corners(number: int) -> Float[HostArray, "4 3"]:
    """Return the corners of a tag of the board, in the frame of the board [m].

    Its origin is the middle of the top left tag.
    """
    row, column = divmod(number - BOARD_IDS[0], BOARD_SHAPE[0])
    pitch = BOARD_TAG + BOARD_GAP
    return tag_corners(BOARD_TAG) + pitch * np.array([column, -row, 0.0])


def write_tags(
    path: str | Path,
    *,
    size: float = 20e-3,
    count: int = 12,
    first: int = 0,
    paper: str = "a4",
) -> int:
    """Write a PDF with tags, and with the board on its last page, to scale.

    The black square of a tag has the side `size` [m], and the first one the number
    `first`; paper is "a4" or "letter". Returns the number of pages.

    Raises:
        ImportError: If OpenCV is not installed.
        ValueError: If there are no such tags, they are those of the board, or they do
            not fit on the paper.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    pages = [*tag_pages(size, count=count, first=first, paper=paper), board_page(paper)]
    with PdfPages(path) as pdf:
        for page in pages:
            pdf.savefig(page)
    return len(pages)


def tag_pages(size: float, *, count: int, first: int, paper: str) -> list["Figure"]:
    """Draw the sheets with the tags; arguments and errors as for `write_tags`."""
    from matplotlib.patches import Rectangle

    check_known("paper", PAPERS, paper)
    width, height = PAPERS[paper]
    if not 0.0 < size < np.inf:
        raise ValueError(f"size of the tags is {size:g} m; expected a positive length.")
    if count < 1:
        raise ValueError(f"count of the tags is {count}; expected one or more.")
    for number in (first, first + count - 1):
        check_tag(number)
    if first + count > BOARD_IDS[0] and first <= BOARD_IDS[-1]:
        raise ValueError(
            f"tags {BOARD_IDS[0]} to {BOARD_IDS[-1]} are those of the board; take "
            f"others than {first} to {first + count - 1}."
        )
    # A rim of one cell, which must stay white, and as much for the scissors.
    pitch = size * (1.0 + 4.0 / CELLS)
    columns = int((width - 2.0 * _MARGIN) // pitch)
    rows = int((height - 2.0 * (_MARGIN + _HEAD)) // (pitch + _LABEL))
    if not (columns and rows):
        raise ValueError(
            f"tags of {1e3 * size:g} mm do not fit on {paper} paper: make them smaller."
        )
    numbers = range(first, first + count)
    cut = {"fill": False, "edgecolor": "#b0b0b0", "lw": 0.3, "ls": (0, (4, 4))}
    pages = []
    for begin in range(0, count, columns * rows):
        figure, axes = _page(
            paper,
            f"Tags of {1e3 * size:g} mm (AprilTag 36h11): the black square. Print at "
            "100 %, leave the white rim, glue flat.",
        )
        for i, number in enumerate(numbers[begin : begin + columns * rows]):
            row, column = divmod(i, columns)
            x = _MARGIN + pitch * (column + 0.5)
            y = height - _MARGIN - _HEAD - (pitch + _LABEL) * row - 0.5 * pitch
            _draw_tag(axes, number, (x, y), size)
            side = size * (1.0 + 3.0 / CELLS)
            corner = x - 0.5 * side, y - 0.5 * side
            axes.add_patch(Rectangle(corner, side, side, **cut))
            below = y - 0.5 * size * (1.0 + 3.4 / CELLS)
            axes.text(x, below, f"{number}", ha="center", va="top", fontsize=8)
        pages.append(figure)
    return pages


def board_page(paper: str) -> "Figure":
    """Draw the board, by which cameras are calibrated."""
    figure, axes = _page(
        paper,
        "Board for the camera: glue it on something flat, and take ten photographs "
        "that it fills, from all sides.",
    )
    middles = np.array([board_corners(n).mean(axis=0)[:2] for n in BOARD_IDS])
    middles += 0.5 * np.array(PAPERS[paper]) - middles.mean(axis=0)
    for number, middle in zip(BOARD_IDS, middles.tolist(), strict=True):
        _draw_tag(axes, number, middle, BOARD_TAG)
    return figure


def _page(paper: str, title: str) -> tuple["Figure", "Axes"]:
    """Make a sheet whose coordinates are metres, with a title and a scale."""
    from matplotlib.figure import Figure

    width, height = PAPERS[paper]
    figure = Figure(figsize=(width / INCH, height / INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, width), ylim=(0.0, height))
    axes.set_axis_off()
    top = height - _MARGIN
    axes.text(_MARGIN, top, title, va="top", fontsize=9, parse_math=False)
    y = _MARGIN + 2e-3
    axes.plot([_MARGIN, _MARGIN + _SCALE], [y, y], color="black", lw=0.5)
    for x in np.linspace(_MARGIN, _MARGIN + _SCALE, 11):
        axes.plot([x, x], [y, y + 2e-3], color="black", lw=0.5)
    text = f"This line is {1e3 * _SCALE:g} mm long; if it is not, give the size that "
    text += "you measure as size."
    axes.text(_MARGIN, y + 3e-3, text, va="bottom", fontsize=8)
    return figure, axes


def _draw_tag(axes: "Axes", number: int, middle: Sequence[float], size: float) -> None:
    """Draw a tag: its white cells as one path, without seams, on a black square."""
    from matplotlib.patches import PathPatch, Rectangle
    from matplotlib.path import Path as Outline

    corner = middle[0] - 0.5 * size, middle[1] - 0.5 * size
    style = {"edgecolor": "none", "snap": False}
    axes.add_patch(Rectangle(corner, size, size, facecolor="black", **style))
    rows, columns = np.nonzero(tag_cells(number)[::-1])  # from the bottom row up
    lower = np.stack([columns, rows], axis=1)[:, None]
    cells = lower + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    white = Outline.make_compound_path_from_polys(np.add(corner, size / CELLS * cells))
    axes.add_patch(PathPatch(white, facecolor="white", **style))
