"""Chambers that are open at an inlet and sealed there, against closed ones."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    TURN,
    actuator_displacements,
    actuator_rows,
    arrays_of,
    bent,
    curvature_entries,
)
from scipy.spatial import KDTree

import softcal_jax as sc
from benchmarks._hollow import hollow
from softcal_jax.actuators import Chamber
from softcal_jax.configurations import configuration_arrays
from softcal_jax.mesh import TetMesh, beam

each_order = pytest.mark.parametrize("order", [1, 2])
SEALED = Chamber("c", "cavity", seal=True)
SIDE = 1 / 3
"""Side of the square section of the channel and of its rims [m]."""


def channel(first, last, order=1, *, pattern="mirrored", cells=4):
    """A block of 3 x 3 x `cells` cells of side 1/3 with a channel along x.

    The cells `first` to `last - 1` of the middle column are missing; the first cell has
    the lower corner (0, -1/2, -1/2).
    """
    size, grid = (cells / 3, 1.0, 1.0), (cells, 3, 3)
    full = beam(*size, grid, origin=(0.0, -0.5, -0.5), pattern=pattern)
    x, *across = full.centroids.T
    middle = np.abs(across).max(axis=0) < SIDE / 2
    return hollow(full, middle & (x > first / 3) & (x < last / 3), order)


def delta(mesh, x, chamber=SEALED):
    return float(actuator_displacements(arrays_of(mesh, chamber), jnp.asarray(x))[0])


def row(mesh, x, chamber=SEALED):
    return np.asarray(actuator_rows(arrays_of(mesh, chamber), jnp.asarray(x)))[0]


@each_order
@pytest.mark.parametrize(("first", "last"), [(0, 3), (1, 4), (0, 4)])
def test_volume_with_one_lid_or_two(first, last, order):
    """Open at either end, or at both."""
    arrays = arrays_of(channel(first, last, order), SEALED)
    assert len(arrays.groups) == 2
    expected = (last - first) / 3 * SIDE**2
    np.testing.assert_allclose(arrays.rest, [expected], rtol=1e-13)


@each_order
def test_affine_map_scales_the_volume_by_its_determinant(order):
    mesh = channel(0, 3, order)
    F = np.array([[1.3, 0.2, -0.1], [0.0, 0.9, 0.4], [0.3, -0.2, 1.1]])
    growth = (np.linalg.det(F) - 1.0) * SIDE**2
    x = mesh.points @ F.T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(delta(mesh, x), growth, rtol=1e-12)


@pytest.mark.parametrize(("order", "share"), [(1, 1.0), (2, 0.0)])
def test_volume_within_a_curved_rim(order, share):
    """y -> y (1 + a z^2) on a channel of length 1 with sides |y|, |z| < h.

    The volume grows by the integral of a z^2, 4/3 a h^4, which quadratic tets meet; the
    straight edges of linear ones run along the chord, z^2 = h^2: 4 a h^4.
    """
    mesh, a, h = channel(0, 3, order), 0.8, SIDE / 2
    x = mesh.points.copy()
    x[:, 1] *= 1.0 + a * x[:, 2] ** 2
    exact, chord = 4.0 / 3.0 * a * h**4, 4.0 * a * h**4
    expected = exact + share * (chord - exact)
    np.testing.assert_allclose(delta(mesh, x), expected, rtol=1e-11)


def test_a_closed_twin_whose_lid_is_the_same_cone():
    """One more layer of tets closes the twin; the node in its lid follows the rim."""
    tall = channel(1, 4, pattern="centred", cells=5)
    closed = TetMesh(tall.points - [SIDE, 0, 0], tall.tets, {}, tall.surface_groups)
    mesh = channel(0, 3, pattern="centred")
    _, twin = KDTree(closed.points).query(mesh.points)
    (apex,) = np.flatnonzero(np.all(np.abs(closed.points) < 1e-9, axis=1))
    rim = np.flatnonzero(
        (np.abs(mesh.points[:, 0]) < 1e-9)
        & (np.abs(np.abs(mesh.points[:, 1:]) - SIDE / 2).max(axis=1) < 1e-9)
    )
    assert len(rim) == 4
    x = bent(mesh.points)
    moved = bent(closed.points)
    moved[apex] = x[rim].mean(axis=0)
    plain = Chamber("c", "cavity")
    np.testing.assert_allclose(delta(mesh, x), delta(closed, moved, plain), rtol=1e-12)
    whole = row(closed, moved, plain)
    expected = whole[twin]
    # What the pressure does to the lid acts on its rim.
    expected[rim] += whole[apex] / 4.0
    np.testing.assert_allclose(row(mesh, x), expected, rtol=0, atol=1e-15)


@each_order
def test_a_sealed_chamber_has_no_resultant(order):
    """Nor has a closed one: wall and lids are in balance, also with two lids."""
    for mesh in (channel(0, 3, order), channel(0, 4, order)):
        x = bent(mesh.points)
        force = row(mesh, x)
        np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-15)
        np.testing.assert_allclose(np.cross(x, force).sum(axis=0), 0.0, atol=1e-15)


@each_order
def test_rigid_motion_keeps_the_volume(order):
    mesh = channel(0, 4, order)
    x = mesh.points @ TURN.T + np.array([3.0, -1.0, 2.0])
    np.testing.assert_allclose(delta(mesh, x), 0.0, atol=1e-14)


@each_order
def test_force_is_the_gradient_of_the_volume(order):
    """Central differences, whose error falls at second order."""
    mesh = channel(0, 4, order)
    x = bent(mesh.points)
    direction = np.sin(7.0 * x + [0.3, 1.1, -0.4])
    arrays = arrays_of(mesh, SEALED)
    of = lambda x: float(actuator_displacements(arrays, jnp.asarray(x))[0])
    error = [
        (of(x + h * direction) - of(x - h * direction)) / (2.0 * h)
        - np.sum(row(mesh, x) * direction)
        for h in (1e-2, 1e-3)
    ]
    np.testing.assert_allclose(error[0] / error[1], 100.0, rtol=0.01)
    for matrices in curvature_entries(arrays, jnp.asarray(x), jnp.ones(1)):
        swapped = jnp.swapaxes(matrices, 1, 2)
        np.testing.assert_allclose(matrices, swapped, rtol=0, atol=1e-15)


@pytest.mark.slow
@each_order
def test_equilibrium_is_that_of_a_closed_twin(order):
    """The rim is clamped; the twin is closed by what is clamped as a whole."""
    law = sc.NeoHookean(E=100e3, nu=0.4)
    # Two layers, since the cut of the cells alternates.
    tall = channel(2, 5, order, cells=6)
    closed = TetMesh(tall.points - [2 * SIDE, 0, 0], tall.tets, {}, tall.surface_groups)
    mesh = channel(0, 3, order)
    _, twin = KDTree(closed.points).query(mesh.points)
    moved = []
    for body, chamber in ((mesh, SEALED), (closed, Chamber("c", "cavity"))):
        held = sc.select_nodes(body, lambda X: X[:, 0] < 1e-9)
        model = sc.build_model(
            body.with_node_group("held", held),
            law,
            density=1000.0,
            actuators=[chamber],
        )
        pose = sc.Configuration(
            "blown", "held", (0, 0, 0), actuation={"c": sc.ImposedForce(2e4)}
        )
        lanes = configuration_arrays(model.mesh, [pose], model.mechanism)
        lane = jax.tree.map(lambda leaf: leaf[0], lanes)
        solve = eqx.filter_jit(sc.solve_equilibrium)
        moved.append(np.asarray(solve(model, lane).displacement)[: body.n_nodes])
    assert np.abs(moved[0]).max() > 0.01
    # Far above the tolerance of the equilibrium, 1e-8.
    largest = np.abs(moved[0]).max()
    np.testing.assert_allclose(moved[0], moved[1][twin], rtol=0, atol=1e-6 * largest)


def test_a_closed_wall_needs_no_seal():
    with pytest.raises(ValueError, match=r"'cavity'.*Leave seal out"):
        arrays_of(channel(1, 3), SEALED)


def test_an_open_wall_says_how_to_seal_it():
    with pytest.raises(ValueError, match=r"'cavity'.* 4 open .*\(seal = true\)"):
        arrays_of(channel(0, 3), Chamber("c", "cavity"))


def test_openings_that_meet():
    """Two faces that share a corner are missing: where does each opening end?"""
    mesh = channel(1, 3)
    faces = mesh.faces("cavity")
    others = [set(f) & set(faces[0]) for f in faces]
    k = next(k for k, both in enumerate(others) if len(both) == 1)
    left = np.delete(faces, [0, k], axis=0)
    opened = TetMesh(mesh.points, mesh.tets, surface_groups={"cavity": left})
    with pytest.raises(ValueError, match=r"'c': openings .* mm"):
        arrays_of(opened, SEALED)


def test_what_is_around_the_body_is_no_cavity():
    """The outer surface without a side, sealed there."""
    mesh = channel(1, 3)
    outer = mesh.faces("outer")
    open_side = outer[~(np.abs(mesh.points[outer, 0]) < 1e-9).all(axis=1)]
    body = TetMesh(mesh.points, mesh.tets, surface_groups={"cavity": open_side})
    with pytest.raises(ValueError, match=r"'cavity'.*inner side"):
        arrays_of(body, SEALED)


@pytest.mark.parametrize("order", [1, 2])
def test_a_lid_follows_the_points_of_the_mesh_at_rest(order):
    mesh = channel(0, 3, order)
    points = mesh.points + 0.05 * np.random.default_rng(0).normal(
        size=mesh.points.shape
    )
    other = TetMesh(points, mesh.tets, mesh.node_groups, mesh.surface_groups)
    ours = arrays_of(mesh, SEALED).following(other, jnp.asarray(points))
    built = arrays_of(other, SEALED)
    np.testing.assert_allclose(ours.rest, built.rest, rtol=1e-12)
    x = jnp.asarray(bent(points))
    np.testing.assert_allclose(
        actuator_displacements(ours, x), actuator_displacements(built, x), rtol=1e-12
    )
