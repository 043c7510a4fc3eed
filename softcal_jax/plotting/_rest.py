"""Draw the body at rest, plain and shaded, as a backdrop without OpenGL."""

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.mesh import TetMesh
from softcal_jax.plotting._faces import visible_faces
from softcal_jax.plotting._view import View

_FINE = 2
"""Samples of a pixel in each direction."""

_LIGHT, _DARK = 0.97, 0.70
"""Brightness of a face seen from the front, and from the side."""

_OUTLINED = 7.0
"""Mean edge from which faces are outlined; below, lines would cover all [pixels]."""


def rest_image(
    mesh: TetMesh, view: View, *, size: tuple[int, int], scale: float
) -> Float[HostArray, "height width 3"]:
    """Paint the faces that look towards the viewer, the farthest first.

    Args:
        mesh: The mesh [m].
        view: The projection, whose centre is that of the picture.
        size: Width and height [pixels].
        scale: Pixels per metre.

    Returns:
        Colours from 0 to 1, white where there is no body.
    """
    from PIL import Image, ImageDraw

    faces = visible_faces(mesh, view)
    flat = view.project(faces.corners.reshape(-1, 3)).reshape(-1, 3, 2)
    fine = _FINE * scale
    pixels = flat * [fine, -fine] + 0.5 * _FINE * np.array(size)
    edges = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2)
    outlined = bool(edges.size) and edges.mean() > _FINE * _OUTLINED
    shade = np.rint(255.0 * (_DARK + (_LIGHT - _DARK) * faces.light)).astype(int)
    image = Image.new("L", (_FINE * size[0], _FINE * size[1]), 255)
    draw = ImageDraw.Draw(image)
    for corners, grey in zip(pixels.tolist(), shade.tolist(), strict=True):
        line = int(0.86 * grey) if outlined else grey
        draw.polygon([tuple(corner) for corner in corners], fill=grey, outline=line)
    grey = np.asarray(image.resize(size, Image.Resampling.BOX), float) / 255.0
    return np.repeat(grey[:, :, None], 3, axis=2)
