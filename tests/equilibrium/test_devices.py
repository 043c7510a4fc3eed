"""Lanes on several devices of JAX, against `vmap` on one."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softcal_jax as sc

LANES = (1, 2, 3, 5)

ON_TWO = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import SingleDeviceSharding
import softcal_jax as sc

jax.config.update("jax_enable_x64", True)
result = {"cores": [sc.use_cores(2), len(jax.devices()), sc.use_cores(2)]}
try:
    sc.use_cores(3)
except RuntimeError as error:
    result["late"] = str(error)

mesh = sc.beam(0.1, 0.02, 0.02, cells=(2, 1, 1))
model = sc.build_model(mesh, sc.NeoHookean(E=250e3, nu=0.3), density=1070)
tip = sc.Markers(["tip"], [(0.1, 0.01, 0.01)])
pulls = [(0, 0, -9.81), (0, 5.0, 0), (0, 4.0, 4.0)]
poses = [sc.Configuration(f"{g}", "x_min", g, markers=tip) for g in pulls]
batch = sc.lanes(model, poses)


@jax.custom_batching.sequential_vmap
def solution(solver, values, rhs):
    return solver.factor_solve(values, rhs).x


def solved(model, lane, diagonal):
    scale, rhs = lane
    return scale, solution(model.solver, scale * diagonal, rhs)


def handle(model, lane):
    return model.solver.token.id


def tips(model, lane, E):
    body = sc.set_field(model, "E", E)
    return sc.marker_positions(body, lane, sc.solve_equilibrium(body, lane))[0]


random = np.random.default_rng(0)
rhs = random.normal(size=(5, 1, model.n_dof))
diagonal = (1.0 + random.uniform(size=model.solver.sparsity.nnz)) * np.asarray(
    model.solver.sparsity.identity()
)
result["linear"] = {}
for n in json.loads(sys.argv[1]):
    lanes = (1.0 + jnp.arange(5.0)[:n], rhs[:n])
    on_two = sc.map_lanes(solved, model, lanes, diagonal)
    on_one = jax.vmap(lambda lane: solved(model, lane, diagonal))(lanes)
    result["linear"][n] = [
        all(map(np.array_equal, on_one, on_two)),
        isinstance(on_two[1].sharding, SingleDeviceSharding),
    ]
if hasattr(model.solver, "token"):
    ids = sc.map_lanes(handle, model, jnp.arange(4))
    result["handles"] = [int(i) for i in (model.solver.token.id, *ids)]

traces = []


def power(model, lane, factor, exponent):
    traces.append(exponent)
    return factor * (lane**2 if exponent == 2 else lane)


result["squares"] = sc.map_lanes(power, model, jnp.arange(3.0), 2.0, 2).tolist()
n_traces = len(traces)
sc.map_lanes(power, model, jnp.arange(3.0), 4.0, 2)
result["traced_again"] = len(traces) - n_traces

mapped = lambda E: sc.map_lanes(tips, model, batch, E)
alone = lambda E: jax.vmap(lambda lane: tips(model, lane, E))(batch)
E, weights = jnp.asarray(250e3), random.normal(size=(3, 3))
for name, of in (("mapped", mapped), ("alone", alone)):
    value, pull_back = jax.vjp(of, E)
    result[name] = [np.asarray(value).tolist(), float(pull_back(weights)[0])]
tangent = jax.jit(lambda E: jax.jvp(mapped, (E,), (jnp.ones(()),))[1])(E)
result["forward"] = float(jnp.sum(weights * tangent))
json.dump(result, sys.stdout)
"""


@pytest.fixture(scope="module")
def on_two():
    """Of a process with two devices, whose number is fixed once JAX computes."""
    done = subprocess.run(
        [sys.executable, "-c", ON_TWO, json.dumps(LANES)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_cores_are_chosen_at_the_start(on_two):
    """Again, too, as where a cell of a notebook runs twice; but no other number."""
    assert on_two["cores"] == [2, 2, 2]
    assert "use_cores(3) came too late" in on_two["late"]
    assert "CPU devices: 2" in on_two["late"]


def test_any_number_of_lanes_gives_what_vmap_gives(on_two):
    """To the last bit and in order; what follows runs on one device."""
    assert on_two["linear"] == {str(n): [True, True] for n in LANES}


def test_each_device_has_factors_of_its_own(on_two, model):
    """Lanes take turns on the devices; what runs beside them has the model's own."""
    if "mkl" not in model.solver.name:
        pytest.skip("another solver on this platform, which keeps no factors")
    own, first, second, *others = on_two["handles"]
    assert len({own, first, second}) == 3
    assert others == [first, second]


def test_numbers_are_arguments_of_one_program(on_two):
    """All but integers, which the function may decide by."""
    assert on_two["squares"] == [0.0, 2.0, 8.0]
    assert on_two["traced_again"] == 0


def test_equilibria_and_derivatives_are_those_of_vmap(on_two):
    value, gradient = on_two["mapped"]
    # XLA compiles for several devices by other passes: rounding of the solve differs.
    np.testing.assert_allclose(value, on_two["alone"][0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(gradient, on_two["alone"][1], rtol=1e-10)
    np.testing.assert_allclose(on_two["forward"], gradient, rtol=1e-10)


def test_the_number_of_this_process_is_fixed():
    assert sc.use_cores(1) == len(jax.devices()) == 1
    with pytest.raises(RuntimeError, match=r"use_cores\(2\) .*too late.*restart"):
        sc.use_cores(2)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        sc.use_cores(0)


@pytest.fixture(scope="module")
def model():
    mesh = sc.beam(0.1, 0.02, 0.02, cells=(2, 1, 1))
    return sc.build_model(mesh, sc.NeoHookean(E=250e3, nu=0.3), density=0.0)


def test_one_device_is_vmap(model):
    scaled = lambda model, lane, by: {"twice": 2.0 * lane[0], "all": by * lane[1]}
    lanes = jnp.arange(3.0), jnp.ones((3, 2))
    found = sc.map_lanes(scaled, model, lanes, 4.0)
    np.testing.assert_array_equal(found["twice"], [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(found["all"], np.full((3, 2), 4.0))
    if "mkl" in model.solver.name:
        assert model.solver.devices is None


@pytest.mark.parametrize(
    "lanes", [(), jnp.ones(()), jnp.ones((0, 3)), (jnp.ones(2), jnp.ones((3, 1)))]
)
def test_what_has_no_lanes_is_refused(model, lanes):
    with pytest.raises(ValueError, match="as many lanes in all arrays, 1 or more, got"):
        sc.map_lanes(lambda model, lane: lane, model, lanes)
