"""Hollow spheres under pressure against closed forms, small and large.

Inner radius 1, outer radius 2, curved quadratic tets; held by its planes of symmetry,
on which a sphere pushes with nothing.
"""

from functools import cache

import jax
import numpy as np
import pytest
from mechanisms import NO_GRAVITY, TIGHT, arrays
from problems import Shell, central_difference, lame_sphere, neo_hookean_sphere
from spheres import hollow_sphere

from softcal_jax.actuators import Chamber, SurfacePressure
from softcal_jax.configurations import (
    ActuatorDisplacement,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Support,
)
from softcal_jax.control import actuator_compliance, actuator_readings
from softcal_jax.equilibrium import (
    RESULTS,
    build_model,
    energy_and_force,
    solve_equilibrium,
)
from softcal_jax.materials import NeoHookean

E, NU = 1.0, 0.3
P = 0.2
"""A large pressure: the inner surface moves by a quarter of its radius."""

SYMMETRY = tuple(Support(f"{axis} = 0", axis) for axis in "xyz")
CHAMBER = Chamber("chamber", "inner")
ALL = (CHAMBER, SurfacePressure("inner", "inner"), SurfacePressure("outer", "outer"))


@cache
def ball(n: int, actuators=(CHAMBER,), *, nu=NU, curved=True):
    """Model of the sphere with n cells on the edge of an octant, and n layers."""
    mesh = hollow_sphere(n, curved=curved)
    return build_model(mesh, NeoHookean(E, nu), density=0.0, actuators=actuators)


def inflated(**actuation):
    volume = ActuatorDisplacement("volume", "chamber")
    return Configuration(
        "inflated", SYMMETRY, NO_GRAVITY, effectors=[volume], actuation=actuation
    )


@jax.jit
def read(model, lane, solution):
    energy = energy_and_force(model, solution.displacement)[0]
    return actuator_readings(model, lane, solution), energy


def solved(model, **actuation):
    """Solution, pressure and volume growth of the chamber, strain energy."""
    lane = arrays(model, inflated(**actuation))
    solution = solve_equilibrium(model, lane, settings=TIGHT)
    state, energy = read(model, lane, solution)
    assert bool(solution.converged), RESULTS[solution.result]
    return solution, float(state.forces[0]), float(state.displacements[0]), energy


def shell(model, solution) -> Shell:
    """Mean radial displacement of the nodes of both surfaces."""
    X, means = model.mesh.points, []
    for surface in ("inner", "outer"):
        nodes = np.unique(model.mesh.faces(surface))
        radial = np.sum(np.asarray(solution.displacement)[nodes] * X[nodes], axis=1)
        means.append(np.mean(radial / np.linalg.norm(X[nodes], axis=1)))
    return Shell(*means)


def test_small_pressure_against_lame():
    """Converges with the mesh to u(1) = 0.8 p, u(2) = 0.3 p and V = 4 pi u(1)."""
    p, error = 1e-5, []
    exact = lame_sphere(p, E, NU)
    np.testing.assert_allclose(np.array(exact) / p, [0.8, 0.3], rtol=1e-12)
    expected = np.array([*exact, 4.0 * np.pi * exact.inner])
    for n in (2, 4):
        solution, _, volume, _ = solved(ball(n), chamber=ImposedForce(p))
        computed = [*shell(ball(n), solution), volume]
        error.append(np.abs(computed / expected - 1.0))
    # 3 % on the coarse mesh; quadratic tets gain a factor 8 by halving in the end.
    assert error[1].max() < 5e-3
    assert (error[0] / error[1])[1:].min() > 5.0


def test_pressure_inside_and_outside_scales_the_body():
    """sigma = -p everywhere: x = s X for a body of any shape with straight edges.

    Neo-Hookean: J sigma = mu (s^2 - 1) + lam ln J. (On curved edges the quadrature of
    the tets, which is that for straight ones, leaves 0.5 %.)
    """
    s, mu, lam = 0.8, E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    p = -(mu * (s**2 - 1.0) + lam * np.log(s**3)) / s**3
    model = ball(2, ALL, curved=False)
    for inside in ("chamber", "inner"):
        asked = {inside: ImposedForce(p), "outer": ImposedForce(p)}
        solution, _, volume, _ = solved(model, **asked)
        there = (s - 1.0) * model.mesh.points
        # Solved to 1e-12 of the forces.
        np.testing.assert_allclose(solution.displacement, there, rtol=0, atol=1e-9)
        rest = float(model.mechanism.actuators.rest[0])
        np.testing.assert_allclose(volume, (s**3 - 1.0) * rest, rtol=1e-9)


def test_following_pressure_on_the_closed_wall_is_a_chamber():
    """At a large inflation, by the full tangent and by the symmetric one."""
    by_chamber, _, volume, _ = solved(ball(2, ALL), chamber=ImposedForce(P))
    by_surface, _, again, _ = solved(ball(2, ALL), inner=ImposedForce(P))
    alone, _, _, _ = solved(ball(2), chamber=ImposedForce(P))
    assert shell(ball(2), alone).inner > 0.2
    for other in (by_surface, alone):
        np.testing.assert_allclose(
            other.displacement, by_chamber.displacement, rtol=0, atol=1e-9
        )
    np.testing.assert_allclose(again, volume, rtol=1e-9)


def test_volume_imposed_gives_back_the_pressure():
    solution, _, volume, _ = solved(ball(2), chamber=ImposedForce(P))
    again, p, same, _ = solved(ball(2), chamber=ImposedDisplacement(volume))
    np.testing.assert_allclose([p, same], [P, volume], rtol=1e-9)
    np.testing.assert_allclose(
        again.displacement, solution.displacement, rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("imposed", [ImposedForce, ImposedDisplacement])
def test_pressure_is_the_slope_of_the_energy_and_W_aa_that_of_the_volume(imposed):
    """dE = p dV along any path, W_aa = dV/dp, by differences of second order."""
    model = ball(2)
    solution, _, volume, _ = solved(model, chamber=ImposedForce(P))
    value = P if imposed is ImposedForce else volume
    lane = arrays(model, inflated(chamber=imposed(value)))
    W = float(jax.jit(actuator_compliance)(model, lane, solution).W_aa[0, 0])

    def state(value):
        _, p, volume, energy = solved(model, chamber=imposed(float(value)))
        return np.array([energy, p, volume])

    error = []
    for h in (0.1, 0.05):
        dE, dp, dV = central_difference(state, value, value, h)
        error.append([dE / dV - P, dV / dp - W])
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    coarse, fine = np.array(error)
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.05)
    assert np.abs(fine / [P, W]).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [1.3, 2.0, 2.5])
def test_large_inflation_of_an_incompressible_sphere(stretch):
    """By its volume, on both sides of the largest pressure, p = 0.81 mu at 1.9."""
    exact, model = neo_hookean_sphere(stretch), ball(3, nu=0.4999)
    assert model.formulation == "mean-dilatation"
    growth = 4.0 / 3.0 * np.pi * (stretch**3 - 1.0)
    solution, p, _, _ = solved(model, chamber=ImposedDisplacement(growth))
    computed = [p / (E / 3.0), *(shell(model, solution) / np.array([1.0, 2.0]) + 1.0)]
    # The mesh: at n = 2 it leaves 1.7 % of the pressure and of the inner stretch.
    expected = [exact.pressure, stretch, exact.outer_stretch]
    np.testing.assert_allclose(computed, expected, rtol=7e-3)
    assert int(solution.n_negative) == 0
