"""A law without a potential: implicit derivatives and both sides of compliances."""

from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import TIGHT
from classical_beam import (
    E_T,
    LANES,
    LIFTED,
    LINEAR,
    THETA,
    body,
    hanging,
)
from mechanisms import both_ways_at, solve
from problems import assert_second_order, lane_of

from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import EquilibriumSolution
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import ClassicalCorotational
from softcal_jax.sensitivity import parameter_compliance


class Inputs(NamedTuple):
    """What is varied: parameters, and loads of one lane."""

    E_t: jax.Array
    theta: jax.Array
    gravity: jax.Array
    imposed: jax.Array


TWO_LANES = configuration_arrays(LINEAR, [hanging(20.0), hanging(10.0, LIFTED)])


def markers(inputs, model, c):
    """Where the markers are, and the equilibrium."""
    elasticity = lambda m: (m.law.elasticity.E_t, m.law.elasticity.fibre.theta)
    inputs = jax.tree.map(jnp.asarray, inputs)
    model = eqx.tree_at(elasticity, model, inputs[:2])
    c = eqx.tree_at(lambda c: (c.gravity, c.imposed), c, inputs[2:])
    return solve(model, c, None, TIGHT)[1]


along = both_ways_at(markers)


class Lane(NamedTuple):
    """One configuration and its equilibrium."""

    inputs: Inputs
    held: tuple
    solution: EquilibriumSolution

    def derivatives(self, tangent, cotangent=np.zeros((2, 3))):  # noqa: B008
        both = along(self.solution, self.inputs, tangent, cotangent, *self.held)
        return jax.tree.map(np.asarray, both)


@cache
def lanes(mesh="linear"):
    model, several = body(ClassicalCorotational, mesh=mesh), []
    for index in range(2):
        c = lane_of(TWO_LANES if mesh == "linear" else LANES, index)
        inputs = Inputs(np.asarray(E_T), np.asarray(THETA), c.gravity, c.imposed)
        solution = solve(model, c, None, TIGHT)[0]
        several.append(Lane(inputs, (model, c), solution))
    return several


def direction(lane, name: str) -> Inputs:
    """A direction in one input, of the size of the input; none in the others."""
    noise = np.random.default_rng(3).normal(size=np.shape(getattr(lane.inputs, name)))
    part = {
        "E_t": np.asarray(0.3 * E_T),
        "theta": np.asarray(0.3),
        "gravity": 20.0 * noise,
        "imposed": 1e-3 * noise,
    }[name]
    if name == "imposed":
        part = np.where(lane.held[1].fixed, part, 0.0)
    return jax.tree.map(np.zeros_like, lane.inputs)._replace(**{name: part})


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("name", Inputs._fields)
def test_implicit_derivative_is_second_order_against_differences(name, index):
    lane = lanes()[index]
    tangent = direction(lane, name)
    jvp, _ = lane.derivatives(tangent)
    assert np.max(np.abs(jvp)) > 1e-4
    values = lambda inputs: np.asarray(markers(inputs, *lane.held))
    assert_second_order(values, lane.inputs, tangent, jvp, (3e-2, 1e-2))


@pytest.mark.parametrize("name", Inputs._fields)
@pytest.mark.parametrize("index", [0, 1])
def test_forward_equals_reverse(name, index):
    lane = lanes()[index]
    tangent = direction(lane, name)
    cotangent = np.random.default_rng(5).normal(size=(2, 3))
    forward, reverse = lane.derivatives(tangent, cotangent)
    product = sum(jax.tree.leaves(jax.tree.map(np.vdot, reverse, tangent)))
    assert abs(product) > 1e-4
    # Transposed solves by factors of their own: rounding times the condition.
    np.testing.assert_allclose(product, np.vdot(cotangent, forward), rtol=1e-9)


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
    for lane in lanes(mesh):
        direct, adjoint = compliances(*lane.held, lane.solution.displacement)
        still = jax.tree.map(np.zeros_like, lane.inputs)
        # Of unit steps: of the logarithm of the modulus, and of 1 rad.
        steps = still._replace(E_t=np.asarray(E_T)), still._replace(theta=np.ones(()))
        slopes = np.stack(
            [lane.derivatives(step)[0].ravel() for step in steps], axis=-1
        )
        scale = np.max(np.abs(direct))
        np.testing.assert_allclose(direct, adjoint, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(direct, slopes, rtol=0, atol=1e-9 * scale)


@jax.jit
def compliances(model, c, u):
    z = SPACE.start()
    of = lambda method: parameter_compliance(model, c, u, SPACE, z, method=method).W_ep
    return of("direct"), of("adjoint")
