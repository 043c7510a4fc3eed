"""The three beams of random truths, and the noise they are measured with."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from softcal_jax.configurations import Configuration, Markers, SurfaceForce
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    Uncertain,
    exactly_known,
    random_starts,
)
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

CELLS = (3, 1, 1)
"""Cells along, up and across, of quadratic tets."""

BOUNDS = {"E_t": (100e3, 1e6), "E_l": (100e3, 1e6), "theta": (-np.pi / 2, np.pi / 2)}
"""Bounds of the fits and of the true values [Pa, rad]."""

START = {"E_t": 500e3, "E_l": 300e3, "theta": 0.0}
"""Start of all fits [Pa, rad]."""

DENSITY = 1000.0
"""Density of the beams [kg/m3]."""

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""

JITTER = 1e-4
"""Standard deviation of each coordinate [m]."""


class Pose(NamedTuple):
    """How a beam is posed: the held end, its turn [deg], a weight on its end [N]."""

    held: str
    turn: float
    weight: float = 0.0

    def down(self, size: float) -> tuple[float, float, float]:
        """A vector down: the beam turns about its axis, seen from it gravity turns."""
        angle = np.deg2rad(self.turn)
        return 0.0, -size * float(np.cos(angle)), size * float(np.sin(angle))


class Layout(NamedTuple):
    """A beam and its poses: length, height and width [m], the markers along it [-]."""

    title: str
    size: tuple[float, float, float]
    poses: tuple[Pose, ...]
    markers: tuple[float, ...]


LAYOUTS = (
    Layout(
        "two ends",
        (0.12, 0.015, 0.015),
        tuple(Pose(h, t) for h in ("x_min", "x_max") for t in (0.0, 90.0)),
        (0.0, 0.35, 0.5, 0.65, 1.0),
    ),
    Layout(
        "weights",
        (0.10, 0.012, 0.012),
        tuple(Pose("x_min", t, w) for t in (0.0, 90.0) for w in (0.0, 0.03)),
        (0.2, 0.4, 0.6, 0.8, 1.0),
    ),
    Layout(
        "flat section",
        (0.12, 0.012, 0.020),
        (*(Pose("x_min", t) for t in (0.0, 45.0, 90.0)), Pose("x_max", 45.0)),
        (0.0, 0.25, 0.5, 0.75, 1.0),
    ),
)
"""Each with four poses and five markers, so that they share their programs."""


class Noise(NamedTuple):
    """A kind of noise: offset of a recording [m], share of the motion [-]."""

    title: str
    offset: float = 0.0
    share: float = 0.0

    @property
    def uncertain(self) -> Uncertain:
        """What a fit is told about it."""
        return replace(exactly_known(), recordings=self.offset)


NOISES = (Noise("jitter"), Noise("offsets", 5e-4, 0.02))


@cache
def problem(
    layout: Layout,
) -> tuple[Model, ParameterSpace, tuple[Configuration, ...]]:
    """A beam, its parameters and its poses, without measurements."""
    length, height, width = layout.size
    law = ReducedTransverseIsotropic(
        START["E_t"], START["E_l"], 0.3, Fibre(0.0, plane="xy")
    )
    mesh = beam(length, height, width, CELLS, order=2)
    model = build_model(mesh, Corotational(law), density=DENSITY)
    centre = (0.5 * height, 0.5 * width)
    points = ControlPoints([(0.0, *centre), (length, *centre)])
    entries = [
        ControlPointParameters(
            field,
            points,
            start=START[field],
            lower=low,
            upper=high,
            unit="rad" if field == "theta" else "Pa",
            scale="linear" if field == "theta" else "log",
            S=1.0 if field == "theta" else None,
            interpolation="director" if field == "theta" else "linear",
        )
        for field, (low, high) in BOUNDS.items()
    ]
    space = ParameterSpace(entries, axes=[("E_l", "E_t", "theta")])
    names = tuple(f"at {100 * s:g} %" for s in layout.markers)
    # On the bottom midline, so that turns about the axis of the beam show.
    places = [(s * length, 0.0, 0.5 * width) for s in layout.markers]
    markers = Markers(names, places, JITTER)
    return model, space, tuple(_configuration(p, markers) for p in layout.poses)


def _configuration(pose: Pose, markers: Markers) -> Configuration:
    free = "x_max" if pose.held == "x_min" else "x_min"
    weight = f" with {pose.weight:g} N" if pose.weight else ""
    return Configuration(
        f"{pose.held} turned {pose.turn:g}{weight}",
        pose.held,
        gravity=pose.down(GRAVITY),
        loads=[SurfaceForce(free, pose.down(pose.weight))],
        markers=markers,
    )


def true_values(space: ParameterSpace, n: int) -> list[dict[str, float]]:
    """Random values of all parameters, uniform between the bounds, E_l below E_t."""
    drawn = random_starts(space, n, seed=2)
    values = [np.asarray(space.from_scaled(row)) for row in drawn]
    return [dict(zip(space.names, map(float, v), strict=True)) for v in values]


def noisy(
    exact: Sequence[Configuration], noise: Noise, random: np.random.Generator
) -> list[Configuration]:
    """Exact measurements with one draw of noise."""
    drawn = []
    for c in exact:
        assert c.markers is not None
        assert c.measured is not None
        motion = c.measured - c.markers.positions
        jitter = JITTER * random.standard_normal(motion.shape)
        offset = noise.offset * random.standard_normal(3)
        share = noise.share * random.standard_normal() * motion
        measured = c.measured + jitter + offset + share
        drawn.append(replace(c, measured=measured, relative_std=noise.share))
    return drawn
