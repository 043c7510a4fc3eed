"""The view of a body, chosen from its shape and its motion, and what is seen in it."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.mesh import TetMesh, boundary_faces, boundary_tets

_AZIMUTH, _ELEVATION = np.radians(20.0), np.radians(18.0)


class View(NamedTuple):
    """A parallel projection.

    The unit vectors point right and up in the picture, and towards the viewer. Width
    and height are those of what must be visible [m].
    """

    right: Float[HostArray, "3"]
    up: Float[HostArray, "3"]
    towards: Float[HostArray, "3"]
    centre: Float[HostArray, "3"]
    width: float
    height: float

    def project(self, points: Float[HostArray, "*n 3"]) -> Float[HostArray, "*n 2"]:
        """Project points to picture coordinates, from the centre [m]."""
        return (points - self.centre) @ np.stack([self.right, self.up], axis=1)


def fit_body(
    view: View, width: int, margin: int, lowest: float, highest: float
) -> tuple[float, int]:
    """Fit a body to a width: compute pixels per metre, and the height in pixels."""
    scale = (width - 2 * margin) / view.width
    height = int(np.clip(view.height * scale + 2 * margin, lowest, highest))
    return min(scale, (height - 2 * margin) / view.height), height


def fit_panel(view: View, size: int, margin: float) -> tuple[int, int, float]:
    """Fit a panel to a body: width and height in pixels, and pixels per metre.

    The longer side is `size`, the other at least half of it; `margin` is the room for
    the body, over its width and height.
    """
    extent = margin * np.array([view.width, view.height])
    width, height = np.maximum(size * extent / extent.max(), 0.5 * size).astype(int)
    return int(width), int(height), min(width / extent[0], height / extent[1])


def choose_view(
    points: Float[HostArray, "n_nodes 3"],
    displacement: Float[HostArray, "n_nodes 3"] | None = None,
    more: Iterable[HostArray] = (),
    gravity: Sequence[float] | Float[HostArray, "3"] = (0.0, 0.0, -1.0),
    seen_from: Sequence[float] | None = None,
) -> View:
    """Look across the plane of longest axis and motion, slightly from above.

    The part that moves most is on the right, nearer to the viewer, and gravity points
    down. Points of `more`, like markers, are visible too. With `seen_from`, a direction
    towards the viewer, it is seen from there.
    """
    displacement = np.zeros_like(points) if displacement is None else displacement
    above = _unit(-np.asarray(gravity, float)) if np.any(gravity) else np.eye(3)[2]
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    axis, across = axes[0], axes[1]
    motion = np.zeros(3)
    if np.abs(displacement).max() > 1e-9 * np.ptp(points, axis=0).max():
        motion = np.linalg.svd(displacement, full_matrices=False)[2][0]
    motion = motion - (motion @ axis) * axis
    if np.linalg.norm(motion) < 0.3:  # no motion, or along the axis
        upright = abs(axis @ above) > 0.9
        motion = across if upright else above - (axis @ above) * axis
    normal = np.cross(axis, motion) if seen_from is None else np.array(seen_from, float)
    normal = _unit(normal)
    vertical = above
    if abs(normal @ above) >= 0.9:  # seen from above
        vertical = np.eye(3)[1 if abs(normal[1]) < 0.9 else 2]
    right = _unit(np.cross(vertical, normal))
    weight = np.linalg.norm(displacement, axis=1)
    side = weight @ (centred @ right)
    if side <= 1e-6 * weight.sum() * np.ptp(centred @ right):
        side = right[np.argmax(np.abs(right))]  # undecided: let the axis point right
    towards = normal
    if seen_from is None:
        way = np.sign(side)
        # Turn a little, so that the far end and the top are visible too.
        turn = np.tan(_AZIMUTH) * way * right + np.tan(_ELEVATION) * vertical
        towards = _unit(way * normal + turn)
    right = _unit(np.cross(vertical, towards))
    up = np.cross(towards, right)
    seen = np.vstack([points, points + displacement, *more])
    frame = np.stack([right, up, towards], axis=1)
    flat = seen @ frame
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle = frame @ (0.5 * (low + high))
    width, height, _ = high - low
    size = {"width": float(width), "height": float(height)}
    return View(right=right, up=up, towards=towards, centre=middle, **size)


def _unit(v: Float[HostArray, "3"]) -> Float[HostArray, "3"]:
    return v / np.linalg.norm(v)


class VisibleFaces(NamedTuple):
    """Faces that look towards the viewer, the farthest first.

    They have nodes at their corners [m], the share of their area that is seen, and the
    tet that each bounds.
    """

    nodes: Int[HostArray, "n_faces 3"]
    corners: Float[HostArray, "n_faces 3 3"]
    light: Float[HostArray, " n_faces"]
    tet: Int[HostArray, " n_faces"]


def visible_faces(mesh: TetMesh, view: View) -> VisibleFaces:
    """Find the faces of the boundary that look towards the viewer."""
    nodes = boundary_faces(mesh)[:, :3]
    corners = mesh.points[nodes]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    light = normal @ view.towards
    seen = np.flatnonzero(light > 0.0)
    seen = seen[np.argsort(corners[seen].mean(axis=1) @ view.towards)]
    tet = boundary_tets(mesh)[seen]
    return VisibleFaces(nodes[seen], corners[seen], light[seen], tet)
