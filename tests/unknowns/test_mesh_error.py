"""What the mesh alone may have moved, against another code and finer meshes."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from refinement import refine

from softcal_jax.actuators import Cable, Motor
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.calibration import Evaluator, build_problem
from softcal_jax.configurations import (
    ActuatorForce,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    PointForce,
    Support,
    SupportReaction,
    SurfaceForce,
)
from softcal_jax.equilibrium import NewtonSettings, Workers, build_model
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.materials import (
    ClassicalCorotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    TransverseHyperelastic,
)
from softcal_jax.mesh import beam, to_quadratic
from softcal_jax.unknowns import MESH, considered_errors

REFERENCE = 6.7812
"""Sag of a silicone cantilever [mm]: mixed hexahedra of FElupe, extrapolated, in
the record of `python -m benchmarks run locking`."""

ONLY_THE_MESH = replace(exactly_known(), mesh=1.0)
TIP = (0.1, 0.015, 0.015)
HANGING = ("x_min", (0.0, 0.0, -9.81))


def posed(law, formulation="auto", cells=(7, 2, 2), at=TIP, order=2, **more):
    """The cantilever of the benchmark, under its own weight and as told."""
    mesh = beam(0.1, 0.03, 0.03, cells, order=order)
    model = build_model(mesh, law, density=1070.0, formulation=formulation)
    seen = Markers(["tip"], [at], 1e-4)
    measured = np.zeros((1, 3))
    pose = Configuration("weight", *HANGING, markers=seen, measured=measured, **more)
    space = ParameterSpace([Parameter("E", "E", 265e3, 1e3, 1e8, unit="Pa")])
    return build_problem(model, space, [pose]), [pose]


def considered_at_start(problem, configurations, apart=True):
    """Readings at the start, and what is said to be wrong with them.

    `apart` tells forces of actuators from the rest.
    """
    z = problem.space.start()
    with Workers(problem.model, len(configurations)) as workers:
        evaluator = Evaluator(problem, workers)
        equilibrium = evaluator.equilibria(z)
        assert np.all(equilibrium.converged)
        weights = lambda p: p.lanes.arrays.effectors.inverse_std
        weighed = eqx.tree_at(weights, problem, jnp.ones_like(weights(problem)))
        read = evaluator.effectors(z, equilibrium)
        errors = considered_errors(
            workers,
            replace(weighed, uncertain=ONLY_THE_MESH),
            z=z,
            equilibrium=equilibrium,
            without_forces=evaluator.without_forces(z, equilibrium) if apart else [],
        )
        return read, errors


def both_by_pose(problem, configurations):
    """Readings at the start, and what the mesh is said to do to them."""
    read, errors = considered_at_start(problem, configurations)
    n_c = len(configurations)
    return read, errors.of(MESH).sum(axis=1).reshape(n_c, -1)


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
    tip, std = errors_of(*posed(NeoHookean(265e3, 0.499), formulation))
    off = tip[2] + REFERENCE
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
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("nu", [0.3, 0.499])
@pytest.mark.parametrize("cells", [(10, 4, 4), (14, 4, 4)])
def test_it_is_right_to_a_factor_of_two(cells, nu, order):
    """Linear tets a fifth too stiff, quadratic ones some permille stiff or soft."""
    tip, std = errors_of(*posed(NeoHookean(265e3, nu), cells=cells, order=order))
    off = {0.3: 7.0236, 0.499: REFERENCE}[nu] + tip[2]
    assert 0.5 < std[2] / -off < 2.0


@pytest.mark.slow
def test_so_it_is_under_large_loads():
    """Bent by over a quarter of its length, where a linear body shows no error in x."""
    pushed = {"loads": [SurfaceForce("x_max", (0.0, 0.0, -1.1))], "at": (0.1, 0.0, 0.0)}
    (tip, std), (fine, _) = (
        errors_of(*posed(NeoHookean(265e3, 0.3), cells=cells, **pushed))
        for cells in ((4, 1, 1), (16, 4, 4))
    )
    assert np.linalg.norm(tip) > 25.0
    apart = fine - tip
    assert 0.5 < np.linalg.norm(std) / np.linalg.norm(apart) < 2.0
    assert std @ apart > 0.95 * np.linalg.norm(std) * np.linalg.norm(apart)


def stretched(mesh, law, formulation="auto", pull=0.2):
    """A bar between rollers, stretched evenly; a marker inside, and the force."""
    sides = [Support(name, axis) for name, axis in (("y_min", "y"), ("z_min", "z"))]
    ends = [Support("x_min", "x"), Support("x_max", "x", (pull * mesh.size, 0.0, 0.0))]
    pose = Configuration(
        "pose",
        [*sides, *ends],
        gravity=(0.0, 0.0, 0.0),
        markers=Markers(["m"], [(0.03, 0.02, 0.01)], 1e-4),
        measured=np.zeros((1, 3)),
        effectors=[SupportReaction("force", "x_max")],
    )
    model = build_model(mesh, law, density=1000.0, formulation=formulation)
    density = Parameter("density", "density", 1000.0, 500.0, 2000.0, unit="kg/m3")
    exact = NewtonSettings(rtol=1e-12)
    problem = build_problem(model, ParameterSpace([density]), [pose], exact)
    return both_by_pose(problem, [pose])


@pytest.mark.parametrize(
    ("order", "formulation"),
    [
        (1, "displacement"),
        (2, "displacement"),
        pytest.param(2, "mean-dilatation", marks=pytest.mark.slow),
    ],
)
def test_an_even_stretch_has_no_error(order, formulation):
    """The patch test: every mesh gets it right, and the estimate says so."""
    mesh = beam(0.1, 0.02, 0.02, (3, 2, 1), order=order)
    # One program with the jump of the material, which has a modulus per tet.
    law = NeoHookean(np.full(mesh.n_tets, 2e5), 0.3)
    read, of_mesh = stretched(mesh, law, formulation)
    assert np.max(np.abs(read)) > 1.0  # newtons
    np.testing.assert_allclose(of_mesh, 0.0, atol=1e-7)


def test_a_jump_of_the_material_is_no_error():
    """Two halves in parallel, each with an even stress, if the mesh names them."""
    mesh = beam(0.1, 0.02, 0.02, (3, 2, 1), order=1)
    left = mesh.centroids[:, 1] < 0.01
    law = NeoHookean(np.where(left, 2e5, 8e5), 0.0)
    named = mesh.with_tet_group("left", np.flatnonzero(left))
    (_, apart), (_, smeared) = (stretched(m, law, pull=1e-3) for m in (named, mesh))
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    assert np.max(np.abs(smeared)) > 1e-4


def test_a_robot_without_a_tet_that_deforms_has_no_error():
    """All of it is one body, which hangs from a motor without torque."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    all_nodes = np.arange(mesh.n_nodes)
    body = RigidBody("all", all_nodes, origin=(0.0, 0.01, 0.01), axes=axes)
    law, motor = NeoHookean(2e5, 0.3), Motor("motor", "all")
    model = build_model(mesh, law, density=1000.0, bodies=[body], actuators=[motor])
    pose = Configuration(
        "hanging",
        gravity=(9.81, 0.0, 0.0),
        markers=Markers(["m"], [(0.1, 0.01, 0.02)], 1e-4),
        measured=np.zeros((1, 3)),
        actuation={"motor": ImposedForce(0.0)},
    )
    density = Parameter("density", "density", 1000.0, 500.0, 2000.0, unit="kg/m3")
    problem = build_problem(model, ParameterSpace([density]), [pose])
    _, errors = considered_at_start(problem, [pose])
    assert MESH not in errors.causes


TIP_BODY = RigidBody("tip", "x_max")
CABLE = Cable("cable", [(0.0, 0.01, 0.015), (0.06, 0.01, 0.015)])
LEANING = Fibre(0.4, plane="xz")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "setup"),
    [
        (1, {"gravity": (0.0, 0.0, -9.81)}),
        (2, {"gravity": (0.0, 0.0, -9.81)}),
        (2, {"loads": SurfaceForce("z_max", (0.0, 1e-2, -1e-2))}),
        (2, {"actuation": {"cable": ImposedForce(0.5)}}),
        (2, {"actuation": {"cable": ImposedDisplacement(2e-3)}}),
        (2, {"bodies": {"tip": Pose((0.0, 0.0, 3e-3), (0.0, 2e-2, 0.0))}}),
        (2, {"bodies": {"tip": Pose((0.0, 0.0, 0.0), (0.3, 0.0, 0.0))}}),
    ],
)
def test_readings_change_like_this_on_a_finer_mesh(order, setup):
    """Whatever loads or moves: fibres askew, a graded modulus, a body at the end.

    Markers where no motion is imposed, and the force there where one is.
    """
    coarse = beam(0.1, 0.02, 0.02, (6, 2, 2), order=order)
    fine = refine(to_quadratic(coarse)) if order == 1 else refine(coarse)
    E_t = 3e5 * (1.0 + coarse.centroids[:, 0] / 0.15)
    driven = setup.get("actuation", {}).get("cable")
    imposed = "bodies" in setup or isinstance(driven, ImposedDisplacement)
    force = (
        SupportReaction("force", "x_min")
        if "bodies" in setup
        else ActuatorForce("force", "cable")
    )
    pose = Configuration(
        "pose",
        "x_min",
        setup.get("gravity", (0.0, 0.0, 0.0)),
        setup.get("loads", ()),
        Markers(["m", "n"], [(0.05, 0.0, 0.02), (0.08, 0.02, 0.0)], 1e-4),
        np.zeros((2, 3)),
        effectors=[force],
        bodies=setup.get("bodies", {}),
        actuation=setup.get("actuation", {}),
    )
    problems = []
    for mesh in (coarse, fine):
        each = np.repeat(E_t, mesh.n_tets // coarse.n_tets)
        law = TransverseHyperelastic(E_t=each, E_l=6e5, nu=0.2, mu_l=1e5, fibre=LEANING)
        robot = {"bodies": [TIP_BODY], "actuators": [CABLE]}
        model = build_model(mesh, law, density=1000.0, **robot)
        space = ParameterSpace([Parameter("E_l", "E_l", 6e5, 1e5, 1e6, unit="Pa")])
        problems.append(build_problem(model, space, [pose]))
    (read, std), (exact, _) = (
        [np.ravel(rows) for rows in both_by_pose(p, [pose])] for p in problems
    )
    seen = slice(6, 9) if imposed else slice(0, 6)
    off, std = (exact - read)[seen], std[seen]
    size, said = np.linalg.norm(off), np.linalg.norm(std)
    assert 0.5 * said < size < 2.0 * said
    assert off @ std > 0.95 * size * said


def test_actuation_has_an_error_of_its_own():
    """That of the weight is the one of the pose without it, and both sum to it all."""
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1), order=1)
    model = build_model(mesh, NeoHookean(2e5, 0.3), density=1000.0, actuators=[CABLE])
    pulled = Configuration(
        "pulled",
        *HANGING,
        markers=Markers(["m"], [(0.1, 0.01, 0.01)], 1e-4),
        measured=np.zeros((1, 3)),
        actuation={"cable": ImposedForce(0.5)},
    )
    hanging = replace(pulled, name="hanging", actuation={"cable": ImposedForce(0.0)})
    poses = [pulled, replace(hanging, name="idle", gravity=(0.0, 0.0, 0.0)), hanging]
    space = ParameterSpace([Parameter("E", "E", 2e5, 1e5, 1e6, unit="Pa")])
    problem = build_problem(model, space, poses, NewtonSettings(rtol=1e-10))
    _, errors = considered_at_start(problem, poses)
    _, together = considered_at_start(problem, poses, apart=False)
    assert errors.names == ("locking", "locking by actuation")
    assert set(errors.causes) == {MESH}
    of_weight, by_cable = errors.values.T.reshape(2, 3, 3)
    np.testing.assert_allclose(of_weight[0], of_weight[2], rtol=1e-6)
    assert np.all(by_cable[1:] == 0.0)
    sums = np.ravel(of_weight + by_cable)
    np.testing.assert_allclose(sums, together.values[:, 0], rtol=1e-12, atol=1e-15)
    assert np.linalg.norm(by_cable[0]) > 0.1 * np.linalg.norm(of_weight[0])


CORNERS = [(0.1, y, z) for y in (0.0, 0.03) for z in (0.0, 0.03)]
TWIST = [
    PointForce(c, (0.0, 0.1 * np.sign(0.015 - c[2]), 0.1 * np.sign(c[1] - 0.015)))
    for c in CORNERS
]
STIFF_ALONG = FibreReinforced(NeoHookean(1e5, 0.3), 1e7, Fibre(0.0, plane="xy"))
TURNED = {"at": (0.05, 0.015, 0.03), "loads": TWIST}


@pytest.mark.slow
@pytest.mark.parametrize("cells", [(5, 1, 1), (6, 2, 2), (10, 2, 2)])
@pytest.mark.parametrize(
    ("law", "axis", "setup"),
    [
        (NeoHookean(265e3, 0.3), 1, TURNED),
        (STIFF_ALONG, 1, TURNED),
        (STIFF_ALONG, 2, {}),
        (ClassicalCorotational(Isotropic(265e3, 0.3)), 2, {}),
    ],
    ids=["torsion", "torsion of stiff fibres", "stiff fibres", "no potential"],
)
def test_what_is_no_locking_of_the_volume_is_seen(law, axis, setup, cells):
    """One and two tets across against four: up to 18 % too stiff."""
    (tip, std), (exact, _) = (
        errors_of(*posed(law, cells=grid, **setup)) for grid in (cells, (20, 4, 4))
    )
    off = exact[axis] - tip[axis]
    assert abs(off) > 0.005 * abs(exact[axis])
    assert 0.5 < std[axis] / off < 2.0
