"""Draw the body in three dimensions, by VTK, without a screen.

The VTK wheel links no graphics library. It loads one for the first picture, and if it
finds none, the process dies of a segmentation fault. So a library is looked for first,
and VTK is told which one to use.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import Tessellation, tessellate
from softcal_jax.plotting._figure import (
    DISPLACEMENT_MAP,
    OBSTACLE,
    OUTLINE,
    PRESSURE_MAP,
    RIGID,
)
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import pyvista

_SMOOTHING = "ssaa"  # VTK averages 4 x 4 samples of each pixel
_GHOST = "#ececec"  # colour of the body at rest
_ROUND: dict[str, Any] = {"smooth_shading": True, "split_sharp_edges": True}
_COVERED, _TOUCHED, _OUTLINE = 0.5, 0.85, 0.45  # strengths of what lies over the body
_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"

_REMEDY = (
    "pictures of the body cannot be drawn, as this machine has no OpenGL that works "
    "without a screen. On Debian or Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
)


class RenderingError(RuntimeError):
    """This machine cannot draw pictures of a body."""


def rendering_problem() -> str | None:
    """Say why bodies cannot be drawn here, and the remedy; None if they can."""
    try:
        _backend()
    except RenderingError as error:
        return str(error)
    return None


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK draw without a screen; make and close its window inside the block."""
    backend = _backend()
    if backend is not None:
        os.environ[_CHOICE] = backend
    try:
        yield
    finally:
        if backend is not None:
            del os.environ[_CHOICE]


def _backend() -> str | None:
    """Choose VTK's render window; None where its own choice is right."""
    if not sys.platform.startswith("linux") or os.environ.get(_CHOICE):
        return None  # macOS and Windows need no choice, or the user has chosen
    # A program that already shows windows by GLX must stay with it: EGL would fail.
    # Without a display there are no windows: gmsh has only loaded the library.
    maps = Path("/proc/self/maps").read_text(errors="replace")
    if os.environ.get("DISPLAY") and "/libGLX" in maps and "/libEGL" not in maps:
        return None
    # Avoid X11 otherwise: it warns without a DISPLAY and fails with a stale one.
    return _headless_backend()


@functools.cache
def _headless_backend() -> str:
    osmesa = (f"libOSMesa.so{end}" for end in (".8", ".6", ""))
    if _can_load("libEGL.so.1") and _egl_works():
        return "vtkEGLRenderWindow"
    if any(map(_can_load, osmesa)):
        return "vtkOSOpenGLRenderWindow"
    raise RenderingError(_REMEDY)


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _egl_works() -> bool:
    """Check that EGL finds a driver; libEGL may be installed without one."""
    from vtkmodules.vtkCommonCore import vtkLogger
    from vtkmodules.vtkRenderingOpenGL2 import vtkEGLRenderWindow

    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        window = vtkEGLRenderWindow()
        window.SetOffScreenRendering(True)
        works = bool(window.SupportsOpenGL())
        window.Finalize()
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
    return works


def rigid_faces(model: Model, faces: Int[HostArray, "n n_fn"]) -> Bool[HostArray, " n"]:
    """Say of which faces all nodes belong to one rigid body."""
    bodies, body = model.mechanism.bodies, np.full(model.mesh.n_nodes, -1)
    body[bodies.attached] = bodies.body
    owners = body[faces]
    return (owners[:, 0] >= 0) & np.all(owners == owners[:, :1], axis=1)


def body_image(
    model: Model,
    displacement: Float[HostArray, "n_nodes 3"],
    view: View,
    *,
    size: tuple[int, int],
    scale: float,
    largest: float,
    finer: float = 1.0,
    obstacles: "Sequence[pyvista.PolyData]" = (),
    pressure: Float[HostArray, " n_faces"] | None = None,
) -> Int[HostArray, "height width 3"]:
    """Draw the deformed body, coloured by displacement, over the outline at rest.

    The size is in pixels, the scale in pixels per metre; the image has `finer` times as
    many of them. The colours end at the largest displacement [m]. Obstacles are half
    transparent and do not change what is visible. Where there is a pressure on faces of
    the boundary [Pa], it is the colour, seen through all else.
    """
    import pyvista

    width, height = (round(finer * pixels) for pixels in size)
    tessellation, points = tessellate(model.mesh), model.mesh.points
    n = len(tessellation.faces)
    pressure = np.zeros(n) if pressure is None else pressure.repeat(n // len(pressure))
    pressed, whole = pressure > 0.0, np.ones(n, bool)
    rigid = rigid_faces(model, tessellation.faces) & ~pressed
    rest = _surface(tessellation, points, np.zeros_like(displacement), whole)
    deformed = lambda chosen: _surface(tessellation, points, displacement, chosen)
    with offscreen():
        plotter = pyvista.Plotter(off_screen=True, window_size=[width, height])
        plotter.background_color = "white"  # pyright: ignore
        plotter.enable_anti_aliasing(_SMOOTHING)
        try:
            ghost = [
                plotter.add_mesh(rest, color=_GHOST, lighting=False),
                plotter.add_mesh(_edges(rest), color=OUTLINE, line_width=4.4 * finer),
            ]
            body = [
                plotter.add_mesh(
                    deformed(~rigid & ~pressed),
                    scalars="displacement",
                    cmap=DISPLACEMENT_MAP,
                    clim=[0.0, largest or 1.0],
                    ambient=0.55,
                    diffuse=0.5,
                    specular=0.05,
                    show_scalar_bar=False,
                    **_ROUND,
                ),
                plotter.add_mesh(
                    _edges(deformed(whole)),
                    color="black",
                    opacity=0.55,
                    line_width=3.6 * finer,
                ),
            ]
            if rigid.any():
                body.append(plotter.add_mesh(deformed(rigid), color=RIGID, ambient=0.4))
            touched = []
            if pressed.any():
                patch = deformed(pressed)
                patch.cell_data["pressure"] = pressure[pressed]
                look = {"cmap": PRESSURE_MAP, "clim": [0.0, pressure.max()]}
                look |= {"show_scalar_bar": False, "lighting": False}
                touched = [plotter.add_mesh(patch, scalars="pressure", **look)]
            around = [
                plotter.add_mesh(surface, color=OBSTACLE, ambient=0.4, **_ROUND)
                for surface in obstacles
            ]
            camera = plotter.camera
            distance = 10.0 * (model.mesh.size + view.width + view.height)
            camera.focal_point = tuple(view.centre)
            camera.position = tuple(view.centre + distance * view.towards)
            camera.up = tuple(view.up)
            camera.parallel_projection = True
            camera.parallel_scale = 0.5 * size[1] / scale
            plotter.renderer.ResetCameraClippingRange()
            # Draw in layers, since overlapping surfaces would hide parts of each other:
            # the body at rest, the deformed one, obstacles in front of it, what is
            # touched through them, and the outline faintly over all.
            body += touched
            actors = [*ghost, *body, *around]
            layer = partial(_layer, plotter, actors)
            behind, alone, outline = map(layer, (ghost, body, ghost[1:]))
            covered = layer([*body, *around]) if around else alone
            layers = [(behind, 1.0), (alone, 1.0), (covered, _COVERED)]
            if touched:
                layers.append((layer(touched), _TOUCHED))
            layers.append((outline, _OUTLINE))
        finally:
            plotter.close()
    picture = np.full((height, width, 3), 255.0, np.float32)
    for (colour, cover), strength in layers:
        picture += strength * (colour - cover * picture)
    return np.rint(picture).clip(0, 255).astype(np.int32)


def _layer(plotter: "pyvista.Plotter", actors: list, shown: list):
    """Render some of the actors: colour times opacity, and opacity from 0 to 1."""
    for actor in actors:
        actor.SetVisibility(actor in shown)
    plotter.render()
    rgba = plotter.screenshot(None, transparent_background=True, return_img=True)
    rgba = np.asarray(rgba, np.float32)
    cover = rgba[..., 3:] / 255.0
    return rgba[..., :3] - 255.0 * (1.0 - cover), cover


def _surface(
    tessellation: Tessellation,
    points: Float[HostArray, "n_nodes 3"],
    displacement: Float[HostArray, "n_nodes 3"],
    chosen: Bool[HostArray, " n_triangles"],
) -> "pyvista.PolyData":
    import pyvista

    moved = tessellation.interpolate(displacement)
    x = tessellation.interpolate(points) + moved
    triangles = tessellation.triangles[chosen]
    surface = pyvista.PolyData.from_regular_faces(x, triangles)
    surface.point_data["displacement"] = np.linalg.norm(moved, axis=1)
    return surface


def _edges(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    edges: Any = surface.extract_feature_edges(
        30.0, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    # A round body has no sharp edges; show its triangles instead.
    if edges.n_cells == 0:
        edges = surface.extract_all_edges()
    return edges
