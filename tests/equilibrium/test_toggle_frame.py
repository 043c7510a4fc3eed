"""Snap-through of Williams' toggle frame, along its load by arc length.

Two straight members, clamped at their outer ends and stiffly joined at the crown, carry
a dead load there (Williams, Q. J. Mech. Appl. Math. 17, 1964). They give way at 34 lb,
bend through and become stiff again as they are stretched.

A quarter of it is meshed: half the span and half the width, by symmetry. Poisson's
ratio is 0, as in a beam: with that of a metal, members also bend across, which takes
finer meshes, and the clamped ends cannot swell (24 by 2 by 2 cells carry 0.4 % more).
"""

import numpy as np
import pytest
from mechanisms import NO_GRAVITY, arrays
from problems import TOGGLE, toggle_loads
from scipy.optimize import fminbound

from softcal_jax.configurations import Centroid, Configuration, Support, SurfaceForce
from softcal_jax.equilibrium import RESULTS, LoadPath, build_model, trace_equilibria
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import TetMesh, beam

FULL = 1.25 * 34.0 * TOGGLE.pound
"""Load at the end of the path, beyond both limits [N]."""
MESH_ERROR = 0.01
"""Of the load with 12 x 1 x 1 cells; 2.3 % with 8 x 1 x 1, 0.2 % with 24 x 2 x 2."""


def turning(sign, between):
    """Deflection at which the load turns: largest at sign 1, smallest at -1 [m]."""
    load = lambda w: -sign * toggle_loads(np.array([w]))[0]
    return np.asarray(fminbound(load, *between, xtol=1e-8)).item()


@pytest.fixture(scope="module")
def limits():
    """Deflections of the crown at the largest load and at the smallest after it [m]."""
    return np.array([turning(1.0, (0.004, 0.008)), turning(-1.0, (0.008, 0.012))])


@pytest.fixture(scope="module")
def path():
    height = TOGGLE.depth * TOGGLE.length / TOGGLE.half_span
    box = beam(TOGGLE.half_span, 0.5 * TOGGLE.width, height, (12, 1, 1), order=2)
    points = box.points.copy()
    points[:, 2] += TOGGLE.rise * points[:, 0] / TOGGLE.half_span
    mesh = TetMesh(points, box.tets, box.node_groups, box.surface_groups)
    law = Corotational(Isotropic(TOGGLE.E, 0.0))
    held = [Support("x_min", "xz"), Support("x_max", "x"), Support("y_min", "y")]
    frame = Configuration(
        "toggle",
        held,
        NO_GRAVITY,
        loads=SurfaceForce("x_max", (0.0, 0.0, -0.25 * FULL)),
        effectors=[Centroid("crown", "x_max")],
    )
    model = build_model(mesh, law, density=0.0)
    steps = LoadPath(states=20, first=0.15, largest=0.3)
    return trace_equilibria(model, arrays(model, frame), steps)


def deflections(path):
    """Of the crown, downwards."""
    height = path.readings[:, 0, 2]
    return height[0] - height


def test_the_path_snaps_through_and_stiffens_again(path, limits):
    assert bool(path.result == RESULTS.converged), RESULTS[path.result]
    deflection = deflections(path)
    # Several states before the limit, between the limits and after them.
    between = np.sum((deflection > limits[0]) & (deflection < limits[1]))
    assert between >= 3
    assert np.sum(deflection > limits[1]) >= 3
    expected = toggle_loads(deflection)
    np.testing.assert_allclose(FULL * path.load, expected, rtol=MESH_ERROR, atol=1e-9)


def test_both_limits_are_where_the_beam_has_them(path, limits):
    loads = toggle_loads(limits)
    assert round(loads[0] / TOGGLE.pound) == 34
    # The parabola through states that are 0.9 mm apart is flat where the load turns.
    turns = np.flatnonzero(np.diff(np.sign(np.diff(path.load)))) + 1
    about = np.stack([turns - 1, turns, turns + 1])
    curves = np.array(
        [np.polyfit(deflections(path)[k], path.load[k], 2) for k in about.T]
    )
    flat = -curves[:, 1] / (2.0 * curves[:, 0])
    np.testing.assert_allclose(flat, limits, rtol=0.02)
    turning_loads = curves[:, 2] - curves[:, 1] ** 2 / (4.0 * curves[:, 0])
    np.testing.assert_allclose(FULL * turning_loads, loads, rtol=MESH_ERROR)


def test_it_is_unstable_between_the_limits_alone(path, limits):
    deflection = deflections(path)
    between = (deflection > limits[0]) & (deflection < limits[1])
    np.testing.assert_array_equal(path.n_negative, between.astype(int))
