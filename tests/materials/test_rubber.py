"""Nearly incompressible rubbers: closed forms, limits and Treloar's measurements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import at, derived, energy, stress, tangent
from problems import assert_second_order
from scipy.spatial.transform import Rotation

from benchmarks._treloar import MOONEY_RIVLIN_2012, OGDEN_1972, TRELOAR
from softcal_jax.materials import Gent, MooneyRivlin, Ogden, Yeoh

MU = 0.4
LAWS = {
    "mooney-rivlin": MooneyRivlin(0.14, 0.06),
    "yeoh": Yeoh(0.2, -0.004, 0.0003),
    "gent": Gent(MU, 40.0),
    "ogden 1": Ogden(0.5, 1.6),
    "ogden 2": Ogden(0.3, 1.6, -0.16, -2.0),
    "ogden 3": Ogden(0.3, 1.6, 0.064, 2.5, -0.08, -2.0),
}
each_law = pytest.mark.parametrize("name", LAWS)


def slopes(name, s):
    """dW/d ln s_i of principal stretches whose product is 1, but for a pressure.

    s_i dW/ds_i with W as its author wrote it for an incompressible rubber.
    """
    law, s = LAWS[name], np.asarray(s)
    I1 = np.sum(s**2)
    if name == "mooney-rivlin":
        return 2 * law.c10 * s**2 - 2 * law.c01 * s**-2.0
    if name == "yeoh":
        x = I1 - 3
        return 2 * s**2 * (law.c10 + 2 * law.c20 * x + 3 * law.c30 * x**2)
    if name == "gent":
        return s**2 * law.mu * law.J_m / (law.J_m - (I1 - 3))
    return sum(mu * s**alpha for mu, alpha in law.terms())


STATES = {
    "uniaxial": lambda s: [s, s**-0.5, s**-0.5],
    "equibiaxial": lambda s: [s, s, s**-2.0],
    "pure shear": lambda s: [s, 1.0, 1.0 / s],
}


@each_law
@pytest.mark.parametrize("kind", STATES)
@pytest.mark.parametrize("s", [0.7, 1.0, 1.0 + 1e-9, 1.5, 2.5])
def test_principal_stresses(name, kind, s):
    """Differences of principal Cauchy stresses are those of s dW/ds, at volume one.

    Treloar, The Physics of Rubber Elasticity (1975), Sec. 10.3; Ogden 1972, Eq. 2.10.
    The pressure is what a volume change would add to all of them.
    """
    stretches = STATES[kind](s)
    sigma = stress(LAWS[name], np.diag(stretches)) @ np.diag(stretches)
    principal, expected = np.diag(sigma), slopes(name, stretches)
    np.testing.assert_allclose(sigma, np.diag(principal), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        principal - principal.mean(), expected - expected.mean(), rtol=1e-12, atol=1e-13
    )
    # No pressure at J = 1, but for the rounding of J times the bulk modulus of 200.
    np.testing.assert_allclose(principal.mean(), 0.0, atol=1e-12)


@each_law
@pytest.mark.parametrize("gamma", [1e-3, 0.8, 2.0])
def test_simple_shear(name, gamma):
    """The pure shear of s and 1/s in it, s - 1/s = gamma, turned by Mohr's circle.

    The principal axes of the stress are those of b = F F^T, of which b_12 = gamma.
    """
    F = np.eye(3)
    F[0, 1] = gamma
    s = gamma / 2 + np.hypot(1.0, gamma / 2)
    slope = slopes(name, [s, 1.0 / s, 1.0])
    sigma = stress(LAWS[name], F) @ F.T
    expected = gamma * (slope[0] - slope[1]) / (s**2 - s**-2)
    np.testing.assert_allclose(sigma[0, 1], expected, rtol=1e-12)
    # Universal relation of Rivlin, whatever the law.
    np.testing.assert_allclose(
        sigma[0, 0] - sigma[1, 1], gamma * sigma[0, 1], rtol=1e-9
    )


@each_law
def test_small_strain_limit(name):
    """Hooke's tensor of mu and K = 2 mu (1 + nu) / (3 (1 - 2 nu))."""
    law, d = LAWS[name], np.eye(3)
    bulk = 2 * MU * 1.499 / (3 * 0.002)
    hooke = (bulk - 2 * MU / 3) * np.einsum("ij,kl->ijkl", d, d) + MU * (
        np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    )
    np.testing.assert_allclose(law.shear_modulus(), MU, rtol=1e-15)
    np.testing.assert_allclose(tangent(law, np.eye(3)), hooke, rtol=0, atol=1e-12)


@each_law
def test_volume(name):
    """F = s I costs K/4 (J^2 - 1 - 2 ln J) alone, with the pressure K/2 (J - 1/J)."""
    bulk, s = 2 * MU * 1.499 / (3 * 0.002), 1.02
    J = s**3
    F = s * np.eye(3)
    expected = bulk / 4 * (J**2 - 1 - 2 * np.log(J))
    here, inverted = at(LAWS[name], F), at(LAWS[name], -F)
    np.testing.assert_allclose(here.energy, expected, rtol=1e-11)
    pressure = bulk / 2 * (J - 1 / J) * J / s
    np.testing.assert_allclose(here.stress, pressure * np.eye(3), rtol=1e-11)
    assert np.isnan(inverted.energy)
    assert np.isnan(inverted.stress).any()


COINCIDING = {
    "at rest": [1.0, 1.0, 1.0],
    "two": [1.3, 1.3, 0.6],
    "two nearly": [1.3, 1.3 * (1 + 1e-9), 0.6],
    "all nearly": [1.0, 1.0 + 1e-7, 1.0 - 3e-8],
    "limit of the series": [1.0, 1.0099, 0.98],
}


@pytest.mark.parametrize("state", COINCIDING)
def test_ogden_where_stretches_coincide(state):
    """Second order of differences, forward = reverse, and the Hessian: all finite."""
    law = LAWS["ogden 3"]
    Q, R = (Rotation.random(rng=seed).as_matrix() for seed in (1, 2))
    F = Q @ np.diag(COINCIDING[state]) @ R
    dF, cotangent = np.random.default_rng(0).normal(size=(2, 3, 3))
    A = tangent(law, F)
    P = lambda F: stress(law, F)
    assert_second_order(P, F, dF, np.tensordot(A, dF, 2), (1e-2, 1e-3))
    both = derived(law, F, dF, cotangent)
    np.testing.assert_allclose(A, both.tangent, rtol=0, atol=1e-10)
    np.testing.assert_allclose(A, A.transpose(2, 3, 0, 1), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        np.vdot(cotangent, both.along), np.vdot(both.pulled_back, dF), rtol=1e-12
    )


def test_ogden_in_its_exponents():
    """Calibrated exponents: stress and energy by alpha, at second order."""
    F = jnp.diag(jnp.asarray([1.4, 1.4, 0.55]))
    law = lambda alpha: Ogden(0.3, alpha, 0.05, 2.0)
    # The derivative of the energy by F and alpha, in either order.
    psi = lambda F, a: law(a).energy_density(F)

    @jax.jit
    def slopes(a):
        P_by_alpha = jax.jacfwd(lambda a: law(a).stress(F))(a)
        mixed = jax.jacfwd(jax.grad(psi), argnums=1)(F, a)
        return jax.grad(psi, argnums=1)(F, a), P_by_alpha, mixed

    psi_by_alpha, P_by_alpha, mixed = slopes(jnp.asarray(1.7))
    for of, slope in ((energy, psi_by_alpha), (stress, P_by_alpha)):
        value = lambda a, of=of: of(law(a), F)
        error = lambda h, value=value, slope=slope: np.max(
            np.abs((value(1.7 + h) - value(1.7 - h)) / (2 * h) - slope)
        )
        np.testing.assert_allclose(error(1e-1) / error(1e-2), 100.0, rtol=0.05)
    np.testing.assert_allclose(mixed, P_by_alpha, atol=1e-13)


def test_a_third_derivative_of_ogden_is_refused():
    with pytest.raises(NotImplementedError, match=r"Ogden .*second.*third"):
        jax.eval_shape(jax.jacfwd(LAWS["ogden 1"].tangent), np.eye(3))


def test_two_terms_are_mooney_rivlin():
    """alpha = 2 and -2 with mu_p = 2 c10 and -2 c01 (Ogden 1972)."""
    ogden = Ogden(2 * 0.14, 2.0, -2 * 0.06, -2.0)
    for seed in range(3):
        F = np.eye(3) + 0.2 * np.random.default_rng(seed).normal(size=(3, 3))
        expected = stress(LAWS["mooney-rivlin"], F)
        np.testing.assert_allclose(stress(ogden, F), expected, rtol=0, atol=1e-11)


def test_gent_far_from_its_limit_is_neo_hookean():
    """J_m -> infinity: W -> mu/2 (i1 - 3), Mooney-Rivlin with c01 = 0."""
    F = np.eye(3) + 0.2 * np.random.default_rng(3).normal(size=(3, 3))
    expected = tangent(MooneyRivlin(MU / 2, 0.0), F)
    np.testing.assert_allclose(tangent(Gent(MU, 1e12), F), expected, rtol=0, atol=1e-9)


def test_gent_locks():
    """P grows beyond bound up to i1 = 3 + J_m; from there on nothing is a number."""
    law = Gent(MU, 10.0)
    limit = np.max(np.roots([1.0, 0.0, -13.0, 2.0]).real)  # s^3 - 13 s + 2 = 0
    pulled = lambda s: at(law, np.diag([s, s**-0.5, s**-0.5]))
    assert pulled(limit - 1e-6).stress[0, 0] > 1e4 * MU
    for s in (limit + 1e-6, 2.0 * limit):
        assert all(np.isnan(value).any() for value in pulled(s))
        F = jnp.diag(jnp.array([s, s**-0.5, s**-0.5]))
        for derivative in (jax.grad, jax.jacfwd):
            assert np.isnan(derivative(law.energy_density)(F)).all()


def nominal(law, kind, stretch):
    """Nominal stress of a test in which the rubber keeps its volume."""
    stretches = np.asarray(STATES[kind](stretch))
    P = np.diag(stress(law, np.diag(stretches)))
    # The free face has no stress: take its pressure off.
    return P[0] - P[2] * stretches[2] / stretches[0]


def misfit(law, kind):
    """Root mean square error of the stress [Pa]."""
    s, P = TRELOAR[kind]
    computed = np.array([nominal(law, kind, each) for each in s])
    return np.sqrt(np.mean((computed - P) ** 2))


def test_ogden_fits_treloar_as_he_published():
    """Ogden 1972, Figs. 1 to 3: within some percent up to stretches of 7, 5 and 4.4."""
    law = Ogden(**OGDEN_1972)
    # 0.4 MPa: 6.178e5 * 1.3 / 2 + 1177 * 5 / 2 + 9807 * 2 / 2 = 414 kPa.
    np.testing.assert_allclose(law.shear_modulus(), 414.3e3, rtol=1e-3)
    largest = {kind: test.stress.max() for kind, test in TRELOAR.items()}
    for kind, share in (
        ("uniaxial", 0.06),
        ("pure shear", 0.03),
        ("equibiaxial", 0.03),
    ):
        assert misfit(law, kind) < share * largest[kind], kind


@pytest.mark.parametrize("kind", MOONEY_RIVLIN_2012)
def test_mooney_rivlin_fits_one_test_each(kind):
    """Constants of Steinmann et al. 2012 are the least squares of their own test.

    P is linear in c10 and c01, so NumPy finds them; in pure shear only their sum
    counts. Those of the uniaxial test are a third off in rms, as published.
    """
    s, P = TRELOAR[kind]
    c = MOONEY_RIVLIN_2012[kind]
    law = MooneyRivlin(**c)
    factor, i2 = {
        "uniaxial": (2 * (s - s**-2), 1 / s),
        "pure shear": (2 * (s - s**-3), np.ones_like(s)),
        "equibiaxial": (2 * (s - s**-5), s**2),
    }[kind]
    columns = np.stack([factor, factor * i2], axis=1)
    computed = np.array([nominal(law, kind, each) for each in s])
    np.testing.assert_allclose(computed, columns @ [c["c10"], c["c01"]], rtol=1e-9)
    best, *_ = np.linalg.lstsq(columns, P)
    least = np.sqrt(np.mean((columns @ best - P) ** 2))
    assert misfit(law, kind) < (1.4 if kind == "uniaxial" else 1.05) * least


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MooneyRivlin(1.0, -2.0), "shear modulus -2 Pa .*positive"),
        (lambda: Yeoh(-1.0, 1.0, 1.0), "shear modulus -2 Pa"),
        (lambda: Ogden(1.0, -1.0), r"shear modulus -0\.5 Pa"),
        (lambda: Ogden(1.0, 1.0, mu_3=1.0), "term 3 .*mu_3 and alpha_3"),
        (lambda: Gent(1.0, -3.0), "J_m .*positive .* -3"),
        (lambda: Gent(-1.0, 3.0), "mu .*positive .* -1"),
        (lambda: Gent(1.0, 3.0, 0.5), r"nu .*\(0, 0\.5\), got 0\.5\. .*0\.499"),
    ],
)
def test_bad_constants(make, message):
    with pytest.raises(ValueError, match=message):
        make()
