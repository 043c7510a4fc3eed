"""Photographs of tags with known poses: VTK draws them, a lens and a sensor spoil them.

What is drawn are the cells of each tag as squares in space, by a pinhole camera that
looks at them, four times as fine as the photograph. Each pixel of that is then looked
up along its own rays, 16 over its area, which distortion bends; blur acts on light, and
what the sensor reads is encoded as sRGB, gets noise, and is written as JPEG.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from softcal_jax.exchange.camera import BOARD_IDS, board_corners, tag_cells, tag_corners
from softcal_jax.exchange.camera._adjustment import Placement

WHITE, BLACK, TABLE = 0.8, 0.04, 0.35
"""Light of paper, ink and background [-]."""


@dataclass(frozen=True)
class Lens:
    """A camera.

    Attributes:
        size: Width and height [px].
        focal: Focal length [px].
        middle: Principal point [px].
        distortion: OpenCV's k1, k2, p1, p2, k3.
        blur: Standard deviation of what a point becomes [px].
        noise: Standard deviation of what the sensor reads, of its range [-].
    """

    size: tuple[int, int]
    focal: float
    middle: tuple[float, float]
    distortion: tuple[float, ...]
    blur: float = 0.9
    noise: float = 2.0 / 255.0

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Directions, with z = 1, that pixels (n, 2) look along.

        Brown's distortion is undone by repeated substitution.
        """
        k1, k2, p1, p2, k3 = self.distortion
        bent = (pixels - np.array(self.middle)) / self.focal
        x, y = bent.T
        for _ in range(12):
            r2 = x**2 + y**2
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            aside = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
            up = p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y
            x, y = (bent[:, 0] - aside) / radial, (bent[:, 1] - up) / radial
        return np.column_stack([x, y, np.ones(len(pixels))])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Where points in the frame of the camera are on the photograph."""
        import cv2

        cx, cy = self.middle
        K = np.array([[self.focal, 0, cx], [0, self.focal, cy], [0, 0, 1.0]])
        zero = np.zeros(3)
        lens = np.array(self.distortion)
        return cv2.projectPoints(points, zero, zero, K, lens)[0].reshape(-1, 2)


def phone(megapixels: float = 12.0) -> Lens:
    """Like the main camera of a phone, 27 mm in terms of 35 mm film."""
    scale = np.sqrt(megapixels / 12.0)
    size = round(4000 * scale), round(3000 * scale)
    middle = 0.5 * size[0] + 18.3 * scale, 0.5 * size[1] - 11.6 * scale
    return Lens(size, 3050.0 * scale, middle, (0.06, -0.09, 4e-4, -3e-4, 0.02))


def looking(
    at: np.ndarray, *, tilt: float, turn: float, roll: float, away: float
) -> Placement:
    """Pose, in the camera, of a frame whose point `at` is seen from a direction.

    The direction is tilted from its z axis [rad], and turned about it.
    """
    towards = Rotation.from_euler("ZY", [turn, tilt]).apply([0.0, 0.0, 1.0])
    z = -towards
    side = np.cross([0.0, 0.0, 1.0], z) if tilt > 1e-6 else np.array([1.0, 0.0, 0.0])
    x = side / np.linalg.norm(side)
    axes = np.array([x, np.cross(z, x), z])
    R = Rotation.from_euler("z", roll).as_matrix() @ axes
    return Placement(R, np.array([0.0, 0.0, away]) - R @ at)


def random_views(
    rng: np.random.Generator, at: np.ndarray, n: int, *, away: float
) -> list[Placement]:
    """Poses from all sides, tilted by 20 to 50 degrees, not quite in the middle."""
    turns = 2.0 * np.pi * (np.arange(n) + rng.uniform(size=n)) / n
    return [_random_view(rng, at, turn, away) for turn in turns]


def clear_views(
    rng: np.random.Generator, sheet: "Sheet", n: int, *, away: float
) -> list[Placement]:
    """Poses like `random_views` from which no tag hides a part of another one.

    They look at the middle of the tags; one that is not clear is drawn again, anywhere
    on its side.
    """
    at = np.mean([place.p for place, _ in sheet.values()], axis=0)
    views = []
    for i in range(n):
        view = None
        while view is None or not _clear(sheet, view):
            turn = 2.0 * np.pi * (i + rng.uniform()) / n
            view = _random_view(rng, at, turn, away)
        views.append(view)
    return views


def _random_view(
    rng: np.random.Generator, at: np.ndarray, turn: float, away: float
) -> Placement:
    aside = rng.uniform(-0.02, 0.02, 3)
    tilt, roll = np.deg2rad(rng.uniform(20.0, 50.0)), rng.uniform(-0.5, 0.5)
    far = away * rng.uniform(0.95, 1.05)
    return looking(at + aside, tilt=tilt, turn=turn, roll=roll, away=far)


def _clear(sheet: "Sheet", view: Placement) -> bool:
    """Whether a line parts any two tags with their rims, seen without a lens."""
    rims = []
    for place, size in sheet.values():
        seen = 1.25 * tag_corners(size) @ place.R.T + place.p
        seen = seen @ view.R.T + view.p
        rims.append(seen[:, :2] / seen[:, 2:])
    return all(_parted(one, other) for one, other in combinations(rims, 2))


def _parted(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether a side of two convex polygons has one on either side."""
    for polygon in (one, other):
        for x, y in np.roll(polygon, -1, axis=0) - polygon:
            a, b = one @ [y, -x], other @ [y, -x]
            if a.max() < b.min() or b.max() < a.min():
                return True
    return False


Sheet = Mapping[int, tuple[Placement, float]]
"""Pose and size of tags by their numbers."""


def squares(sheet: Sheet) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all cells, with a white rim of one, and which of them are white."""
    corners, white = [], []
    for number, (place, size) in sheet.items():
        cells = np.pad(tag_cells(number), 1, constant_values=True)
        grid = (np.arange(11) / 8.0 - 0.625) * size
        for row in range(10):
            for column in range(10):
                x, y = grid[column : column + 2], -grid[row : row + 2]
                square = np.array(
                    [[x[i], y[j], 0.0] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
                )
                corners.append(square @ place.R.T + place.p)
        white.append(cells.ravel())
    return np.array(corners), np.concatenate(white)


JITTER = 4
"""Pictures from which a photograph is looked up."""

REACH = 30
"""What is drawn around a tag [px]."""


class Part(NamedTuple):
    """Light on a part of a photograph.

    Attributes:
        light: By row and column [-].
        left: First column.
        top: First row.
    """

    light: np.ndarray
    left: int
    top: int


def draw(sheet: Sheet, view: Placement, lens: Lens) -> list[Part]:
    """Draw the parts of a photograph that show tags.

    Raises:
        ValueError: If a tag is outside of the photograph.
    """
    return [_draw(tags, box, view, lens) for tags, box in _apart(sheet, view, lens)]


Box = tuple[np.ndarray, np.ndarray]
"""First column and row, and those after the last ones."""


def _apart(sheet: Sheet, view: Placement, lens: Lens) -> list[tuple[Sheet, Box]]:
    """Tags and the part of the photograph that each is on; together if they overlap."""
    groups: list[tuple[Sheet, Box]] = []
    for number, tag in sheet.items():
        tags: dict[int, tuple[Placement, float]] = {number: tag}
        box = _box(tags, view, lens)
        while True:
            near = [g for g in groups if _overlap(g[1], box)]
            if not near:
                break
            groups = [g for g in groups if not _overlap(g[1], box)]
            for other, theirs in near:
                tags |= other
                box = np.minimum(box[0], theirs[0]), np.maximum(box[1], theirs[1])
        groups.append((tags, box))
    return groups


def _overlap(one: Box, other: Box) -> bool:
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))


def _box(sheet: Sheet, view: Placement, lens: Lens) -> Box:
    corners, _ = squares(sheet)
    places = lens.pixels(corners.reshape(-1, 3) @ view.R.T + view.p)
    if not (np.all(places > 0) and np.all(places < lens.size)):
        raise ValueError(
            f"tags {', '.join(map(str, sheet))} are not on the photograph."
        )
    low = np.maximum(np.floor(places.min(axis=0)).astype(int) - REACH, 0)
    high = np.ceil(places.max(axis=0)).astype(int) + REACH + 1
    return low, np.minimum(high, lens.size)


def _draw(sheet: Sheet, box: Box, view: Placement, lens: Lens) -> Part:
    """Draw a part of a photograph, with all tags that are on it."""
    corners, white = squares(sheet)
    seen = corners.reshape(-1, 3) @ view.R.T + view.p
    low, high = box

    # A camera at the same place that looks at the middle of what is seen.
    middle = lens.rays(0.5 * (low + high)[None])[0]
    z = middle / np.linalg.norm(middle)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    axes = _askew(np.array([x, np.cross(z, x), z]), seen)
    ahead = seen @ axes.T
    half = 1.05 * np.abs(ahead[:, :2] / ahead[:, 2:]).max() + 40.0 / lens.focal
    fineness = 4 if half * lens.focal < 700.0 else 2
    focal = fineness * lens.focal
    width = int(np.ceil(2.0 * half * focal))
    scene = _Scene(seen.reshape(-1, 4, 3), white, width, focal)
    u, v = (np.arange(a, b) for a, b in zip(low, high, strict=True))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    # Within a pixel the lens bends by 1e-5 of its side, so a ray is linear there.
    ray = lens.rays(pixels)
    along = [lens.rays(pixels + step) - ray for step in np.eye(2)]
    light = np.zeros((len(v), len(u)))
    # Edges of a picture keep to its pixels, so that each has others.
    aside = np.array([(k, (3 * k + 1) % JITTER, 0.0) for k in range(JITTER)])
    frames = Rotation.from_rotvec(aside / JITTER / focal).as_matrix() @ axes
    for k, picture in enumerate(scene.pictures(frames)):
        x, y, z = frames[k] @ ray.T
        slopes = [frames[k] @ change.T for change in along]
        quarter = np.array([k % 2, k // 2])  # which of each 2 x 2 parts of a pixel
        for step in np.ndindex(fineness // 2, fineness // 2):
            a, b = (2 * np.array(step) + quarter + 0.5) / fineness - 0.5
            dx, dy, dz = a * slopes[0] + b * slopes[1]
            # The middle of the first pixel of VTK is half a pixel from its border.
            row, column = (
                focal * part / (z + dz) + 0.5 * width - 0.5 for part in (y + dy, x + dx)
            )
            looked_up = map_coordinates(picture, [row, column], order=1, cval=TABLE)
            light += looked_up.reshape(light.shape)
    light /= JITTER * (fineness // 2) ** 2
    return Part(light, int(low[0]), int(low[1]))


def _askew(axes: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Turn a camera about its z axis, so that squares lie askew in its picture.

    VTK moves an edge along rows, columns or diagonals by up to half a pixel all along
    it; one that lies between them is a pixel too far here and too near there.
    """
    ahead = seen @ axes.T
    places = (ahead[:, :2] / ahead[:, 2:]).reshape(-1, 4, 2)
    along = np.diff(places[:, :3], axis=1)
    # The mean of angles that count up to 45 degrees.
    eighth = np.angle(np.exp(8j * np.arctan2(along[..., 1], along[..., 0])).mean())
    return Rotation.from_euler("z", (eighth - np.pi) / 8.0).as_matrix().T @ axes


@dataclass(frozen=True)
class _Scene:
    """Squares in the frame of a camera, and the size of its pictures."""

    corners: np.ndarray
    white: np.ndarray
    width: int
    focal: float

    def pictures(self, frames: np.ndarray) -> Iterator[np.ndarray]:
        """Light that pinhole cameras with the axes of these frames see."""
        import pyvista as pv

        from softcal_jax.plotting._scene import offscreen

        n, width = len(self.corners), self.width
        faces = np.hstack([np.full((n, 1), 4), np.arange(4 * n).reshape(-1, 4)])
        mesh = pv.PolyData(self.corners.reshape(-1, 3), faces)
        levels = np.where(self.white, 255, 0).astype(np.uint8)
        mesh.cell_data["grey"] = np.repeat(levels[:, None], 3, axis=1)
        grey = (TABLE - BLACK) / (WHITE - BLACK)
        with offscreen():
            plotter = pv.Plotter(
                off_screen=True, window_size=[width, width], lighting="none"
            )
            # Smoothed edges are mixed as codes of sRGB, which moves them.
            plotter.disable_anti_aliasing()
            plotter.background_color = (grey, grey, grey)  # pyright: ignore
            plotter.add_mesh(mesh, scalars="grey", rgb=True, lighting=False)
            camera = plotter.camera
            camera.position = (0.0, 0.0, 0.0)
            camera.view_angle = np.rad2deg(2.0 * np.arctan(0.5 * width / self.focal))
            for axes in frames:
                camera.focal_point, camera.up = tuple(axes[2]), tuple(-axes[1])
                camera.clipping_range = (0.05, 5.0)
                plotter.render()
                image = np.asarray(plotter.screenshot(return_img=True))[..., 0]
                yield BLACK + (WHITE - BLACK) / 255.0 * image
            plotter.close()


def photograph(
    path: Path, sheet: Sheet, view: Placement, lens: Lens, rng: np.random.Generator
) -> Path:
    """Write a JPEG, with light that falls off to one side.

    Raises:
        ValueError: If a tag is outside of the photograph.
    """
    import cv2

    width, height = lens.size
    falls_off = np.linspace(1.05, 0.85, width)
    codes = np.empty((height, width), np.float32)
    codes[:] = _srgb(TABLE * falls_off)
    for light, left, top in draw(sheet, view, lens):
        # What is drawn reaches so far that blur leaves nothing at its border.
        columns = slice(left, left + light.shape[1])
        blurred = gaussian_filter(light, lens.blur) * falls_off[columns]
        codes[top : top + light.shape[0], columns] = _srgb(blurred)
    codes += lens.noise * rng.standard_normal(codes.shape, np.float32)
    image = np.clip(np.rint(255.0 * codes), 0, 255).astype(np.uint8)
    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    if not ok:
        raise ValueError(f"{path}: OpenCV cannot write it.")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())
    return path


def _srgb(light: np.ndarray) -> np.ndarray:
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055
    )


def photographs(
    folder: Path,
    sheet: Sheet,
    views: Sequence[Placement],
    lens: Lens,
    rng: np.random.Generator,
) -> list[Path]:
    """Write one photograph for each view."""
    return [
        photograph(folder / f"{i}.jpg", sheet, view, lens, rng)
        for i, view in enumerate(views)
    ]


def board() -> Sheet:
    """The printed board."""
    corners = {number: board_corners(number) for number in BOARD_IDS}
    return {
        number: (Placement(np.eye(3), tag.mean(axis=0)), float(tag[1, 0] - tag[0, 0]))
        for number, tag in corners.items()
    }
