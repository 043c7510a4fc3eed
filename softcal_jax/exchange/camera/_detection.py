"""Tags on a photograph: which there are, and their corners to hundredths of a pixel.

OpenCV finds the tags. Its own refinements look at the surroundings of each corner,
which blur rounds off; here the edges of the black border are measured along their whole
length, and each corner is where two of them meet.
"""

from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from softcal_jax._files import check_file, once
from softcal_jax._typing import Float, HostArray
from softcal_jax.exchange.camera._sheet import CELLS, dictionary, opencv

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
