"""Bars clamped at x = 0, with moduli per tet and markers on the axis."""

from functools import cache

import numpy as np

from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh, beam

STD = 1e-4
ROOT, MID, TIP = ((x, 0.01, 0.01) for x in (0.0, 0.05, 0.1))


@cache
def bar(cells, order=1):
    """100 x 20 x 20 mm; the tet group "tip" starts at 50 mm."""
    box = beam(0.1, 0.02, 0.02, cells, order=order)
    tip = box.points[box.tets[:, :4]].mean(axis=1)[:, 0] > 0.05
    groups = {"root": np.flatnonzero(~tip), "tip": np.flatnonzero(tip)}
    mesh = TetMesh(box.points, box.tets, box.node_groups, box.surface_groups, groups)
    law = NeoHookean(np.full(mesh.n_tets, 1e5), 0.3)
    return build_model(mesh, law, density=1000.0)


def pose(name, places, *, force=(0.0, 0.0, 0.0), g=9.81, clamp="x_min", guided=False):
    """Under gravity, with a force on the end that is not clamped [N]."""
    free = "x_max" if clamp == "x_min" else "x_min"
    supports = [Support(clamp)] + [Support(free, "yz")] * guided
    markers = Markers([f"m{i}" for i in range(len(places))], places, STD)
    return Configuration(
        name, supports, (0.0, 0.0, -g), SurfaceForce(free, force), markers
    )


def stretched(*places):
    return pose("stretched", places, force=(0.5, 0.0, 0.0), g=0.0)


def on_axis(*x, **options):
    return ControlPoints([(value, 0.01, 0.01) for value in x], **options)


def moduli(points, start=1e5):
    return ControlPointParameters(
        "E", points, start=start, lower=3e4, upper=1e6, unit="Pa"
    )
