"""What a program does with a tet is traced once, and keeps nothing of the program."""

import jax
import jax.numpy as jnp
import pytest
from bodies import small_model
from mechanisms import arrays

from softcal_jax.actuators import Cable, Guide
from softcal_jax.configurations import Configuration, ImposedDisplacement
from softcal_jax.equilibrium import NewtonSettings, _assembly as assembly, build_model
from softcal_jax.equilibrium._solve import begin_newton, continue_newton
from softcal_jax.fields import find_field
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam


def forces(model, u):
    return assembly.field_forces(model, u, {"E": find_field(model, "E")})


def plain_model():
    """Linear tets: whoever looks for leaks traces every function anew."""
    return build_model(
        beam(1.0, 1.0, 1.0, (1, 1, 1)), NeoHookean(1.0, 0.3), density=1.0
    )


KERNELS = pytest.mark.parametrize(
    ("name", "assembled"),
    [
        ("newton_system", assembly.tangent_values),
        ("element_energy_and_force", assembly.energy_and_force),
        ("element_energy_and_force", forces),
    ],
)


@KERNELS
def test_of_all_calls(name, assembled, monkeypatch):
    count, kernel = [0], getattr(assembly, name)

    def counting(*arguments):
        count[0] += 1
        return kernel(*arguments)

    monkeypatch.setattr(assembly, name, counting)
    model = small_model()
    u = jnp.zeros((model.n_points, 3))
    assembly._mapped.clear_cache()
    several = lambda model, u: [assembled(model, u + step) for step in range(3)]
    jax.eval_shape(several, model, u)
    jax.eval_shape(several, model, 2.0 * u)
    assert count == [1]


@pytest.mark.slow
@KERNELS
def test_nothing_of_a_program_is_kept(name, assembled):
    model = plain_model()
    u = jnp.zeros((model.n_points, 3))
    assembly._mapped.clear_cache()
    with jax.checking_leaks():
        jax.jit(lambda model, u: assembled(model, u)).trace(model, u)


def test_a_state_of_newton_keeps_its_types():
    """Or each call of the loop would be compiled once more."""
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1))
    cable = Cable("cable", [Guide((0.0, 0.5, 2.0), "ground"), (1.0, 0.5, 1.0)])
    # Where lengths are imposed there is no potential, and the loop keeps more.
    model = build_model(mesh, NeoHookean(1.0, 0.3), density=1.0, actuators=[cable])
    pull = {"cable": ImposedDisplacement(0.1)}
    lane = arrays(model, Configuration("pulled", "x_min", actuation=pull))
    settings = NewtonSettings()
    before = jax.eval_shape(
        lambda u: begin_newton(model, settings, lane, u), jnp.zeros((model.n_points, 3))
    )
    more = lambda state, n: continue_newton(model, settings, n, lane, state)[0]
    after = jax.eval_shape(more, before, jnp.asarray(2))
    types = lambda state: [
        (leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(state)
    ]
    assert before.iterate.merit_before is not None
    assert types(after) == types(before)
