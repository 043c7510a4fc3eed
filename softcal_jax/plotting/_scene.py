"""Draw the body in three dimensions, by VTK, into an array of pixels."""

from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.equilibrium import Model
from softcal_jax.plotting._colours import DISPLACEMENT_MAP, OUTLINE, RIGID
from softcal_jax.plotting._offscreen import offscreen
from softcal_jax.plotting._surface import Tessellation, tessellate
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import pyvista

_SUPERSAMPLING = 2
_GHOST = "#ececec"
"""Colour of the body at rest."""


def body_image(
    model: Model,
    displacement: Float[HostArray, "n_nodes 3"],
    view: View,
    *,
    size: tuple[int, int],
    scale: float,
    largest_mm: float,
) -> Int[HostArray, "height width 3"]:
    """Draw the deformed body, coloured by displacement, over the outline at rest.

    Args:
        model: The model.
        displacement: Nodal displacement [m].
        view: The projection.
        size: Width and height in pixels.
        scale: Pixels per metre.
        largest_mm: Displacement at the top of the colours [mm].

    Returns:
        Pixels, 0 to 255.

    Raises:
        RenderingError: If the machine has no suitable OpenGL.
    """
    import pyvista

    width, height = size
    tessellation = tessellate(model.mesh)
    rest = _surface(tessellation, model.mesh.points, np.zeros_like(displacement))
    deformed = _surface(tessellation, model.mesh.points, displacement)
    rigid = _rigid(model, tessellation)
    soft = _surface(tessellation, model.mesh.points, displacement, chosen=~rigid)
    fine = _SUPERSAMPLING
    with offscreen():
        plotter = pyvista.Plotter(
            off_screen=True, window_size=[fine * width, fine * height]
        )
        plotter.disable_anti_aliasing()  # the finer grid smooths already
        try:
            ghost = [
                plotter.add_mesh(rest, color=_GHOST, lighting=False),
                plotter.add_mesh(_edges(rest), color=OUTLINE, line_width=1.6 * fine),
            ]
            body = [
                plotter.add_mesh(
                    soft,
                    scalars="displacement",
                    cmap=DISPLACEMENT_MAP,
                    clim=[0.0, largest_mm or 1.0],
                    smooth_shading=True,
                    split_sharp_edges=True,
                    ambient=0.55,
                    diffuse=0.5,
                    specular=0.05,
                    show_scalar_bar=False,
                ),
                plotter.add_mesh(
                    _edges(deformed), color="black", opacity=0.55, line_width=1.2 * fine
                ),
            ]
            if rigid.any():
                part = _surface(
                    tessellation, model.mesh.points, displacement, chosen=rigid
                )
                body.append(plotter.add_mesh(part, color=RIGID, ambient=0.4))
            camera = plotter.camera
            distance = 10.0 * (model.mesh.size + view.width + view.height)
            camera.focal_point = tuple(view.centre)
            camera.position = tuple(view.centre + distance * view.towards)
            camera.up = tuple(view.up)
            camera.parallel_projection = True
            camera.parallel_scale = 0.5 * height / scale
            plotter.renderer.ResetCameraClippingRange()
            # Draw in layers, since overlapping surfaces would hide parts of each other:
            # the body at rest, the deformed one, and the outline faintly over both.
            layers = [
                _layer(plotter, shown, [*ghost, *body])
                for shown in (ghost, body, ghost[1:])
            ]
        finally:
            plotter.close()
    picture = np.full((height, width, 3), 255.0, np.float32)
    for (colour, cover), strength in zip(layers, (1.0, 1.0, 0.45), strict=True):
        picture += strength * (colour - cover * picture)
    return np.rint(picture).astype(np.int32)


def _layer(plotter: "pyvista.Plotter", shown: list, actors: list):
    """Render some of the actors: colour times opacity, and opacity from 0 to 1."""
    for actor in actors:
        actor.SetVisibility(actor in shown)
    plotter.render()
    rgba = plotter.screenshot(None, transparent_background=True, return_img=True)
    rgba = np.asarray(rgba, np.float32)
    cover = rgba[..., 3:] / 255.0
    return _shrink(rgba[..., :3] * cover), _shrink(cover)


def _shrink(image: Float[HostArray, "rows columns n"]):
    """Average the samples of each pixel."""
    n = _SUPERSAMPLING
    return sum(image[i::n, j::n] for i in range(n) for j in range(n)) / n**2


def _surface(
    tessellation: Tessellation,
    points: Float[HostArray, "n_nodes 3"],
    displacement: Float[HostArray, "n_nodes 3"],
    *,
    chosen: Bool[HostArray, " n_triangles"] | None = None,
) -> "pyvista.PolyData":
    import pyvista

    triangles = tessellation.triangles
    triangles = triangles if chosen is None else triangles[chosen]

    moved = tessellation.interpolate(displacement)
    surface = pyvista.PolyData.from_regular_faces(
        tessellation.interpolate(points) + moved, triangles
    )
    surface.point_data["displacement"] = 1e3 * np.linalg.norm(moved, axis=1)
    return surface


def _rigid(model: Model, tessellation: Tessellation) -> Bool[HostArray, " n_triangles"]:
    """Find the triangles whose nodes all belong to one rigid body."""
    bodies = model.mechanism.bodies
    body = np.full(model.mesh.n_nodes, -1)
    body[bodies.attached] = bodies.body
    own = body[tessellation.faces]
    return (own[:, 0] >= 0) & np.all(own == own[:, :1], axis=1)


def _edges(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    edges: Any = surface.extract_feature_edges(
        30.0,
        boundary_edges=False,
        non_manifold_edges=False,
        manifold_edges=False,
    )
    # A round body has no sharp edges; show its triangles instead.
    if edges.n_cells == 0:
        edges = surface.extract_all_edges()
    return edges
