"""Obstacles as they are drawn: their surfaces, where they stand."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.distance import cdist

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.bodies import BodyStateArrays
from softcal_jax.configurations import standing
from softcal_jax.contact import ContactState, HalfSpace
from softcal_jax.equilibrium import Model, RobotState
from softcal_jax.export import readable_values
from softcal_jax.plotting._figure import FAINT, OBSTACLE, Axes, draw_name, draw_patch
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import pyvista

_MOST = 2500  # triangles of a surface; more of them look the same
_COVER = 0.35  # opacity of an obstacle in a plan


class PlacedObstacle(NamedTuple):
    """An obstacle that is drawn.

    Attributes:
        number: Its index among the obstacles of the model.
        name: Its name, and the force on it at an equilibrium.
        origin: Place of the origin of its surface [m].
        axes: Directions of the axes of its surface, by rows [-].
    """

    number: int
    name: str
    origin: Float[HostArray, "3"]
    axes: Float[HostArray, "3 3"]

    def place(self, points: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
        """Move points of its surface to where it stands [m]."""
        return self.origin + np.asarray(points, float) @ self.axes


def obstacles_at(model: Model, state: RobotState) -> list[PlacedObstacle]:
    """List the obstacles that are there at an equilibrium."""
    contacts = model.mechanism.contacts
    x = np.asarray(model.mechanism.points) + state.displacement
    felt = {contact.name: contact for contact in state.contacts}
    names = [_named(name, felt.get(name)) for name in contacts.names]
    present = np.array([name in felt for name in contacts.names], bool)
    return list(_placed(model, present, x[contacts.frames], names))


def _named(name: str, contact: ContactState | None) -> str:
    if contact is None or contact.area == 0.0:
        return name
    size = float(np.linalg.norm(contact.force))
    return f"{name}: {readable_values([size], 'N', digits=3)}"


def obstacles_at_start(model: Model, states: BodyStateArrays) -> list[PlacedObstacle]:
    """List the obstacles that are there before the load, in states of the bodies."""
    if model.mechanism.contacts.n_obstacles == 0:
        return []  # without compiling for it
    present, frames = jax.device_get(standing(model.mechanism, states))
    return list(_placed(model, present, frames, model.mechanism.contacts.names))


def _placed(
    model: Model,
    present: Bool[HostArray, " n_obstacles"],
    frames: Float[HostArray, "n_obstacles 4 3"],
    names: Sequence[str],
) -> Iterator[PlacedObstacle]:
    contacts, middle = model.mechanism.contacts, model.mesh.points.mean(axis=0)
    for k in np.flatnonzero(present).tolist():
        origin = frames[k, 0]
        axes = (frames[k, 1:] - origin) / contacts.length
        if isinstance(contacts.shapes[k], HalfSpace):
            # Its plate lies beside the body, wherever in the plane its origin is.
            origin = middle - axes[2] * (axes[2] @ (middle - origin))
        yield PlacedObstacle(k, names[k], origin, axes)


def obstacle_surface(model: Model, index: int) -> "pyvista.PolyData":
    """Make the surface of an obstacle in its frame, of few triangles [m]."""
    surface: Any = model.mechanism.contacts.shapes[index].drawn(model.mesh.size)
    surface = surface.triangulate()
    if surface.n_cells > _MOST:
        surface = surface.decimate(1.0 - _MOST / surface.n_cells)
    return surface


def placed_surfaces(
    model: Model, obstacles: Sequence[PlacedObstacle]
) -> "list[pyvista.PolyData]":
    """Make the surfaces of obstacles where they stand [m]."""
    surfaces = []
    for obstacle in obstacles:
        surface = obstacle_surface(model, obstacle.number)
        surface.points = obstacle.place(surface.points)
        surfaces.append(surface)
    return surfaces


def draw_obstacles(
    axes: Axes, view: View, model: Model, obstacles: Sequence[PlacedObstacle]
) -> None:
    """Draw obstacles by what is seen of their surfaces, behind or before the body."""
    depth = model.mesh.points.mean(axis=0) @ view.towards
    for surface in placed_surfaces(model, obstacles):
        corners = _seen(np.asarray(surface.points)[surface.regular_faces], view)
        behind = corners.mean(axis=(0, 1)) @ view.towards < depth
        style = {"facecolor": OBSTACLE, "edgecolor": "none", "alpha": _COVER}
        draw_patch(axes, view, corners, **style, zorder=0.5 if behind else 1.5)
    name_obstacles(axes, view, model, obstacles)


def _seen(corners: Float[HostArray, "n 3 3"], view: View) -> Float[HostArray, "m 3 3"]:
    """Take the triangles on the side of the viewer, or all of what has one side."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    outwards = np.sum(normals * (middles - middles.mean(axis=0)))
    towards = normals @ view.towards * np.sign(outwards or 1.0)
    return corners[towards > 0.0] if (towards > 0.0).any() else corners


def name_obstacles(
    axes: Axes, view: View, model: Model, obstacles: Sequence[PlacedObstacle]
) -> None:
    """Write the name of each obstacle where it is farthest from the body."""
    half = 0.9 * np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    body = view.project(model.mesh.points)
    surfaces = placed_surfaces(model, obstacles)
    for obstacle, surface in zip(obstacles, surfaces, strict=True):
        flat = view.project(np.asarray(surface.points))
        inside = np.all(np.abs(flat) <= half, axis=1)
        inside &= np.any(flat < 0.55 * half, axis=1)  # gravity is in that corner
        flat = flat[inside] if inside.any() else np.clip(flat, -half, half)
        place = flat[np.argmax(cdist(flat, body).min(axis=1))]
        style = {"ha": "center", "va": "center", "fontsize": "small", "color": FAINT}
        draw_name(axes, obstacle.name, place, (0, 0), **style)
