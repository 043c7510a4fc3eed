"""Masses of rigid bodies count in the budget as other weights do."""

import pytest

from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import Configuration, configuration_lanes
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter, ParameterSpace, Uncertain
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.unknowns import Problem, unknowns


@pytest.mark.parametrize(
    ("mass", "gravity", "named"),
    [(0.01, -9.81, ["body_mass plate"]), (0.01, 0.0, []), (None, -9.81, [])],
)
def test_a_mass_that_gravity_acts_on_is_considered(mass, gravity, named):
    plate = RigidBody("plate", "x_max", mass=mass)
    mesh, law = beam(0.1, 0.02, 0.02, (2, 1, 1)), NeoHookean(1e5, 0.3)
    model = build_model(mesh, law, density=1000.0, bodies=[plate])
    poses = [Configuration(name, "x_min", (0.0, 0.0, gravity)) for name in "ab"]
    lanes = configuration_lanes(mesh, poses, model.mechanism)
    space = ParameterSpace((Parameter("E", "E", 1e5, 1e4, 1e6),))
    loads = Uncertain(loads=0.01)
    every = unknowns(Problem(model, space, lanes, poses, uncertain=loads))
    errors = [u for u in every if u.cause == "loads" and u.happens]
    assert [u.name for u in errors] == named
    assert all((u.role, u.prior) == ("considered", 0.01) for u in errors)
    # One error for both poses: the same body was weighed once.
    assert all(len(set(u.scope)) == 1 for u in errors)
