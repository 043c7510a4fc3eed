"""Shapes of obstacles as signed distances, in the frame of their rigid body.

The distance is negative inside. Edges are rounded, so that its gradient is continuous
up to a depth of the rounding.
"""

import dataclasses
import math
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from softcal_jax._module import Module, key
from softcal_jax._typing import Array, Float, HostArray, check_untraced
from softcal_jax.elements import vector_length

if TYPE_CHECKING:
    from pyvista import PolyData


class AbstractShape(Module):
    """The shape of an obstacle, fixed to the frame of its rigid body.

    A shape of one's own defines `distance`, which JAX must be able to differentiate
    twice, `depth` and `drawn`. Lengths that project files call positive are checked.
    """

    def __check_init__(self):
        what = {kind: name for name, kind in SHAPES.items()}.get(type(self), "shape")
        for field in dataclasses.fields(self):
            if field.metadata.get("size") == "positive":
                leaf = f"{field.name} of one of model.mechanism.contacts.shapes"
                check_untraced(field.name, getattr(self, field.name), leaf)
                value = np.min(getattr(self, field.name))
                if not 0.0 < value < np.inf:
                    raise ValueError(
                        f"{field.name} of a {what} must be positive and finite [m], "
                        f"got {value}."
                    )
        rounding, most = getattr(self, "rounding", 0.0), 2.0 * self.depth
        if rounding > most:
            raise ValueError(
                f"rounding of a {what} must be at most half of its smallest side "
                f"({most:g} m), got {rounding:g} m."
            )

    @abstractmethod
    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        """Compute the signed distance of a point of the frame, negative inside [m]."""

    @property
    @abstractmethod
    def depth(self) -> float:
        """How deep a point may lie inside and still find the way out it came in [m]."""

    @abstractmethod
    def drawn(self, size: float) -> "PolyData":
        """Make its surface to be drawn beside a robot of a size [m]."""


RADIUS = key("m", 'its radius: "5 mm"', "positive")
ROUNDING = key("m", 'radius of its edges: "0.5 mm"', "positive")


def _rounded(
    q: Float[Array, " n"], rounding: float | Float[Array, ""]
) -> Float[Array, ""]:
    """Return the distance from a rounded edge, for the distances `q` from its core."""
    return vector_length(jnp.maximum(q, 0.0)) + jnp.minimum(jnp.max(q), 0.0) - rounding


class HalfSpace(AbstractShape):
    """A table or wall: all below the plane of the first two axes of the frame."""

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        return y[2]

    @property
    def depth(self) -> float:
        return math.inf

    def drawn(self, size: float) -> "PolyData":
        import pyvista as pv

        return pv.Plane(i_size=1.5 * size, j_size=1.5 * size)


class Ball(AbstractShape):
    """A sphere about the origin of the frame, with a radius [m]."""

    radius: float = eqx.field(metadata=RADIUS)

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        return vector_length(y) - self.radius

    @property
    def depth(self) -> float:
        return 0.5 * self.radius

    def drawn(self, size: float) -> "PolyData":
        import pyvista as pv

        return pv.Sphere(radius=self.radius, theta_resolution=36, phi_resolution=36)


class Capsule(AbstractShape):
    """A cylinder with round ends, along the third axis of the frame.

    Attributes:
        radius: Its radius [m].
        length: Distance of the centres of its ends, which lie half of it from the
            origin [m].
    """

    radius: float = eqx.field(metadata=RADIUS)
    length: float = eqx.field(
        metadata=key("m", 'distance of the centres of its ends: "20 mm"', "positive")
    )

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        half = 0.5 * self.length
        nearest = jnp.clip(y[2], -half, half)
        return vector_length(jnp.stack([y[0], y[1], y[2] - nearest])) - self.radius

    @property
    def depth(self) -> float:
        return 0.5 * self.radius

    def drawn(self, size: float) -> "PolyData":
        return _revolved(self.radius, self.length + 2.0 * self.radius, self.radius)


class RoundedCylinder(AbstractShape):
    """A cylinder along the third axis of the frame, with rounded edges: a flat punch.

    Attributes:
        radius: Its radius [m].
        length: Its length; the ends lie half of it from the origin [m].
        rounding: Radius of its edges [m].
    """

    radius: float = eqx.field(metadata=RADIUS)
    length: float = eqx.field(metadata=key("m", 'its length: "20 mm"', "positive"))
    rounding: float = eqx.field(metadata=ROUNDING)

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        out = jnp.stack([vector_length(y[:2]), jnp.abs(y[2])])
        core = jnp.stack([self.radius, 0.5 * self.length]) - self.rounding
        return _rounded(out - core, self.rounding)

    @property
    def depth(self) -> float:
        return 0.5 * min(self.radius, 0.5 * self.length)

    def drawn(self, size: float) -> "PolyData":
        return _revolved(self.radius, self.length, self.rounding)


def _revolved(radius: float, length: float, rounding: float) -> "PolyData":
    """Make the surface of a cylinder along the third axis, with rounded edges."""
    import pyvista as pv

    turn = np.linspace(0.0, 0.5 * np.pi, 9)
    r = radius - rounding * (1.0 - np.cos(turn))
    z = 0.5 * length - rounding * (1.0 - np.sin(turn))
    r, z = np.append(r, 0.0), np.append(z, z[-1])
    r, z = np.append(r[::-1], r), np.append(-z[::-1], z)
    outline: Any = pv.lines_from_points(np.column_stack([r, np.zeros_like(r), z]))
    surface = outline.extrude_rotate(resolution=48, capping=False)
    return surface.triangulate().clean(tolerance=1e-6)


class RoundedBox(AbstractShape):
    """A box about the origin of the frame, with rounded edges.

    Attributes:
        size: Lengths of its sides along the axes of the frame [m].
        rounding: Radius of its edges [m].
    """

    size: tuple[float, float, float] = eqx.field(
        metadata=key("m", 'lengths of its sides: "(20, 20, 10) mm"', "positive")
    )
    rounding: float = eqx.field(metadata=ROUNDING)

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        core = 0.5 * jnp.stack([jnp.asarray(s, float) for s in self.size])
        return _rounded(jnp.abs(y) - core + self.rounding, self.rounding)

    @property
    def depth(self) -> float:
        return 0.25 * min(self.size)

    def drawn(self, size: float) -> "PolyData":
        import pyvista as pv

        a, b, c = (0.5 * side for side in self.size)
        return pv.Box(bounds=(-a, a, -b, b, -c, c))


SHAPES: dict[str, type[AbstractShape]] = {
    "plane": HalfSpace,
    "sphere": Ball,
    "cylinder": RoundedCylinder,
    "capsule": Capsule,
    "box": RoundedBox,
}
"""The shapes that project files make, as they call them."""


class DistanceGrid(AbstractShape):
    """A closed surface, as its signed distance on a grid; `read_surface` makes it.

    Between the points of the grid it is a cubic B-spline, with continuous first and
    second derivatives.

    Attributes:
        coefficients: Coefficients of the spline [m].
        origin: First point of the grid, in the frame of the body [m].
        spacing: Distance of its points [m].
        deepest: Largest distance of a point inside from the surface [m].
    """

    coefficients: Float[Array | HostArray, "n_x n_y n_z"]
    origin: Float[HostArray, "3"]
    spacing: float
    deepest: float

    def distance(self, y: Float[Array, "3"]) -> Float[Array, ""]:
        at = (y - jnp.asarray(self.origin)) / self.spacing
        last = jnp.array(self.coefficients.shape, float) - 3.0
        inside = jnp.clip(at, 1.0, last)
        low = jnp.floor(jax.lax.stop_gradient(jnp.minimum(inside, last - 1e-9)))
        weights = jax.vmap(_spline_weights)(inside - low)
        first = low.astype(int) - 1
        cube = jax.lax.dynamic_slice(self.coefficients, first, (4, 4, 4))
        value = jnp.einsum("ijk,i,j,k->", cube, *weights)
        # Beyond the grid the way back to it is added.
        return value + self.spacing * vector_length(at - inside)

    @property
    def depth(self) -> float:
        return 0.5 * self.deepest

    def drawn(self, size: float) -> "PolyData":
        import pyvista as pv

        shape, spacing = self.coefficients.shape, (float(self.spacing),) * 3
        grid: Any = pv.ImageData(dimensions=shape, spacing=spacing, origin=self.origin)
        knots = np.asarray(self.coefficients)
        for axis in range(3):
            knots = ndimage.correlate1d(knots, [1 / 6, 2 / 3, 1 / 6], axis)
        return grid.contour([0.0], knots.ravel(order="F"))


def _spline_weights(t: Float[Array, ""]) -> Float[Array, "4"]:
    """Return the weights of the four cubic B-splines around a point."""
    s = 1.0 - t
    inner = lambda t: 2.0 / 3.0 - t**2 + 0.5 * t**3
    return jnp.stack([s**3 / 6.0, inner(t), inner(s), t**3 / 6.0])


def read_surface(
    path: str | Path, *, length_unit: float = 1.0, points: int = 64
) -> DistanceGrid:
    """Read a closed surface (STL, PLY, OBJ, VTP) as the shape of an obstacle.

    VTK computes its signed distances on a grid of `points` along its longest side, and
    a quarter of them more around; farther than eight spacings from the surface, on a
    grid of four times the spacing. Its coordinates are those of the frame of its rigid
    body, in `length_unit` [m].

    Raises:
        ValueError: If the surface is not closed, or has no triangles.
    """
    import pyvista as pv

    surface: Any = pv.read(path)
    surface = surface.triangulate().clean()
    if surface.n_cells == 0 or surface.n_open_edges > 0:
        raise ValueError(
            f"{path} has {surface.n_cells} triangles and {surface.n_open_edges} open "
            "edges; expected a closed surface: mend it in the program that wrote it."
        )
    surface.points = length_unit * np.asarray(surface.points, float)
    low, high = np.reshape(surface.bounds, (3, 2)).T
    spacing = float(max(high - low)) / (points - 1)
    around = max(4, points // 8)
    shape = np.ceil((high - low) / spacing).astype(int) + 1 + 2 * around
    origin = low - around * spacing
    surface = surface.compute_normals(auto_orient_normals=True)

    def distances(points: np.ndarray) -> np.ndarray:
        asked = pv.PolyData(points).compute_implicit_distance(surface)
        return np.asarray(asked["implicit_distance"], float)

    # Far from the surface, where VTK takes longest, every fourth point is enough, with
    # two more around for the ends of the spline.
    cells = np.indices((*shape,))
    coarse = np.indices((*((shape + 2) // 4 + 5),))
    values = distances(origin + 4 * spacing * (coarse.reshape(3, -1).T - 2))
    values = ndimage.map_coordinates(values.reshape(coarse.shape[1:]), cells / 4 + 2)
    near = np.abs(values) < 8 * spacing
    values[near] = distances(origin + spacing * cells[:, near].T)
    knots = ndimage.spline_filter(values, order=3, mode="mirror")
    return DistanceGrid(knots, origin, spacing, float(-values.min()))
