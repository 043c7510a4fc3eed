"""A tube of silicone wound with thread, inflated, against its closed form."""

import jax
import numpy as np
import pytest
from mechanisms import NO_GRAVITY, TIGHT, arrays
from scipy.integrate import quad
from scipy.optimize import brentq

from softcal_jax.actuators import SurfacePressure
from softcal_jax.configurations import Configuration, ImposedForce, Support
from softcal_jax.equilibrium import RESULTS, build_model, solve_equilibrium
from softcal_jax.materials import Fibre, FibreReinforced, NeoHookean
from softcal_jax.mesh import TetMesh, beam

E, E_F, OUTER = 1.0, 80.0, 1.2
PRESSURE = 1.0
"""Moves the inner wall by 8.6 % of its radius; without threads it would burst."""


def quarter(cells, tension_only):
    """A quarter of a tube around z of inner radius 1, with hoop threads."""
    box = beam(1.0, 1.0, 0.3, (cells // 12, cells, 1), order=2)
    r, phi = 1.0 + (OUTER - 1.0) * box.points[:, 0], 0.5 * np.pi * box.points[:, 1]
    points = np.stack([r * np.cos(phi), r * np.sin(phi), box.points[:, 2]], axis=1)
    mesh = TetMesh(points, box.tets, box.node_groups, box.surface_groups)
    law = FibreReinforced(
        NeoHookean(E, 0.4999),
        E_F,
        Fibre.helix(np.pi / 2, mesh.centroids, [0.0, 0.0, 1.0]),
        tension_only=tension_only,
    )
    inner = SurfacePressure("inner", "x_min")
    return build_model(mesh, law, density=0.0, actuators=[inner])


def closed_form(pressure):
    """Motion of the inner wall of an incompressible tube in plane strain.

    r^2 = R^2 + b keeps the volume; with the hoop stretch l = r / R, balance along r
    (Ogden, Non-Linear Elastic Deformations, Sec. 5.3.4) gives the pressure
    p = integral (sigma_hoop - sigma_r) dr / r, of mu (l^2 - l^-2) and of l E_f (l - 1).
    """
    mu = E / 3.0

    def needed(u):
        b = 2.0 * u + u * u

        def rate(R):
            hoop = np.sqrt(1.0 + b / R**2)
            stress = mu * (hoop**2 - hoop**-2.0)
            stress += hoop * E_F * (hoop - 1.0)
            return stress * R / (R**2 + b)

        return quad(rate, 1.0, OUTER)[0]

    return brentq(lambda u: needed(u) - pressure, 1e-6, 0.5, xtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("tension_only", [False, True])
def test_threads_hold_the_tube(tension_only):
    """Threads are straight in a tet: the error falls with the square of its angle."""
    exact = closed_form(PRESSURE)
    assert 0.08 < exact < 0.09
    supports = [Support("y_min", "y"), Support("y_max", "x")]
    supports += [Support("z_min", "z"), Support("z_max", "z")]
    inflated = Configuration(
        "inflated", supports, NO_GRAVITY, actuation={"inner": ImposedForce(PRESSURE)}
    )
    errors, steps = [], []
    for cells in (12, 24):
        model = quarter(cells, tension_only)
        assert model.formulation == "mean-dilatation"
        solve = jax.jit(lambda m, lane: solve_equilibrium(m, lane, settings=TIGHT))
        solution = solve(model, arrays(model, inflated))
        assert bool(solution.converged), RESULTS[solution.result]
        wall = np.unique(model.mesh.faces("x_min"))
        X = model.mesh.points[wall]
        x = X + np.asarray(solution.displacement)[wall]
        u = np.mean(np.linalg.norm(x[:, :2], axis=1)) - 1.0
        errors.append(abs(u / exact - 1.0))
        steps.append(int(solution.steps))
    assert errors[1] < 0.01
    assert errors[0] / errors[1] > 3.0
    # At most 36 with either kind of fibre.
    assert max(steps) < 60
