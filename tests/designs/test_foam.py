"""Foam tables against the published homogenisation, and the search in them."""

import numpy as np
import pytest
from problems import FOAM_OF_THE_ROBOT, ORTHOTROPIC_FOAM

from softcal_jax.designs import FoamTable, published_foam

DENSITIES = np.array([0.0918, 0.1798, 0.2639, 0.3422])
SHRINK = 0.2


def test_the_published_samples_are_met():
    rows = [(12e6 * f.Ex, 6e6 * (f.Ey + f.Ez)) for f in ORTHOTROPIC_FOAM]
    foam = published_foam()
    moduli = foam.moduli(DENSITIES, np.full(4, SHRINK))
    np.testing.assert_allclose(moduli, rows, rtol=1e-9)
    density = np.array([0.0901, 0.1534, 0.2323, 0.3297])
    E = 12e6 * np.array([0.0247, 0.0436, 0.0738, 0.1244])
    moduli = foam.moduli(density, np.ones(4))
    np.testing.assert_allclose(moduli, np.stack([E, E], axis=1), rtol=1e-9)


def test_the_foam_of_the_robot():
    """Its published moduli are those of a foam with published Poisson's ratios.

    Both of these lie at 0.661 of the way from the first to the second sample, at the
    density 0.150: a value that the search does not know.
    """
    robot = FOAM_OF_THE_ROBOT
    first, second = ORTHOTROPIC_FOAM[:2]
    by_ratio = [
        np.interp(
            getattr(robot, ours),
            [getattr(f, theirs) for f in (first, second)],
            DENSITIES[:2],
        )
        for ours, theirs in (("nu_t", "nu_yz"), ("nu_tl", "nu_zx"))
    ]
    np.testing.assert_allclose(by_ratio, 0.150, atol=1e-4)
    foam = published_foam().find(
        np.array([1e3 * robot.E_l]), np.array([1e3 * robot.E_t])
    )
    np.testing.assert_allclose(foam.density, by_ratio[0], rtol=0.01)
    np.testing.assert_allclose(foam.anisotropy, SHRINK, rtol=0.01)
    # The robot's are linear between samples, ours powers of the density.
    assert foam.error < 0.01


def test_moduli_are_proportional_to_those_of_the_solid():
    twice = published_foam(24e6).moduli(DENSITIES, np.full(4, 0.5))
    once = published_foam().moduli(DENSITIES, np.full(4, 0.5))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-12)


def phasor(iso=(0.0, 0.0, 0.4, 0.4, 1.0, 1.0)):
    """Three levels with powers of the density, stiff by 6, 3 and 1."""
    density = np.array([0.1, 0.3] * 3)
    soft = 12e6 * density**2
    stiff = soft * np.repeat([6.0, 3.0, 1.0], 2)
    return FoamTable("Phasor", density, np.array(iso), soft, stiff)


@pytest.mark.parametrize("table", [published_foam(), phasor()], ids=lambda t: t.infill)
def test_the_search_inverts_the_table(table):
    random = np.random.default_rng(3)
    lowest = table.anisotropy.min()
    anisotropy = random.uniform(lowest, 1.0, 500)
    density = random.uniform(0.1, 0.3, 500)
    foam = table.find(*table.moduli(density, anisotropy).T)
    assert foam.error.max() < 1e-9
    np.testing.assert_allclose(foam.density, density, rtol=1e-7)
    np.testing.assert_allclose(foam.anisotropy, anisotropy, rtol=1e-7, atol=1e-7)


def test_between_levels_phasor_is_linear_in_its_isotropy():
    """Half way from iso 0 (6 times) to 0.4 (3 times): sqrt(18) times."""
    E_soft, E_stiff = phasor().moduli(np.array([0.2]), np.array([0.2]))[0]
    np.testing.assert_allclose([E_soft, E_stiff], [4.8e5, 4.8e5 * np.sqrt(18.0)])


def test_what_is_out_of_reach_gets_the_nearest():
    """A brute search over the whole table finds nothing nearer."""
    table = published_foam()
    asked = np.array(
        [(5e3, 5e5), (3e4, 3e6), (9e5, 9e5 * 1.01), (4e6, 8e6), (9e4, 2e6)]
    )
    foam = table.find(*asked.T)
    shrink = np.geomspace(0.2, 1.0, 200)
    for i, pair in enumerate(asked):
        best = np.inf
        for t in np.linspace(0.0, 1.0, 200):
            s = np.log(shrink / 0.2) / np.log(5.0)
            low = (1 - s) * np.log(0.0918) + s * np.log(0.0901)
            high = (1 - s) * np.log(0.3422) + s * np.log(0.3297)
            moduli = table.moduli(np.exp(low + t * (high - low)), shrink)
            best = min(best, np.linalg.norm(np.log(moduli / pair), axis=1).min())
        got = np.log([foam.E_soft[i], foam.E_stiff[i]]) - np.log(pair)
        assert np.linalg.norm(got) < best + 1e-9
        np.testing.assert_allclose(foam.error[i], np.abs(got).max(), rtol=1e-12)


def test_one_level_is_a_curve():
    table = FoamTable("Polyfoam", [0.1, 0.4], [0.1, 0.1], [1e4, 1.6e5], [1e5, 1.6e6])
    foam = table.find(np.array([4e4]), np.array([4e5]))
    np.testing.assert_allclose(foam.density, 0.2, rtol=1e-8)
    np.testing.assert_allclose(foam.anisotropy, 0.1, rtol=1e-12)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"infill": "Gyroid"}, "infill 'Gyroid'"),
        ({"density": [0.1, 20.0]}, r"sample 2: density .*\(0, 1\].* 20\."),
        ({"anisotropy": [0.0, 0.2]}, r"sample 1: shrink .*\(0, 1\], got 0\."),
        ({"E_soft": [1e4, np.nan]}, "sample 2: E_soft .*positive .* nan"),
        ({"E_stiff": [1e3, 1e6]}, "sample 1: E_stiff .*E_soft .* 1000"),
        ({"density": [0.1, 0.1]}, r"shrink 0\.2 .*densities 0\.1, 0\.1; .*two"),
        ({"anisotropy": [0.2, 0.3]}, r"shrink 0\.2 .*densities 0\.1; .*two"),
    ],
)
def test_bad_tables(changed, message):
    fine = {
        "infill": "Polyfoam",
        "density": [0.1, 0.4],
        "anisotropy": [0.2, 0.2],
        "E_soft": [1e4, 1e5],
        "E_stiff": [1e5, 1e6],
    }
    FoamTable(**fine)
    with pytest.raises(ValueError, match=message):
        FoamTable(**{**fine, **changed})


@pytest.mark.parametrize("modulus", [0.0, -1.0, np.inf, np.nan])
def test_a_solid_without_modulus(modulus):
    with pytest.raises(ValueError, match=f"got {modulus:g}; 12 MPa .*TPU"):
        published_foam(modulus)
