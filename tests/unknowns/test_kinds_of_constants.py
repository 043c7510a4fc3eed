"""Errors of the constants of a law of one's own, by the kind that it declares."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace, Uncertain, find_field
from softcal_jax.materials import POISSON, AbstractLaw, constant
from softcal_jax.mesh import beam
from softcal_jax.unknowns import Setting, unknowns


class Pair(NamedTuple):
    """Two constants that a law holds together, which declare nothing."""

    first: jax.Array
    second: jax.Array


class OwnLaw(AbstractLaw):
    """A law with a ratio that says what it is, and one that does not."""

    mu: jax.Array = eqx.field(metadata=constant("Pa", "modulus"))
    ratio: jax.Array = eqx.field(metadata=constant("", "a ratio", kind=POISSON))
    nu: jax.Array
    pair: Pair

    def energy_density(self, F):
        return self.mu * jnp.sum((F - jnp.eye(3)) ** 2) * (1.0 + self.ratio)


def own_model(ratio):
    numbers = (jnp.asarray(value) for value in (1e5, ratio, 0.3, 1.0, 2.0))
    mu, declared, nu, *pair = numbers
    law = OwnLaw(mu, declared, nu, Pair(*pair))
    return build_model(beam(0.1, 0.02, 0.02, (2, 1, 1)), law, density=1000.0)


def considered(gravity=(0.0, 0.0, -9.81), ratio=0.3, field="mu"):
    """Standard deviations of the errors of constants that happen, by name."""
    model = own_model(ratio)
    pose = Configuration("hang", "x_min", gravity=gravity)
    lanes = configuration_lanes(model.mesh, [pose], model.mechanism)
    space = ParameterSpace((Parameter(field, field, 0.4, 0.1, 0.45, scale="linear"),))
    every = unknowns(Setting(model, space, [pose], lanes, Uncertain()))
    errors = [u for u in every if u.role == "considered" and u.happens]
    return {u.cause: u.prior for u in errors if hasattr(u.entry, "field")}


def test_only_a_constant_that_says_its_kind_is_considered():
    assert considered() == {"ratio": 0.05, "density": 0.03}


def test_an_error_is_at_most_half_of_what_is_left():
    assert considered(ratio=0.48)["ratio"] == pytest.approx(0.01)


def test_a_constant_that_is_fitted_is_not_considered():
    assert set(considered(field="ratio")) == {"density"}


def test_a_density_acts_by_gravity_alone():
    assert set(considered(gravity=(0.0, 0.0, 0.0))) == {"ratio"}


def test_constants_that_a_law_holds_together_are_found():
    model = own_model(0.3)
    np.testing.assert_array_equal(find_field(model, "second")(model), 2.0)
