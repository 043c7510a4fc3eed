"""Places of markers and frames that are not where they are said to be."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    BodyFrame,
    Centroid,
    Configuration,
    Markers,
    configuration_arrays,
)
from softcal_jax.equilibrium import build_model, effector_values
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

PLACES = np.array([[0.06, 0.011, 0.012], [0.09, 0.01, 0.023]])
D = np.array([1e-3, -2e-3, 0.5e-3])


def readings(places, offset, motion, *, order=1, base_radius=0.0):
    """Positions of two markers and of a frame's point, which have this offset."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=order)
    bodies = [RigidBody("base", "x_min")]
    model = build_model(mesh, NeoHookean(5e5, 0.3), density=1e3, bodies=bodies)
    markers = Markers(("a", "b"), places, base_radius=base_radius)
    sensor = BodyFrame("sensor", "base", point=(0.0, 0.03, 0.0))
    pose = Configuration("pose", "x_max", markers=markers, effectors=(sensor,))
    lane = lane_of(configuration_arrays(mesh, [pose], model.mechanism))
    assert lane.effectors.movable == ("a", "b", "sensor")
    lane = eqx.tree_at(lambda c: c.effectors.offset, lane, np.tile(offset, (3, 1)))
    X = model.positions(jnp.zeros((model.n_points, 3)))
    u = jnp.asarray(motion(np.asarray(X)))
    return np.asarray(effector_values(model, lane, u))[:3]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("base_radius", [0.0, 0.03])
def test_an_affine_motion_carries_the_place_with_its_offset(order, base_radius):
    A = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.3], [0.05, 0.0, 1.2]])
    motion = lambda X: X @ A.T + 0.01 - X
    where = {"order": order, "base_radius": base_radius}
    seen = readings(PLACES, D, motion, **where)
    places = np.vstack([PLACES, [0.0, 0.03, 0.0]])
    np.testing.assert_allclose(seen, (places + D) @ A.T + 0.01, rtol=0, atol=1e-15)


def test_an_offset_within_a_tet_is_that_of_a_marker_there():
    """One inside the body, one on a post; linear tets have no higher terms."""
    motion = lambda X: 1e-2 * np.random.default_rng(0).normal(size=X.shape)
    seen = readings(PLACES, D, motion)
    there = readings(PLACES + D, np.zeros(3), motion)
    np.testing.assert_allclose(seen[:2], there[:2], rtol=0, atol=1e-15)
    assert np.abs(seen - readings(PLACES, np.zeros(3), motion)).min(axis=1).all()


def test_a_mean_over_nodes_has_no_place_of_its_own():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
    model = build_model(mesh, NeoHookean(5e5, 0.3), density=1e3)
    pose = Configuration("pose", "x_min", effectors=(Centroid("end", "x_max"),))
    arrays = configuration_arrays(mesh, [pose], model.mechanism)
    assert arrays.effectors.movable == ()
