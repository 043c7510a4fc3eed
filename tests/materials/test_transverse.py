"""Transverse isotropy against formulas written by hand, its compliance in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import stiffness
from problems import (
    FOAM_OF_THE_ROBOT,
    FOAM_SOLID_MODULI,
    ORTHOTROPIC_FOAM,
    REDUCED_OFF_AXIS,
)

from softcal_jax.materials import (
    Fibre,
    Isotropic,
    ReducedTransverseIsotropic,
    TransverseIsotropic,
)

# Voigt order 11 22 33 23 13 12, engineering shear.
VOIGT = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
ALONG_Z = Fibre(np.pi / 2)  # in "xz"
FULL = {"E_t": 1.0, "E_l": 0.3, "nu_t": 0.26, "nu_tl": 0.41, "mu_l": 0.09}


def compliance(E_t, E_l, nu_t, nu_tl, mu_l):
    """Voigt compliance with axis 3 along the fibre, entry by entry."""
    S = np.diag([1 / E_t, 1 / E_t, 1 / E_l, 1 / mu_l, 1 / mu_l, 2 * (1 + nu_t) / E_t])
    S[0, 1] = S[1, 0] = -nu_t / E_t
    S[0, 2] = S[2, 0] = S[1, 2] = S[2, 1] = -nu_tl / E_t
    return S


def voigt(elasticity):
    """Voigt stiffness of an elasticity."""
    C = np.asarray(stiffness(elasticity))
    return np.array([[C[i, j, k, l] for k, l in VOIGT] for i, j in VOIGT])


def young(elasticity, n):
    """Young's modulus for a load along n, by inversion of the Voigt stiffness."""
    load = np.array([n[i] * n[j] for i, j in VOIGT])
    strain = np.linalg.solve(voigt(elasticity), load)
    return 1.0 / (strain @ load)


def test_full_set_is_the_inverse_of_its_compliance():
    C = np.linalg.inv(compliance(**FULL))
    ours = voigt(TransverseIsotropic(**FULL, fibre=ALONG_Z))
    np.testing.assert_allclose(ours, C, rtol=0, atol=1e-14)


def test_reduced_set_is_the_inverse_of_its_compliance():
    """nu_ij = nu sqrt(E_i/E_j), mu_ij = sqrt(E_i E_j) / (2 (1 + nu)) of Li and Barbic.

    For stress along i the strain along j is -nu_ij / E_i = -nu / sqrt(E_i E_j).
    """
    E = np.array([1.0, 1.0, 0.25])
    for nu in (-0.7, 0.0, 0.3, 0.49):
        S = np.zeros((6, 6))
        S[:3, :3] = -nu / np.sqrt(np.outer(E, E)) + (1 + nu) * np.diag(1 / E)
        for row, (i, j) in enumerate(VOIGT[3:], start=3):
            S[row, row] = 2 * (1 + nu) / np.sqrt(E[i] * E[j])
        C = np.linalg.inv(S)
        ours = voigt(ReducedTransverseIsotropic(1.0, 0.25, nu, ALONG_Z))
        np.testing.assert_allclose(ours, C, rtol=0, atol=1e-13 * abs(C).max())


def test_reduced_set_in_the_form_of_its_paper():
    """sigma = (B eps B + nu/(1-2 nu) (B:eps) B) / (1 + nu), with B in NumPy."""
    law = ReducedTransverseIsotropic(2.0, 0.5, 0.3, Fibre(0.7, 0.3, "yz"))
    u = np.asarray(law.fibre.direction())
    B = np.sqrt(2.0) * np.eye(3) + (np.sqrt(0.5) - np.sqrt(2.0)) * np.outer(u, u)
    strain = np.array([[0.3, -0.1, 0.2], [-0.1, 0.5, 0.4], [0.2, 0.4, -0.6]])
    sigma = (B @ strain @ B + 0.3 / 0.4 * np.sum(B * strain) * B) / 1.3
    np.testing.assert_allclose(law.stress(jnp.asarray(strain)), sigma, rtol=1e-13)


@pytest.mark.parametrize(("degrees", "modulus"), REDUCED_OFF_AXIS)
@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.49])
def test_reduced_off_axis_modulus_does_not_depend_on_nu(degrees, modulus, nu):
    law = ReducedTransverseIsotropic(1000.0, 250.0, nu, Fibre(np.radians(degrees)))
    # The reference has six decimals.
    np.testing.assert_allclose(young(law, [1.0, 0, 0]), modulus, rtol=0, atol=1e-6)


@pytest.mark.parametrize("theta", [0.0, 0.3, 0.8, np.pi / 2, 2.5])
@pytest.mark.parametrize("plane", ["xy", "xz"])
def test_off_axis_moduli(theta, plane):
    """Load along x, fibre at theta to it: closed forms of both sets."""
    c, s = np.cos(theta), np.sin(theta)
    E_t, E_l, _, nu_tl, mu_l = FULL.values()
    full = c**4 / E_l + s**4 / E_t + c**2 * s**2 * (1 / mu_l - 2 * nu_tl / E_t)
    law = TransverseIsotropic(**FULL, fibre=Fibre(theta, 0.0, plane))
    np.testing.assert_allclose(young(law, [1.0, 0, 0]), 1 / full, rtol=1e-13)
    reduced = (c**2 / np.sqrt(E_l) + s**2 / np.sqrt(E_t)) ** -2
    law = ReducedTransverseIsotropic(E_t, E_l, 0.3, Fibre(theta, 0.0, plane))
    np.testing.assert_allclose(young(law, [1.0, 0, 0]), reduced, rtol=1e-13)


@pytest.mark.parametrize("nu", [-0.9, 0.0, 0.3, 0.49])
def test_equal_moduli_are_isotropic(nu):
    """Whatever the fibre; the full set with the isotropic shear modulus."""
    fibre = Fibre(0.7, -0.4)
    C = np.asarray(stiffness(Isotropic(2.0, nu)))
    scale = abs(C).max()
    reduced = stiffness(ReducedTransverseIsotropic(2.0, 2.0, nu, fibre))
    np.testing.assert_allclose(reduced, C, rtol=0, atol=1e-15 * scale)
    full = stiffness(TransverseIsotropic(2.0, 2.0, nu, nu, 1.0 / (1.0 + nu), fibre))
    # Near nu = 1/2 the stiffnesses are differences of large numbers.
    np.testing.assert_allclose(full, C, rtol=0, atol=3e-14 * scale)


def test_half_a_turn_of_the_fibre_changes_nothing():
    for make in (
        lambda fibre: TransverseIsotropic(**FULL, fibre=fibre),
        lambda fibre: ReducedTransverseIsotropic(1.0, 0.3, 0.3, fibre),
    ):
        C = stiffness(make(Fibre(0.4)))
        turned = stiffness(make(Fibre(0.4 + np.pi)))
        np.testing.assert_allclose(turned, C, rtol=0, atol=1e-15)
        assert jnp.max(jnp.abs(stiffness(make(Fibre(0.4 + np.pi / 2))) - C)) > 0.1


def test_published_foam_of_the_robot_is_stable():
    eigenvalues = np.linalg.eigvalsh(
        voigt(TransverseIsotropic(*FOAM_OF_THE_ROBOT, ALONG_Z))
    )
    assert eigenvalues.min() > 0
    # Its two softest modes are the shears along the fibre.
    np.testing.assert_allclose(eigenvalues[:2], FOAM_OF_THE_ROBOT.mu_l, rtol=1e-12)


@pytest.mark.parametrize("row", ORTHOTROPIC_FOAM)
def test_published_foams_are_stable_in_the_full_set(row):
    """Means over the two stiff axes of the published orthotropic foams."""
    E_s, G_s = FOAM_SOLID_MODULI
    E_t = E_s * (row.Ey + row.Ez) / 2
    # nu_zx: contraction along the soft axis for stress across it.
    law = TransverseIsotropic(
        E_t, E_s * row.Ex, row.nu_yz, row.nu_zx, G_s * (row.Gzx + row.Gxy) / 2, ALONG_Z
    )
    assert np.linalg.eigvalsh(voigt(law)).min() > 0


def test_reduced_set_cannot_represent_the_foam():
    """Its longitudinal shear is 8.8 times that of the foam, its nu_tl 1.005."""
    foam = FOAM_OF_THE_ROBOT
    C = voigt(ReducedTransverseIsotropic(foam.E_t, foam.E_l, foam.nu_t, ALONG_Z))
    np.testing.assert_allclose(C[3, 3] / foam.mu_l, 8.8, atol=0.05)
    S = np.linalg.inv(C)
    np.testing.assert_allclose(-S[0, 2] * foam.E_t, 1.005, atol=5e-4)


def test_derivative_in_theta():
    """dE/dtheta of the reduced set, whose E(theta) is known, through the stress."""

    @jax.jit
    def modulus(theta):
        law = ReducedTransverseIsotropic(1.0, 0.25, 0.3, Fibre(theta))
        unit = jnp.eye(9).reshape(9, 3, 3)
        C = jax.vmap(lambda e: law.stress(0.5 * (e + e.T)))(unit).reshape(9, 9)
        # A symmetric stress has a symmetric strain: complete C on the skew part.
        swap = jnp.eye(9).reshape(3, 3, 9).transpose(1, 0, 2).reshape(9, 9)
        C = C + 0.5 * (jnp.eye(9) - swap)
        return 1.0 / jnp.linalg.solve(C, jnp.eye(9)[0])[0]

    for theta in (0.2, 0.9, 2.0):
        c, s = np.cos(theta), np.sin(theta)
        root = c**2 / 0.5 + s**2
        np.testing.assert_allclose(modulus(theta), root**-2, rtol=1e-13)
        slope = -2 * root**-3 * (2 * c * s) * (1.0 - 1.0 / 0.5)
        np.testing.assert_allclose(jax.grad(modulus)(theta), slope, rtol=1e-12)


def test_fibre_directions():
    t, p = 0.3, 0.7
    expected = {
        "xy": [np.cos(p) * np.cos(t), np.cos(p) * np.sin(t), np.sin(p)],
        "xz": [np.cos(p) * np.cos(t), np.sin(p), np.cos(p) * np.sin(t)],
        "yz": [np.sin(p), np.cos(p) * np.cos(t), np.cos(p) * np.sin(t)],
    }
    for plane, u in expected.items():
        np.testing.assert_allclose(Fibre(t, p, plane).direction(), u, rtol=1e-15)
    np.testing.assert_allclose(
        Fibre(t).direction(), [np.cos(t), 0.0, np.sin(t)], rtol=1e-15
    )


def test_bad_plane(unchecked):
    with pytest.raises(ValueError, match=r"plane 'zx'.* 'xy', 'xz', 'yz'"):
        Fibre(0.0, 0.0, "zx")


def test_bad_angles():
    with pytest.raises(ValueError, match=r"theta .*finite \[rad\], got nan"):
        Fibre(np.array([0.0, np.nan]))
    with pytest.raises(ValueError, match=r"phi .*finite \[rad\], got inf"):
        Fibre(0.0, np.inf)


@pytest.mark.parametrize("name", ["E_t", "E_l", "mu_l"])
def test_bad_modulus(name):
    with pytest.raises(ValueError, match=rf"^{name} .*positive .* -1\."):
        TransverseIsotropic(**(FULL | {name: -1.0}), fibre=ALONG_Z)
    if name != "mu_l":
        reduced = {"E_t": 1.0, "E_l": 0.3, "nu": 0.3, name: 0.0}
        with pytest.raises(ValueError, match=rf"^{name} .*positive .* 0\."):
            ReducedTransverseIsotropic(**reduced, fibre=ALONG_Z)


@pytest.mark.parametrize("nu_t", [-1.0, 1.0, np.nan])
def test_bad_transverse_ratio(nu_t):
    with pytest.raises(ValueError, match=rf"nu_t .*\(-1, 1\), got {nu_t:g}\."):
        TransverseIsotropic(**(FULL | {"nu_t": nu_t}), fibre=ALONG_Z)


def test_bad_fibre_ratio_names_its_range():
    """The limit is sharp: the stiffness loses definiteness where the check bites."""
    limit = np.sqrt((1 - 0.26) / (2 * 0.3))
    message = r"nu_tl .*\(-1.111, 1.111\) .* 1 Pa, .* 0.3 Pa, .* 0.26, .*got 1.2"
    with pytest.raises(ValueError, match=message):
        TransverseIsotropic(**(FULL | {"nu_tl": 1.2}), fibre=ALONG_Z)
    for sign in (-1, 1):
        inside = FULL | {"nu_tl": sign * limit * (1 - 1e-9)}
        TransverseIsotropic(**inside, fibre=ALONG_Z)
        assert np.linalg.eigvalsh(compliance(**inside)).min() > 0
        outside = FULL | {"nu_tl": sign * limit * (1 + 1e-9)}
        assert np.linalg.eigvalsh(compliance(**outside)).min() < 0
        message = rf"nu_tl .*\(-1\.111, 1\.111\) .*got {sign * limit:.6g}\."
        with pytest.raises(ValueError, match=message):
            TransverseIsotropic(**outside, fibre=ALONG_Z)


def test_one_bad_tet_is_found():
    with pytest.raises(ValueError, match=r"E_l = 9 Pa, .* got 0.41"):
        TransverseIsotropic(1.0, np.array([0.3, 9.0, 0.3]), 0.26, 0.41, 0.09, ALONG_Z)
    with pytest.raises(ValueError, match=r"one per tet, .*E_t 2, E_l 3, "):
        TransverseIsotropic(np.ones(2), np.ones(3), 0.26, 0.41, 0.09, ALONG_Z)


@pytest.mark.parametrize("nu", [-1.0, 0.5, np.nan])
def test_bad_ratio_of_the_reduced_set(nu):
    with pytest.raises(ValueError, match=rf"nu .*\(-1, 0\.5\), got {nu:g}\."):
        ReducedTransverseIsotropic(1.0, 0.3, nu, ALONG_Z)
