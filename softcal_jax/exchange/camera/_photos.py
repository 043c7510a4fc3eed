"""The pose of a tag in the frame of another one, from photographs of both.

OpenCV finds the tags. Its own refinements look at the surroundings of each corner,
which blur rounds off; here the edges of the black border are measured along their whole
length, and each corner is where two of them meet.
"""

import glob
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from softcal_jax._files import check_file, once
from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax.exchange.camera import _sheet as sheet
from softcal_jax.exchange.camera._adjustment import (
    Adjustment,
    CameraModel,
    Observations,
    Placement,
    adjust,
    lens,
)

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
    cv2 = sheet.opencv()
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
    detector = cv2.aruco.ArucoDetector(sheet.dictionary())
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
    low = float(np.min((start - corners[2:]) @ out)) / sheet.CELLS
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


_FOCAL_LENGTHS = (0.6, 0.8, 1.0, 1.3)
"""Focal lengths to begin with, in the longer side of a photograph [-].

Those of the main cameras of phones are 0.65 to 0.8.
"""

_OUTLIER, _FIRST_OUTLIER = (3.0, 0.3), (6.0, 3.0)
"""Factor and pixels by which a photograph's errors exceed the median of all if it does
not fit the others; and before the adjustment, which one that is far off would spoil."""

_LEAST_ON_BOARD = 4  # least tags of the board that a photograph of it must show


class TagPose(Module):
    """Pose of a tag in the frame of the base tag.

    Attributes:
        position: Middle of the tag [m].
        rotation: Its axes as columns [-].
        covariance: Covariance of the position and of a rotation vector r, in the axes
            of the base tag: the true axes are exp(r) times these [m, rad].
        noise: Standard deviation of a coordinate of a corner [px].
        rms: Root mean square of the reprojection errors of each photograph [px].
        focal: Focal length [px].
    """

    position: Float[HostArray, "3"]
    rotation: Float[HostArray, "3 3"]
    covariance: Float[HostArray, "6 6"]
    noise: float
    rms: Float[HostArray, " n_photos"]
    focal: float


def find_photos(
    patterns: str | Sequence[str], folder: str | os.PathLike[str] = "."
) -> tuple[Path, ...]:
    """List files by patterns like "pose1/*.jpg", each once.

    Raises:
        FileNotFoundError: If no file fits a pattern.
    """
    patterns = [patterns] if isinstance(patterns, str) else patterns
    files: dict[Path, None] = {}
    for pattern in patterns:
        names = sorted(glob.glob(pattern, root_dir=folder))
        if not names:
            where = "the current folder" if Path(folder) == Path() else folder
            raise FileNotFoundError(f"no photograph in {where} fits {pattern!r}.")
        files |= dict.fromkeys(Path(folder) / name for name in names)
    return tuple(files)


def tag_pose(
    photos: Sequence[str | os.PathLike[str]],
    *,
    tag: int,
    base_tag: int,
    size: float,
    base_size: float | None = None,
    board: Sequence[str | os.PathLike[str]] = (),
) -> TagPose:
    """Find the pose of a tag in the frame of a base tag, from photographs of both.

    All photographs are of one pose of the robot, by one camera with fixed zoom, from
    different directions: tilts of tags that are seen from the front only are hardly
    visible. Camera, its positions and the pose are fitted together. The camera is
    calibrated by photographs of the printed board, if there are any, and else by those
    of the tags.

    Args:
        photos: The photographs.
        tag: Number of the tag on the robot.
        base_tag: Number of the tag on its base.
        size: Side of the black square of the tag [m].
        base_size: The same of the base tag, by default equal to `size` [m].
        board: Photographs of the board by the same camera.

    Raises:
        FileNotFoundError: If a photograph is missing.
        ImportError: If OpenCV is not installed.
        ValueError: If a photograph does not show what it should, or has another size
            than the others, or does not fit them.
    """
    base_size = size if base_size is None else base_size
    for number, side in ((tag, size), (base_tag, base_size)):
        sheet.check_tag(number)
        if not 0.0 < side < np.inf:
            raise ValueError(
                f"the size of tag {number} is {side:g}; expected a length."
            )
    if tag == base_tag:
        raise ValueError(f"tag and base_tag are both {tag}; use two tags.")
    if not photos:
        raise ValueError("there are no photographs.")
    shown = [read_photo(Path(path)) for path in photos]
    boards = [read_photo(Path(path)) for path in board]
    first, size_px = shown[0], shown[0].size
    for photo in (*shown, *boards):
        if photo.size != size_px:
            sizes = [f"{w} x {h} px" for w, h in (photo.size, size_px)]
            raise ValueError(
                f"photograph {photo.path} has {sizes[0]}, and {first.path} {sizes[1]}: "
                "all are to be by one camera, without crop or zoom."
            )
    _check_shown(shown, (tag, base_tag))
    cameras = [CameraModel.unknown(size_px, f * max(size_px)) for f in _FOCAL_LENGTHS]
    if boards:
        cameras = [_camera_of(boards, cameras)]
    base, moved = sheet.tag_corners(base_size), sheet.tag_corners(size)
    fit = _fitted(shown, [{base_tag: base}, {tag: moved}], cameras)
    (placed,) = fit.targets
    return TagPose(
        position=placed.p,
        rotation=placed.R,
        covariance=fit.covariance,
        noise=fit.noise,
        rms=fit.rms,
        focal=float(fit.camera.values[0]),
    )


def _camera_of(boards: Sequence[Photo], cameras: Sequence[CameraModel]) -> CameraModel:
    """Calibrate the camera from photographs of the board."""
    board = {number: sheet.board_corners(number) for number in sheet.BOARD_IDS}
    for photo in boards:
        n = len(board.keys() & photo.corners.keys())
        if n < _LEAST_ON_BOARD:
            raise ValueError(
                f"photograph {photo.path} shows {n} tags of the board; expected "
                f"{_LEAST_ON_BOARD} or more: have it fill the picture."
            )
    return _fitted(boards, [board], cameras).camera


def _check_shown(photos: Sequence[Photo], numbers: Sequence[int]) -> None:
    """Raise one ValueError for all photographs that do not show tags large enough."""
    wrong = []
    for photo in photos:
        for number in numbers:
            if number not in photo.corners:
                seen = listed([str(n) for n in sorted(photo.corners)])
                wrong.append(
                    f"photograph {photo.path} does not show tag {number}; tags there: "
                    f"{seen}."
                )
            elif (low := height(photo.corners[number])) < SMALLEST:
                wrong.append(
                    f"tag {number} is only {low:.0f} px high on photograph "
                    f"{photo.path}; expected {SMALLEST:.0f} or more."
                )
    if wrong:
        wrong.append(
            "Leave out what does not, or take it anew: sharp, nearer, less aslant, "
            "with the white rim of the tag, or printed larger."
        )
        raise ValueError(" ".join(wrong))


def _fitted(
    photos: Sequence[Photo],
    targets: Sequence[dict[int, Float[HostArray, "4 3"]]],
    cameras: Sequence[CameraModel],
) -> Adjustment:
    """Fit targets that all photographs show, from the best of several starts.

    A target is corners by the number of their tag [m].
    """
    shown = [
        (np.full(4, i), np.full(4, j), points, photo.corners[number])
        for i, photo in enumerate(photos)
        for j, target in enumerate(targets)
        for number, points in target.items()
        if number in photo.corners
    ]
    seen = Observations(*map(np.concatenate, zip(*shown, strict=True)))
    starts = [start for camera in cameras for start in _starts(seen, camera)]
    rms, best = min(starts, key=lambda start: float(np.median(start[0])))
    _check_alike(photos, rms, *_FIRST_OUTLIER)
    fit = adjust(seen, *best)
    _check_alike(photos, fit.rms, *_OUTLIER)
    return fit


def _check_alike(
    photos: Sequence[Photo],
    rms: Float[HostArray, " n_photos"],
    factor: float,
    off: float,
) -> None:
    """Raise ValueError if a photograph fits much worse than the others."""
    usual, worst = float(np.median(rms)), int(np.argmax(rms))
    if rms[worst] > max(factor * usual, usual + off):
        raise ValueError(
            f"photograph {photos[worst].path} does not fit the others: its corners are "
            f"{rms[worst]:.2g} px off, half of the others less than {usual:.2g}. Leave "
            "it out; the robot moved, or it is blurred."
        )


def _starts(
    seen: Observations, camera: CameraModel
) -> Iterator[tuple[Float[HostArray, " n_photos"], tuple]]:
    """Yield errors on each photograph [px], and where `adjust` may begin with them.

    A planar target on a photograph has two poses that fit. Each pose of target 1 in the
    frame of target 0 that fits one photograph is tried on all of them.
    """
    photos = [seen.photo == i for i in range(int(seen.photo.max()) + 1)]
    planar = lambda rows: _fits(seen.points[rows], seen.pixels[rows], camera)
    bases = [planar(rows & (seen.target == 0)) for rows in photos]
    placed: list[tuple[Placement, ...]] = [()]
    if seen.target.any():
        placed = [
            (base.inverse @ moved,)
            for rows, fits in zip(photos, bases, strict=True)
            for _, base in fits
            for _, moved in planar(rows & (seen.target == 1))
        ]
    for others in placed:
        points, best = seen.in_base(others), []
        for rows, fits in zip(photos, bases, strict=True):
            here = points[rows], seen.pixels[rows], camera
            refined = [_fits(*here, start=base)[0] for _, base in fits]
            best.append(min(refined, key=lambda fit: fit[0]))
        errors, poses = zip(*best, strict=True)
        yield np.array(errors), (camera, poses, others)


def _fits(
    points: Float[HostArray, "n 3"],
    pixels: Float[HostArray, "n 2"],
    camera: CameraModel,
    start: Placement | None = None,
) -> list[tuple[float, Placement]]:
    """Return errors, rms of coordinates [px], and poses of some points.

    Without a start both poses of a planar target, by Collins and Bartoli (IJCV 2014).
    """
    cv2 = sheet.opencv()
    options: dict[str, Any] = {"flags": cv2.SOLVEPNP_IPPE}
    if start is not None:  # which OpenCV overwrites
        turn, shift = cv2.Rodrigues(start.R)[0], start.p.copy()
        options = {"useExtrinsicGuess": True, "rvec": turn, "tvec": shift}
    _, *fits = cv2.solvePnPGeneric(points, pixels, *lens(camera.values), **options)
    return [
        (float(error[0]), Placement(cv2.Rodrigues(turn)[0], np.ravel(shift)))
        for turn, shift, error in zip(*fits, strict=True)
    ]
