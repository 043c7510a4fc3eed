"""A body that touches itself, or another part of it: `build_model(touching=...)`."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import meshio
import numpy as np
import pytest
from problems import both_ways, central_difference
from scipy.spatial.transform import Rotation
from wording import says

from softcal_jax.actuators import Chamber
from softcal_jax.bodies import RigidBody
from softcal_jax.calibration import simulation_result
from softcal_jax.configurations import (
    Configuration,
    ContactForce,
    ImposedForce,
    Support,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    effector_values,
    no_equilibrium,
    outcome_words,
    robot_states,
    solve_equilibrium,
    with_points,
)
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import product
from softcal_jax.materials import Corotational, Isotropic, NeoHookean
from softcal_jax.mesh import (
    TetMesh,
    beam,
    boundary_faces,
    boundary_tets,
    face_areas,
    face_indices,
    self_contact,
)
from softcal_jax.results import write_vtu

E, NU, SIDE, SCALE = 1e5, 0.3, 0.02, 1e-5
LAW = Corotational(Isotropic(E, NU))
NO_WEIGHT = (0.0, 0.0, 0.0)
TIGHT = NewtonSettings(rtol=1e-12)


def joined(lower, upper):
    """Two meshes as one, of two parts, with the flat faces between them."""
    n, z = lower.n_nodes, lower.points[:, 2].max()
    points = np.concatenate([lower.points, upper.points])
    tets = np.concatenate([lower.tets, upper.tets + n])
    mesh = TetMesh(points, tets)
    faces = boundary_faces(mesh)
    flat = np.ptp(points[faces][..., 2], axis=1) < 1e-9
    height, below = points[faces[:, 0], 2], faces.max(axis=1) < n
    named = {
        "low": flat & below & np.isclose(height, z),
        "high": flat & ~below & np.isclose(height, upper.points[:, 2].min()),
    }
    for name, chosen in named.items():
        mesh = mesh.with_surface_group(name, faces[chosen])
    x, y, z = points.T
    sides = {"x_min": x == 0.0, "y_min": y == 0.0, "z_min": z == 0.0}
    for name, chosen in {**sides, "z_max": np.isclose(z, z.max())}.items():
        mesh = mesh.with_node_group(name, np.flatnonzero(chosen))
    return mesh


def moved(mesh, by):
    return replace(mesh, points=mesh.points + by)


def two_blocks(order=2, cells=((2, 2, 2), (3, 3, 2)), gap=0.0):
    lower, upper = (beam(SIDE, SIDE, SIDE, n, order=order) for n in cells)
    return joined(lower, moved(upper, [0.0, 0.0, SIDE + gap]))


def solved(model, pose, settings=TIGHT):
    solution = solve_equilibrium(model, pose, settings=settings)
    assert bool(solution.converged), str(solution)
    return solution


def pairs_of(model):
    touching = model.mechanism.contacts.touching
    assert touching is not None
    return touching


def felt(model, pose, solution):
    batch = jax.tree.map(lambda leaf: leaf[None], solution)
    (state,) = robot_states(model, [pose], batch)
    return {contact.name: contact for contact in state.contacts}


PRESSED = -1e-3
BLOCKS = build_model(
    two_blocks(), LAW, density=0.0, touching=[("low", "high")], contact_scale=SCALE
)
SQUEEZE = Configuration(
    "squeeze",
    [
        *(Support("x_min", "x"), Support("y_min", "y"), Support("z_min", "z")),
        Support("z_max", "z", displacement=(0.0, 0.0, PRESSED)),
    ],
    effectors=[ContactForce("force", "low on high", (0, 0, 1))],
    gravity=NO_WEIGHT,
)


def test_two_blocks_are_as_stiff_as_one_of_both():
    """Their meshes do not match; P = E (l - 1) of the corotational law."""
    contact = felt(BLOCKS, SQUEEZE, solved(BLOCKS, SQUEEZE))["low on high"]
    force = SIDE**2 * E * -PRESSED / (2.0 * SIDE)
    np.testing.assert_allclose(contact.force[2], force, rtol=0.01)
    np.testing.assert_allclose(contact.force[:2], 0.0, atol=1e-4 * force)
    assert contact.area == pytest.approx(SIDE**2)
    assert abs(contact.depth) < SCALE
    # In the middle of the surface, which has grown wider.
    half = 0.5 * SIDE * (1.0 + NU * -PRESSED / (2.0 * SIDE)) * force
    np.testing.assert_allclose(contact.moment, (half, -half, 0.0), rtol=0.01, atol=1e-6)


def test_pressure_on_each_surface_adds_up_to_the_force(tmp_path):
    """Points of either surface carry half of the force, so that the mean is exact.

    Those of one alone carry a little more or less, on so few faces that do not match.
    """
    solution = jax.tree.map(lambda leaf: leaf[None], solved(BLOCKS, SQUEEZE))
    (result,) = simulation_result(BLOCKS, [SQUEEZE], solution).configurations
    file, mesh = tmp_path / "a.vtu", BLOCKS.mesh
    write_vtu(file, BLOCKS, result.displacement, state=result.robot)
    pressure = np.array(meshio.read(file).cell_data["contact_pressure"][0])
    forces = []
    for name in ("low", "high"):
        faces = mesh.faces(name)
        tets = boundary_tets(mesh)[face_indices(faces, boundary_faces(mesh))]
        forces.append(face_areas(mesh, faces)[0].sum(axis=1) @ pressure[tets])
        pressure[tets] = 0.0
    (contact,) = result.robot.contacts
    np.testing.assert_allclose(forces, contact.force[2], rtol=0.07)
    np.testing.assert_allclose(np.mean(forces), contact.force[2], rtol=1e-3)
    assert not pressure.any()


def test_a_solve_that_fails_says_which_surfaces_touch_and_where():
    solution = solve_equilibrium(BLOCKS, SQUEEZE, settings=NewtonSettings(max_steps=2))
    text = no_equilibrium(solution, ("squeeze",))
    assert says(text, "'squeeze'", "at 0 % of the load", '"low on high" near', "20) mm")
    assert "slides" not in text
    assert "low on high" not in outcome_words(solved(BLOCKS, SQUEEZE))


@pytest.mark.slow
def test_points_that_lie_over_edges_leave_the_tangent_finite():
    """Meshes that match have points over edges, where two faces are the nearest."""
    mesh = two_blocks(order=1, cells=((1, 1, 2), (2, 2, 2)))
    model = build_model(
        mesh, LAW, density=0.0, touching=[("low", "high")], contact_scale=SCALE
    )
    solution = solved(model, SQUEEZE)
    assert float(solution.rounding) < 1e-10
    force = SIDE**2 * E * -PRESSED / (2.0 * SIDE)
    contact = felt(model, SQUEEZE, solution)["low on high"]
    np.testing.assert_allclose(contact.force[2], force, rtol=0.01)


def crumpled(model, seed=0):
    """Random places of nodes, with the surfaces of two blocks in each other."""
    random = np.random.default_rng(seed)
    u = 2e-5 * random.normal(size=(model.n_points, 3))
    return jnp.asarray(u)


def posed(model):
    pose = replace(SQUEEZE, effectors=())
    return Posed.of(model, configuration_arrays(model.mesh, [pose], model.mechanism)[0])


@pytest.mark.parametrize("order", [1, 2])
def test_energy_forces_and_tangent_are_derivatives_of_each_other(order):
    mesh = two_blocks(order)
    model = build_model(
        mesh, LAW, density=0.0, touching=[("high", "low")], contact_scale=1e-4
    )
    # Beside and over an edge of each other too.
    above = mesh.points[:, 2] > 1.001 * SIDE
    above |= np.isin(np.arange(mesh.n_nodes), mesh.nodes("high"))
    turn, centre = Rotation.from_rotvec([0.02, -0.01, 0.3]), [0.01, 0.01, SIDE]
    x = mesh.points - centre
    shift = turn.apply(x) - x + [0.004, 0.003, -5e-5]
    u = crumpled(model) + np.where(above[:, None], shift, 0.0)
    at = posed(model)
    touch = pairs_of(model)._touched(model.positions(u), jnp.array(1e-4))
    assert 20 < (touch.pair >= 0).sum() < touch.pair.size - 20

    v = jnp.asarray(np.random.default_rng(1).normal(size=u.shape))
    energy, force = (lambda u, k=k: at.contact(u)[k] for k in (0, 1))
    _, slope = jax.jvp(energy, (u,), (v,))
    np.testing.assert_allclose(slope, jnp.sum(force(u) * v), rtol=1e-10)
    stiffness = at.contact_tangent(u, jnp.zeros(model.pattern.nnz), tamed=0)
    of_tangent = product(model.pattern, stiffness, v.ravel()).reshape(v.shape)
    _, of_force = jax.jvp(force, (u,), (v,))
    size = float(jnp.abs(of_force).max())
    np.testing.assert_allclose(of_tangent, of_force, atol=1e-10 * size)
    off = [
        jnp.abs(central_difference(force, u, v, h) - of_force).max() / size
        for h in (1e-7, 1e-8)
    ]
    assert off[0] < 1e-6
    assert off[1] < 0.05 * off[0]  # at second order


def test_forces_are_equal_and_opposite_on_one_line():
    u = crumpled(BLOCKS)
    x, force = np.asarray(BLOCKS.positions(u)), np.asarray(posed(BLOCKS).contact(u)[1])
    size = np.abs(force).sum()
    assert size > 1.0
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-14 * size)
    np.testing.assert_allclose(np.cross(x, force).sum(axis=0), 0.0, atol=1e-15 * size)


def test_a_rigid_motion_changes_nothing():
    u = crumpled(BLOCKS)
    turn = Rotation.from_rotvec([1.0, -2.0, 1.5])
    x = np.array(BLOCKS.positions(u))
    turned = turn.apply(x) + 0.3 - BLOCKS.mesh.points
    at = posed(BLOCKS)
    energy, force, _ = at.contact(u)
    other, rotated, _ = at.contact(jnp.asarray(turned))
    np.testing.assert_allclose(other, energy, rtol=1e-8)
    size = float(jnp.abs(force).max())
    np.testing.assert_allclose(rotated, turn.apply(np.array(force)), atol=1e-8 * size)


def test_which_surface_is_named_first_changes_only_the_sign():
    mesh = BLOCKS.mesh
    model = build_model(
        mesh, LAW, density=0.0, touching=[("high", "low")], contact_scale=SCALE
    )
    u = crumpled(model)
    (forth,), (back,) = (posed(m).contact_states(u) for m in (BLOCKS, model))
    assert (forth.name, back.name) == ("low on high", "high on low")
    np.testing.assert_allclose(back.force, -forth.force, rtol=1e-12)
    np.testing.assert_allclose(back.moment, -forth.moment, rtol=1e-12)


@pytest.mark.slow
def test_derivatives_of_a_touching_state_are_exact():
    """By the modulus, and by the points; forward is reverse."""
    mesh = two_blocks(order=1, cells=((1, 1, 1), (2, 2, 1)))
    model = build_model(
        mesh, LAW, density=0.0, touching=[("low", "high")], contact_scale=1e-4
    )
    lane = configuration_arrays(mesh, [SQUEEZE], model.mechanism)[0]
    points = jnp.asarray(mesh.points)
    crooked = 0.01 * points * points[:, [1, 2, 0]] / SIDE

    def force(p):
        law = Corotational(Isotropic(E * (1.0 + p[0]), NU))
        new = replace(with_points(model, points + p[1] * crooked), law=law)
        u = solve_equilibrium(new, lane, settings=TIGHT).displacement
        return effector_values(new, lane, u)[-1, 0]

    at, along = jnp.zeros(2), jnp.array([0.7, 1.0])
    value, forward, reverse = both_ways(force)(at, along, jnp.ones(()))
    assert abs(value) > 1.0
    np.testing.assert_allclose(reverse @ along, forward, rtol=1e-10)
    assert (jnp.abs(reverse) > 1e-3).all()
    # The error falls at second order, to that of the solve.
    difference = central_difference(force, at, along, 1e-2)
    np.testing.assert_allclose(difference, forward, rtol=1e-6)


# A fold: an arm over a slit, and its mirror image.
LENGTH, WIDTH, SLIT = 0.06, 0.01, 0.004


def arm():
    box = beam(LENGTH, WIDTH, 2.5 * SLIT, (12, 2, 5), order=2)
    x, _, z = box.centroids.T
    used, tets = np.unique(box.tets[(x < 0.01) | (z > 0.5 * SLIT)], return_inverse=True)
    return TetMesh(box.points[used], tets.reshape(-1, 10))


def with_mirror_image(mesh):
    n, on = mesh.n_nodes, mesh.points[:, 2] < 1e-9
    image = np.where(on, np.arange(n), n + np.cumsum(~on) - 1)
    points = np.concatenate([mesh.points, mesh.points[~on] * [1.0, 1.0, -1.0]])
    other = image[mesh.tets][:, [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
    return TetMesh(points, np.concatenate([mesh.tets, other]))


def with_walls(mesh):
    faces = boundary_faces(mesh)
    X = mesh.points[faces]
    x, z = X[..., 0].min(axis=1), X[..., 2]
    at = lambda height: np.isclose(z, height).all(axis=1)
    groups = {
        "upper": at(0.5 * SLIT) & (x > 0.0099),
        "lower": at(-0.5 * SLIT) & (x > 0.0099),
        "top": at(2.5 * SLIT) & (x > 0.8 * LENGTH),
        "bottom": at(-2.5 * SLIT) & (x > 0.8 * LENGTH),
    }
    for name, chosen in groups.items():
        if chosen.any():
            mesh = mesh.with_surface_group(name, faces[chosen])
    held = {"root": mesh.points[:, 0] < 1e-9, "cut": abs(mesh.points[:, 2]) < 1e-9}
    for name, chosen in held.items():
        mesh = mesh.with_node_group(name, np.flatnonzero(chosen))
    return mesh


HALF = with_walls(arm())
FOLD = with_walls(with_mirror_image(arm()))
PUSH = SurfaceForce("top", (0.0, 0.0, -0.03)), SurfaceForce("bottom", (0.0, 0.0, 0.03))
CLOSED = Configuration("closed", ["root"], loads=PUSH, gravity=NO_WEIGHT)


@pytest.mark.slow
def test_a_fold_closes_as_its_half_on_a_mirror():
    fold = build_model(
        FOLD, LAW, density=0.0, touching=[("upper", "lower")], contact_scale=2e-5
    )
    solution = solved(fold, CLOSED)
    contact = felt(fold, CLOSED, solution)["upper on lower"]
    mirror = RigidBody("mirror", shape=HalfSpace())
    half = build_model(HALF, LAW, density=0.0, bodies=[mirror], contact_scale=2e-5)
    plane = [Support("cut", "z")]
    pose = Configuration("half", ["root", *plane], loads=PUSH[:1], gravity=NO_WEIGHT)
    n = HALF.n_nodes
    u, of_half = (
        np.asarray(s.displacement)[:n] for s in (solution, solved(half, pose))
    )
    most = np.abs(of_half).max()
    assert most > 0.4 * SLIT
    np.testing.assert_allclose(u, of_half, atol=0.01 * most)
    assert contact.force[2] < -0.01
    assert contact.area > 1e-5
    # Nothing passes through; without contact it would.
    free = build_model(FOLD, LAW, density=0.0)
    passed = np.asarray(solved(free, CLOSED).displacement)
    assert self_contact(FOLD, np.asarray(solution.displacement)) is None
    assert self_contact(FOLD, passed) is not None


def cavity(cells=(8, 8, 5)):
    """A pad around a flat cavity."""
    side, height = 0.024, 0.005
    box = beam(side, side, height, cells, order=2)
    middle = np.abs(box.centroids - [side / 2, side / 2, height / 2])
    inside = (middle < [side / 4, side / 4, height / 10]).all(axis=1)
    used, tets = np.unique(box.tets[~inside], return_inverse=True)
    mesh = TetMesh(box.points[used], tets.reshape(-1, 10))
    faces = boundary_faces(mesh)
    X = mesh.points[faces]
    within = (X > 1e-9) & (X < [side - 1e-9, side - 1e-9, height - 1e-9])
    wall = within.any(axis=1).all(axis=1)
    mesh = mesh.with_surface_group("cavity", faces[wall])
    bottom = np.flatnonzero(mesh.points[:, 2] == 0.0)
    return mesh.with_node_group("bottom", bottom)


@pytest.mark.slow
def test_a_chamber_that_is_sucked_flat_converges():
    """The pressure goes on pulling at both walls; a surface can touch itself."""
    mesh = cavity()
    model = build_model(
        mesh,
        NeoHookean(E, 0.4),
        density=0.0,
        actuators=[Chamber("c", "cavity")],
        touching=[("cavity", "cavity")],
    )
    vacuum = 2e4
    suction = {"c": ImposedForce(-vacuum)}
    pose = Configuration("flat", ["bottom"], actuation=suction, gravity=NO_WEIGHT)
    solution = solved(model, pose, NewtonSettings())
    contact = felt(model, pose, solution)["cavity on cavity"]
    assert contact.depth < 2.0 * float(model.mechanism.contacts.scale)
    # What the pressure pushes together where they touch, and more around it.
    force = abs(contact.force[2])
    assert vacuum * contact.area < force < 2.0 * vacuum * contact.area
    # Nodes between the points of such large faces are deeper, which is no overlap.
    assert self_contact(mesh, np.asarray(solution.displacement)) is not None
    batch = jax.tree.map(lambda leaf: leaf[None], solution)
    (result,) = simulation_result(model, [pose], batch).configurations
    assert result.self_contact is None


def test_a_step_that_leads_through_a_wall_is_seen():
    mesh = two_blocks(gap=1e-3)
    model = build_model(mesh, LAW, density=0.0, touching=[("low", "high")])
    upper = (
        np.arange(mesh.n_nodes)
        >= mesh.n_nodes - beam(1, 1, 1, (3, 3, 2), order=2).n_nodes
    )
    still, at = jnp.zeros((mesh.n_nodes, 3)), posed(model)
    for way, passes in ((9e-4, False), (1.1e-3, False), (8e-3, True), (0.06, True)):
        step = jnp.asarray(np.where(upper[:, None], [0.0, 0.0, -way], 0.0))
        assert bool(at.passes_through(still, step)) == passes
    # Aside, past each other.
    aside = jnp.asarray(np.where(upper[:, None], [0.05, 0.0, -0.02], 0.0))
    beside = jnp.asarray(np.where(upper[:, None], [0.05, 0.0, 0.0], 0.0))
    assert not bool(at.passes_through(beside, aside))


def test_faces_of_one_body_or_with_a_common_node_never_touch():
    mesh = two_blocks()
    plate = RigidBody("plate", np.union1d(mesh.nodes("low"), mesh.nodes("high")))
    with pytest.raises(ValueError, match=r"'low'.*'high'.*touching.*rigid body"):
        build_model(mesh, LAW, density=0.0, bodies=[plate], touching=[("low", "high")])
    faces = pairs_of(BLOCKS)
    for a, b in faces.faces[faces.ends]:
        assert not set(a) & set(b)


def test_surfaces_that_cannot_touch_are_refused():
    mesh = two_blocks()
    build = lambda **options: build_model(mesh, LAW, density=0.0, **options)
    with pytest.raises(ValueError, match=r"'hi'.*high"):
        build(touching=[("low", "hi")])
    with pytest.raises(ValueError, match="no face of 'low' can meet one of 'low'"):
        build(touching=[("low", "low")])
    with pytest.raises(ValueError, match=r"touching_reach .*positive.*-1"):
        build(touching=[("low", "high")], touching_reach=-1.0)


@pytest.mark.parametrize("overlap", [0.0, 1e-4])
def test_surfaces_that_overlap_at_rest_are_refused(overlap):
    """Those that lie on each other are not."""
    mesh = two_blocks(order=1, cells=((1, 1, 1), (2, 2, 1)), gap=-overlap)
    model = build_model(mesh, LAW, density=0.0, touching=[("low", "high")])
    make = lambda: configuration_arrays(mesh, [SQUEEZE], model.mechanism)
    if overlap == 0.0:
        make()
    else:
        with pytest.raises(ValueError, match=r"'squeeze'.*0\.1 mm.*low on high"):
            make()


def test_a_larger_reach_has_more_pairs():
    pairs = []
    for reach in (4e-3, 8e-3, 1.0):
        model = build_model(
            two_blocks(),
            LAW,
            density=0.0,
            touching=[("low", "high")],
            touching_reach=reach,
            solver="none",
        )
        pairs.append(len(pairs_of(model).ends))
    assert pairs[0] < pairs[1] < pairs[2] == 8 * 18


def test_a_model_without_surfaces_that_touch_is_as_before():
    mesh = beam(SIDE, SIDE, SIDE, (1, 1, 1))
    model = build_model(mesh, LAW, density=0.0)
    assert model.mechanism.contacts.touching is None
    assert model.contact_at == ()
