"""Implicit derivatives of the equilibrium, to everything that it depends on.

On linear tets, which compile fast; `test_beams` differentiates quadratic ones.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from bodies import (
    CLAMP,
    DENSITY,
    LENGTH,
    POISSON,
    SIDE,
    TIGHT,
    TIP_POINT,
    YOUNG,
    hanging,
)
from mechanisms import both_ways_at
from problems import assert_second_order, both_ways, nearest_node

from softcal_jax.configurations import PointForce, Support, configuration_arrays
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam


class Inputs(NamedTuple):
    """What is varied: parameters that all lanes share, and loads of each lane."""

    E: jax.Array
    nu: jax.Array
    density: jax.Array
    force: jax.Array
    gravity: jax.Array
    imposed: jax.Array


MIDDLE = (0.1, 0.01, 0.01)
MESH = beam(LENGTH, SIDE, SIDE, (10, 2, 2))
MODEL = build_model(MESH, Corotational(Isotropic(YOUNG, POISSON)), density=DENSITY)
LANES = configuration_arrays(
    MESH,
    [
        hanging("free", loads=(PointForce(TIP_POINT, (0.01, 0.02, -0.01)),)),
        hanging("moved", supports=(*CLAMP, Support("x_max", "z", (0.0, 0.0, 0.02)))),
    ],
)
OBSERVED = np.array([nearest_node(MESH, p) for p in (MIDDLE, TIP_POINT)])
N_TETS = MESH.n_tets
# With explicit types: a weak one would compile every program twice.
START = Inputs(
    E=jnp.full(N_TETS, YOUNG, float),
    nu=jnp.asarray(POISSON, float),
    density=jnp.full(N_TETS, DENSITY, float),
    force=LANES.loads.force,
    gravity=LANES.gravity,
    imposed=LANES.imposed,
)


def positions(inputs: Inputs):
    """Displacements [m] of two points in both configurations."""
    where = lambda m: (m.law.elasticity.E, m.law.elasticity.nu, m.density)
    model = eqx.tree_at(where, MODEL, inputs[:3])
    where = lambda c: (c.loads.force, c.gravity, c.imposed)
    lanes = eqx.tree_at(where, LANES, inputs[3:])
    one = lambda lane: solve_equilibrium(model, lane, settings=TIGHT).displacement
    return jax.vmap(one)(lanes)[:, OBSERVED]


forward_and_reverse = both_ways(positions)


def direction(name: str) -> Inputs:
    """A random direction in one input, of the size of the input; none in the others."""
    base = getattr(START, name)
    noise = jr.normal(jr.key(3), base.shape)
    scale = {"force": 0.02, "imposed": 0.003, "gravity": 5.0}.get(name, 0.3 * base)
    if name == "imposed":
        noise = jnp.where(LANES.fixed, noise, 0.0)
    zero = jax.tree.map(jnp.zeros_like, START)
    return zero._replace(**{name: scale * noise})


@pytest.fixture(scope="module")
def derivative():
    still = jnp.zeros((2, 2, 3))
    return lambda x, t: forward_and_reverse(x, t, still).forward


@pytest.mark.parametrize("name", Inputs._fields)
def test_second_order_against_differences(derivative, name):
    tangent = direction(name)
    jvp = derivative(START, tangent)
    assert jnp.max(jnp.abs(jvp)) > 1e-4
    still = jnp.zeros((2, 2, 3))
    values = lambda inputs: forward_and_reverse(inputs, tangent, still).value
    assert_second_order(values, START, tangent, jvp, (3e-2, 1e-2))


def test_forward_equals_reverse():
    tangent = jax.tree.map(lambda *parts: sum(parts), *map(direction, Inputs._fields))
    cotangent = jr.normal(jr.key(5), (2, 2, 3))
    _, forward, reverse = forward_and_reverse(START, tangent, cotangent)
    products = jax.tree.map(jnp.vdot, reverse, tangent)
    # Both solve with the same factor; rounding times its condition remains.
    np.testing.assert_allclose(sum(products), jnp.vdot(cotangent, forward), rtol=1e-10)
    # A forgotten input would show as a zero here.
    assert all(abs(product) > 0 for product in products)


def test_imposed_displacement_moves_its_own_node(derivative):
    """On a held node the derivative is the tangent itself, and it drags the others."""
    tangent = jax.tree.map(jnp.zeros_like, START)
    end = MESH.nodes("x_max")
    lifted = jnp.zeros_like(START.imposed).at[1, end, 2].set(1.0)
    jvp = derivative(START, tangent._replace(imposed=lifted))
    np.testing.assert_array_equal(jvp[0], 0.0)
    np.testing.assert_array_equal(jvp[1, 1, 2], 1.0)
    assert 0.1 < float(jvp[1, 0, 2]) < 0.9


def test_scaling_of_loads_and_moduli(derivative):
    """Twice the modulus, density and force leave the shape: sum of x du/dx is zero."""
    tangent = jax.tree.map(jnp.zeros_like, START)._replace(
        E=START.E, density=START.density, force=START.force
    )
    alone = derivative(START, tangent._replace(density=0.0 * START.density))
    assert jnp.max(jnp.abs(alone)) > 1e-3
    np.testing.assert_allclose(derivative(START, tangent), 0.0, atol=1e-10)


HELD = LANES[0]  # of one program with what follows


def solved(E):
    model = eqx.tree_at(lambda m: m.law.elasticity.E, MODEL, E)
    return solve_equilibrium(model, HELD, settings=TIGHT)


E_START, E_TANGENT = START.E[0], jnp.asarray(0.3 * YOUNG, float)


def test_the_smallest_det_F_has_a_derivative():
    """Of second order against differences; of one tet, as long as none overtakes it."""
    found = solved(E_START)
    of = both_ways_at(lambda E: solved(E).min_det_F)
    forward, reverse = of(found, E_START, E_TANGENT, jnp.ones(()))
    values = lambda E: solved(E).min_det_F
    assert abs(forward) > 1e-4
    assert_second_order(values, E_START, E_TANGENT, forward, (3e-2, 1e-2))
    np.testing.assert_allclose(reverse * E_TANGENT, forward, rtol=1e-10)


DIAGNOSTICS = "load_reached residual rounding approached along_path".split()


@pytest.mark.parametrize("name", DIAGNOSTICS)
def test_what_has_no_derivative_says_so(name):
    number = lambda E: getattr(solved(E), name)
    _, along = jax.linearize(number, E_START)
    assert np.isnan(along(E_TANGENT))
    with pytest.raises(ValueError, match=f"{name} has no derivative"):
        jax.grad(number)(E_START)


def test_a_compiled_derivative_that_is_none_says_so():
    with pytest.raises(RuntimeError, match="residual has no derivative"):
        eqx.filter_jit(jax.grad(lambda E: solved(E).residual))(E_START)


def test_what_has_no_derivative_may_be_read_beside_what_has_one():
    def tip(E):
        solution = solved(E)
        near = jnp.where(solution.residual < 1e-3, 2.0, 1.0)
        return near * solution.displacement[OBSERVED[1], 2], solution

    def chosen(E):
        other = lambda s: s.displacement[OBSERVED[0], 2]
        height = lambda s: 2.0 * s.displacement[OBSERVED[1], 2]
        return jax.lax.cond(E > 0.0, height, other, solved(E))

    slope, solution = jax.grad(tip, has_aux=True)(E_START)
    assert float(solution.residual) < 1e-3
    np.testing.assert_allclose(jax.grad(chosen)(E_START), slope, rtol=1e-12)
