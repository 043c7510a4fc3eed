"""Draw how a configuration is held and loaded: supports, dead loads, gravity."""

from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import AbstractLoad, Configuration, Support
from softcal_jax.export import readable_values
from softcal_jax.mesh import TetMesh, node_indices
from softcal_jax.plotting._annotations import draw_name
from softcal_jax.plotting._colours import FORCE, GRAVITY, SUPPORT, SYMBOLS
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import matplotlib.axes

_SHORTEST, _LONGEST = 0.07, 0.14
"""Lengths of the arrows of the smallest and largest load, over the view's width."""

_GRAVITY = 0.05
"""Length of the arrow of gravity, over the width of the picture."""

_LEAST = 0.15
"""Share of an arrow's length that must be seen; a shorter one is drawn end on [-]."""


def load_place(
    load: AbstractLoad, mesh: TetMesh, x: Float[HostArray, "n_nodes 3"]
) -> tuple[Float[HostArray, "3"], Float[HostArray, "3"]]:
    """Find the mean place where a load acts [m], with nodes at x, and its sum [N]."""
    forces = load.nodal_forces(mesh)
    # Nodes of quadratic faces share a force unevenly, with some shares of zero.
    weights = np.abs(forces @ forces.sum(axis=0))
    if not weights.any():
        weights = np.linalg.norm(forces, axis=1)
    if not weights.any():
        weights = np.ones(mesh.n_nodes)
    return np.average(x, axis=0, weights=weights), forces.sum(axis=0)


def load_points(
    configuration: Configuration, mesh: TetMesh, x: Float[HostArray, "n_nodes 3"]
) -> Float[HostArray, "n 3"]:
    """Return the points at which loads act, which must be visible [m]."""
    places = [load_place(load, mesh, x)[0] for load in configuration.loads]
    return np.array(places, float).reshape(-1, 3)


def draw_setup(
    axes: "matplotlib.axes.Axes",
    view: View,
    configuration: Configuration,
    mesh: TetMesh,
    x: Float[HostArray, "n_nodes 3"],
) -> list[str]:
    """Draw supports, dead loads and gravity, each with its name or size.

    The axes are in metres, around the centre of the view; x are positions of the nodes
    in the picture [m]. Returns what was drawn, for the legend.
    """
    for support in configuration.supports:
        _draw_support(axes, view, support, mesh, x)
    placed = [load_place(load, mesh, x) for load in configuration.loads]
    sizes = [float(np.linalg.norm(force)) for _, force in placed]
    for load, (place, force), size in zip(
        configuration.loads, placed, sizes, strict=True
    ):
        if size > 0.0:
            share = _SHORTEST + (_LONGEST - _SHORTEST) * size / max(sizes)
            text = readable_values([size], "N", digits=3)
            named = getattr(load, "where", None)
            name = f"{text} on {named}" if isinstance(named, str) else text
            along = view.width * share * force / size
            _draw_arrow(axes, view, place, along, FORCE, name)
    g = np.asarray(configuration.gravity, float)
    size = float(np.linalg.norm(g))
    corner = np.array([axes.get_xlim()[1], axes.get_ylim()[1]])
    if size > 0.0:
        # In the upper right corner, with its middle at the same place always.
        half = _GRAVITY * corner[0] * g / size
        x, y = corner * (0.87, 0.8)
        place = view.centre + x * view.right + y * view.up - half
        _draw_arrow(axes, view, place, 2.0 * half, GRAVITY, f"{size:.4g} m/s2")
    else:
        style = {"fontsize": 13, "color": GRAVITY, "ha": "right"}
        draw_name(axes, "no gravity", 0.95 * corner, (0, 0), **style)
    drawn = ["support"] if configuration.supports else []
    drawn += ["load"] if any(sizes) else []
    return drawn + (["gravity"] if size > 0.0 else [])


def _draw_support(
    axes: "matplotlib.axes.Axes",
    view: View,
    support: Support,
    mesh: TetMesh,
    x: Float[HostArray, "n_nodes 3"],
) -> None:
    """Draw the held faces as a patch, or the held nodes as squares."""
    from matplotlib.collections import PolyCollection

    nodes = node_indices(mesh, support.where, "a support")
    name = support.name
    if name in mesh.surface_groups:
        flat = view.project(x[mesh.faces(name)[:, :3]])
        style = {"facecolor": SUPPORT, "edgecolor": "white", "lw": 0.4, "alpha": 0.4}
        axes.add_collection(PolyCollection(list(flat), **style))
    else:
        axes.plot(*view.project(x[nodes]).T, **{**SYMBOLS["support"], "ms": 5})
    text = name if support.axes == "xyz" else f"{name}: {support.axes} held"
    if support.stiffness is not None:
        text += ", elastic"
    if np.any(support.displacement):
        text += f", moved by {readable_values(support.displacement, 'm', digits=3)}"
    places = view.project(x[nodes])
    lowest = places[np.argmin(places[:, 1])]
    style = {"ha": "center", "va": "top", "fontsize": 13, "color": SUPPORT}
    draw_name(axes, text, (places[:, 0].mean(), lowest[1]), (0, -8), **style)


def _draw_arrow(
    axes: "matplotlib.axes.Axes",
    view: View,
    place: Float[HostArray, "3"],
    along: Float[HostArray, "3"],
    colour: str,
    text: str,
) -> None:
    """Draw an arrow from where a force acts, along a vector of its length [m]."""
    start = view.project(place)
    step = np.array([along @ view.right, along @ view.up])
    if np.linalg.norm(step) < _LEAST * np.linalg.norm(along):
        axes.plot(*start, "o", ms=13, mfc="none", mec=colour, mew=2.5)
        axes.plot(*start, "." if along @ view.towards > 0 else "x", ms=8, color=colour)
        draw_name(axes, text, start, (12, 8), fontsize=13, color=colour)
        return
    look = {"arrowstyle": "-|>", "color": colour, "lw": 3.0, "mutation_scale": 20}
    end = start + step
    arrow = {**look, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(end), tuple(start), arrowprops=arrow)
    # Towards the middle of the picture, where there is room.
    left = start[0] > 0.0
    side = {"ha": "right" if left else "left", "va": "center", "fontsize": 13}
    where = (-9 if left else 9, 0)
    draw_name(axes, text, 0.5 * (start + end), where, color=colour, **side)
