"""Fields of a law that all tets share, like the weights of a network."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import force
from jax import Array
from mechanisms import TIGHT, both_ways_at
from problems import central_difference

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
from softcal_jax.elements import determinant
from softcal_jax.equilibrium import tet_stresses
from softcal_jax.fields import constants_of
from softcal_jax.materials import SHARED, AbstractLaw

MESH = beam(0.1, 0.02, 0.02, (2, 1, 1), order=1)
HANG = Configuration("hang", [Support("x_min")], (0.0, 0.0, -9.81))


def invariant(F):
    return jnp.sum(F * F) - 3.0 - 2.0 * jnp.log(determinant(F))


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


@cache
def tip_by(law_of):
    """Where the tip goes, a function of the coefficients of a law."""
    model = model_of(law_of(C))

    def tip(c):
        body = eqx.tree_at(lambda m: m.law, model, law_of(c))
        return solve_equilibrium(body, HANG, settings=TIGHT).displacement[-1]

    return tip


def test_a_vector_that_is_shared_is_what_its_entries_are():
    expected = tip_by(separate)(C)
    np.testing.assert_allclose(tip_by(series)(C), expected, rtol=1e-9)


def test_its_derivative_is_that_of_its_entries():
    """By differences of the law that has them apart, of second order."""
    solution = solve_equilibrium(model_of(series(C)), HANG, settings=TIGHT)
    along = both_ways_at(tip_by(series))
    apart, error = lambda c: np.asarray(tip_by(separate)(jnp.asarray(c))), []
    for k in range(2):
        step, back = 0.1 * np.asarray(C) * np.eye(2)[k], np.eye(3)[2]
        slope, reverse = map(np.asarray, along(solution, C, step, back))
        np.testing.assert_allclose(reverse @ step, slope[2], rtol=1e-9)
        error.append(
            [
                np.abs(central_difference(apart, np.asarray(C), step, h) - slope).max()
                / np.abs(slope).max()
                for h in (1.0, 0.5)
            ]
        )
    coarse, fine = np.array(error).T
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.1)
    assert fine.max() < 1e-2


def test_a_shape_that_happens_to_fit_is_not_guessed():
    """As many coefficients as tets are still coefficients."""
    many = jnp.full(MESH.n_tets, 1e3)

    class Sum(Series):
        def energy_density(self, F):
            return (
                jnp.sum(self.c) * invariant(F)
                + 0.5 * self.bulk * (determinant(F) - 1.0) ** 2
            )

    u = jnp.asarray(0.1 * MESH.points[:, ::-1] ** 2 / 0.1)
    bulk = jnp.linspace(8e4, 1e5, MESH.n_tets)
    expected = force(model_of(Separate(1e3 * MESH.n_tets, 0.0, bulk)), u)
    computed = force(model_of(Sum(many, bulk)), u)
    size = np.max(np.abs(expected))
    np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-13 * size)


def test_a_vector_that_says_nothing_is_named():
    with pytest.raises(ValueError, match=r"law\.c .*\(2,\).*SHARED"):
        model_of(Guessed(C, BULK))


def test_numbers_of_python_are_values():
    """And one program serves all of them."""
    model = model_of(Separate(1.7e4, 2e3, 1e5))
    expected = tip_by(separate)(C)
    tip = solve_equilibrium(model, HANG, settings=TIGHT).displacement[-1]
    np.testing.assert_allclose(tip, expected, rtol=1e-9)
    other = set_field(model, "c1", 2e4)
    with Compilations() as seen:
        solve_equilibrium(other, HANG)
        solve_equilibrium(model.with_law(Separate(1.8e4, 2e3, 1e5)), HANG)
    assert "jit(_mapped)" not in seen.programs


def test_beside_what_is_shared_a_field_is_calibrated():
    """With the error of the mesh, and the fields of a file."""
    bulk = Parameter("bulk", "bulk", 8e4, 1e4, 1e6)
    markers = Markers(("tip",), MESH.points[-1:], std=1e-4)
    pose = replace(HANG, markers=markers)
    (seen,) = simulated_measurements(model_of(Series(C, BULK)), [pose], seed=0)
    result = calibrate(model_of(Series(C, BULK)), bulk, seen, intervals=None)
    assert result.converged
    assert "mesh" in [cause.name for cause in result.budget.causes]
    assert [path for path, *_ in constants_of(result.model)] == ["law.bulk", "density"]


class Layers(eqx.Module):
    layers: list

    def __call__(self, x):
        for layer in self.layers:
            x = layer(x)
        return x


def test_a_network_is_a_law():
    """Also one that holds a list."""
    key = jax.random.key(0)
    net = eqx.nn.MLP(1, 1, 4, 1, final_activation=jax.nn.softplus, key=key)
    model = model_of(Network(Layers([net]), BULK))
    weight = lambda m: m.law.net.layers[0].layers[0].weight

    def height(w):
        body = eqx.tree_at(weight, model, w)
        return solve_equilibrium(body, HANG, settings=TIGHT).displacement[-1, 2]

    solution = solve_equilibrium(model, HANG, settings=TIGHT)
    assert solution.converged
    assert np.isfinite(tet_stresses(model, solution.displacement).stress).all()
    step = jnp.zeros((4, 1)).at[3, 0].set(1.0)
    slope, reverse = both_ways_at(height)(solution, weight(model), step, jnp.ones(()))
    difference = central_difference(height, weight(model), step, 1e-4)
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)
    assert float(reverse[3, 0]) == pytest.approx(float(slope), rel=1e-9)
