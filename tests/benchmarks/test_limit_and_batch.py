"""The benchmarks of single iterations and of batches, on small meshes."""

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks._cantilever import equilibrium
from benchmarks._paper import measured_beam
from benchmarks.batch import evaluation_seconds, loaded
from benchmarks.limit import (
    ROUNDING,
    Size,
    _case,
    assembly_bytes,
    newton_errors,
    newton_per_lane,
    one_size,
    order,
)

SMALL = Size((2, 1, 1), 1, 1.0)
CELLS = (4, 1, 1)


def test_bytes_of_an_assembly():
    """By hand: 12 tets of 4 nodes, 12 gradients and 78 entries, in one block of 16."""
    model, _, _ = _case(SMALL)
    assert (model.n_tets, model.weights.shape[0] * model.weights.shape[2]) == (12, 16)
    elements = 16 * (4 * 4 + 8 * 12 + 8 + 4 * 78)
    assert assembly_bytes(model) == elements + 8 * (3 * 12 + model.pattern.nnz)


def test_order_of_convergence():
    assert np.isclose(order([1.0, 1e-1, 1e-2, 1e-4, 1e-8, 1e-15]), 2.0)
    assert np.isclose(order([1e-2, 1e-3, 1e-4]), 1.0)


@pytest.mark.slow
def test_everything_on_small_meshes():
    """Compiles for minutes: all that the benchmarks measure, but the sizes."""
    figures, seconds = one_size(SMALL)
    assert figures["free_dof"] == 24
    assert all(min(times) > 0.0 for times in seconds.values())
    model, _, lane = _case(SMALL)
    assert figures["steps"] == int(equilibrium(model, lane).steps)
    errors = newton_errors(model, lane)
    assert errors[-1] <= ROUNDING < errors[-2]
    measured = measured_beam(CELLS, plane="xy")
    check_lanes(measured)
    counted = newton_per_lane(measured)
    assert counted
    assert 1.0 <= np.mean(counted) < 5.0
    assert len(evaluation_seconds(measured, 5, 2)) == 2


def check_lanes(measured):
    """Poses in turn, each with a weight of its own."""
    poses = measured.problem.configurations
    lanes = loaded(measured, 6).configurations
    np.testing.assert_array_equal(lanes.fixed[4:], poses.fixed[:2])
    share = jnp.linalg.norm(lanes.gravity, axis=1) / jnp.linalg.norm(poses.gravity[0])
    np.testing.assert_allclose(share, np.linspace(0.8, 1.2, 6), rtol=1e-12)
