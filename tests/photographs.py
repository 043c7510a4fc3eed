"""Photographs of tags with known poses: VTK draws them, a lens and a sensor spoil them.

What is drawn are the cells of each tag as squares in space, by a pinhole camera that
looks at them, four times as fine as the photograph. Each pixel of that is then looked
up along its own rays, 16 over its area, which distortion bends; blur acts on light, and
what the sensor reads is encoded as sRGB, gets noise, and is written as JPEG.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from softcal_jax.camera import BOARD_IDS, board_corners, tag_cells
from softcal_jax.camera._adjustment import Placement

WHITE, BLACK, TABLE = 0.8, 0.04, 0.35
"""Light of paper, ink and background [-]."""


@dataclass(frozen=True)
class Lens:
    """A camera of `size` pixels, with OpenCV's k1, k2, p1, p2, k3."""

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


def looking(at: np.ndarray, *, tilt: float, turn: float, roll: float, away: float):
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


def random_views(rng: np.random.Generator, at: np.ndarray, n: int, *, away: float):
    """Poses from all sides, tilted by 20 to 50 degrees, not quite in the middle."""
    views = []
    for turn in 2.0 * np.pi * (np.arange(n) + rng.uniform(size=n)) / n:
        aside = rng.uniform(-0.02, 0.02, 3)
        tilt, roll = np.deg2rad(rng.uniform(20.0, 50.0)), rng.uniform(-0.5, 0.5)
        far = away * rng.uniform(0.95, 1.05)
        views.append(looking(at + aside, tilt=tilt, turn=turn, roll=roll, away=far))
    return views


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
                own = np.array(
                    [[x[i], y[j], 0.0] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
                )
                corners.append(own @ place.R.T + place.p)
        white.append(cells.ravel())
    return np.array(corners), np.concatenate(white)


JITTER = 4
"""Pictures from which a photograph is looked up."""


def draw(
    sheet: Sheet, view: Placement, lens: Lens
) -> tuple[np.ndarray, tuple[int, int]]:
    """Light on the part of a photograph that shows tags, and its first column, row."""
    corners, white = squares(sheet)
    seen = corners.reshape(-1, 3) @ view.R.T + view.p
    places = lens.pixels(seen)
    assert np.all(places > 0), "a tag is outside of the photograph"
    assert np.all(places < lens.size), "a tag is outside of the photograph"
    low = np.maximum(np.floor(places.min(axis=0)).astype(int) - 30, 0)
    high = np.minimum(np.ceil(places.max(axis=0)).astype(int) + 31, lens.size)

    # A camera at the same place that looks at the middle of what is seen.
    middle = lens.rays(0.5 * (places.min(axis=0) + places.max(axis=0))[None])[0]
    z = middle / np.linalg.norm(middle)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    axes = np.array([x, np.cross(z, x), z])
    ahead = seen @ axes.T
    half = 1.05 * np.abs(ahead[:, :2] / ahead[:, 2:]).max() + 40.0 / lens.focal
    fineness = 4 if half * lens.focal < 700.0 else 2
    focal = fineness * lens.focal
    width = int(np.ceil(2.0 * half * focal))
    scene = _Scene(seen.reshape(-1, 4, 3), white, width, focal)
    u, v = (np.arange(a, b) for a, b in zip(low, high, strict=True))
    light = np.zeros((len(v), len(u)))
    for k in range(JITTER):
        # Edges of a picture keep to its pixels, so that each has others.
        aside = np.array([k, (3 * k + 1) % JITTER, 0.0]) / JITTER / focal
        turned = Rotation.from_rotvec(aside).as_matrix() @ axes
        dark = scene.picture(turned)
        own = np.array([k % 2, k // 2])  # which of each 2 x 2 parts of a pixel
        for step in np.ndindex(fineness // 2, fineness // 2):
            at = (2 * np.array(step) + own + 0.5) / fineness - 0.5
            pixels = np.stack(np.meshgrid(u + at[0], v + at[1]), axis=-1).reshape(-1, 2)
            ray = lens.rays(pixels) @ turned.T
            # The middle of the first pixel of VTK is half a pixel from its border.
            found = focal * ray[:, :2] / ray[:, 2:] + 0.5 * width - 0.5
            looked_up = map_coordinates(dark, found.T[::-1], order=1, cval=TABLE)
            light += looked_up.reshape(light.shape)
    return light / (JITTER * (fineness // 2) ** 2), (int(low[0]), int(low[1]))


@dataclass(frozen=True)
class _Scene:
    """Squares in the frame of a camera, and the size of its pictures."""

    corners: np.ndarray
    white: np.ndarray
    width: int
    focal: float

    def picture(self, axes: np.ndarray) -> np.ndarray:
        """Light that a pinhole camera with some axes sees."""
        import pyvista as pv

        from softcal_jax.plotting._offscreen import offscreen

        n, width = len(self.corners), self.width
        faces = np.hstack([np.full((n, 1), 4), np.arange(4 * n).reshape(-1, 4)])
        mesh = pv.PolyData(self.corners.reshape(-1, 3), faces)
        levels = np.where(self.white, 255, 0).astype(np.uint8)
        mesh.cell_data["grey"] = np.repeat(levels[:, None], 3, axis=1)
        grey = (TABLE - BLACK) / (WHITE - BLACK)
        with offscreen():
            plotter = pv.Plotter(
                off_screen=True, window_size=(width, width), lighting="none"
            )
            # Smoothed edges are mixed as codes of sRGB, which moves them.
            plotter.disable_anti_aliasing()
            plotter.background_color = (grey, grey, grey)
            plotter.add_mesh(mesh, scalars="grey", rgb=True, lighting=False)
            camera = plotter.camera
            camera.position = (0.0, 0.0, 0.0)
            camera.focal_point, camera.up = tuple(axes[2]), tuple(-axes[1])
            camera.view_angle = np.rad2deg(2.0 * np.arctan(0.5 * width / self.focal))
            camera.clipping_range = (0.05, 5.0)
            image = plotter.screenshot(return_img=True)[..., 0] / 255.0
            plotter.close()
        return BLACK + (WHITE - BLACK) * image


def photograph(
    path: Path, sheet: Sheet, view: Placement, lens: Lens, rng: np.random.Generator
) -> Path:
    """Writes a JPEG, with light that falls off to one side."""
    import cv2

    light, (left, top) = draw(sheet, view, lens)
    whole = np.full(lens.size[::-1], TABLE)
    whole[top : top + light.shape[0], left : left + light.shape[1]] = light
    part = slice(max(top - 9, 0), top + light.shape[0] + 9)
    whole[part] = gaussian_filter(whole[part], lens.blur)
    whole *= np.linspace(1.05, 0.85, lens.size[0])[None]
    curve = np.where(
        whole <= 0.0031308, 12.92 * whole, 1.055 * whole ** (1 / 2.4) - 0.055
    )
    noisy = curve + lens.noise * rng.normal(size=curve.shape)
    image = np.clip(np.rint(255.0 * noisy), 0, 255).astype(np.uint8)
    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert ok
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())
    return path


def photographs(
    folder: Path,
    sheet: Sheet,
    views: Sequence[Placement],
    lens: Lens,
    rng: np.random.Generator,
) -> list[Path]:
    """Writes one photograph for each view."""
    return [
        photograph(folder / f"{i}.jpg", sheet, view, lens, rng)
        for i, view in enumerate(views)
    ]


def board() -> Sheet:
    """The printed board."""
    corners = {number: board_corners(number) for number in BOARD_IDS}
    return {
        number: (Placement(np.eye(3), own.mean(axis=0)), float(own[1, 0] - own[0, 0]))
        for number, own in corners.items()
    }
