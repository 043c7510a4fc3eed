"""What a program does with a tet is traced once, and keeps nothing of the program."""

import jax
import jax.numpy as jnp
import pytest
from jax import Array

from softcal_jax.equilibrium import (
    build_model,
    energy_and_force,
    field_forces,
    tangent_values,
)
from softcal_jax.fields import find_field
from softcal_jax.materials import AbstractLaw
from softcal_jax.mesh import beam

TRACES = []


def counted():
    """A model of a law of its own, of which nothing has been traced yet."""

    class Counted(AbstractLaw):
        E: Array

        def energy_density(self, F):
            TRACES.append("energy_density")
            return 0.5 * self.E * jnp.sum((F - jnp.eye(3)) ** 2)

    TRACES.clear()
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1))
    return build_model(mesh, Counted(jnp.asarray(1.0, float)), density=1.0)


def forces(model, u):
    return field_forces(model, u, {"E": find_field(model, "E")})


KERNELS = pytest.mark.parametrize(
    "assembled", [tangent_values, energy_and_force, forces]
)


@KERNELS
def test_of_all_calls(assembled):
    model = counted()
    u = jnp.zeros((model.n_points, 3))
    jax.eval_shape(lambda model, u: assembled(model, u), model, u)
    once = len(TRACES)
    assert once > 0
    several = lambda model, u: [assembled(model, u + step) for step in range(3)]
    jax.eval_shape(several, model, u)
    jax.eval_shape(several, model, 2.0 * u)
    assert len(TRACES) == once


@pytest.mark.slow
@KERNELS
def test_nothing_of_a_program_is_kept(assembled):
    model = counted()
    u = jnp.zeros((model.n_points, 3))
    with jax.checking_leaks():
        jax.jit(lambda model, u: assembled(model, u)).trace(model, u)
