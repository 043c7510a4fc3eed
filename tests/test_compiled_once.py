"""What computes is compiled once for each set of shapes, also where called eagerly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from benchmarks._compilations import Compilations
from softcal_jax import (
    Configuration,
    Markers,
    NeoHookean,
    Parameter,
    ParameterSpace,
    Support,
    beam,
    build_model,
    identify,
    solve_equilibrium,
)
from softcal_jax.calibration import bounded_step, build_problem, evaluate
from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import (
    NewtonSettings,
    adjoint_rows,
    continue_equilibrium,
    effector_values,
    energy_and_force,
    linearise,
    marker_positions,
    sensitivity,
)
from softcal_jax.fields import set_field
from softcal_jax.sensitivity import (
    adjoint_of_tets,
    energy_compliance,
    equilibrium_response,
    mesh_row,
    parameter_compliance,
    parameter_forces,
    parameter_rows,
    stress_patches,
)

# The shapes of calibration/light_beam.py, for its programs.
MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, NeoHookean(1e5, 0.3), density=1000.0)
TIP = np.array([[0.1, 0.01, 0.01]])
HANG = Configuration(
    "hang",
    [Support("x_min")],
    (0.0, 0.0, -9.81),
    markers=Markers(("tip",), TIP),
    measured=TIP - [0.0, 0.0, 0.01],
)
LANES = configuration_arrays(MESH, [HANG])
LANE = lane_of(LANES)
SPACE = ParameterSpace(
    [
        Parameter("E", "E", 1e5, 1e4, 1e6),
        Parameter("density", "density", 1e3, 1e2, 1e4),
    ]
).numbered
Z = SPACE.start()


def tip_height(E):
    model = set_field(MODEL, "E", E)
    return marker_positions(model, LANE, solve_equilibrium(model, LANE))[0, 2]


@pytest.fixture(scope="module")
def state():
    u = solve_equilibrium(MODEL, LANE).displacement
    return u, linearise(MODEL, LANE, u)


def step():
    one = jnp.asarray(np.ones(6))
    errors = jnp.asarray(np.ones((22, 6))), jnp.asarray(np.ones(22))
    return bounded_step(*errors, -one, one)


def batch(u, lin):
    return jax.vmap(lambda lane: solve_equilibrium(MODEL, lane))(LANES)


def response(u, lin):
    """As `evaluate` calls it."""
    newton, precise = NewtonSettings().as_arrays(), jnp.asarray(False)
    return equilibrium_response(MODEL, SPACE, newton, Z, LANE, u, u, precise)


def adjoint(u, lin):
    rows = parameter_rows(lin, SPACE, Z)
    return sensitivity(lin, rows, effector_values, adjoint=True)


CALLS = {
    "solve_equilibrium": lambda u, lin: solve_equilibrium(MODEL, LANE),
    "solve_equilibrium, guess": lambda u, lin: solve_equilibrium(MODEL, LANE, guess=u),
    "solve_equilibrium, vmap": batch,
    "continue_equilibrium": lambda u, lin: continue_equilibrium(
        MODEL, LANE, u, settings=NewtonSettings()
    ),
    "energy_and_force": lambda u, lin: energy_and_force(MODEL, u),
    "linearise": lambda u, lin: linearise(MODEL, LANE, u),
    "effector_values": lambda u, lin: effector_values(MODEL, LANE, u),
    "parameter_forces": lambda u, lin: parameter_forces(MODEL, LANE, u, SPACE, Z),
    "parameter_rows": lambda u, lin: parameter_rows(lin, SPACE, Z),
    "sensitivity": lambda u, lin: sensitivity(
        lin, parameter_rows(lin, SPACE, Z), effector_values
    ),
    "sensitivity, adjoint": adjoint,
    "adjoint_rows": lambda u, lin: adjoint_rows(lin, effector_values),
    "adjoint_of_tets": lambda u, lin: adjoint_of_tets(
        lin, ("E",), jnp.ones((3, MODEL.n_dof))
    ),
    "parameter_compliance": lambda u, lin: parameter_compliance(
        MODEL, LANE, u, SPACE, Z
    ),
    "energy_compliance": lambda u, lin: energy_compliance(MODEL, LANE, u, SPACE, Z),
    "equilibrium_response": response,
    "mesh_row": lambda u, lin: mesh_row(lin, stress_patches(MODEL)),
    "bounded_step": lambda u, lin: step(),
    "evaluate": lambda u, lin: evaluate(
        build_problem(MODEL, SPACE, HANG), Z, guess=u[None]
    ),
    "identify": lambda u, lin: identify(MODEL, SPACE, HANG),
    "gradient": lambda u, lin: jax.grad(tip_height)(1e5),
    "forward": lambda u, lin: jax.jacfwd(tip_height)(1e5),
    "Hessian": lambda u, lin: jax.hessian(tip_height)(1e5),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_second_eager_call_compiles_nothing(name, state):
    call = CALLS[name]
    jax.block_until_ready(jax.tree.leaves(call(*state)))
    with Compilations() as seen:
        call(*state)
    assert seen.programs == []


def test_what_is_read_compiles_no_equilibrium():
    """Another marker or reading is no part of the program that solves."""
    bare = configuration_arrays(MESH, [Configuration("bare", [Support("x_min")])])
    lane = lane_of(bare)
    jax.block_until_ready(solve_equilibrium(MODEL, LANE))
    with Compilations() as seen:
        jax.block_until_ready(solve_equilibrium(MODEL, lane))
    assert seen.programs == []
