"""Designed angles of a strip that twists as it bends, against anisotropic beam theory.

A prismatic bar of a material with the compliances S11 and S16 along x, bent by the
moment M about y: its fibres carry M z / I, which strain by S11 and shear by S16, so it
bends by S11 M / I and twists by S16 M / (2 I) per length, whatever its section
(Lekhnitskii, Theory of Elasticity of an Anisotropic Body, 1963, sec. 21).
"""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from softcal_jax.configurations import Configuration, Markers, SurfaceForce
from softcal_jax.designs import design
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

LENGTH, FORCE = 0.2, 1e-6
E_T, E_L, NU = 0.8e6, 0.3e6, 0.3
TRUE = np.deg2rad([25.0, 55.0])
"""Angles of the fibre in both halves of the strip."""

pytestmark = pytest.mark.slow


def compliances(theta):
    """S11 and S16 of a fibre at theta from x (Jones, Mechanics of Composites, 1999)."""
    c, s = np.cos(theta), np.sin(theta)
    root = np.sqrt(E_L * E_T)
    S11, S22, S12, S66 = 1 / E_L, 1 / E_T, -NU / root, 2 * (1 + NU) / root
    along = c**4 * S11 + s**4 * S22 + c**2 * s**2 * (2 * S12 + S66)
    mixed = (2 * S11 - 2 * S12 - S66) * c**2 - (2 * S22 - 2 * S12 - S66) * s**2
    return along, c * s * mixed


def goals(side, where):
    """Heights of both edges of the strip, by the closed form."""
    x = np.linspace(0.0, LENGTH, 4001)
    S11, S16 = compliances(np.where(x < LENGTH / 2, *TRUE))
    M = FORCE * (LENGTH - x) / (side**4 / 12)
    integral = lambda y: cumulative_trapezoid(y, x, initial=0.0)
    down = np.interp(where, x, integral(integral(S11 * M)))
    twist = np.interp(where, x, integral(0.5 * S16 * M))
    edges = np.array([0.0, side])
    z = side / 2 - down[:, None] - twist[:, None] * (edges - side / 2)
    return [(a, b) for a in where for b in edges], z.ravel(), down[-1]


def designed(side, cells):
    """The angles of a square strip, designed for goals at its middle and its tip."""
    law = ReducedTransverseIsotropic(E_T, E_L, NU, Fibre(0.7, plane="xy"))
    mesh = beam(LENGTH, side, side, (cells, 2, 2), order=2)
    model = build_model(mesh, Corotational(law), density=1000.0)
    places, z, size = goals(side, np.array([LENGTH / 2, LENGTH]))
    points = np.array([(x, y, side / 2) for x, y in places])
    names = [f"edge {k}" for k in range(len(points))]
    goal = Configuration(
        "twisted",
        ["x_min"],
        gravity=(0.0, 0.0, 0.0),
        loads=[SurfaceForce("x_max", (0.0, 0.0, -FORCE))],
        markers=Markers(names, points, std=1e-3 * size, axes="z"),
        measured=np.column_stack([points[:, :2], z]),
    )
    halves = {"root": (LENGTH / 4, 0.0, 0.0), "tip": (3 * LENGTH / 4, 0.0, 0.0)}
    theta = ControlPointParameters(
        "theta",
        ControlPoints(halves, nearest=1),
        np.deg2rad([35.0, 45.0]),
        -np.pi / 2,
        np.pi / 2,
        interpolation="director",
        scale="linear",
        S=1.0,
        unit="rad",
    )
    made = design(model, theta, goal, starts=1)
    assert made.fit.converged
    return np.array([made.fit.value(f"theta of {half}") for half in halves])


def test_the_slender_strip_has_the_angles_of_the_closed_form():
    """Clamp and change of angle act over one width, so it is off by width / length."""
    thick, slender = (
        np.rad2deg(designed(side, cells)) for side, cells in ((0.01, 20), (0.005, 40))
    )
    off = np.abs([thick - np.rad2deg(TRUE), slender - np.rad2deg(TRUE)])
    assert np.all(off[1] < 0.62 * off[0])
    limit = 2.0 * slender - thick
    np.testing.assert_allclose(limit, np.rad2deg(TRUE), atol=0.5)
