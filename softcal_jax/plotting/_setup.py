"""Draw how a configuration is held and loaded: supports, dead loads, gravity."""

from typing import TYPE_CHECKING, Any

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import AbstractLoad, Configuration, Support
from softcal_jax.export import readable_values
from softcal_jax.mesh import TetMesh, node_indices
from softcal_jax.plotting._annotations import draw_name
from softcal_jax.plotting._colours import FORCE, GRAVITY, SUPPORT
from softcal_jax.plotting._view import View

if TYPE_CHECKING:
    import matplotlib.axes

_SHORTEST, _LONGEST = 0.07, 0.14
"""Lengths of the arrows of the smallest and largest load, over the view's width."""

_GRAVITY = 24.0
"""Half the length of its arrow, if it is seen from the side [pixels]."""

_LEAST = 0.15
"""Part of an arrow that must be seen from the side; else a dot shows it end on [-]."""

_STYLES: dict[str, dict[str, Any]] = {
    "support": {"marker": "s", "ms": 9, "ls": "none", "color": SUPPORT, "alpha": 0.7},
    "load": {"color": FORCE, "lw": 3.0, "marker": "v", "ms": 8},
    "gravity": {"color": GRAVITY, "lw": 3.0, "marker": "v", "ms": 8},
}
"""Symbols of the legend."""


def load_place(
    load: AbstractLoad, mesh: TetMesh, x: Float[HostArray, "n_nodes 3"]
) -> tuple[Float[HostArray, "3"], Float[HostArray, "3"]]:
    """Find the mean place where a load acts [m], with nodes at x, and its sum [N]."""
    forces = load.nodal_forces(mesh)
    # Nodes of quadratic faces share a force unevenly, with some shares of zero.
    weights = np.abs(forces @ forces.sum(axis=0))
    if not weights.any():
        weights = np.linalg.norm(forces, axis=1)
    where = np.flatnonzero(weights) if weights.any() else np.arange(mesh.n_nodes)
    weights = weights[where] if weights.any() else np.ones(len(where))
    return np.average(x[where], axis=0, weights=weights), forces.sum(axis=0)


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

    Args:
        axes: Axes in metres, around the centre of the view.
        view: The projection.
        configuration: What is drawn.
        mesh: The mesh at rest [m].
        x: Positions of its nodes in the picture [m].

    Returns:
        What was drawn, for `setup_handles`.
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
            _draw_arrow(axes, view, place, share * force / size, FORCE, name)
    _draw_gravity(axes, view, configuration.gravity)
    drawn = {
        "support": bool(configuration.supports),
        "load": any(sizes),
        "gravity": bool(np.any(configuration.gravity)),
    }
    return [what for what, there in drawn.items() if there]


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
        corners = x[mesh.faces(name)[:, :3]]
        flat = view.project(corners.reshape(-1, 3)).reshape(-1, 3, 2)
        style = {"facecolor": SUPPORT, "edgecolor": "white", "lw": 0.4, "alpha": 0.4}
        axes.add_collection(PolyCollection(list(flat), **style))
    else:
        small = {**_STYLES["support"], "ms": 5}
        axes.plot(*view.project(x[nodes]).T, **small)
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
    """Draw a force that pulls at a place, its arrow `along` times the view's width."""
    start = view.project(place[None])[0]
    step = view.width * np.array([along @ view.right, along @ view.up])
    if np.linalg.norm(step) < _LEAST * view.width * np.linalg.norm(along):
        axes.plot(*start, "o", ms=13, mfc="none", mec=colour, mew=2.5)
        axes.plot(*start, "." if along @ view.towards > 0 else "x", ms=8, color=colour)
        draw_name(axes, text, start, (12, 8), fontsize=13, color=colour)
        return
    look = {"arrowstyle": "-|>", "color": colour, "lw": 3.0, "mutation_scale": 20}
    end = start + step
    arrow = {**look, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=arrow)
    # Towards the middle of the picture, where there is room.
    left = start[0] > 0.0
    side = {"ha": "right" if left else "left", "va": "center", "fontsize": 13}
    where = (-9 if left else 9, 0)
    draw_name(axes, text, 0.5 * (start + end), where, color=colour, **side)


def _draw_gravity(
    axes: "matplotlib.axes.Axes", view: View, gravity: tuple[float, float, float]
) -> None:
    """Draw the direction of gravity in the upper right corner, with its size."""
    g = np.asarray(gravity, float)
    size = float(np.linalg.norm(g))
    words = {"fontsize": 13, "color": GRAVITY, "ha": "right", "va": "center"}
    text = f"{size:.4g} m/s2" if size else "no gravity"
    axes.text(0.965, 0.955, text, transform=axes.transAxes, **words)
    if not size:
        return
    step = np.array([g @ view.right, g @ view.up]) / size
    middle = (0.92, 0.87)
    if np.linalg.norm(step) < _LEAST:
        symbol = "." if g @ view.towards > 0 else "x"
        style = {"transform": axes.transAxes, "color": GRAVITY}
        axes.plot(*middle, "o", ms=15, mfc="none", mec=GRAVITY, mew=2.5, **style)
        axes.plot(*middle, symbol, ms=8, **style)
        return
    # As long on the paper in every direction.
    width, height = axes.get_window_extent().size
    half = _GRAVITY * step / [width, height]
    look = {"arrowstyle": "-|>", "color": GRAVITY, "lw": 3.0, "mutation_scale": 18}
    arrow = {**look, "shrinkA": 0, "shrinkB": 0}
    tip, tail = middle + half, middle - half
    axes.annotate(
        "",
        tuple(tip),
        tuple(tail),
        arrowprops=arrow,
        xycoords="axes fraction",
        textcoords="axes fraction",
    )


def setup_handles(drawn: list[str]) -> list[Any]:
    """Make the entries of the legend for what `draw_setup` has drawn."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], label=what, **style)
        for what, style in _STYLES.items()
        if what in drawn
    ]
