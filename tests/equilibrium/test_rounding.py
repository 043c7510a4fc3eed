"""The residual is the one of the forces, and the solve says where rounding ended it."""

import numpy as np
import pytest
from bodies import TIGHT, lane, solve

from softcal_jax.calibration import simulation_result
from softcal_jax.configurations import Configuration, Support, configuration_arrays
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    gravity_load,
    internal_force,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 1, 1))
OUTER = MESH.points[MESH.tets].mean(axis=1)[:, 0] > 0.05
LIFTED = Support("x_min", "xyz", (0.0, 0.0, 0.01))
NO_WEIGHT = {"gravity": (0.0, 0.0, 0.0)}
POSES = (
    Configuration("hanging", (Support("x_min"),), gravity=(0.0, 0.0, -9.81)),
    Configuration("idle", (Support("x_min"),), **NO_WEIGHT),
    Configuration("lifted", (LIFTED,), **NO_WEIGHT),
)
HANGING, IDLE, LIFTED_UP = range(3)
LANES = configuration_arrays(MESH, POSES)


def body(contrast):
    """A beam whose outer half is stiffer than the inner one by this factor."""
    E = np.where(OUTER, contrast, 1.0) * 1e5
    return build_model(MESH, NeoHookean(E, 0.3), density=1000.0)


@pytest.mark.parametrize("contrast", [1.0, 1e6])
def test_the_residual_is_relative_to_the_forces(contrast):
    """To the larger of external and internal force, whatever is stiffest.

    A floor by the stiffest region would hide most of it. Newton's method is stopped far
    from its end, as another program does not repeat rounding.
    """
    model = body(contrast)
    solution = solve(model, LANES, NewtonSettings(rtol=0.1))
    inside = internal_force(model, solution.displacement[HANGING])
    pose = lane(LANES, HANGING)
    outside = pose.dead_loads + gravity_load(model, pose.acceleration)
    free = np.where(pose.fixed, 0.0, inside - outside)
    scale = max(np.linalg.norm(inside), np.linalg.norm(outside))
    residual = np.linalg.norm(free) / scale
    assert residual > 1e-3
    solved = solution.residual[HANGING]
    np.testing.assert_allclose(solved, residual, rtol=1e-6)


def test_rounding_that_stopped_the_solve_is_said():
    """A residual of 1e-12 is in reach of the uniform beam alone, or without load."""
    even, uneven = (solve(body(contrast), LANES, TIGHT) for contrast in (1.0, 1e6))
    np.testing.assert_array_equal(even.at_rounding, [False, False, True])
    np.testing.assert_array_equal(uneven.at_rounding, [True, False, True])
    assert even.residual[HANGING] <= TIGHT.rtol
    assert TIGHT.rtol < uneven.residual[HANGING] <= uneven.rounding[HANGING]
    # It grows with the mean stiffness.
    growth = uneven.rounding[HANGING] / even.rounding[HANGING]
    assert 1e5 < growth < 1e7
    for solution in (even, uneven):
        assert solution.residual[IDLE] == 0.0
        np.testing.assert_array_equal(solution.rounding[LIFTED_UP], 1.0)
        assert bool(np.all(solution.converged))
    result = simulation_result(body(1e6), POSES, uneven)
    of_hanging = f"converged at rounding (residual {uneven.residual[HANGING]:.1e})"
    words = [of_hanging, "converged", "converged at rounding"]
    assert [pose.outcome for pose in result.configurations] == words
