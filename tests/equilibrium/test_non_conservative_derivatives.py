"""A law without a potential: implicit derivatives and both sides of compliances."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from bodies import TIGHT
from classical_beam import (
    E_T,
    LANES,
    LENGTH,
    LIFTED,
    LINEAR,
    SIDE,
    THETA,
    body,
    hanging,
)
from problems import both_ways, central_difference, nearest_node

from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import effector_values, solve_equilibrium
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import ClassicalCorotational
from softcal_jax.sensitivity import parameter_compliance


class Inputs(NamedTuple):
    """What is varied: parameters that all lanes share, and loads of each lane."""

    E_t: jax.Array
    theta: jax.Array
    gravity: jax.Array
    imposed: jax.Array


TWO_LANES = configuration_arrays(LINEAR, [hanging(20.0), hanging(10.0, LIFTED)])
START = Inputs(
    E_t=jnp.asarray(E_T),
    theta=jnp.asarray(THETA),
    gravity=TWO_LANES.gravity,
    imposed=TWO_LANES.imposed,
)
LINEAR_BODY = body(ClassicalCorotational, mesh="linear")
OBSERVED = np.array([nearest_node(LINEAR, (x, SIDE, SIDE)) for x in (0.075, LENGTH)])


@both_ways
def positions(inputs: Inputs):
    """Displacements [m] of two points in all configurations."""
    elasticity = lambda law: (law.elasticity.E_t, law.elasticity.fibre.theta)
    model = eqx.tree_at(lambda m: elasticity(m.law), LINEAR_BODY, inputs[:2])
    lanes = eqx.tree_at(lambda c: (c.gravity, c.imposed), TWO_LANES, inputs[2:])
    one = lambda c: solve_equilibrium(model, c, settings=TIGHT).displacement
    return jax.vmap(one)(lanes)[:, OBSERVED]


STILL = jnp.zeros((2, 2, 3))


def direction(name: str) -> Inputs:
    """A direction in one input, of the size of the input; none in the others."""
    noise = jr.normal(jr.key(3), getattr(START, name).shape)
    part = {
        "E_t": jnp.asarray(0.3 * E_T),
        "theta": jnp.asarray(0.3),
        "gravity": 20.0 * noise,
        "imposed": 1e-3 * noise,
    }[name]
    if name == "imposed":
        part = jnp.where(TWO_LANES.fixed, part, 0.0)
    return jax.tree.map(jnp.zeros_like, START)._replace(**{name: part})


@pytest.mark.slow
@pytest.mark.parametrize("name", Inputs._fields)
def test_implicit_derivative_is_second_order_against_differences(name):
    tangent = direction(name)
    jvp = positions(START, tangent, STILL).forward
    assert jnp.max(jnp.abs(jvp)) > 1e-4
    values = lambda inputs: positions(inputs, tangent, STILL).value
    error = lambda h: jnp.max(
        jnp.abs(central_difference(values, START, tangent, h) - jvp)
    )
    # Second order: a third of the step leaves a ninth of the error.
    np.testing.assert_allclose(error(3e-2) / error(1e-2), 9.0, rtol=0.05)


def test_forward_equals_reverse():
    tangents = [direction(name) for name in Inputs._fields]
    cotangent = jr.normal(jr.key(5), (2, 2, 3))
    for tangent in tangents:
        _, forward, reverse = positions(START, tangent, cotangent)
        product = sum(jax.tree.leaves(jax.tree.map(jnp.vdot, reverse, tangent)))
        assert abs(product) > 1e-4
        # Transposed solves by factors of their own: rounding times the condition.
        np.testing.assert_allclose(product, jnp.vdot(cotangent, forward), rtol=1e-9)


SPACE = ParameterSpace(
    (
        Parameter("E_t", "E_t", E_T, 1e4, 1e7),
        Parameter("theta", "theta", THETA, -1.5, 1.5, scale="linear", S=1.0),
    )
)


# On quadratic tets two programs that are larger, for the same sides of the same law.
@pytest.mark.parametrize(
    "mesh", ["linear", pytest.param("quadratic", marks=pytest.mark.slow)]
)
def test_direct_and_adjoint_compliances_are_the_implicit_derivative(mesh):
    model = body(ClassicalCorotational, mesh=mesh)
    poses = TWO_LANES if mesh == "linear" else LANES
    z = SPACE.start()

    def effectors(z):
        changed = SPACE.model_at(model, z)

        def one(c):
            u = solve_equilibrium(changed, c, settings=TIGHT).displacement
            return effector_values(model, c, u).ravel(), u

        return jax.vmap(one)(poses)

    @jax.jit
    def derivatives(z):
        _, along, u = jax.linearize(effectors, z, has_aux=True)
        return u, jax.vmap(along, out_axes=-1)(jnp.eye(2))

    @jax.jit
    def compliances(z, u):
        changed = SPACE.model_at(model, z)

        def one(c, u):
            both = ("direct", "adjoint")
            return [
                parameter_compliance(changed, c, u, SPACE, z, method=method).W_ep
                for method in both
            ]

        return jax.vmap(one)(poses, u)

    u, slopes = derivatives(z)
    direct, adjoint = compliances(z, u)
    scale = float(jnp.max(jnp.abs(direct)))
    np.testing.assert_allclose(direct, adjoint, rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(direct, slopes, rtol=0, atol=1e-9 * scale)
