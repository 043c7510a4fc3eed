"""A space without its names computes the same, and equals any other that is alike."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    motor_zero,
)
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam


def space(a, b, c, zero, density, *, ordered=False):
    """Fixed, tied, ordered and joined to an axis, by the names that are given."""
    points = ControlPoints({a: (0, 0, 0), b: (0.1, 0, 0), c: (0, 0.02, 0)})
    other = ControlPoints({b: (0.1, 0, 0), "extra " + a: (0.05, 0, 0)}, power=3.0)
    modulus = {"lower": 1e4, "upper": 1e6, "unit": "Pa"}
    entries = [
        ControlPointParameters(
            "E_t", points, start=[5e5, 6e5, 7e5], fixed={c: 4e5}, **modulus
        ),
        ControlPointParameters(
            "E_l", points, start=2e5, tied={c: f"E_l of {a}"}, prior_std=0.3, **modulus
        ),
        ControlPointParameters(
            "theta",
            points,
            start=0.1,
            lower=-np.pi / 2,
            upper=np.pi / 2,
            scale="linear",
            interpolation="director",
        ),
        Parameter(density, "density", 900.0, 500.0, 2e3, max_step=0.1),
        motor_zero(zero, limit=0.1, prior_std=0.01),
        ControlPointParameters("nu", other, start=0.2, lower=0.1, upper=0.4),
    ]
    if ordered:
        return ParameterSpace(entries, order=[("E_l", "E_t"), (f"nu of {b}", density)])
    return ParameterSpace(entries, axes=[("E_l", "E_t", "theta")])


@pytest.mark.parametrize("ordered", [False, True])
def test_it_is_the_same_space(ordered):
    named = space("left", "2", "1", "motor", "density of all", ordered=ordered)
    plain = named.numbered
    assert len(plain.names) == len(named.names) == len(set(plain.names))
    z = named.start() + 0.01
    for method in ("start", "lower", "upper", "max_step", "prior_weights"):
        np.testing.assert_array_equal(
            getattr(plain, method)(), getattr(named, method)()
        )
    for method in ("from_scaled", "room", "wrap", "admissible", "from_prior"):
        np.testing.assert_array_equal(
            getattr(plain, method)(z), getattr(named, method)(z)
        )
    for ours, theirs in zip(plain.order_rows(), named.order_rows(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert (plain.chart is None) == ordered
    if not ordered:
        np.testing.assert_array_equal(
            plain.chart.to_tensor(z), named.chart.to_tensor(z)
        )


def test_fields_on_the_mesh_are_the_same():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1))
    n = np.ones(mesh.n_tets)
    law = ReducedTransverseIsotropic(5e5 * n, 2e5 * n, 0.3, Fibre(0.0 * n, plane="xy"))
    model = build_model(mesh, Corotational(law), density=1000.0)
    points = ControlPoints({"b": (0, 0, 0), "a": (0.1, 0, 0), "c": (0, 0.02, 0)})
    named = ParameterSpace(
        [
            ControlPointParameters(
                "E_t", points, start=[3e5, 4e5, 5e5], lower=1e5, upper=1e6,
                fixed={"a": 9e5}, tied={"c": "rho"},
            ),
            Parameter("rho", "density", 900.0, 500.0, 2e6),
        ]
    )  # fmt: skip
    z = named.start()
    ours, theirs = (s.model_at(model, z) for s in (named.numbered, named))
    for leaf, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_array_equal(leaf, other)


@pytest.mark.parametrize("ordered", [False, True])
def test_alike_spaces_are_one(ordered):
    """What tells compiled programs apart: the structure, not the arrays."""
    one = space("left", "2", "1", "motor", "rho", ordered=ordered)
    two = space("1", "2", "right", "motor", "E", ordered=ordered)
    structure = lambda s: jax.tree.structure(s.numbered)
    assert jax.tree.structure(one) != jax.tree.structure(two)
    assert structure(one) == structure(two)


def test_another_motor_is_another_program():
    one, two = (space("a", "b", "c", motor, "rho") for motor in ("left", "right"))
    assert jax.tree.structure(one.numbered) != jax.tree.structure(two.numbered)


def test_values_are_not_touched():
    q = Parameter("E", "E", 2e5, 1e5, 1e6, S=3.0, scale="linear", periodic=True)
    (plain,) = ParameterSpace([q]).numbered.entries
    assert plain.name == "parameter 1"
    for name in ("field", "start", "lower", "upper", "S", "scale", "periodic"):
        assert (
            jnp.all(getattr(plain, name) == getattr(q, name))
            if name
            not in (
                "field",
                "scale",
            )
            else getattr(plain, name) == getattr(q, name)
        )
