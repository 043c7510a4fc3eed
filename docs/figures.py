"""Draw the figures of the guide and the evidence: `python docs/figures.py` does.

The demo is calibrated for its error budget and its course, and a beam with two unknown
moduli is asked what one pose tells about them, and what two do. Of the tentacle and
Emio, a pose is drawn that was held out; with the word "robots" only these are.
"""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

import softcal_jax as sc
from softcal_jax.identifiability import Identifiability
from softcal_jax.plotting import (
    PictureStyle,
    draw_budget,
    draw_course,
    plot_panels,
    printed,
    render_configuration,
)
from softcal_jax.plotting._figure import BAD, FAINT, GOOD, SERIES, TEXT
from softcal_jax.robots import ready_made_path

if TYPE_CHECKING:
    import matplotlib.axes

sys.path.insert(0, str(Path(__file__).parents[1] / "notebooks"))
from refresh import small

FOLDER = Path(__file__).with_name("guide") / "figures"

ROBOTS = {"tentacle": "m2_018", "emio": "pose 163"}
"""Ready-made robots, and the poses of which pictures go to the evidence."""

FIGURES = ("budget.svg", "course.svg", "one_pose_or_two.png")
"""What `draw` writes."""

LENGTH, WIDTH = 0.150, 0.015
"""Size of the beam with two moduli [m]."""

E_TRUE, STD = 300e3, 5e-4
"""Its modulus at both control points [Pa]; standard deviation of its marker [m]."""

BOUNDS = (75e3, 1.2e6)
"""Bounds of both moduli, and of the axes [Pa]."""

CHART = PictureStyle(width_mm=190.0, font_size=10.0)
"""Of the charts."""

COLOURS = {"identifiable": GOOD, "not identifiable": BAD}


def draw(folder: Path) -> None:
    """Write all figures into a folder: two charts of the page, and a picture."""
    folder.mkdir(parents=True, exist_ok=True)
    result = sc.load_project(ready_made_path("beam")).calibrate()
    courses = [
        partial(draw_course, result=result, name=name)
        for name in ("rms", "lambda_p", "E")
    ]
    budget = [partial(draw_budget, result=result)]
    plot_panels(folder / "course.svg", courses, columns=3, style=CHART)
    plot_panels(folder / "budget.svg", budget, lines=4.0, style=CHART)
    picture = folder / "one_pose_or_two.png"
    draw_regions(outlooks_by_poses(), picture)
    picture.write_bytes(small(picture.read_bytes()))


def draw_robots(folder: Path) -> None:
    """Write a picture of a predicted pose of each of the `ROBOTS` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for robot, name in ROBOTS.items():
        result = sc.load_project(ready_made_path(robot)).calibrate(watch=False)
        (pose,) = (c for c in result.configurations if c.name == name)
        picture = folder / f"{robot}.png"
        render_configuration(result.model, pose, picture)
        picture.write_bytes(small(picture.read_bytes()))


def outlooks_by_poses() -> dict[str, Identifiability]:
    """Ask what a marker on the free end of a hanging beam tells about two moduli.

    One control point lies at each end. The beam is held at its left end, or once at
    either end.
    """
    mesh = sc.beam(LENGTH, WIDTH, WIDTH, cells=(10, 2, 2), order=2)
    model = sc.build_model(mesh, sc.NeoHookean(E=E_TRUE, nu=0.3), density=950)
    left, right = (0.0, WIDTH / 2, WIDTH / 2), (LENGTH, WIDTH / 2, WIDTH / 2)
    points = sc.ControlPoints({"left": left, "right": right})
    bounds = {"lower": BOUNDS[0], "upper": BOUNDS[1], "unit": "Pa"}
    E = sc.ControlPointParameters("E", points, start=E_TRUE, **bounds)
    poses = [
        sc.Configuration(
            f"held at {held}",
            held,
            (0.0, -9.81, 0.0),
            markers=sc.Markers(["end"], [free], std=STD),
        )
        for held, free in (("x_min", right), ("x_max", left))
    ]
    return {
        title: sc.identify(model, sc.ParameterSpace([E]), poses[:n])
        for n, title in enumerate(("held left", "held left, and held right"), 1)
    }


def draw_regions(outlooks: dict[str, Identifiability], path: Path) -> None:
    """Draw the region of the two moduli that the data leave open, for each outlook."""
    style = PictureStyle(width_mm=254.0, font_size=14.0, dpi=100.0)
    with printed(path, style, height=0.56) as figure:
        panels = figure.subplots(1, len(outlooks), sharex=True, sharey=True)
        for axes, (title, found) in zip(panels, outlooks.items(), strict=True):
            _draw_region(axes, found)
            colour = COLOURS[found.verdict]
            r = found.correlation[0, 1]
            text = f"{title}\n{found.verdict}, correlation {r:.3f}"
            axes.set_title(text, color=colour, weight="bold")
            axes.set_xlabel("E at the left end [kPa]")
        panels[0].set_ylabel("E at the right end [kPa]")
        panels[-1].legend(fontsize=12, frameon=False, loc="lower left")


def _draw_region(axes: "matplotlib.axes.Axes", found: Identifiability) -> None:
    """Ellipses of one and two standard errors, in the logarithms of the moduli."""
    turn = np.linspace(0.0, 2 * np.pi, 200)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    root = np.linalg.cholesky(found.covariance)
    for n, alpha in ((2, 0.25), (1, 0.5)):
        x, y = 1e-3 * E_TRUE * np.exp(n * root @ circle)
        label = f"{n} standard error{'s' * (n > 1)}"
        axes.fill(x, y, color=SERIES[0], alpha=alpha, lw=0, label=label)
    asked = 1e-3 * E_TRUE * np.exp(found.precision * np.array([-1.0, 1.0]))
    low, high = asked
    square = [low, high, high, low, low], [low, low, high, high, low]
    axes.plot(*square, "--", color=SERIES[1], lw=1.8, label="what is asked for: 10 %")
    centre = 1e-3 * E_TRUE
    axes.plot(centre, centre, "+", color=TEXT, ms=9, mew=1.5, label="the true moduli")
    limits = 1e-3 * np.array(BOUNDS)
    ticks = [75, 150, 300, 600, 1200]
    for scale, limit, mark in (
        (axes.set_xscale, axes.set_xlim, axes.set_xticks),
        (axes.set_yscale, axes.set_ylim, axes.set_yticks),
    ):
        scale("log")
        limit(*limits)
        mark(ticks, [str(tick) for tick in ticks], fontsize=12)
        mark([], minor=True)
    axes.set_box_aspect(1.0)
    axes.grid(True, color=FAINT, alpha=0.25)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    if sys.argv[1:] != ["robots"]:
        draw(FOLDER)
    draw_robots(FOLDER.parents[1] / "evidence" / "figures")
