"""A cable beside a straight beam against beam theory: bending, shortening, buckling.

The beam (L / h = 20) is clamped at x = 0 and ends in a rigid plate that the cable pulls
towards an anchor in the clamp's plane. With nu = 0 compression and pure bending are
displacements of second degree, which quadratic tets hold without any error: what is
left at small tension is the geometry's own nonlinearity.
"""

from functools import cache

import numpy as np
import pytest
from mechanisms import NO_GRAVITY, TIGHT, arrays, solve, solved
from problems import Plane, cable_beam, central_difference

from softcal_jax.actuators import Cable, Guide, SurfaceForceActuator
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyFrame,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    SurfaceForce,
)
from softcal_jax.equilibrium import RESULTS, Model, build_model, energy_and_force
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

SLENDERNESS, E = 20.0, 1e5
SIDE = 1.0 / SLENDERNESS
AREA, EI = SIDE**2, E * SIDE**4 / 12.0
BEAM = beam(1.0, SIDE, SIDE, (20, 1, 1), origin=(0.0, -SIDE / 2, -SIDE / 2), order=2)
EFFECTORS = (
    BodyFrame("tip", "tip"),
    ActuatorDisplacement("shortening", "cable"),
    ActuatorForce("tension", "cable"),
    ActuatorForce("pull", "pull"),
)
OFFSET = 0.1
"""Of the cable from the axis [m]: outside the beam, as on a plate with an arm."""


@cache
def pulled(offset: float) -> Model:
    """The beam with its cable at an offset in z."""
    ends = [Guide((0.0, 0.0, offset), "ground"), Guide((1.0, 0.0, offset), "tip")]
    return build_model(
        BEAM,
        Corotational(Isotropic(E, 0.0)),
        density=0.0,
        bodies=[RigidBody("tip", "x_max")],
        actuators=[
            Cable("cable", ends),
            SurfaceForceActuator("pull", "x_max", (1.0, 0.0, 0.0)),
        ],
    )


def driven(offset: float, **actuation):
    """Solution and effectors."""
    configuration = Configuration(
        "pulled", "x_min", NO_GRAVITY, effectors=EFFECTORS, actuation=actuation
    )
    return solved(pulled(offset), configuration, TIGHT)[:2]


def under(tension: float, offset: float = OFFSET):
    """Solution, pose of the tip in the plane, and shortening of the cable."""
    solution, values = driven(offset, cable=ImposedForce(tension))
    (x, _, z), turn, (delta, *_) = values[:3]
    # About -y, so that a positive angle lifts the tip.
    return solution, Plane(x, z, -turn[1]), delta


def test_small_tension_bends_and_shortens_as_beam_theory_says():
    """Rotation T h L / EI, rise T h L^2 / 2 EI, shortening T L / EA.

    The cable's own shortening is that of its line, T L / EA + T h^2 L / EI (pure
    bending with axial force: Gere and Timoshenko, Mechanics of Materials, ch. 5).
    """
    error = []
    for tension in (2e-3 * EI, 1e-3 * EI):
        _, tip, delta = under(tension)
        moment, strain = tension * OFFSET, tension / (E * AREA)
        computed = [tip.angle, tip.z, 1.0 - tip.x, delta]
        expected = [
            moment / EI,
            moment / (2.0 * EI),
            strain,
            strain + moment * OFFSET / EI,
        ]
        error.append(np.array(computed) / np.array(expected) - 1.0)
    # The theory is of first order in the load: halving it halves the difference, and
    # nothing of the mesh remains at none. (The bow retracts the tip by (T h L / EI)^2 /
    # 6, eight times the second order of the others.)
    np.testing.assert_allclose(2.0 * error[1] - error[0], 0.0, atol=1e-5)
    np.testing.assert_allclose(error[0] / error[1], 2.0, rtol=2e-3)
    np.testing.assert_allclose(error[1][2], moment**2 / EI**2 / 6 / strain, rtol=1e-3)


@pytest.mark.parametrize("tension", [0.5, 9.0])
def test_centred_cable_shortens_the_beam(tension):
    """T L / EA at any tension below buckling: the law is linear in the stretch."""
    solution, tip, delta = under(tension * EI, 0.0)
    shortening = tension * EI / (E * AREA)
    # Solved to 1e-12 of the forces.
    np.testing.assert_allclose([delta, 1.0 - tip.x], shortening, rtol=1e-9)
    np.testing.assert_allclose([tip.z, tip.angle], 0.0, atol=1e-9)
    assert int(solution.n_negative) == 0


@pytest.mark.parametrize("stretch", [1e-3, 0.01, 0.05])
def test_a_slack_cable_carries_what_the_stretched_bar_lacks(stretch):
    """A bar in parallel with a cable let out by 0.01: a closed form of the contact.

    Pulled by its end face to an elongation, the bar carries EA times it; a cable that
    is longer by `slack` stays slack up to that elongation, then holds the end: pulled
    by a force, the tension is what the bar does not carry there.
    """
    EA, slack = E * AREA, 0.01
    _, alone = driven(0.0, pull=ImposedDisplacement(stretch))
    np.testing.assert_allclose(alone[4, 0], EA * stretch, rtol=1e-8)
    asked = {"pull": ImposedForce(EA * stretch), "cable": ImposedDisplacement(-slack)}
    solution, values = driven(0.0, **asked)
    tension = max(0.0, EA * (stretch - slack))
    np.testing.assert_allclose(values[3, 0], tension, rtol=1e-7, atol=1e-9 * EA)
    np.testing.assert_allclose(values[2, 0], -min(stretch, slack), rtol=1e-8)
    np.testing.assert_allclose(solution.multipliers, values[3:, 0] * [1, 0], rtol=1e-7)


LOADS = {
    "cable": lambda P: {"actuation": {"cable": ImposedForce(P)}},
    "dead": lambda P: {"loads": SurfaceForce("x_max", (-P, 0.0, 0.0))},
}


@pytest.mark.parametrize(("load", "critical"), [("dead", 0.25), ("cable", 1.0)])
def test_a_straight_strut_is_stable_up_to_its_buckling_load(load, critical):
    """P = pi^2 EI / 4 L^2 under a dead load, pi^2 EI / L^2 towards a clamped point.

    Timoshenko and Gere, Theory of Elastic Stability (1961), ch. 2: tan kL = kL (1 -
    c/L) for a load through a point at a distance c below the top. Newton needs one
    step, from a state without stress; the state that it reaches is what counts.
    """
    model, outcomes = pulled(0.0), []
    for share in (0.99, 1.01, 1.5):
        asked = LOADS[load](share * critical * np.pi**2 * EI)
        strut = Configuration(
            "strut", "x_min", NO_GRAVITY, effectors=EFFECTORS, **asked
        )
        lane = arrays(model, strut)
        solution, _ = solve(model, lane, None, TIGHT)
        outcomes.append((solution.result, int(solution.n_negative)))
    stable, unstable = (RESULTS.converged, 0), (RESULTS.unstable, 2)
    # Shear lowers the load by P / kGA, 0.5 % at most, and the shortening by P / EA
    # raises it. A square section bends both ways.
    assert outcomes == [stable, unstable, unstable]


@pytest.mark.parametrize("tension", [1.0, 4.0, 7.0])
def test_large_bending_against_the_shear_beam(tension):
    """The cable turns with the chord between its ends, and the force with it."""
    _, tip, delta = under(tension * EI)
    expected = cable_beam(tension, OFFSET, SLENDERNESS)
    # The ends do not warp under shear, and the mesh is coarse.
    np.testing.assert_allclose(tip, expected.tip, rtol=2e-3)
    np.testing.assert_allclose(delta, expected.shortening, rtol=2e-3)


def test_shortening_is_the_derivative_of_the_potential_by_the_tension():
    """Pi(T) = min U - T delta_a: dPi/dT = -delta_a, and dU/dT = T d(delta_a)/dT."""

    def energies(tension):
        solution, _, delta = under(float(tension))
        energy = energy_and_force(pulled(OFFSET), solution.displacement)[0]
        return np.array([energy - tension * delta, energy, delta])

    T = 4.0 * EI
    _, _, delta = energies(T)
    error = []
    for h in (0.2, 0.1):
        pi, energy, slope = central_difference(energies, T, T, h) / T
        error.append([pi + delta, energy - T * slope])
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    coarse, fine = np.array(error)
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.1)
