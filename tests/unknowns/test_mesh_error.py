"""What the mesh alone may have moved, against another code and finer meshes."""

from dataclasses import replace

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from softcal_jax.actuators import Cable, Motor
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.calibration import (
    build_problem,
    evaluate,
    simulated_measurements,
)
from softcal_jax.configurations import (
    ActuatorForce,
    Centroid,
    Configuration,
    EdgeForce,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    PointForce,
    Support,
    SupportReaction,
    SurfaceForce,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    NewtonSettings,
    Workers,
    build_model,
    refined_model,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.materials import (
    ClassicalCorotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    TransverseHyperelastic,
)
from softcal_jax.mesh import beam, finer, refine, to_quadratic
from softcal_jax.unknowns import MESH, Setting, _mesh_error, considered_errors

REFERENCE = 6.7812
"""Sag of a silicone cantilever [mm]: mixed hexahedra of FElupe, extrapolated, in
the record of `python -m benchmarks run locking`."""

ONLY_THE_MESH = replace(exactly_known(), mesh=1.0)
TIP = (0.1, 0.015, 0.015)
HANGING = ("x_min", (0.0, 0.0, -9.81))


def posed(law, formulation="auto", cells=(7, 2, 2), at=TIP, **more):
    """The cantilever of the benchmark, under its own weight and as told."""
    mesh = beam(0.1, 0.03, 0.03, cells, order=2)
    model = build_model(mesh, law, density=1070.0, formulation=formulation)
    seen = Markers(["tip"], [at], 1e-4)
    measured = np.zeros((1, 3))
    pose = Configuration("weight", *HANGING, markers=seen, measured=measured, **more)
    space = ParameterSpace([Parameter("E", "E", 265e3, 1e3, 1e8, unit="Pa")])
    return build_problem(model, space, [pose]), [pose]


def considered_at_start(problem, configurations):
    """Readings at the start, and what is said to be wrong with them."""
    z = problem.space.start()
    at = evaluate(problem, z)
    assert np.all(at.equilibrium.converged)
    with Workers(problem.model, len(configurations)) as workers:
        setting = Setting(
            problem.model,
            problem.space,
            configurations,
            problem.configurations,
            ONLY_THE_MESH,
        )
        errors = considered_errors(workers, setting, z=z, equilibrium=at.equilibrium)
        return at.effectors, errors


def both_by_pose(problem, configurations):
    """Readings at the start, and what the mesh is said to do to them."""
    read, found = considered_at_start(problem, configurations)
    n_c = len(configurations)
    of_mesh = found.in_std(n_c, np.ones(np.shape(read))).of(MESH)
    return read, of_mesh.reshape(n_c, -1)


def errors_of(problem, configurations):
    """Displacement of the tip, and what the mesh is said to do to it [mm]."""
    read, of_mesh = both_by_pose(problem, configurations)
    tip = np.asarray(read).reshape(-1, 3)[0]
    tip = tip - configurations[0].markers.positions[0]
    return 1e3 * tip, 1e3 * of_mesh.reshape(-1, 3)[0]


@pytest.mark.parametrize(
    "formulation",
    ["displacement", pytest.param("mean-dilatation", marks=pytest.mark.slow)],
)
def test_the_exact_solution_is_within_two_standard_deviations(formulation):
    """And the error is not overstated."""
    own, std = errors_of(*posed(NeoHookean(265e3, 0.499), formulation))
    off = own[2] + REFERENCE
    assert 0.5 * abs(std[2]) < abs(off) < 2.0 * abs(std[2])
    # One is too stiff, the other too soft.
    assert np.sign(off) == (1.0 if formulation == "displacement" else -1.0)
    assert np.sign(std[2]) == -np.sign(off)


@pytest.mark.slow
def test_it_is_of_the_order_of_the_element():
    """Halved cells have a quarter of the error, in the benchmark and as estimated."""
    law = NeoHookean(265e3, 0.3)
    coarse, fine = (
        errors_of(*posed(law, cells=cells))[1][2] for cells in ((7, 2, 2), (14, 4, 4))
    )
    assert 3.5 < coarse / fine < 4.8


@pytest.mark.slow
def test_large_loads_move_as_far_as_they_do():
    """Bent by over a quarter of its length; both meshes are solved to the end."""
    pushed = {"loads": [SurfaceForce("x_max", (0.0, 0.0, -1.1))], "at": (0.1, 0.0, 0.0)}
    (own, std), (fine, _) = (
        errors_of(*posed(NeoHookean(265e3, 0.3), cells=cells, **pushed))
        for cells in ((4, 1, 1), (8, 2, 2))
    )
    assert np.linalg.norm(own) > 25.0
    apart = np.linalg.norm(fine - own)
    assert np.linalg.norm(std) == pytest.approx(apart, rel=0.25)


BODY = RigidBody("tip", "x_max")
CABLE = Cable("cable", [(0.0, 0.01, 0.02), (0.06, 0.01, 0.02)])
MOVED = Support("x_min", "xyz", (0.0, 1e-5, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_it_is_the_change_on_a_finer_mesh(order):
    """Of all that loads and moves: small motions of the same robot, meshed anew.

    The finer robot is built from its parts, with groups that the refined mesh names.
    """
    coarse = beam(0.1, 0.02, 0.02, (3, 1, 1), order=order)
    law = TransverseHyperelastic(
        E_t=np.linspace(3e5, 5e5, coarse.n_tets),
        E_l=6e5,
        nu=0.2,
        mu_l=1e5,
        fibre=Fibre(0.4, plane="xz"),
    )
    finer_mesh = to_quadratic(coarse) if order == 1 else refine(coarse)
    each = finer_mesh.n_tets // coarse.n_tets
    finer_law = replace(law, E_t=np.repeat(law.E_t, each))
    pose = Configuration(
        "pose",
        MOVED,
        (0.0, 0.0, -1e-3),
        SurfaceForce("z_max", (0.0, 1e-5, -1e-5)),
        Markers(["m"], [(0.05, 0.01, 0.02)], 1e-4),
        np.zeros((1, 3)),
        bodies={"tip": Pose((0.0, 0.0, 3e-5), (0.0, 2e-4, 0.0))},
        actuation={"cable": ImposedDisplacement(2e-5)},
    )
    models = [
        build_model(mesh, own, density=1000.0, bodies=[BODY], actuators=[CABLE])
        for mesh, own in ((coarse, law), (finer_mesh, finer_law))
    ]
    space = ParameterSpace([Parameter("E_l", "E_l", 6e5, 1e5, 1e6, unit="Pa")])
    exact = NewtonSettings(rtol=1e-12)
    (own,), (fine,) = (
        simulated_measurements(model, [pose], newton=exact) for model in models
    )
    _, change = errors_of(build_problem(models[0], space, [pose], exact), [pose])
    apart = 1e3 * np.ravel(fine.measured - own.measured)
    np.testing.assert_allclose(change, apart, rtol=0, atol=2e-3 * max(abs(change)))


CLAMP = "x_min"
PAD = Support("x_max", "xyz", (0.0, 0.0, 1e-5), stiffness=1e6)
LOAD = SurfaceForce("z_max", (0.0, 1e-5, -1e-5))
SEEN = (
    Centroid("middle", "z_max"),
    SupportReaction("cell", "x_min"),
    ActuatorForce("tension", "cable"),
)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_it_is_that_of_each_of_many_configurations(order):
    """Held in turns, with pads and without; readings of forces stay out of scale.

    An elastic pad carries what the body does not, and the tension of a cable whose
    displacement is imposed grows with the stiffness.
    """
    coarse = beam(0.1, 0.02, 0.02, (3, 1, 1), order=order)
    fine = to_quadratic(coarse) if order == 1 else refine(coarse)
    posed = [
        Configuration(
            f"pose {k}",
            (CLAMP, PAD) if k % 2 else (CLAMP,),
            (0.0, 0.0, -1e-3 * (k + 1)),
            LOAD,
            Markers(["m"], [(0.05, 0.01, 0.02)], 1e-4),
            effectors=SEEN,
            actuation={"cable": ImposedDisplacement(1e-5 * k)},
        )
        for k in range(1, 6)
    ]
    models = [
        build_model(mesh, NeoHookean(2e5, 0.3), density=1000.0, actuators=[CABLE])
        for mesh in (coarse, fine)
    ]
    space = ParameterSpace([Parameter("E", "E", 2e5, 1e5, 1e6, unit="Pa")])
    exact = NewtonSettings(rtol=1e-12)
    own, other = (simulated_measurements(m, posed, newton=exact) for m in models)
    _, changes = both_by_pose(build_problem(models[0], space, own, exact), own)
    for change, c, f in zip(changes, own, other, strict=True):
        by_marker = np.ravel(f.measured - c.measured)
        largest = np.max(np.abs(by_marker))
        np.testing.assert_allclose(change[:3], by_marker, atol=5e-3 * largest)
        apart = float(f.effectors[2].measured) - float(c.effectors[2].measured)
        np.testing.assert_allclose(change[-6], apart, rtol=5e-3)


def test_groups_mean_what_they_did_on_the_coarse_mesh():
    """Edges by their corners, means over nodes and reactions."""
    coarse = beam(0.1, 0.02, 0.02, (1, 1, 1), order=2)
    corners = np.flatnonzero(coarse.points[:8, 0] > 0.0)
    r = finer(coarse)
    pose = Configuration(
        "pose",
        "x_min",
        loads=[EdgeForce(corners, (0.0, 0.0, -1.0))],
        effectors=[Centroid("c", "x_max"), SupportReaction("r", "x_min")],
    )
    alike = _mesh_error._as_found(pose, r)
    lanes = [
        configuration_lanes(*own).arrays
        for own in ((coarse, [pose]), (r.mesh, [alike]))
    ]
    force = [np.asarray(own.loads.force)[0, 0] for own in lanes]
    u = np.asarray(jr.normal(jr.key(0), coarse.points.shape))
    work = np.sum(force[0] * u), np.sum(force[1] * np.concatenate([u, r.carried(u)]))
    assert work[0] == pytest.approx(work[1], rel=1e-12)
    seen = lanes[1].effectors
    used = lambda nodes, weights: np.asarray(nodes)[np.asarray(weights) > 0.0]
    centre = used(seen.nodes[0, 0], seen.weights[0, 0])
    np.testing.assert_array_equal(centre, coarse.nodes("x_max"))
    summed = used(seen.reaction_nodes, seen.reaction_weights)
    np.testing.assert_array_equal(summed, r.mesh.nodes("x_min"))


def test_posts_that_were_short_enough_are_so_on_the_finer_mesh():
    """Of the greatest length, where one mesh rounds up and the other down."""
    coarse = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    r, refused = finer(coarse), 0
    for x in np.linspace(0.0, 0.1, 101):
        markers = Markers(["m"], [(x, 0.007, 0.03)], 1e-4)
        pose = Configuration("pose", "x_min", markers=markers)
        try:
            configuration_lanes(coarse, [pose])
        except ValueError:
            continue
        configuration_lanes(r.mesh, [_mesh_error._as_found(pose, r)])
        try:
            configuration_lanes(r.mesh, [pose])
        except ValueError:
            refused += 1
    assert refused > 0, "else this says nothing"


def test_a_slack_cable_does_nothing_at_rest():
    """Its displacement is imposed, but without a force; that of a taut one stays."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1))
    cables = [replace(CABLE, name=name) for name in ("taut", "slack")]
    model = build_model(mesh, NeoHookean(2e5, 0.3), density=1e3, actuators=cables)
    imposed = {name: ImposedDisplacement(1e-3) for name in ("taut", "slack")}
    pose = Configuration("pose", "x_min", actuation=imposed)
    batch, _ = configuration_lanes(mesh, [pose], model.mechanism)
    forces = jnp.array([[0.1, 0.0]])
    seen = _mesh_error._comparable(model, batch, forces).actuation
    np.testing.assert_array_equal(seen.by_displacement, [[True, False]])
    np.testing.assert_array_equal(seen.value, [[1e-3, 0.0]])


def test_constants_of_the_finer_model_are_those_of_the_parent():
    """One per tet, and one for all; a law without a potential, too."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    per_tet = 0.1 + 1e-3 * np.arange(mesh.n_tets)
    law = NeoHookean(2e5, per_tet)
    model = build_model(mesh, law, density=1e3)
    fine, _ = refined_model(model)
    np.testing.assert_array_equal(fine.law.nu, np.repeat(per_tet, 8))
    np.testing.assert_array_equal(fine.law.E, 2e5)
    classical = ClassicalCorotational(Isotropic(2e5, 0.49))
    linear = build_model(beam(0.1, 0.02, 0.02, (3, 1, 1)), classical, density=1e3)
    assert refined_model(linear)[0].formulation == "displacement"


@pytest.mark.slow
def test_where_only_weight_keeps_the_rest_shape_nothing_is_known():
    """A beam that hangs from a motor without torque: at rest it turns freely."""
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    body = RigidBody("arm", "x_min", origin=(0.0, 0.01, 0.01), axes=axes)
    model = build_model(
        beam(0.1, 0.02, 0.02, (3, 1, 1), order=2),
        NeoHookean(2e5, 0.3),
        density=1000.0,
        bodies=[body],
        actuators=[Motor("motor", "arm")],
    )
    pose = Configuration(
        "hanging",
        gravity=(9.81, 0.0, 0.0),
        loads=LOAD,
        markers=Markers(["m"], [(0.1, 0.01, 0.02)], 1e-4),
        measured=np.zeros((1, 3)),
        actuation={"motor": ImposedForce(0.0)},
    )
    space = ParameterSpace([Parameter("E", "E", 2e5, 1e5, 1e6, unit="Pa")])
    _, found = considered_at_start(build_problem(model, space, [pose]), [pose])
    assert found.in_std(1, np.ones((1, 1, 3))).causes == ()
    assert found.unknown(1) == (MESH,)


CORNERS = [(0.1, y, z) for y in (0.0, 0.03) for z in (0.0, 0.03)]
TWIST = [
    PointForce(c, (0.0, 0.1 * np.sign(0.015 - c[2]), 0.1 * np.sign(c[1] - 0.015)))
    for c in CORNERS
]
STIFF_ALONG = FibreReinforced(NeoHookean(1e5, 0.3), 1e7, Fibre(0.0, plane="xy"))


@pytest.mark.slow
@pytest.mark.parametrize("cells", [(5, 1, 1), (10, 2, 2)])
@pytest.mark.parametrize(
    ("law", "axis", "told"),
    [
        (NeoHookean(265e3, 0.3), 1, {"at": (0.05, 0.015, 0.03), "loads": TWIST}),
        (STIFF_ALONG, 2, {}),
        (ClassicalCorotational(Isotropic(265e3, 0.3)), 2, {}),
    ],
    ids=["torsion", "stiff fibres", "no potential"],
)
def test_what_is_no_locking_of_the_volume_is_seen(law, axis, told, cells):
    """One and two tets across against four: up to 15 % too stiff."""
    (own, std), (exact, _) = (
        errors_of(*posed(law, cells=own, **told)) for own in (cells, (20, 4, 4))
    )
    off = abs(exact[axis]) - abs(own[axis])
    assert off > 0.005 * abs(exact[axis])
    assert 0.5 * abs(std[axis]) < off < 2.0 * abs(std[axis])
