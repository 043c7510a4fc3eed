"""Fields of a law that all tets share, like the weights of a network."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks._compilations import Compilations
from softcal_jax import (
    Configuration,
    Markers,
    Parameter,
    Support,
    beam,
    build_model,
    calibrate,
    set_field,
    simulated_measurements,
    solve_equilibrium,
)
from softcal_jax._typing import Array
from softcal_jax.elements import determinant
from softcal_jax.equilibrium import tet_stresses
from softcal_jax.export import tet_fields
from softcal_jax.materials import SHARED, AbstractLaw

MESH = beam(0.1, 0.02, 0.02, (2, 1, 1), order=1)
HANG = Configuration("hang", [Support("x_min")], (0.0, 0.0, -9.81))


def invariant(F):
    return determinant(F) ** (-2.0 / 3.0) * jnp.sum(F * F) - 3.0


class Separate(AbstractLaw):
    c1: Array
    c2: Array
    bulk: Array

    def energy_density(self, F):
        I1 = invariant(F)
        volume = 0.5 * self.bulk * (determinant(F) - 1.0) ** 2
        return self.c1 * I1 + self.c2 * I1**2 + volume


class Series(AbstractLaw):
    """The same with its coefficients as one vector."""

    c: Array = eqx.field(metadata=SHARED)
    bulk: Array

    def energy_density(self, F):
        I1 = invariant(F)
        volume = 0.5 * self.bulk * (determinant(F) - 1.0) ** 2
        return jnp.sum(self.c * jnp.stack([I1, I1**2])) + volume


class Guessed(AbstractLaw):
    """A vector that does not say what it is."""

    c: Array
    bulk: Array

    def energy_density(self, F):
        return jnp.sum(self.c) * invariant(F)


class Network(AbstractLaw):
    net: eqx.nn.MLP = eqx.field(metadata=SHARED)
    bulk: Array

    def energy_density(self, F):
        I1 = invariant(F)
        stiff = self.net(I1[None])[0]
        return 1e4 * stiff * I1 + 0.5 * self.bulk * (determinant(F) - 1.0) ** 2


C, BULK = jnp.array([1.7e4, 2e3]), jnp.full(MESH.n_tets, 1e5)


def model_of(law):
    return build_model(MESH, law, density=1000.0)


def separate(c):
    return Separate(c[0], c[1], BULK)


def series(c):
    return Series(c, BULK)


class Tip(NamedTuple):
    """Where the tip goes, and its derivative by two coefficients, both ways."""

    at: Array
    forward: Array
    reverse: Array


@cache
def tip_by(law_of):
    """One program of each law for all tests, a function of its coefficients."""
    model = model_of(law_of(C))

    def tip(c):
        body = eqx.tree_at(lambda m: m.law, model, law_of(c))
        return solve_equilibrium(body, HANG).displacement[-1]

    @jax.jit
    def both_ways(c) -> Tip:
        at, along = jax.linearize(tip, c)
        (reverse,) = jax.vmap(jax.linear_transpose(along, c))(jnp.eye(3))
        return Tip(at, jax.vmap(along, out_axes=1)(jnp.eye(2)), reverse)

    return both_ways


def test_a_vector_that_is_shared_is_what_its_entries_are():
    expected = tip_by(separate)(C).at
    np.testing.assert_allclose(tip_by(series)(C).at, expected, rtol=1e-9)


def test_its_derivative_is_that_of_its_entries():
    apart, shared = tip_by(separate)(C).forward, tip_by(series)(C)
    np.testing.assert_allclose(shared.forward, apart, rtol=1e-7)
    np.testing.assert_allclose(shared.reverse, apart, rtol=1e-7)


def test_a_shape_that_happens_to_fit_is_not_guessed():
    """As many coefficients as tets are still coefficients."""
    many = jnp.full(MESH.n_tets, 1e3)

    class Sum(Series):
        def energy_density(self, F):
            return (
                jnp.sum(self.c) * invariant(F)
                + 0.5 * self.bulk * (determinant(F) - 1.0) ** 2
            )

    expected = tip_by(separate)(jnp.array([jnp.sum(many), 0.0])).at
    found = solve_equilibrium(model_of(Sum(many, BULK)), HANG).displacement[-1]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_vector_that_says_nothing_is_named():
    with pytest.raises(ValueError, match=r"law.c has shape \(2,\).*SHARED"):
        model_of(Guessed(C, BULK))


def test_numbers_of_python_are_values():
    """And one program serves all of them."""
    model = model_of(Separate(1.7e4, 2e3, 1e5))
    expected = tip_by(separate)(C).at
    found = solve_equilibrium(model, HANG).displacement[-1]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    other = set_field(model, "c1", 2e4)
    with Compilations() as seen:
        solve_equilibrium(other, HANG)
        solve_equilibrium(model.with_law(Separate(1.8e4, 2e3, 1e5)), HANG)
    assert "jit(_mapped)" not in seen.programs


class Layers(eqx.Module):
    layers: list

    def __call__(self, x):
        for layer in self.layers:
            x = jnp.tanh(layer(x))
        return 2.0 + x


def test_what_is_shared_may_hold_a_list():
    keys = jax.random.split(jax.random.key(1))
    net = Layers([eqx.nn.Linear(1, 1, key=key) for key in keys])
    assert solve_equilibrium(model_of(Network(net, BULK)), HANG).converged


def test_beside_what_is_shared_a_field_is_calibrated():
    """With the error of the mesh, and the fields of a file."""
    bulk = Parameter("bulk", "bulk", 8e4, 1e4, 1e6)
    markers = Markers(("tip",), MESH.points[-1:], std=1e-4)
    pose = replace(HANG, markers=markers)
    (seen,) = simulated_measurements(model_of(Series(C, BULK)), [pose], seed=0)
    result = calibrate(model_of(Series(C, BULK)), bulk, seen, intervals=None)
    assert result.converged
    assert "mesh" in [cause.name for cause in result.budget.causes]
    assert set(tet_fields(result.model, {})) == {"bulk", "density"}


def test_a_network_is_a_law():
    key = jax.random.key(0)
    net = eqx.nn.MLP(1, 1, 8, 2, final_activation=jax.nn.softplus, key=key)
    model = model_of(Network(net, BULK))

    @eqx.filter_jit
    @eqx.filter_value_and_grad(has_aux=True)
    def height(law):
        body = eqx.tree_at(lambda m: m.law, model, law)
        solution = solve_equilibrium(body, HANG)
        return solution.displacement[-1, 2], solution

    (_, u), slope = height(model.law)
    assert u.converged
    assert np.isfinite(tet_stresses(model, u.displacement).stress).all()
    weight = lambda law: law.net.layers[0].weight
    h = 1e-4
    bend = lambda h: eqx.tree_at(weight, model.law, weight(model.law).at[3, 0].add(h))
    (above, _), _ = height(bend(h))
    (below, _), _ = height(bend(-h))
    difference = float(above - below) / (2.0 * h)
    assert weight(slope)[3, 0] == pytest.approx(difference, rel=1e-4)
