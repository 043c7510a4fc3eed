"""Points of a mesh at rest: what follows them, as against a model built of them.

`test_rigid_bodies` has derivatives of equilibria by points.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import arrays, strip
from problems import central_difference

from softcal_jax.actuators import Cable, Guide, SurfaceForceActuator
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    ActuatorDisplacement,
    BodyFrame,
    Configuration,
    ImposedForce,
    Markers,
    PointForce,
    Support,
    SupportReaction,
    SurfaceForce,
)
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    RESULTS,
    build_model,
    energy_and_force,
    lanes,
    solve_equilibrium,
    with_points,
)
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import (
    Corotational,
    Isotropic,
    SofaCorotational,
)
from softcal_jax.mesh import TetMesh, locate

MESH = strip(3)
POINTS = jnp.asarray(MESH.points)
ON_MESH = MESH.centroids[[7, 10, 13]]  # within tets, which then carry them always
TIP, OUT = np.array([0.12, 0.012, 0.01]), np.array([0.0, 0.0, 0.008])
MODULUS = ControlPointParameters(
    "E",
    ControlPoints([(0.0, 0.01, 0.01), (0.12, 0.01, 0.01)]),
    start=[2e5, 4e5],
    lower=1e5,
    upper=1e6,
)
SPACE = ParameterSpace([MODULUS])
TABLE = RigidBody("table", origin=(0.06, 0.01, -0.0006), shape=HalfSpace())


def built(points, mesh=MESH, *more):
    """A model of the points, and a pose; what the mesh carries has moved along."""
    points, plate = np.asarray(points), mesh.nodes("at 3")
    places = locate(mesh, ON_MESH, max_distance=1e-3)
    guide, marker, pushed = places.interpolate(points)
    tip = TIP + points[plate].mean(axis=0) - mesh.points[plate].mean(axis=0)
    guides = [Guide((-0.02, 0.01, 0.03), "ground"), guide, Guide(tip + OUT, "plate")]
    side = SurfaceForceActuator("side", "y_max", (0.0, 1.0, 0.3))
    plate = RigidBody("plate", "at 3", mass=0.01, centre_of_mass=tip + OUT)
    model = build_model(
        TetMesh(points, mesh.tets, mesh.node_groups, mesh.surface_groups),
        Corotational(Isotropic(250e3, 0.3)),
        density=1070.0,
        bodies=[plate, *more],
        actuators=[Cable("cable", guides), side],
        contact_scale=1e-3,
    )
    read = [
        BodyFrame("frame", "plate", point=tip),
        SupportReaction("ground", "x_min", std=1.0),
        ActuatorDisplacement("length", "cable"),
    ]
    pose = Configuration(
        "pose",
        "x_min",
        (0.0, 0.0, -9.81),
        loads=PointForce(tuple(pushed.tolist()), (0.01, 0.0, 0.005)),
        markers=Markers("marker", [marker]),
        effectors=read,
        actuation={"cable": ImposedForce(0.02), "side": ImposedForce(0.05)},
    )
    return model, pose


def moves(points):
    """A motion of points under which neither lengths nor areas keep their shares."""
    return 1e-3 * jnp.asarray(np.random.default_rng(0).normal(size=points.shape))


MODEL, POSE = built(POINTS)
LANE, TANGENT = arrays(MODEL, POSE), moves(POINTS)
ELSEWHERE = POINTS + TANGENT


def numbers_of(model):
    """All that a model has, with a modulus at control points.

    But for what its solver keeps, and an infinite depth.
    """
    model, _ = SPACE.apply(model, None, SPACE.start())
    others = lambda m: (m.solver, m.mechanism.contacts.depth)
    model = eqx.tree_at(others, model, (None, None))
    return eqx.filter(model, eqx.is_inexact_array)


@pytest.mark.parametrize("order", [1, 2])
def test_a_model_is_that_built_of_the_points(monkeypatch, order):
    """With obstacles: values, and derivatives of second order."""
    mesh = strip(3, order)
    # The length of a frame is a unit alone.
    monkeypatch.setattr(TetMesh, "size", mesh.size)
    points = jnp.asarray(mesh.points)
    tangent, model = moves(points), built(points, mesh, TABLE)[0]
    rebuilt = lambda points: numbers_of(built(points, mesh, TABLE)[0])
    moved = eqx.filter_jit(lambda points: numbers_of(with_points(model, points)))
    host = numbers_of(with_points(model, points + tangent))
    both = jax.tree.leaves(host), jax.tree.leaves(rebuilt(points + tangent))
    for ours, theirs in zip(*both, strict=True):
        size = np.max(np.abs(theirs), initial=0.0)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * size)
        assert isinstance(ours, np.ndarray) == isinstance(theirs, np.ndarray)

    _, slope = jax.jvp(moved, (points,), (tangent,))
    steps = [central_difference(rebuilt, points, tangent, h) for h in (3e-1, 1e-1)]
    changing = []
    leaves = map(jax.tree.leaves, (host, slope, *steps))
    for value, leaf, *differences in zip(*leaves, strict=True):
        rounding = 1e-11 * np.max(np.abs(value), initial=0.0)
        coarse, fine = (
            np.max(np.abs(leaf - each), initial=0.0) for each in differences
        )
        if coarse <= rounding:  # linear in the points, or still
            continue
        # Second order: a third of the step leaves a ninth of the error.
        changing.append(coarse / fine)
    # Modulus, contact areas, surface force, cable, gradients, weights, volumes.
    assert len(changing) == 7
    np.testing.assert_allclose(changing, 9.0, rtol=0.05)


def test_points_set_in_another_way_raise():
    set_points = lambda points: eqx.tree_at(lambda m: m.mesh.points, MODEL, points)
    energy = lambda points: energy_and_force(set_points(points), 0.1 * FAR)[0]
    height = lambda points: jnp.sum(solve_equilibrium(set_points(points), LANE).steps)
    for use in (energy, height, jax.grad(energy), jax.jit(energy)):
        with pytest.raises(ValueError, match="with_points"):
            use(POINTS + TANGENT)
    with pytest.raises(ValueError, match="with_points"):
        lanes(set_points(np.asarray(POINTS + TANGENT)), POSE)


FAR = jnp.zeros((MODEL.n_points, 3))


def test_points_set_where_the_model_is_traced_are_not_used_unnoticed():
    """Values are nan, with their reason; derivatives raise."""
    set_points = lambda model, points: eqx.tree_at(
        lambda m: m.mesh.points, model, points
    )

    @eqx.filter_jit
    def height(model, points):
        solution = solve_equilibrium(set_points(model, points), LANE)
        return jnp.sum(solution.displacement), solution.result

    @eqx.filter_jit
    def energy(model, points):
        return energy_and_force(set_points(model, points), 0.1 * FAR)[0]

    with pytest.raises(ValueError, match="with_points"):
        jax.grad(lambda points: height(MODEL, points)[0])(POINTS)
    for points, known in ((POINTS, True), (ELSEWHERE, False)):
        u, result = height(MODEL, points)
        assert bool(result == RESULTS.other_points) is not known
        assert bool(jnp.isfinite(u)) is known
        assert bool(jnp.isfinite(energy(MODEL, points))) is known


def test_a_program_that_takes_the_model_can_be_kept():
    """JAX keeps none that calls back into Python, as an error in a program does."""
    solve = jax.jit(lambda model, lane: solve_equilibrium(model, lane).displacement)
    assert "callback" not in solve.lower(MODEL, LANE).as_text()


SPREAD = {
    "load": {"loads": SurfaceForce("y_max", (0.0, 0.0, 0.1)), "supports": "x_min"},
    "support": {"supports": Support("x_min", stiffness=1e7)},
}


@pytest.mark.parametrize("kind", SPREAD)
def test_what_is_spread_by_area_does_not_follow_unnoticed(kind):
    pose = Configuration("spread", **SPREAD[kind])
    lane = arrays(MODEL, pose)
    energy = lambda points: jnp.sum(
        solve_equilibrium(with_points(MODEL, points), lane).displacement
    )
    with pytest.raises(ValueError, match="NodalForces"):
        jax.grad(energy)(POINTS)
    anew = lanes(with_points(MODEL, POINTS + TANGENT), pose)[0]
    where = lambda c: c.loads.force if kind == "load" else c.springs.area
    assert not np.allclose(where(anew), where(lane), rtol=1e-3)


def test_lanes_are_not_made_of_points_that_are_traced():
    def made(points):
        return lanes(with_points(MODEL, points), POSE).gravity

    with pytest.raises(ValueError, match=r"'pose' .*outside of jit and autodiff"):
        jax.jit(made)(POINTS)


def test_bad_points():
    with pytest.raises(ValueError, match=r"shape \(2, 3\); expected .*\(16, 3\)"):
        with_points(MODEL, POINTS[:2])
    inside_out = POINTS.at[:, 0].multiply(-1.0)
    with pytest.raises(ValueError, match="inside out"):
        with_points(MODEL, inside_out)
    with pytest.raises(RuntimeError, match="inside out"):
        eqx.filter_jit(lambda x: with_points(MODEL, x).weights)(inside_out)
    law = SofaCorotational.of_mesh(MESH, Isotropic(1e5, 0.3), "large")
    edges = build_model(MESH, law, density=1.0, solver="none")
    with pytest.raises(ValueError, match="SofaCorotational"):
        with_points(edges, POINTS)
