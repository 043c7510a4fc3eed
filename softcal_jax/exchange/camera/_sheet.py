"""The printed tags and the board: patterns, corners, and sheets to scale as a PDF.

The tags are those of the family AprilTag 36h11 (Olson, ICRA 2011): a black border, one
cell wide, around 6 x 6 cells. The frame of a tag has its origin in the middle, x to the
right of the print, y up and z out of the paper.

On a photograph, OpenCV finds the tags. Its own refinements look at the surroundings of
each corner, which blur rounds off; here the edges of the black border are measured
along their whole length, and each corner is where two of them meet.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from softcal_jax._files import check_file, once
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


_REACH = 0.4  # how far an edge is looked at on either side, in cells [-]
_LEAST_REACH, _MOST_REACH = 2.0, 8.0  # limits of this reach [px]

_AWAY = 0.12
"""Share of an edge at either end that is left out: blur rounds the corners [-]."""

SMALLEST = 30.0
"""Least height of a tag over its edges: in less, a cell has under four pixels [px]."""


class Photo(NamedTuple):
    """Tags on a photograph.

    Attributes:
        path: The file.
        size: Its width and height as the sensor has them [px].
        corners: Corners of each tag by its number, from the top left one of the print
            clockwise; the middle of the first pixel is (0, 0) [px].
    """

    path: Path
    size: tuple[int, int]
    corners: Mapping[int, Float[HostArray, "4 2"]]


@partial(once, most=100)
def read_photo(path: Path) -> Photo:
    """Find the tags on a photograph, which may be any file that OpenCV reads.

    Its orientation flag is ignored, so that all photographs of a camera have the axes
    of its sensor.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If OpenCV is not installed.
        ValueError: If it cannot be read, or one tag occurs twice.
    """
    check_file(path, "photograph")
    cv2 = opencv()
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    image = None
    # Decoded from memory, since OpenCV opens no names but ASCII ones on Windows.
    with suppress(cv2.error):  # of an empty file, or of 2^30 pixels and more
        image = cv2.imdecode(np.fromfile(path, np.uint8), flags)
    if image is None:
        raise ValueError(
            f"photograph {path} cannot be read, or is larger than 1000 megapixels; "
            "save it as JPEG or PNG (not HEIC)."
        )
    detector = cv2.aruco.ArucoDetector(dictionary(), cv2.aruco.DetectorParameters())
    outlines, numbers, _ = detector.detectMarkers(image)
    numbers = [] if numbers is None else [int(n) for n in np.ravel(numbers)]
    for number in numbers:
        if numbers.count(number) > 1:
            raise ValueError(
                f"photograph {path} has tag {number} {numbers.count(number)} times: "
                "use each tag once, and cover the others."
            )
    corners = {
        number: _refined(image, np.reshape(outline, (4, 2)).astype(float))
        for number, outline in zip(numbers, outlines, strict=True)
    }
    return Photo(path, (image.shape[1], image.shape[0]), corners)


def height(corners: Float[HostArray, "4 2"]) -> float:
    """Return the least height of a tag over its edges [px]."""
    along = np.roll(corners, -1, axis=0) - corners
    out = np.column_stack([along[:, 1], -along[:, 0]])
    out /= np.linalg.norm(along, axis=1)[:, None]
    over = np.einsum("kx,klx->kl", out, corners[:, None] - corners[None])
    opposite = [[(k + 2) % 4, (k + 3) % 4] for k in range(4)]
    return float(np.take_along_axis(over, np.array(opposite), axis=1).min())


def _linear(image: UInt8[HostArray, "h w"]) -> Float[HostArray, "h w"]:
    """Undo the encoding of sRGB (IEC 61966-2-1), after which blur moves no edge [-]."""
    levels = np.arange(256) / 255.0
    curve = ((levels + 0.055) / 1.055) ** 2.4
    return np.where(levels <= 0.04045, levels / 12.92, curve)[image]


def _refined(
    image: UInt8[HostArray, "height width"], corners: Float[HostArray, "4 2"]
) -> Float[HostArray, "4 2"]:
    """Measure the corners of a tag from its edges, twice: first near OpenCV's."""
    around = 2.0 * _MOST_REACH
    low = np.maximum(corners.min(axis=0) - around, 0.0).astype(int)
    high = (corners.max(axis=0) + around).astype(int)
    light = _linear(image[low[1] : high[1], low[0] : high[0]])
    corners = corners - low
    for _ in range(2):
        edges = [_edge(light, np.roll(corners, -k, axis=0)) for k in range(4)]
        corners = np.array([_corner(edges[k - 1], edges[k]) for k in range(4)])
    return corners + low


def _edge(
    light: Float[HostArray, "h w"], corners: Float[HostArray, "4 2"]
) -> Float[HostArray, "3 2"]:
    """Measure the edge between the first two corners of a tag, which a lens bends.

    Along each normal, an edge that was blurred symmetrically lies where a sharp edge
    would let through as much light. Returns the parabola of its points, from 0 to 1, as
    `np.polyval` takes it [px].
    """
    # Imported here, so that other commands do not wait for it.
    from scipy.ndimage import map_coordinates

    start, along = corners[0], corners[1] - corners[0]
    length = float(np.linalg.norm(along))
    out = np.array([along[1], -along[0]]) / length
    # Cells are lower where the tag is seen from the side.
    low = float(np.min((start - corners[2:]) @ out)) / CELLS
    reach = np.clip(_REACH * low, _LEAST_REACH, _MOST_REACH)
    s = np.linspace(_AWAY, 1.0 - _AWAY, max(8, int(length)))
    t = np.linspace(-reach, reach, 4 * int(np.ceil(reach)) + 1)
    points = start + s[:, None, None] * along + t[None, :, None] * out
    rows_columns = points[..., ::-1].transpose(2, 0, 1)
    profiles = map_coordinates(light, rows_columns, order=1, mode="nearest")
    n = max(2, len(t) // 8)
    # The light on a tag changes slowly along an edge.
    black, white = (
        np.polyval(np.polyfit(s, part.mean(axis=1), 1), s)
        for part in (profiles[:, :n], profiles[:, -n:])
    )
    dark = np.trapezoid(white[:, None] - profiles, t, axis=1) / (white - black)
    straight = np.array([np.zeros(2), along, start])
    return straight + np.outer(np.polyfit(s, dark - reach, 2), out)


def _corner(
    edge: Float[HostArray, "3 2"], following: Float[HostArray, "3 2"]
) -> Float[HostArray, "2"]:
    """Return where an edge ends at the beginning of the following one [px]."""
    slope = lambda parabola, s: 2.0 * parabola[0] * s + parabola[1]
    s, u = 1.0, 0.0
    for _ in range(4):  # Newton steps; edges are nearly straight
        gap = np.polyval(following, u) - np.polyval(edge, s)
        jacobian = np.column_stack([slope(edge, s), -slope(following, u)])
        ds, du = np.linalg.solve(jacobian, gap)
        s, u = s + ds, u + du
    return np.polyval(edge, s)
