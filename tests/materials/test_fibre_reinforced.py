"""Isotropic matrices with fibres: closed forms, limits, and where fibres point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import GRADIENTS, MU, NU, E, derived, energy, stress, tangent
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation

from softcal_jax.materials import (
    ClassicalCorotational,
    Corotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
)

MATRIX = NeoHookean(E, NU)
E_F = 80.0
ALONG_X = Fibre.along([2.0, 0.0, 0.0])
STIFF = FibreReinforced(MATRIX, E_F, ALONG_X)
THREADS = FibreReinforced(MATRIX, E_F, ALONG_X, tension_only=True)
TWO = FibreReinforced(MATRIX, E_F, Fibre.along([0.0, 0.0, 1.0], 0.6), families=2)


def free_bar(s):
    """Lateral stretch and stress of the neo-Hookean bar (Bonet and Wood, Sec. 6.4)."""
    lam = E * NU / ((1 + NU) * (1 - 2 * NU))
    side = lambda b: MU * (b - 1.0 / b) + lam * np.log(s * b * b) / b
    b = brentq(side, 0.3, 3.0, xtol=1e-15)
    return b, MU * (s - 1.0 / s) + lam * np.log(s * b * b) / s


@pytest.mark.parametrize("s", [0.7, 1.0, 1.05, 1.6])
def test_bar_along_the_fibres(s):
    """The nominal stress is that of the matrix and E_f (s - 1)."""
    b, P = free_bar(s)
    expected = np.diag([P + E_F * (s - 1.0), 0.0, 0.0])
    F = np.diag([s, b, b])
    np.testing.assert_allclose(stress(STIFF, F), expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("s", [0.7, 1.3])
def test_bar_across_inextensible_fibres(s):
    """At F = diag(1, s, b) the fibres add nothing: plane strain of the matrix."""
    F = np.diag([1.0, s, 1.0 / s])
    np.testing.assert_allclose(stress(STIFF, F), stress(MATRIX, F), rtol=0, atol=1e-14)


def test_threads_are_slack_when_shortened():
    """Pulled they are fibres; shortened, nothing is left but 1e-4 of E_f."""
    F = np.diag([1.2, 0.9, 1.0])
    np.testing.assert_allclose(stress(THREADS, F), stress(STIFF, F), rtol=0, atol=1e-14)
    for s in (0.6, 0.99):
        F = np.diag([s, 1.0, 1.0])
        left = stress(THREADS, F) - stress(MATRIX, F)
        np.testing.assert_allclose(left, np.diag([-1e-4 * E_F, 0, 0]), atol=1e-14)
        # What is left turns with the fibre, and resists no further push.
        rest = tangent(THREADS, F) - tangent(MATRIX, F)
        np.testing.assert_allclose(rest[0, 0, 0, 0], 0.0, atol=1e-12)
        np.testing.assert_allclose(rest[1, 0, 1, 0], -1e-4 * E_F / s, rtol=1e-12)


def test_the_tangent_of_threads_is_continuous_and_exact():
    """At rest, where fibres begin to give way, stress and tangent have no step."""
    F = lambda e: np.diag([1.0 + e, 1.0, 1.0])
    for method in (stress, tangent):
        gap = method(THREADS, F(1e-12)) - method(THREADS, F(-1e-12))
        # Slopes are below E_f / 1e-4, over a distance of 2e-12.
        assert np.max(np.abs(gap)) < 2e-12 * (E_F / 1e-4 + 10.0) + 1e-12
    for e in (-2e-4, -1e-5, 0.0, 3e-5):
        exact = derived(THREADS, F(e)).tangent
        np.testing.assert_allclose(tangent(THREADS, F(e)), exact, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(tangent(THREADS, F(0.0)), tangent(STIFF, F(0.0)))


@pytest.mark.parametrize("families", [1, 2])
def test_without_stiffness_it_is_the_matrix(families):
    law = FibreReinforced(MATRIX, 0.0, Fibre(0.3), families=families)
    for F in GRADIENTS:
        np.testing.assert_array_equal(stress(law, F), stress(MATRIX, F))
        np.testing.assert_array_equal(tangent(law, F), tangent(MATRIX, F))


def test_small_strain_limit():
    """E_f u u u u for each family, beside Hooke's tensor."""
    u = [np.array([np.sin(a), 0.0, np.cos(a)]) for a in (0.6, -0.6)]
    # Local axes of `along` have any orientation about z, but the plane of both holds z.
    fibres = [np.asarray(fibre.direction()) for fibre in TWO.fibres()]
    np.testing.assert_allclose([v[2] for v in fibres], [v[2] for v in u], rtol=1e-14)
    np.testing.assert_allclose(fibres[0] @ fibres[1], u[0] @ u[1], rtol=1e-14)
    expected = sum(E_F * np.einsum("i,j,k,l->ijkl", v, v, v, v) for v in fibres)
    got = tangent(TWO, np.eye(3)) - tangent(MATRIX, np.eye(3))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_turning_the_fibres_turns_the_law():
    """psi of fibres Q u at F Q^T is that of fibres u at F, Q a rotation at rest."""
    Q = Rotation.random(rng=4).as_matrix()
    u = np.asarray(STIFF.fibre.direction())
    turned = FibreReinforced(MATRIX, E_F, Fibre.of((Q @ u)[None]))
    turned = jax.tree.map(lambda leaf: leaf.reshape(()), turned)
    for F in GRADIENTS:
        np.testing.assert_allclose(
            energy(turned, F @ Q.T), energy(STIFF, F), rtol=1e-12
        )


def test_nearly_incompressible_silicone_with_thread():
    """What soft arms are wound of is a law, in either order of stiffness."""
    law = FibreReinforced(NeoHookean(264e3, 0.499), 20e6, Fibre(0.0))
    A = tangent(law, np.eye(3)).reshape(9, 9)
    symmetric = np.asarray([0, 4, 8])
    assert np.linalg.eigvalsh(A[np.ix_(symmetric, symmetric)]).min() > 0


def test_helix_and_axis():
    """By hand at one point of a tube around the line x = 1, z = 2 along y."""
    where, about = np.array([[1.0, 0.3, 5.0]]), ([0, 2.0, 0], [1.0, 0, 2.0])
    # Away from the axis is +z, so around it y x z = +x.
    u = lambda fibre: np.ravel(fibre.direction())
    hoop = Fibre.helix(np.pi / 2, where, *about)
    np.testing.assert_allclose(u(hoop), [1, 0, 0], atol=1e-15)
    c, s = np.cos(0.4), np.sin(0.4)
    helix = Fibre.helix(0.4, where, *about)
    np.testing.assert_allclose(u(helix), [s, c, 0], atol=1e-15)
    np.testing.assert_allclose(u(helix.mirrored()), [-s, c, 0], atol=1e-15)
    np.testing.assert_allclose(u(Fibre.along(about[0])), [0, 1, 0], atol=1e-15)


def test_bad_fibres():
    with pytest.raises(ValueError, match=r"1 of 2 tets .* 1, at \(0, 0, 5\) mm"):
        Fibre.helix(0.0, np.array([[0.01, 0, 0], [0, 0, 0.005]]), [0, 0, 1])
    with pytest.raises(ValueError, match=r"direction \[0\.0, 0\.0, 0\.0\] .* 1 "):
        Fibre.of(np.array([[1.0, 0, 0], [0, 0, 0]]))
    with pytest.raises(ValueError, match=r"\[0\.0, nan, 0\.0\] .*no finite length"):
        Fibre.along([0.0, np.nan, 0.0])
    with pytest.raises(ValueError, match=r"E_f .*negative .*\[Pa\], got -1\."):
        FibreReinforced(MATRIX, -1.0, Fibre(0.0))
    classical = ClassicalCorotational(Isotropic(E, NU))
    with pytest.raises(ValueError, match=r"potential, .*ClassicalCorot"):
        FibreReinforced(classical, 1.0, Fibre(0.0))


def test_bad_calls(unchecked):
    with pytest.raises(ValueError, match=r"families .*1 or 2, got 3\."):
        FibreReinforced(MATRIX, 1.0, Fibre(0.0), families=3)
    with pytest.raises(ValueError, match=r"like .*NeoHookean.* got 264000\.0\."):
        FibreReinforced(264e3, 20e6, Fibre(0.0))


def test_the_matrix_may_be_tabulated():
    law = FibreReinforced(Corotational(Isotropic(E, NU)), E_F, Fibre(0.2))
    table = law.tabulated()
    np.testing.assert_allclose(
        stress(table, GRADIENTS[0]), stress(law, GRADIENTS[0]), rtol=0, atol=1e-13
    )


@pytest.mark.parametrize("degrees", [40.0, 54.7356103, 70.0])
def test_netting_of_a_tube_under_pressure(degrees):
    """Inextensible threads at +-alpha turn until tan^2 = 2, the ratio of the stresses.

    A closed thin tube has twice as much Cauchy stress around as along it, which
    threads alone carry at tan^2 alpha' = 2 only, 54.7 degrees (netting analysis). Where
    threads keep their length, l_a = cos alpha' / cos alpha along the tube and
    l_h = sin alpha' / sin alpha around it. One wound at 70 degrees lengthens.
    """
    alpha, final = np.deg2rad(degrees), np.arctan(np.sqrt(2.0))
    expected = [np.cos(final) / np.cos(alpha), np.sin(final) / np.sin(alpha)]
    law = FibreReinforced(
        NeoHookean(1e-5, 0.49),
        1e5,
        Fibre(alpha, plane="xy"),
        families=2,
        tension_only=True,
    )

    @jax.jit
    def residual(stretches):
        """Cauchy stress along, around and through the wall; the last is magnified."""
        sigma = jnp.diag(law.stress(jnp.diag(stretches))) * stretches
        sigma = sigma / jnp.prod(stretches)
        return jnp.stack([sigma[0] - 1.0, sigma[1] - 2.0, 1e5 * sigma[2]])

    a, h = (1.0 + 1e-4) * np.asarray(expected)
    start = jnp.asarray([a, h, 1.0 / (a * h)])
    solution = root(residual, start, jac=jax.jit(jax.jacfwd(residual)))
    np.testing.assert_allclose(residual(jnp.asarray(solution.x)), 0.0, atol=1e-6)
    # The threads stretch by the load over their stiffness.
    np.testing.assert_allclose(solution.x[:2], expected, rtol=2e-4)
