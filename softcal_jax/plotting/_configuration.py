"""Draw one configuration: the body, and measured beside simulated markers.

VTK draws the body, and Matplotlib draws text, markers and scales over and around it, so
that markers inside or behind the body are visible and no texts overlap.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, RobotState
from softcal_jax.plotting import _figure as figures, _robot as robots
from softcal_jax.plotting._figure import (
    SCREEN,
    PictureStyle,
    add_axes,
    add_view,
    printed,
)
from softcal_jax.plotting._obstacles import (
    name_obstacles,
    obstacles_at,
    placed_surfaces,
)
from softcal_jax.plotting._scene import body_image
from softcal_jax.plotting._view import choose_view, fit_body

_SIDE = 190  # width of the scale beside the body [pixels]
_LOWEST, _HIGHEST = 0.2625, 0.5625  # limits of the height of its part, over the width
_TALL = 600  # to which a part may rise where the picture is narrow [pixels]
_MARGIN = 60  # around the body, for marker symbols and names [pixels]


def render_configuration(
    model: Model,
    result: ConfigurationResult,
    path: str | Path,
    *,
    converged: bool = True,
    titled: bool = True,
    style: PictureStyle = SCREEN,
) -> None:
    """Draw a configuration with its simulated and measured markers.

    Args:
        model: The model.
        result: The configuration, calibrated or simulated.
        path: PNG, SVG or PDF file.
        converged: Whether the calibration converged; if not, the picture says so.
        titled: Whether its name and errors stand above it.
        style: Width, size of words, resolution, and where the body is seen from.

    Raises:
        RenderingError: If the machine has no OpenGL that works without a screen.
    """
    points = result.points
    # A coordinate that was not measured does not contribute to the drawn distance.
    measured = [
        np.where(p.seen, p.measured, p.simulated) if p.seen.any() else p.measured
        for p in points
    ]
    fitted = result.role != "simulation"
    render_body(
        model,
        result.displacement,
        path,
        title=result.name + _ROLES[result.role] if titled else "",
        subtitle=motion_words(result) if titled else "",
        measured=np.array(measured) if points and fitted else None,
        simulated=np.array([p.simulated for p in points]) if points else None,
        marker_names=[p.name for p in points],
        labels=LABELS.get(result.role, LABELS[""]),
        warning="" if converged else NOT_CONVERGED,
        robot=result.robot,
        sensors=robots.sensor_frames(result),
        posed=result.posed,
        style=style,
    )


NOT_CONVERGED = "NOT CONVERGED: do not use these values"
"""What stands above every picture of a calibration that did not converge."""

LABELS = {"": ("measured", "simulated")}
LABELS |= dict.fromkeys(("design", "command"), ("goal", "reached"))
"""What legends call measured and simulated points, by role, "" for any other."""

_ROLES = {
    "calibration": " - calibration (fitted)",
    "validation": " - validation (predicted, not fitted)",
    "prediction": " - predicted",
    "design": " - design",
    "command": " - inverse control",
    "simulation": "",
}


def motion_words(fit: ConfigurationResult) -> str:
    """Say how far the simulated markers are off, or how far a simulated body moves."""
    if fit.role == "simulation":
        moved = readable(fit.largest_displacement, "distance")
        return f"simulated; moves by up to {moved}"
    if not any(point.seen.any() for point in fit.points):
        return "no markers"
    none = "no equilibrium found"
    size = lambda rms: readable(rms, "distance") if math.isfinite(rms) else none
    text = size(fit.rms_after)
    if fit.role in ("design", "command"):
        return f"rms distance of the markers from their goals: {text}"
    if fit.role != "prediction":
        text = f"{size(fit.rms_before)} before, {text} after"
    text = f"rms residual of the markers: {text}"
    if math.isfinite(fit.rms_share):
        text += f" ({readable(fit.rms_share, 'share')} of their motion)"
    if math.isfinite(fit.turn_after):
        text += f"; orientations: {math.degrees(fit.turn_after):.2f} deg"
    return text


def render_body(
    model: Model,
    displacement: Float[HostArray, "n_nodes 3"],
    path: str | Path,
    *,
    title: str = "",
    subtitle: str = "",
    measured: Float[HostArray, "n_markers 3"] | None = None,
    simulated: Float[HostArray, "n_markers 3"] | None = None,
    marker_names: Sequence[str] = (),
    warning: str = "",
    robot: RobotState | None = None,
    sensors: Sequence[robots.SensorFrame] = (),
    posed: Configuration | None = None,
    labels: tuple[str, str] = LABELS[""],
    style: PictureStyle = SCREEN,
) -> None:
    """Draw a deformed body, coloured by displacement, over its outline at rest.

    Args:
        model: The model.
        displacement: Nodal displacement [m].
        path: PNG, SVG or PDF file.
        title: First line.
        subtitle: Second line.
        measured: Measured marker positions; rows with a NaN are left out [m].
        simulated: Simulated marker positions [m].
        marker_names: Names beside the markers.
        warning: Printed large and red above the title.
        robot: Rigid bodies, drawn grey, obstacles, and actuators with their forces.
        sensors: Poses of 6-D sensors.
        posed: The configuration, whose supports, dead loads and gravity are drawn.
        labels: What the legend calls `measured` and `simulated`.
        style: Width, size of words, resolution, and where the body is seen from.

    Raises:
        RenderingError: If the machine has no OpenGL that works without a screen.
    """
    u = np.asarray(displacement, float)
    none = np.zeros((0, 3))
    measured = none if measured is None else measured
    simulated = none if simulated is None else simulated
    markers = np.concatenate([measured, simulated])
    more = [markers[np.isfinite(markers).all(axis=1)]]
    picture = None if robot is None else robots.robot_picture(model, robot)
    if picture is not None:
        more.append(picture.points)
    x = model.mesh.points + u
    if posed is not None:
        more += [robots.load_place(load, model.mesh, x)[0] for load in posed.loads]
    gravity = () if posed is None else posed.gravity
    view = choose_view(model.mesh.points, u, np.vstack(more), gravity, style.seen_from)
    width = style.pixels - _SIDE
    lowest, highest = _LOWEST * style.pixels, max(_HIGHEST * style.pixels, _TALL)
    scale, height = fit_body(view, width, _MARGIN, lowest, highest)
    largest = float(np.linalg.norm(u, axis=1).max())
    around = [] if robot is None else obstacles_at(model, robot)
    with printed(path, style, height=height / style.pixels) as figure:
        pixels = body_image(
            model,
            u,
            view,
            size=(width, height),
            scale=scale,
            largest=largest,
            finer=style.dpi / figure.dpi,
            obstacles=placed_surfaces(model, around),
        )
        body = add_view(figure, 0, 0, width, height, scale=scale)
        extent = (*body.get_xlim(), *body.get_ylim())
        body.imshow(pixels, extent=extent, interpolation="none")
        drawn = ["at rest"]
        called: dict[str, str] = dict(
            zip(("measured", "simulated"), labels, strict=True)
        )
        for name, points in zip(called, (measured, simulated), strict=True):
            if np.isfinite(points).all(axis=1).any():
                drawn.append(name)
        if {"measured", "simulated"} <= {*drawn}:
            drawn.append("distance")
        if model.mechanism.bodies.has_nodes.any():
            drawn.append("rigid body")
        if around:
            drawn.append("obstacle")
            name_obstacles(body, view, model, around)
        if posed is not None:
            drawn += robots.draw_setup(body, view, posed, model.mesh, x)
        if picture is not None:
            drawn += robots.draw_robot(body, view, picture)
        drawn += robots.draw_sensors(body, view, sensors)
        flat = view.project(measured), view.project(simulated)
        figures.draw_markers(body, *flat, marker_names)
        figures.separate_names(body)
        bar = (width + 20, 0.06 * height, 28, 0.94 * height - 45)
        figures.draw_colour_scale(add_axes(figure, *bar), largest)
        handles = figures.legend_of(drawn, called)
        words = {"title": title, "subtitle": subtitle, "warning": warning}
        figures.draw_frame(figure, view, handles, scale=scale, **words)
