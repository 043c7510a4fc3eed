"""A C-shaped body whose upper arm bends down, through the lower one or not."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_result, make_simulation
from scipy.spatial.transform import Rotation
from wording import says

from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.calibration import simulation_result
from softcal_jax.configurations import Configuration, Support
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh, beam, boundary_faces, check_mesh, self_contact

LENGTH, WIDTH, GAP = 0.06, 0.02, 0.01  # each arm is as thick as the gap


def c_shape(order, cells=(12, 4, 6)):
    """Two arms along x, one gap above the other, joined at x < 10 mm."""
    box = beam(LENGTH, WIDTH, 3 * GAP, cells, order=order)
    x, _, z = box.centroids.T
    tets = box.tets[(x < 0.01) | (np.abs(z - 1.5 * GAP) > 0.5 * GAP)]
    used, tets = np.unique(tets, return_inverse=True)
    mesh = TetMesh(box.points[used], tets.reshape(-1, box.tets.shape[1]))
    return mesh.with_node_group("x_min", np.flatnonzero(mesh.points[:, 0] == 0.0))


def closing(mesh, distance, both=0.0):
    """Bend the upper arm down, its end by so much, and both arms up."""
    x, _, z = mesh.points.T
    # What the tets of an order interpolate exactly.
    share = (x / LENGTH) ** mesh.order
    u = np.zeros_like(mesh.points)
    u[:, 2] = share * (both - distance * (z >= 1.999 * GAP))
    check_mesh(TetMesh(mesh.points + u, mesh.tets))
    return u


def narrowed(mesh, gap):
    """Lower the upper arm until only this gap is left."""
    x, y, z = mesh.points.T
    arms = np.minimum(z, GAP) + np.maximum(z - 2.0 * GAP, 0.0)
    points = np.stack([x, y, arms + gap * np.clip(z / GAP - 1.0, 0.0, 1.0)], axis=1)
    check_mesh(TetMesh(points, mesh.tets))
    return points


def depths(mesh, distance):
    """Depth of the nodes of facing surfaces in the other arm: distance to its faces."""
    x, y, z = mesh.points.T
    depth = distance * (x / LENGTH) ** mesh.order - GAP
    facing = np.isclose(z, GAP) | np.isclose(z, 2.0 * GAP)
    depth = np.min([depth, LENGTH - x, y, WIDTH - y], axis=0)
    depth[~facing | ~np.isin(np.arange(mesh.n_nodes), boundary_faces(mesh))] = 0.0
    return depth


@pytest.mark.parametrize("order", [1, 2])
def test_an_arm_bent_into_the_other_is_as_deep_as_it_went(order):
    mesh = c_shape(order)
    contact = self_contact(mesh, closing(mesh, 0.014))
    assert contact is not None
    expected = depths(mesh, 0.014)
    inside = np.flatnonzero(expected > 1e-5)
    np.testing.assert_array_equal(np.sort(contact.nodes), inside)
    np.testing.assert_allclose(contact.depth, expected[contact.nodes], rtol=1e-9)
    assert (np.diff(contact.depth) <= 0.0).all()
    x, y, _ = 1e3 * mesh.points[contact.nodes[0]]
    assert says(contact.where, f"near ({x:.4g}, {y:.4g}, ")


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("gap", [1e-4, 1e-6])
def test_a_gap_that_stays_open_is_no_contact(order, gap):
    mesh = c_shape(order)
    assert self_contact(mesh, narrowed(mesh, gap) - mesh.points) is None


def test_faces_count_as_curved_as_they_are():
    """Mid nodes enter the flat face between the corners of the other arm, not it."""
    mesh, gap, up = c_shape(2), 2e-5, 0.03
    mesh = replace(mesh, points=narrowed(mesh, gap))
    side = LENGTH / 12
    assert up * (side / LENGTH) ** 2 / 4.0 > 2.0 * gap  # sagitta of a face
    assert self_contact(mesh, closing(mesh, 0.0, up)) is None


def test_a_fold_within_neighbouring_tets_is_no_contact():
    """A distorted tet, where elements are too coarse for a load, is another matter."""
    mesh = beam(0.04, 0.04, 0.04, (4, 4, 4))
    middle = np.linalg.norm(mesh.points - [0.02, 0.02, 0.04], axis=1).argmin()
    u = np.zeros_like(mesh.points)
    u[middle] = [0.001, 0.002, -0.013]
    assert self_contact(mesh, u) is None


@pytest.mark.parametrize("order", [1, 2])
def test_a_turned_body_is_none_whether_it_overlaps_at_rest_or_not(order):
    open_, turn = c_shape(order), Rotation.from_rotvec([1.0, -2.0, 1.5])
    overlapping = replace(open_, points=open_.points + closing(open_, 0.014))
    for mesh in (open_, overlapping):
        assert self_contact(mesh, turn.apply(mesh.points) + 0.3 - mesh.points) is None


def test_the_deepest_node_is_named_by_its_surface_group():
    mesh = c_shape(1)
    faces = boundary_faces(mesh)
    z = mesh.points[faces][..., 2]
    for height in (GAP, 2.0 * GAP):
        named = faces[np.isclose(z, height).all(axis=1)]
        mesh = mesh.with_surface_group(f"slit {1e3 * height:.0f}", named)
    contact = self_contact(mesh, closing(mesh, 0.014))
    assert contact is not None
    height = 1e3 * mesh.points[contact.nodes[0], 2]
    assert contact.where == f"near slit {height:.0f}"


@pytest.mark.parametrize("distance", [0.009, 0.014])
def test_poses_that_touch_are_doubted(distance):
    mesh = c_shape(2)
    model = build_model(mesh, NeoHookean(1e5, 0.3), density=1000.0)
    poses, solution = make_simulation(model, (True, True, False))
    u = jnp.zeros((3, mesh.n_nodes, 3)).at[1:].set(closing(mesh, distance))
    poses = [replace(pose, markers=None) for pose in poses]
    solution = eqx.tree_at(lambda s: s.displacement, solution, u)
    simulation = simulation_result(model, poses, solution)
    # Not of the last one, which has no equilibrium.
    assert len(simulation.doubts) == (distance > GAP)

    known = make_result()
    contact = simulation.configurations[1].self_contact
    fits = [replace(fit, self_contact=contact) for fit in known.configurations[:1]]
    doubts = replace(known, configurations=tuple(fits)).contact_doubts
    assert (doubts != ()) == (distance > GAP)
    assert not doubts or says(doubts, "in droop", "mm deep near (", "not modelled")


DROP = 0.011
"""How far the end of the upper arm comes down: 1 mm into that of the lower one [m]."""


def ends(mesh):
    """Nodes of the last 10 mm of the lower and of the upper arm."""
    x, _, z = mesh.points.T
    last = x > 0.0499
    return np.flatnonzero(last & (z < 1.5 * GAP)), np.flatnonzero(
        last & (z > 1.5 * GAP)
    )


def dropped(mesh):
    """Lower the end of the upper arm, which stays rigid; only the ends overlap."""
    x, _, z = mesh.points.T
    u = np.zeros_like(mesh.points)
    u[:, 2] = -DROP * np.minimum(x / 0.05, 1.0) * (z > 1.999 * GAP)
    return u


def contact_of_ends(bodies=(), states=None, supports=("x_min",)):
    """Self-contact of a pose that has such an equilibrium; nothing is solved."""
    mesh = c_shape(1)
    for name, nodes in zip(("lower", "upper"), ends(mesh), strict=True):
        mesh = mesh.with_node_group(name, nodes)
    law = NeoHookean(1e5, 0.3)
    model = build_model(mesh, law, density=1e3, bodies=bodies, solver="none")
    _, solution = make_simulation(model, (True,))
    u = np.zeros((1, model.n_points, 3))
    u[0, : mesh.n_nodes] = dropped(mesh)
    solution = eqx.tree_at(lambda s: s.displacement, solution, jnp.asarray(u))
    pose = Configuration("pose", supports, bodies=states or {})
    (result,) = simulation_result(model, [pose], solution).configurations
    return result.self_contact


def rigid_ends(**options):
    return RigidBody("low", "lower"), RigidBody("up", "upper", **options)


MOUNTED = Pose((0.0, 0.0, -DROP))


def test_blocks_on_one_rigid_body_are_no_contact():
    """Like a sensor in the block that carries it: they never move to each other."""
    assert contact_of_ends(rigid_ends(mounting=MOUNTED, tied_to="low")) is None


@pytest.mark.parametrize(
    ("bodies", "states"),
    [
        (rigid_ends(), {}),
        (rigid_ends(), {"low": "held"}),
        (rigid_ends()[1:], {}),
        (rigid_ends()[:1], {}),
        ((), {}),
    ],
)
def test_walls_and_blocks_that_move_against_each_other_are_in_contact(bodies, states):
    contact = contact_of_ends(bodies, states)
    assert contact is not None
    assert contact.depth[0] == pytest.approx(DROP - GAP)


def test_parts_whose_places_are_imposed_are_no_contact():
    """Bodies that are held where they were mounted, and nodes that clamps hold."""
    held = {"low": "held", "up": BodyState("held")}
    assert contact_of_ends(rigid_ends(mounting=MOUNTED), held) is None
    clamps = ("x_min", "lower", Support("upper", displacement=(0.0, 0.0, -DROP)))
    assert contact_of_ends(supports=clamps) is None
    # A support that lets them slide imposes no place.
    slides = (*clamps[:2], Support("upper", "z", (0.0, 0.0, -DROP)))
    assert contact_of_ends(supports=slides) is not None


def test_a_block_is_no_contact_of_tets_that_its_body_moves_in_part():
    """As where a leg leaves its socket: those tets are between it and its own body."""
    mesh, (lower, upper) = c_shape(1), ends(c_shape(1))
    carrier = np.full(mesh.n_nodes, -1)
    # The upper side of the lower arm, which the upper arm enters, deforms.
    carrier[[*upper, *lower[mesh.points[lower, 2] < 0.9 * GAP]]] = 0
    entered = self_contact(mesh, dropped(mesh), carrier=carrier)
    assert entered is not None
    assert np.isin(entered.nodes, lower).all()
    without = self_contact(mesh, dropped(mesh))
    assert without is not None
    assert np.isin(without.nodes, upper).any()
