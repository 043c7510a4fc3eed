"""Errors of the constants of a law of one's own, by the kind that it declares."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import two_elasticities

from softcal_jax.calibration import CalibrationWarning, build_problem
from softcal_jax.configurations import Configuration, Markers, configuration_lanes
from softcal_jax.designs import Printing
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    FieldError,
    Parameter,
    ParameterSpace,
    Uncertain,
    asked_errors,
    find_field,
    set_field,
)
from softcal_jax.materials import (
    POISSON,
    AbstractLaw,
    NeoHookean,
    constant,
    youngs_moduli,
)
from softcal_jax.mesh import beam
from softcal_jax.results._vtu import field_units
from softcal_jax.unknowns import Problem, unknowns


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


def considered(gravity=(0.0, 0.0, -9.81), ratio=0.3, field="mu", model=None):
    """Standard deviations of the errors of constants that happen, by name."""
    errors = errors_of(model or own_model(ratio), field, gravity)
    return {u.cause: u.prior for u in errors}


def errors_of(model, field, gravity=(0.0, 0.0, -9.81)):
    """Errors of constants that happen, if one is fitted."""
    pose = Configuration("hang", "x_min", gravity=gravity)
    lanes = configuration_lanes(model.mesh, [pose], model.mechanism)
    space = ParameterSpace((Parameter(field, field, 0.4, 0.1, 0.45, scale="linear"),))
    every = unknowns(Problem(model, space, lanes, [pose], uncertain=Uncertain()))
    errors = [u for u in every if u.role == "considered" and u.happens]
    return [u for u in errors if isinstance(u.entry, FieldError)]


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


class Misnamed(AbstractLaw):
    """A law whose constants have the names of others."""

    nu: jax.Array = eqx.field(metadata=constant("Pa", "a modulus"))
    E: jax.Array = eqx.field(metadata=constant("", "Poisson's ratio", kind=POISSON))
    density: jax.Array = eqx.field(metadata=constant("Pa", "another modulus"))

    def energy_density(self, F):
        return NeoHookean(self.nu + self.density, self.E).energy_density(F)


def misnamed(E=0.3, order=1):
    law = Misnamed(*map(jnp.asarray, (1e5, E, 2e5)))
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1), order=order)
    return build_model(mesh, law, density=1000.0, solver="none")


NU = Parameter("stiffness", "nu", 1e5, 1e4, 1e6, unit="Pa")
RATIO = Parameter("ratio", "E", 0.4, 0.1, 0.499, scale="linear")
OTHER = Parameter("other", "law.density", 2e5, 1e5, 3e5, unit="Pa")
MASS = Parameter("mass", "density", 1e3, 5e2, 2e3, unit="kg/m3")
SPACE = ParameterSpace((NU, RATIO, OTHER, MASS))


def test_what_a_constant_is_does_not_follow_from_its_name():
    model = misnamed()
    assert considered(model=model, field="nu") == {"E": 0.05, "density": 0.03}
    asked = asked_errors(SPACE, SPACE.start(), model=model) * SPACE.slopes(
        SPACE.start()
    )
    np.testing.assert_allclose(asked, [1e4, 0.05, 2e4, 100.0])
    std = Printing(moduli=0.2).scaled(model, SPACE, [1e5, 0.4, 2e5, 1e3])
    np.testing.assert_allclose(std, [0.2, 0.0, 0.2, 0.0])
    units = {"nu": "Pa", "E": "", "density": "kg/m3", "law.density": "Pa"}
    assert field_units(model) == units
    assert youngs_moduli(model.law) == []


@pytest.mark.parametrize(
    ("ratio", "formulation"), [(0.3, "displacement"), (0.495, "mean-dilatation")]
)
def test_the_formulation_follows_from_the_declared_ratio(ratio, formulation):
    """And not from a modulus of 1e5 that is called nu."""
    assert misnamed(ratio, order=2).formulation == formulation


def test_locking_is_said_of_the_declared_ratio():
    model, end = misnamed(order=2), [[0.1, 0.0, 0.0]]
    markers = Markers(["end"], end)
    pose = Configuration("pose", "x_min", markers=markers, measured=end)
    build_problem(model, ParameterSpace((NU, OTHER, MASS)), pose)
    with pytest.warns(CalibrationWarning, match="'ratio' may reach E = 0.499"):
        build_problem(model, SPACE, pose)


def test_one_of_two_constants_of_a_name_is_fitted():
    errors = errors_of(two_elasticities(), "first.nu")
    fields = [entry.field for u in errors if isinstance(entry := u.entry, FieldError)]
    assert fields == ["law.second.nu", "density"]


def test_the_density_is_that_of_the_model():
    model = misnamed()
    changed = set_field(set_field(model, "density", 900.0), "law.density", 3e5)
    assert (float(changed.density), float(changed.law.density)) == (900.0, 3e5)
