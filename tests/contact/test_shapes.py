"""Shapes of obstacles: distances against surfaces, and the tangent of each."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import pyvista as pv

from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import build_mechanism
from softcal_jax.contact import (
    Ball,
    Capsule,
    HalfSpace,
    RoundedBox,
    RoundedCylinder,
    Standing,
    read_surface,
)
from softcal_jax.mesh import beam

BOX = RoundedBox((0.02, 0.03, 0.04), 3e-3)
ROUND = {
    "sphere": (Ball(0.01), (0.0, 0.0, 0.013), 0.003),
    "capsule, end": (Capsule(0.01, 0.03), (0.003, 0.0, 0.015 + 0.012), None),
    "capsule, side": (Capsule(0.01, 0.03), (0.0, 0.012, 0.01), 0.002),
    "cylinder, end": (RoundedCylinder(0.01, 0.03, 2e-3), (0.002, 0.0, 0.017), 0.002),
    "cylinder, inside": (RoundedCylinder(0.01, 0.03, 2e-3), (0.0, 0.009, 0.0), -0.001),
    "box, face": (BOX, (0.0, 0.014, 0.0), -0.001),
    "box, edge": (BOX, (0.01, 0.015, 0.0), (2**0.5 - 1.0) * 3e-3),
    "box, corner": (BOX, (0.01, 0.015, 0.02), (3**0.5 - 1.0) * 3e-3),
    "plane": (HalfSpace(), (3.0, 2.0, -0.5), -0.5),
}


@pytest.mark.parametrize("name", ROUND)
def test_distances(name):
    shape, point, wanted = ROUND[name]
    if wanted is None:
        wanted = np.hypot(0.003, 0.012) - 0.01
    distance, normal = jax.value_and_grad(shape.distance)(jnp.array(point))
    assert float(distance) == pytest.approx(wanted, abs=1e-12)
    assert float(jnp.linalg.norm(normal)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("shape", [Ball(0.01), Capsule(0.01, 0.03)])
def test_what_is_drawn_is_the_surface(shape):
    surface = np.asarray(shape.drawn(0.1).points, float)
    distances = jax.vmap(shape.distance)(jnp.asarray(surface))
    np.testing.assert_allclose(distances, 0.0, atol=2e-4)  # of facets


@pytest.mark.slow
def test_a_surface_of_a_file_is_a_smooth_distance(tmp_path):
    ball = pv.Sphere(radius=10.0, theta_resolution=120, phi_resolution=120)
    ball.save(tmp_path / "ball.stl")
    grid = read_surface(tmp_path / "ball.stl", length_unit=1e-3)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points = jnp.asarray(ways * rng.uniform(5e-3, 11e-3, (200, 1)))
    distance, normal = jax.vmap(jax.value_and_grad(grid.distance))(points)
    wanted = np.linalg.norm(points, axis=1) - 0.01
    np.testing.assert_allclose(distance, wanted, atol=1e-5)
    np.testing.assert_allclose(normal, ways, atol=0.03)
    # Across a face of its cells value, slope and curvature stay what they are.
    face = grid.origin + grid.spacing * np.array([30.0, 12.0, 40.0])
    values = [
        jax.hessian(grid.distance)(jnp.asarray(face + step)) for step in (-1e-12, 1e-12)
    ]
    np.testing.assert_allclose(*values, atol=1e-4 * np.abs(values[0]).max())


def test_a_plate_of_a_file_may_be_thinner_than_two_spacings(tmp_path):
    pv.Box((0.0, 1.0, 0.0, 1.0, 0.0, 0.02)).triangulate().save(tmp_path / "plate.stl")
    grid = read_surface(tmp_path / "plate.stl")
    assert 0.02 < 2.0 * grid.spacing
    # Nearer, the spline rounds the kink in the middle of the plate.
    heights = np.linspace(1.0, 7.0, 19) * grid.spacing
    points = np.array([0.31, 0.57, 0.02]) + heights[:, None] * np.eye(3)[2]
    distance = np.asarray(jax.vmap(grid.distance)(jnp.asarray(points)))
    np.testing.assert_allclose(distance, heights, atol=0.03 * grid.spacing)


def test_an_open_surface_is_refused(tmp_path):
    pv.Disc(outer=1.0).triangulate().save(tmp_path / "disc.stl")
    with pytest.raises(ValueError, match=r"disc.stl has .* open edges; .*closed"):
        read_surface(tmp_path / "disc.stl")


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_the_tangent_is_exact_however_deep(friction):
    """Where points lie in the cushion and deeper, against autodiff of the potential."""
    mesh = beam(0.02, 0.02, 0.01, (1, 1, 1), order=2)
    ball = RigidBody(
        "ball", shape=Ball(0.01), origin=(0.01, 0.01, 0.0195), friction=friction
    )
    mechanism = build_mechanism(mesh, [ball], contact_scale=1e-4)
    contacts, x = mechanism.contacts, jnp.asarray(mechanism.points)
    shift = jnp.zeros_like(x).at[contacts.frames[0]].add(jnp.array([1e-4, 0.0, 5e-5]))
    standing = Standing(jnp.ones(1, bool), (x + 3.0 * shift)[contacts.frames])
    of_nodes = lambda x: contacts.energy_and_force(x, standing)[1]
    way = jnp.asarray(np.random.default_rng(1).normal(size=x.shape))
    _, wanted = jax.jvp(of_nodes, (x,), (way,))
    (nodes,), (matrices,) = contacts.cliques(), contacts.tangents(x, standing)
    moved = way[nodes].reshape(len(nodes), -1)
    forces = jnp.einsum("fpq,fq->fp", matrices, moved).reshape(*nodes.shape, 3)
    found = jnp.zeros_like(x).at[nodes].add(forces)
    scale = float(jnp.abs(wanted).max())
    assert scale > 0.0
    np.testing.assert_allclose(found, wanted, atol=1e-10 * scale)
    tamed = contacts.tangents(x, standing, tamed=1)
    assert float(jnp.abs(tamed[0] - matrices).max()) > 1e-3 * scale / len(x)
