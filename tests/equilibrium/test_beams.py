"""Large bending of slender beams of solid tets against the theory of the elastica.

One model (60x2x2 cells of 6 quadratic tets, L / h = 20, St. Venant-Kirchhoff, nu = 0)
and one batch carry all loads; length, E I are scaled to kappa and alpha.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import CLAMP, lane, solve
from problems import (
    ELASTICA_END_LOAD,
    ELASTICA_OWN_WEIGHT,
    ELASTICA_SENSITIVITY,
    SOLID_KAPPA_5,
    Tip,
    nearest_node,
    shear_beam,
)

from softcal_jax.configurations import Configuration, SurfaceForce, configuration_arrays
from softcal_jax.equilibrium import RESULTS, build_model, solve_equilibrium
from softcal_jax.materials import Isotropic, StVenantKirchhoff
from softcal_jax.mesh import beam

SLENDERNESS, E = 20.0, 1e5
SIDE = 1.0 / SLENDERNESS
EI, AREA = E * SIDE**4 / 12.0, SIDE**2
# Deflections so small that only the linear theory is left.
TINY = 1e-4


def own_weight(name, kappa):
    """Density 1: the weight per length is gravity times area."""
    return Configuration(name, CLAMP, gravity=(0.0, 0.0, -kappa * EI / AREA))


def end_load(name, alpha):
    load = SurfaceForce("x_max", (0.0, 0.0, -alpha * EI))
    return Configuration(name, CLAMP, gravity=(0.0, 0.0, 0.0), loads=(load,))


CONFIGURATIONS = [
    *(own_weight(f"kappa {kappa}", kappa) for kappa in ELASTICA_OWN_WEIGHT),
    *(end_load(f"alpha {alpha}", alpha) for alpha in ELASTICA_END_LOAD),
    own_weight("tiny weight", TINY),
    end_load("tiny load", TINY),
]
NAMES = [configuration.name for configuration in CONFIGURATIONS]


@pytest.fixture(scope="module")
def model():
    mesh = beam(1.0, SIDE, SIDE, (60, 2, 2), order=2)
    return build_model(mesh, StVenantKirchhoff(Isotropic(E, 0.0)), density=1.0)


@pytest.fixture(scope="module")
def lanes(model):
    return configuration_arrays(model.mesh, CONFIGURATIONS)


@pytest.fixture(scope="module")
def tip_node(model):
    return nearest_node(model.mesh, (1.0, SIDE / 2, SIDE / 2))


@pytest.fixture(scope="module")
def tips(model, lanes, tip_node):
    """Where the centre of the end face goes, by name of configuration."""
    solution = solve(model, lanes)
    assert bool(jnp.all(solution.result == RESULTS.converged))
    assert bool(jnp.all(solution.n_negative == 0))
    u = np.asarray(solution.displacement[:, tip_node])
    return {name: Tip(-uz, -ux) for name, (ux, _, uz) in zip(NAMES, u, strict=True)}


@pytest.mark.parametrize("kappa", ELASTICA_OWN_WEIGHT)
def test_own_weight_against_the_elastica(tips, kappa):
    """Softer by the shear, 4 EI/kGA L^2 = 0.2 %, and by the law's own terms (h/L)^2."""
    np.testing.assert_allclose(
        tips[f"kappa {kappa}"], ELASTICA_OWN_WEIGHT[kappa], rtol=6e-3
    )


@pytest.mark.parametrize("kappa", ELASTICA_OWN_WEIGHT)
def test_own_weight_against_the_shear_beam(tips, kappa):
    """With shear, stretch and the law of the fibres, only the mesh is left (0.03 %)."""
    np.testing.assert_allclose(
        tips[f"kappa {kappa}"], shear_beam(kappa, SLENDERNESS), rtol=1e-3
    )


def test_shear_beam_tends_to_the_elastica():
    """The reference itself: the slender limit is the published table."""
    for kappa, tip in ELASTICA_OWN_WEIGHT.items():
        # Shear is of order 1 / slenderness^2, the tolerance of the integration 1e-8.
        np.testing.assert_allclose(shear_beam(kappa, 1e4), tip, rtol=1e-6, atol=1e-8)


def test_shear_beam_of_the_reference():
    """Reissner's beam at L/h = 20 and kappa = 5 with linear fibres: 0.496893."""
    down = shear_beam(5.0, SLENDERNESS, kirchhoff=0.0).down
    np.testing.assert_allclose(down, 0.496893, rtol=0, atol=5e-7)


@pytest.mark.parametrize("alpha", ELASTICA_END_LOAD)
def test_end_load_against_the_elastica(tips, alpha):
    """Softer by the shear, 3 EI/kGA L^2 = 0.15 %, and by the law's terms (h/L)^2."""
    np.testing.assert_allclose(
        tips[f"alpha {alpha}"], ELASTICA_END_LOAD[alpha], rtol=6e-3
    )


def test_the_same_mesh_in_another_code(tips):
    """To the last of the six digits that are kept."""
    np.testing.assert_allclose(tips["kappa 5.0"], SOLID_KAPPA_5, rtol=0, atol=1e-6)


def test_linear_limit(tips):
    """Timoshenko: w L^4/8EI + w L^2/2kGA, and P L^3/3EI + P L/kGA."""
    shear = EI / (5.0 / 6.0 * E / 2.0 * AREA)
    weight, load = TINY * (1 / 8 + shear / 2), TINY * (1 / 3 + shear)
    # What the mesh leaves, as above.
    np.testing.assert_allclose(tips["tiny weight"].down, weight, rtol=1e-3)
    np.testing.assert_allclose(tips["tiny load"].down, load, rtol=1e-3)


def test_derivatives_in_E_against_the_elastica(model, lanes, tip_node):
    """d ln(down)/d ln E and d ln(retract)/d ln E; linear theory would say -1 and -2."""

    @jax.jit
    def slopes(E, lanes):
        def log_tip(log_E):
            law = StVenantKirchhoff(Isotropic(jnp.exp(log_E), model.law.elasticity.nu))
            changed = eqx.tree_at(lambda m: m.law, model, law)
            one = lambda lane: solve_equilibrium(changed, lane).displacement[tip_node]
            return jnp.log(-jax.vmap(one)(lanes)[:, jnp.array([2, 0])])

        return jax.jvp(log_tip, (jnp.log(E),), (jnp.ones(()),))[1]

    used = [NAMES.index(f"kappa {kappa}") for kappa in ELASTICA_SENSITIVITY]
    got = slopes(jnp.asarray(E), lane(lanes, np.array(used)))
    # The solid's own shear: 0.2 % of the deflection, and as much of its slope.
    np.testing.assert_allclose(got, list(ELASTICA_SENSITIVITY.values()), rtol=4e-3)
