"""Energy, stress and tangent of a law belong together, whatever the law."""

import numpy as np
import pytest
from laws import (
    ANISOTROPIC,
    GRADIENTS,
    ISOTROPIC,
    LAM,
    LAWS,
    MU,
    at,
    derived,
    energy,
    overriding,
    stiffness,
    stress,
    tangent,
    together,
)
from problems import assert_second_order
from scipy.spatial.transform import Rotation

each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
each_isotropic_law = pytest.mark.parametrize("law", ISOTROPIC.values(), ids=ISOTROPIC)


def each_overriding(*methods):
    laws = overriding(*methods)
    return pytest.mark.parametrize("law", laws.values(), ids=laws)


each_with_own_forms = each_overriding("stress", "tangent")
each_with_shared_work = each_overriding(
    "energy_and_stress", "stress_and_tangent", "tabulated"
)


def test_the_states_are_far_from_rest_and_not_inverted():
    stretches = np.linalg.svd(GRADIENTS, compute_uv=False)
    assert np.all(np.linalg.det(GRADIENTS) > 0.1)
    assert stretches.max() > 1.5
    assert stretches.min() < 0.6


def noise(seed):
    return np.random.default_rng(seed).normal(size=(3, 3))


@each_law
def test_stress_is_the_derivative_of_the_energy(law):
    """Differences of the energy meet the stress at second order."""
    F, dF = GRADIENTS[0], noise(1)
    power = np.vdot(stress(law, F), dF)
    psi = lambda F: energy(law, F)
    assert_second_order(psi, F, dF, power, (1e-2, 1e-3), rtol=0.02)


@each_law
def test_tangent_is_the_derivative_of_the_stress(law):
    F, dF = GRADIENTS[1], noise(2)
    dP = np.tensordot(tangent(law, F), dF, 2)
    P = lambda F: stress(law, F)
    assert_second_order(P, F, dF, dP, (1e-2, 1e-3))


@each_with_own_forms
def test_closed_forms_equal_automatic_differentiation(law):
    """What a law overrides against what `AbstractLaw` derives from its energy."""
    for F in GRADIENTS:
        closed, exact = at(law, F), derived(law, F)
        np.testing.assert_allclose(closed.stress, exact.stress, rtol=0, atol=1e-13)
        np.testing.assert_allclose(closed.tangent, exact.tangent, rtol=0, atol=1e-12)


@each_law
def test_objectivity(law):
    """psi(Q F) = psi(F) and P(Q F) = Q P(F) for a rotation Q of the observer."""
    for seed, F in enumerate(GRADIENTS):
        Q = Rotation.random(rng=seed).as_matrix()
        one, turned = at(law, F), at(law, Q @ F)
        np.testing.assert_allclose(turned.energy, one.energy, rtol=1e-12)
        np.testing.assert_allclose(turned.stress, Q @ one.stress, rtol=0, atol=1e-13)


@each_isotropic_law
def test_isotropy(law):
    """psi(F Q) = psi(F) for a rotation Q of the rest shape."""
    Q = Rotation.random(rng=1).as_matrix()
    for F in GRADIENTS:
        np.testing.assert_allclose(energy(law, F @ Q), energy(law, F), rtol=1e-12)


@each_law
def test_symmetries(law):
    """Balance of moments, P F^T symmetric, and major symmetry of the tangent."""
    for F in GRADIENTS:
        _, P, A = at(law, F)
        kirchhoff = P @ F.T
        np.testing.assert_allclose(kirchhoff, kirchhoff.T, rtol=0, atol=1e-13)
        np.testing.assert_allclose(A, A.transpose(2, 3, 0, 1), rtol=0, atol=1e-12)


@each_law
def test_rest(law):
    """No stress at rest, also turned."""
    Q = Rotation.random(rng=2).as_matrix()
    for F in (np.eye(3), Q):
        # A few roundings of the moduli, which are of order one.
        psi, P, _ = at(law, F)
        np.testing.assert_allclose(P, 0.0, atol=1e-14)
        np.testing.assert_allclose(psi, 0.0, atol=1e-14)


@each_isotropic_law
def test_linear_limit(law):
    """The tangent at rest is Hooke's tensor."""
    d = np.eye(3)
    hooke = (
        LAM * np.einsum("ij,kl->ijkl", d, d)
        + MU * np.einsum("ik,jl->ijkl", d, d)
        + MU * np.einsum("il,jk->ijkl", d, d)
    )
    np.testing.assert_allclose(tangent(law, np.eye(3)), hooke, rtol=0, atol=1e-14)


@pytest.mark.parametrize("pair", ANISOTROPIC.values(), ids=ANISOTROPIC)
def test_anisotropic_linear_limit(pair):
    """The tangent at rest is the tensor of the elasticity, also turned with it."""
    law, elasticity = pair
    C = stiffness(elasticity)
    assert abs(C).max() > 0.3
    np.testing.assert_allclose(tangent(law, np.eye(3)), C, rtol=0, atol=1e-14)
    Q = Rotation.random(rng=3).as_matrix()
    np.testing.assert_allclose(
        tangent(law, Q),
        np.einsum("ia,kc,aJcL->iJkL", Q, Q, C),
        rtol=0,
        atol=1e-14,
    )


@pytest.mark.parametrize("pair", ANISOTROPIC.values(), ids=ANISOTROPIC)
def test_symmetry_group_of_the_fibre(pair):
    """Turning the rest shape about the fibre changes nothing; about another axis does.

    Half a turn across the fibre, which sends u to -u, changes nothing either.
    """
    law, elasticity = pair
    u = np.asarray(elasticity.fibre.direction())
    across = np.cross(u, [1.0, 2.0, 3.0])
    half = Rotation.from_rotvec(np.pi * across / np.linalg.norm(across))
    other = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
    changes = []
    for F in GRADIENTS:
        psi = energy(law, F)
        for turn in (Rotation.from_rotvec(0.7 * u), half):
            turned = F @ turn.as_matrix()
            np.testing.assert_allclose(energy(law, turned), psi, rtol=1e-12)
        changes.append(abs(energy(law, F @ other) / psi - 1.0))
    assert max(changes) > 0.1


@each_law
def test_laws_with_a_potential_say_so(law):
    assert law.conservative


@each_with_own_forms
def test_tangents_of_large_deformations(law):
    """Far from rest and nearly flat, the tangent still is the Hessian, to its size."""
    for seed in range(3):
        Q, R = (Rotation.random(rng=10 + seed + k).as_matrix() for k in (0, 5))
        F = Q @ np.diag([3.0, 0.9, 0.05]) @ R
        A, H = tangent(law, F), derived(law, F).tangent
        # The condition number 60 of F enters with its square.
        tolerance = 3600 * np.finfo(float).eps
        assert np.max(np.abs(A - H)) < tolerance * np.max(np.abs(H))


@each_with_own_forms
def test_forward_equals_reverse(law):
    F, dF, cotangent = GRADIENTS[2], noise(3), noise(4)
    both = derived(law, F, dF, cotangent)
    np.testing.assert_allclose(
        np.vdot(cotangent, both.along), np.vdot(both.pulled_back, dF), rtol=1e-12
    )


@each_with_shared_work
def test_what_is_computed_together_is_what_is_computed_alone(law):
    for F in GRADIENTS:
        alone, other = at(law, F), together(law, F)
        psi, P = other.energy_and_stress
        np.testing.assert_allclose(psi, alone.energy, rtol=1e-13)
        np.testing.assert_allclose(P, alone.stress, rtol=0, atol=1e-14)
        P, A = other.stress_and_tangent
        np.testing.assert_allclose(P, alone.stress, rtol=0, atol=1e-14)
        np.testing.assert_allclose(A, alone.tangent, rtol=0, atol=1e-13)


@each_with_shared_work
def test_a_tabulated_law_is_the_same_law(law):
    for F in GRADIENTS:
        plain, table = at(law, F), together(law, F).table
        np.testing.assert_allclose(table.energy, plain.energy, rtol=1e-12)
        np.testing.assert_allclose(table.stress, plain.stress, rtol=0, atol=1e-14)
        np.testing.assert_allclose(table.tangent, plain.tangent, rtol=0, atol=1e-13)
