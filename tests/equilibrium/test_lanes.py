"""Configurations as arrays: one, a batch, and what does not fit."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import both_ways

from softcal_jax import (
    Configuration,
    Markers,
    NeoHookean,
    Support,
    beam,
    build_model,
    lanes,
    marker_positions,
    set_field,
    solve_equilibrium,
)
from softcal_jax.equilibrium import (
    NewtonSettings,
    Workers,
    continue_equilibrium,
    equilibria,
)
from softcal_jax.mesh import MeshWarning


def model_of(cells):
    mesh = beam(0.1, 0.02, 0.02, cells, order=1)
    return build_model(mesh, NeoHookean(1e5, 0.3), density=1000.0)


# The shapes of calibration/light_beam.py, for its programs.
MODEL = model_of((3, 1, 1))
TIP = Markers("tip", [(0.1, 0.01, 0.01)])
POSES = [
    Configuration(name, [Support("x_min")], (0.0, 0.0, g), markers=TIP)
    for name, g in {"hang": -9.81, "up": 9.81, "crushed": 1e7}.items()
]
BATCH = lanes(MODEL, POSES)


def solve(lane):
    return solve_equilibrium(MODEL, lane)


def test_a_batch_has_a_length_and_its_lanes():
    assert len(BATCH) == 3
    assert [float(lane.gravity[2]) for lane in BATCH] == [-9.81, 9.81, 1e7]
    assert float(BATCH[-2].gravity[2]) == 9.81
    assert len(BATCH[1:]) == 2
    assert BATCH[0]
    with pytest.raises(IndexError, match=r"lane 3: .* has 3"):
        BATCH[3]
    with pytest.raises(IndexError, match="no lane 3"):
        BATCH[np.int64(3)]
    for use in (len, lambda one: one[0:1], lambda one: one[0]):
        with pytest.raises(TypeError, match="one configuration"):
            use(BATCH[0])
    assert "batch of 3" in repr(BATCH)
    assert "one configuration" in repr(BATCH[0])


def test_a_configuration_is_solved_as_its_lane_is():
    u = solve(BATCH[1]).displacement
    np.testing.assert_array_equal(solve(POSES[1]).displacement, u)
    within = jax.jit(lambda batch: solve(batch[1]).displacement)(BATCH)
    np.testing.assert_allclose(within, u, rtol=1e-9, atol=1e-12)


def test_a_solution_says_first_how_it_ended():
    assert repr(solve(BATCH[0])).startswith("EquilibriumSolution: converged; ")
    failed = solve(BATCH[2])
    assert repr(failed)[len("EquilibriumSolution: ") :][:20] in str(failed.result)
    assert "1 of 2 converged" in repr(jax.vmap(solve)(BATCH[1:]))


def test_a_solution_that_is_traced_has_a_text():
    shown = []
    jax.make_jaxpr(lambda lane: shown.append(repr(solve(lane))))(BATCH[0])
    assert shown[0].startswith("EquilibriumSolution, displacement")


def squares(E, lane):
    """Of what a lane reads and where its nodes are; 0 where it has no equilibrium."""
    model = set_field(MODEL, "E", E)
    found = solve_equilibrium(model, lane)
    read = marker_positions(model, lane, found), found.displacement
    squared = sum(jnp.sum(each**2) for each in read)
    return jnp.where(found.converged, squared, 0.0)


def test_a_lane_without_equilibrium_spoils_no_derivative_of_others():
    E = jnp.asarray(1e5, float)
    total = lambda E: jnp.sum(jax.vmap(squares, (None, 0))(E, BATCH))
    one = jnp.ones(())
    _, forward, reverse = both_ways(total)(E, one, one)
    assert np.isfinite(forward)
    assert forward != 0.0
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)


def test_what_converges_is_not_taken_for_nan():
    u = solve(BATCH[0]).displacement
    with jax.debug_nans(True):
        for found in (solve(BATCH[0]), jax.vmap(solve)(BATCH[:2])):
            numbers = jax.tree.leaves(eqx.filter(found, eqx.is_inexact_array))
            assert not any(np.isnan(leaf).any() for leaf in numbers)
        step = continue_equilibrium(MODEL, BATCH[0], u, settings=NewtonSettings())
        assert bool(step[0].converged)
        assert np.isfinite(jax.grad(squares)(jnp.asarray(1e5, float), BATCH[0]))


def test_an_equilibrium_on_the_way_to_a_report_is_not_taken_for_nan():
    reports = []
    with jax.debug_nans(True), Workers(MODEL, 1) as workers:
        report = lambda *progress: reports.append(progress)
        run = workers, MODEL, BATCH[:1], NewtonSettings()
        assert bool(equilibria(*run, report=report).converged[0])
    assert len(reports) > 1


@pytest.mark.parametrize(
    ("guess", "expected"),
    [
        (jnp.zeros((3, 3)), r"shape \(3, 3\)"),
        (jnp.zeros((MODEL.n_points, 3), jnp.float32), "float32"),
    ],
)
def test_a_guess_that_does_not_fit_is_named(guess, expected):
    with pytest.raises(ValueError, match=expected):
        solve_equilibrium(MODEL, BATCH[0], guess=guess)


def test_a_batch_is_not_solved_as_one():
    with pytest.raises(ValueError, match=r"batch of 3 .* jax\.vmap"):
        solve(BATCH)


def test_a_lane_of_another_model_is_named():
    with pytest.raises(ValueError, match="mesh with 16 nodes"):
        solve_equilibrium(model_of((2, 1, 1)), BATCH[0])


def test_a_configuration_is_not_put_on_a_mesh_that_is_traced():
    with pytest.raises(ValueError, match=r"'hang' .*outside of jit"):
        eqx.filter_jit(lambda model: solve_equilibrium(model, POSES[0]))(MODEL)


def test_a_field_of_another_length_is_named():
    with pytest.raises(ValueError, match=r"E has shape \(7,\)"):
        set_field(MODEL, "E", jnp.ones(7))
    per_tet = jnp.full(MODEL.n_tets, 2e5)
    assert set_field(MODEL, "E", per_tet).law.E.shape == per_tet.shape


def test_a_mesh_in_mm_is_suspected_aloud():
    mesh = beam(100.0, 20.0, 20.0, (1, 1, 1), order=1)
    with pytest.warns(MeshWarning, match=r'100 m .*length_unit = "mm"'):
        build_model(mesh, NeoHookean(1e5, 0.3), density=1e3)
