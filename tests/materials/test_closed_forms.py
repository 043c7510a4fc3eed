"""Stresses of homogeneous deformations against formulas written by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import GRADIENTS, LAM, LAWS, MU, NU, E, energy, stress as stress_of
from problems import NEO_HOOKEAN_UNIAXIAL
from scipy.linalg import polar, solve_sylvester

STRETCHES = [0.6, 0.9, 1.0, 1.2, 1.7]
BULK = LAM + 2.0 * MU / 3.0


def stress(name, F):
    return stress_of(LAWS[name], F)


@pytest.mark.parametrize("stretch", STRETCHES)
def test_corotational_uniaxial(stretch):
    """P = E (stretch - 1) with the lateral stretch 1 - nu (stretch - 1)."""
    lateral = 1.0 - NU * (stretch - 1.0)
    P = stress("corotational", np.diag([stretch, lateral, lateral]))
    expected = np.diag([E * (stretch - 1.0), 0.0, 0.0])
    np.testing.assert_allclose(P, expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("stretch", STRETCHES)
def test_st_venant_kirchhoff_uniaxial(stretch):
    """P = E stretch (stretch^2 - 1) / 2, the lateral Green strain -nu the axial one."""
    lateral = np.sqrt(1.0 - NU * (stretch**2 - 1.0))
    P = stress("st-venant-kirchhoff", np.diag([stretch, lateral, lateral]))
    expected = np.diag([E * stretch * (stretch**2 - 1.0) / 2.0, 0.0, 0.0])
    np.testing.assert_allclose(P, expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(("stretch", "lateral", "P_axial"), NEO_HOOKEAN_UNIAXIAL)
def test_neo_hookean_uniaxial(stretch, lateral, P_axial):
    P = stress("neo-hookean", np.diag([stretch, lateral, lateral]))
    # The reference has nine decimals, and the lateral stress a stiffness of about 1.
    np.testing.assert_allclose(P, np.diag([P_axial, 0.0, 0.0]), rtol=0, atol=3e-9)


@pytest.mark.parametrize("stretch", STRETCHES)
def test_equibiaxial_in_plane_strain(stretch):
    """F = diag(s, s, 1): principal stresses P_i = d psi / d s_i.

    Ogden, Non-Linear Elastic Deformations (1984), Sec. 6.1.
    """
    s, J = stretch, stretch**2
    F = np.diag([s, s, 1.0])
    I1 = 2.0 * s**2 + 1.0
    green = (s**2 - 1.0) / 2.0
    pressure = BULK / 2.0 * (J - 1.0 / J)
    expected = {
        "corotational": (
            2 * (LAM + MU) * (s - 1.0),
            2 * LAM * (s - 1.0),
        ),
        "st-venant-kirchhoff": (s * 2 * (LAM + MU) * green, 2 * LAM * green),
        "neo-hookean": (
            MU * (s - 1.0 / s) + LAM * np.log(J) / s,
            LAM * np.log(J),
        ),
        "energy-only": (
            MU * J ** (-2 / 3) * (s - I1 / (3.0 * s)) + pressure * J / s,
            MU * J ** (-2 / 3) * (1.0 - I1 / 3.0) + pressure * J,
        ),
    }
    for name, (in_plane, across) in expected.items():
        np.testing.assert_allclose(
            stress(name, F),
            np.diag([in_plane, in_plane, across]),
            rtol=1e-13,
            atol=1e-14,
            err_msg=name,
        )


@pytest.mark.parametrize("gamma", [1e-3, 0.5, 2.0])
def test_simple_shear(gamma):
    """F = I + gamma e1 e2^T, J = 1.

    Neo-Hookean: Cauchy stress mu (b - I), so sigma_12 = mu gamma and
    sigma_11 = mu gamma^2 (Bonet and Wood, Nonlinear Continuum Mechanics, Sec. 6.4).
    St. Venant-Kirchhoff: P = F (lambda gamma^2/2 I + 2 mu E), E_12 = gamma/2,
    E_22 = gamma^2/2. Corotational: R turns by atan(gamma/2) and the stretch has the
    trace 1 + sqrt(4 + gamma^2), the eigenvalues of a shear.
    """
    F = np.eye(3)
    F[0, 1] = gamma
    sigma = stress("neo-hookean", F) @ F.T
    expected = MU * np.array([[gamma**2, gamma, 0], [gamma, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(sigma, expected, rtol=1e-13, atol=1e-15)

    S2 = LAM * gamma**2 / 2 * np.eye(3) + MU * np.array(
        [[0, gamma, 0], [gamma, gamma**2, 0], [0, 0, 0]]
    )
    np.testing.assert_allclose(
        stress("st-venant-kirchhoff", F), F @ S2, rtol=1e-13, atol=1e-15
    )

    c, s = 2.0 / np.hypot(2.0, gamma), gamma / np.hypot(2.0, gamma)
    R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    trace = np.hypot(2.0, gamma) + 1.0
    P = 2 * MU * (F - R) + LAM * (trace - 3.0) * R
    np.testing.assert_allclose(stress("corotational", F), P, rtol=1e-12, atol=1e-15)

    I1 = 3.0 + gamma**2
    deviator = F @ F.T - I1 / 3.0 * np.eye(3)
    sigma = stress("energy-only", F) @ F.T
    np.testing.assert_allclose(sigma, MU * deviator, rtol=1e-13, atol=1e-14)


def test_corotational_in_the_form_of_sofa():
    """P = R (2 mu (S - I) + lambda tr(S - I) I), R and S from SciPy."""
    for F in GRADIENTS:
        R, S = polar(F)
        strain = S - np.eye(3)
        P = R @ (2 * MU * strain + LAM * np.trace(strain) * np.eye(3))
        np.testing.assert_allclose(stress("corotational", F), P, rtol=0, atol=1e-13)


def test_corotational_by_a_second_derivation():
    """P = 2 F X with S X + X S = sigma, from psi as a function of F^T F."""
    for F in GRADIENTS:
        _, S = polar(F)
        strain = S - np.eye(3)
        sigma = 2 * MU * strain + LAM * np.trace(strain) * np.eye(3)
        X = solve_sylvester(S, S, sigma)
        np.testing.assert_allclose(
            stress("corotational", F), 2 * F @ X, rtol=0, atol=1e-13
        )


def test_st_venant_kirchhoff_is_unstable_below_one_over_root_three():
    """The slope of P = E s (s^2 - 1) / 2 changes sign there."""
    law = LAWS["st-venant-kirchhoff"]

    def axial(s):
        lateral = jnp.sqrt(1.0 - NU * (s**2 - 1.0))
        return law.stress(jnp.diag(jnp.stack([s, lateral, lateral])))[0, 0]

    limit, slope = 1.0 / np.sqrt(3.0), jax.jit(jax.grad(axial))
    assert slope(limit + 1e-6) > 0 > slope(limit - 1e-6)


def test_energy_of_uniaxial_stretch():
    """Energies themselves, not only their slopes: work done by the bar, to rounding."""
    s = 1.3
    lateral = 1.0 - NU * (s - 1.0)
    psi = energy(LAWS["corotational"], np.diag([s, lateral, lateral]))
    np.testing.assert_allclose(psi, E * (s - 1.0) ** 2 / 2.0, rtol=1e-13)
    lateral = np.sqrt(1.0 - NU * (s**2 - 1.0))
    psi = energy(LAWS["st-venant-kirchhoff"], np.diag([s, lateral, lateral]))
    np.testing.assert_allclose(psi, E * (s**2 - 1.0) ** 2 / 8.0, rtol=1e-13)
