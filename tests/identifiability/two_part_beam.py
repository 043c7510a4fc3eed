"""A beam whose halves have moduli of their own, and poses that see one or both."""

from functools import cache

import numpy as np

from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import NewtonSettings, build_model
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh, beam

# Equilibria to rounding, so that differences show their own error.
TIGHT = NewtonSettings(rtol=1e-12)
STD = 2e-4
SPACE = ParameterSpace(
    (
        Parameter("E of root", "E", 1e5, 3e4, 1e6, region="root", unit="Pa"),
        Parameter("E of tip", "E", 1e5, 3e4, 1e6, region="tip", unit="Pa"),
    )
)
ROOT = ((0.025, 0.01, 0.01),)
TIP = ((0.1, 0.01, 0.01),)
OTHER_END = ((0.0, 0.01, 0.01),)


@cache
def two_part_beam():
    """100 x 20 x 20 mm, clamped at x = 0 as a rule; the tip group starts at 50 mm."""
    box = beam(0.1, 0.02, 0.02, (4, 1, 1), order=1)
    tip = box.points[box.tets].mean(axis=1)[:, 0] > 0.05
    groups = {"root": np.flatnonzero(~tip), "tip": np.flatnonzero(tip)}
    mesh = TetMesh(box.points, box.tets, box.node_groups, box.surface_groups, groups)
    law = NeoHookean(np.full(mesh.n_tets, 1e5), 0.3)
    return build_model(mesh, law, density=1000.0)


def pose(name, points, *, side=0.0, clamp="x_min", measured=None, **markers):
    """Under gravity, with a force across on the free end [N]."""
    free = "x_max" if clamp == "x_min" else "x_min"
    keywords = {"std": STD, **markers}
    names = tuple(f"m{i}" for i in range(len(points)))
    return Configuration(
        name,
        (Support(clamp),),
        (0.0, 0.0, -9.81),
        (SurfaceForce(free, (0.0, side, 0.0)),),
        Markers(names, points, **keywords),
        measured,
    )


def crushed():
    """Pushed along its axis far beyond buckling."""
    push = SurfaceForce("x_max", (-1e6, 0.0, 0.0))
    markers = Markers(("m0",), TIP)
    return Configuration("crushed", (Support("x_min"),), loads=push, markers=markers)


HANG = pose("hang", TIP)
PULL = pose("pull", TIP, side=0.05)
SWAP = pose("swap", OTHER_END, clamp="x_max")
NEAR = pose("near", ROOT)
