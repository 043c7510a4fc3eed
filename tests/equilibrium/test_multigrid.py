"""Conjugate gradients with multigrid: the direct solver's answer, or a clear no."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    CLAMP,
    DENSITY,
    LENGTH,
    POISSON,
    SIDE,
    TIGHT,
    YOUNG,
    hanging,
    lane,
    small_lanes,
    small_model,
    solve,
    stiffness,
)
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from softcal_jax.actuators import Cable, Guide
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import RESULTS, _solver_choice, build_model, factor_solve
from softcal_jax.equilibrium import _multigrid as multigrid
from softcal_jax.equilibrium._linearisation import linearise
from softcal_jax.materials import ClassicalCorotational, Corotational, Isotropic
from softcal_jax.mesh import beam

pytest.importorskip("pyamg")
compiled = jax.jit(factor_solve)
MESH = beam(LENGTH, SIDE, SIDE, (20, 4, 4))
LAW = Corotational(Isotropic(YOUNG, POISSON))
RHS = jnp.asarray(np.random.default_rng(0).normal(size=(3, MESH.n_nodes, 3)))
REST = jnp.zeros(MESH.points.shape)
HANGING = lane(configuration_arrays(MESH, [hanging()]), 0)
AXIAL = jnp.asarray(MESH.points * np.array([-0.3, 0.0, 0.0]))


def model(solver="multigrid", **changed):
    return build_model(MESH, LAW, density=DENSITY, solver=solver, **changed)


def test_solutions_are_those_of_the_direct_solver():
    ours, theirs = (compiled(model(s), HANGING, REST, RHS) for s in ("multigrid", None))
    assert bool(ours.ok)
    assert int(ours.n_negative) == 0
    scale = float(jnp.max(jnp.abs(theirs.x)))
    # The residual, 1e-10, times what a slender beam makes of it.
    np.testing.assert_allclose(ours.x, theirs.x, rtol=0, atol=1e-8 * scale)


def test_rigid_motions_of_nodes_and_bodies_meet_no_resistance():
    robot = model(bodies=(RigidBody("plate", "x_max"),))
    modes = robot.solver.rigid_motions
    held = lane(configuration_arrays(MESH, [hanging()], robot.mechanism), 0)
    loose = eqx.tree_at(lambda c: c.fixed, held, jnp.zeros_like(held.fixed))
    lin = jax.jit(linearise)(robot, loose, jnp.zeros((robot.n_points, 3)))
    s = robot.solver.sparsity
    K = np.zeros((s.n_dof, s.n_dof))
    K[s.rows, s.indices] = lin.system.values
    K = K + np.triu(K, 1).T
    free = ~np.asarray(lin.unknowns.fixed())
    K, modes = K[np.ix_(free, free)], modes[free]
    assert np.abs(K @ modes).max() < 1e-9 * np.abs(K).max()
    assert np.linalg.matrix_rank(modes) == 6


@pytest.fixture
def counts(monkeypatch):
    """The iterations of each solve."""
    found = []
    cg = multigrid.cg

    def counting(*args, **settings):
        count = [0]
        settings["callback"] = lambda x: count.__setitem__(0, count[0] + 1)
        x = cg(*args, **settings)
        found.append(count[0])
        return x

    monkeypatch.setattr(multigrid, "cg", counting)
    monkeypatch.setattr(multigrid, "_kept", None)
    return found


@pytest.mark.parametrize("bodies", [(), (RigidBody("plate", "x_max"),)])
def test_iterations_do_not_grow_with_the_mesh(bodies, counts):
    for cells in ((40, 8, 8), (60, 12, 12)):
        mesh = beam(LENGTH, SIDE, SIDE, cells)
        body = build_model(
            mesh, LAW, density=DENSITY, bodies=bodies, solver="multigrid"
        )
        lanes = configuration_arrays(mesh, [hanging()], body.mechanism)
        u = jnp.zeros((body.n_points, 3))
        rhs = u.at[mesh.n_nodes // 2].set(1.0)[None]
        assert bool(compiled(body, lane(lanes, 0), u, rhs).ok)
    coarse, fine = counts
    assert fine < 60
    assert fine <= coarse + 10


def test_stiff_parts_cost_few_iterations(counts):
    """A polynomial of the matrix as it is would see nothing of the soft half."""
    stiff = MESH.points[MESH.tets].mean(axis=1)[:, 0] < LENGTH / 2
    young = np.where(stiff, 1e3 * YOUNG, YOUNG)
    for law in (LAW, Corotational(Isotropic(young, POISSON))):
        body = build_model(MESH, law, density=DENSITY, solver="multigrid")
        assert bool(compiled(body, HANGING, REST, RHS[:1]).ok)
    alike, apart = counts
    assert apart <= 2 * alike


def test_equilibria_of_a_batch_are_those_of_the_direct_solver():
    lanes = small_lanes(hanging(), hanging("heavy", factor=3.0))
    ours = solve(small_model("multigrid"), lanes, TIGHT)
    default = solve(small_model(), lanes, TIGHT)
    assert bool(jnp.all(ours.converged))
    scale = float(jnp.max(jnp.abs(default.displacement)))
    np.testing.assert_allclose(
        ours.displacement, default.displacement, rtol=0, atol=1e-9 * scale
    )


def test_a_cable_with_an_imposed_length():
    """The bordered system, by several right-hand sides on one hierarchy."""
    ends = ((LENGTH, SIDE / 2, SIDE / 2), Guide((0.0, SIDE / 2, 3 * SIDE), on="ground"))
    cable = Cable("tendon", ends)
    raised = Configuration(
        "raised",
        CLAMP,
        gravity=(0.0, 0.0, 0.0),
        actuation={"tendon": ImposedDisplacement(1e-3)},
    )
    found = []
    for solver in ("multigrid", None):
        body = model(solver, actuators=(cable,))
        found.append(solve(body, configuration_arrays(MESH, [raised], body.mechanism)))
    ours, theirs = found
    assert bool(jnp.all(ours.converged))
    np.testing.assert_allclose(ours.multipliers, theirs.multipliers, rtol=1e-6)


def test_an_indefinite_matrix_is_refused():
    solved = compiled(model(), HANGING, AXIAL, RHS)
    free = ~np.asarray(HANGING.fixed).ravel()
    K = stiffness(model(None), AXIAL)[np.ix_(free, free)]
    assert np.linalg.eigvalsh(K)[0] < 0.0
    assert not bool(solved.ok)
    assert int(solved.n_negative) == 1
    np.testing.assert_array_equal(solved.x, 0.0)


def test_a_mode_that_no_load_has_is_found():
    """A strut that has buckled sideways in its tangent, under an axial load."""
    strut = lane(configuration_arrays(MESH, [hanging(gravity=(0.0, 0.0, 0.0))]), 0)
    pressed = AXIAL * 0.2
    free = ~np.asarray(strut.fixed).ravel()
    K = stiffness(model(None), pressed)[np.ix_(free, free)]
    assert np.linalg.eigvalsh(K)[0] < 0.0
    axial = jnp.zeros((1, *MESH.points.shape)).at[0, MESH.points[:, 0] > 0.199, 0]
    assert not bool(compiled(model(), strut, pressed, axial.set(-1.0)).ok)


@pytest.mark.parametrize("squeeze", [0.5, 1.0, 2.0, 3.0])
def test_every_negative_eigenvalue_of_a_small_body_is_found(squeeze):
    """So small that there is one matrix, whose inverse is the cycle."""
    mesh = beam(0.1, SIDE, SIDE / 2, (10, 2, 1))
    pressed = jnp.asarray(mesh.points * np.array([-0.3 * squeeze, 0.0, 0.0]))
    held = lane(configuration_arrays(mesh, [hanging()]), 0)
    bodies = (
        build_model(mesh, LAW, density=DENSITY, solver=s) for s in ("multigrid", None)
    )
    rhs = jnp.zeros((1, mesh.n_nodes, 3)).at[..., 2].set(1.0)
    ours, theirs = (compiled(body, held, pressed, rhs) for body in bodies)
    assert int(theirs.n_negative) > 0
    assert not bool(ours.ok)
    assert int(ours.n_negative) == 1


@pytest.mark.parametrize("loaded", [[1.0, 0.0], [0.0, 0.0]])
def test_a_negative_eigenvalue_apart_from_the_load_is_found(loaded):
    """What iterations that start from zero would never meet."""
    stiffness = np.array([2.0, 3.0, 4.0, 5.0, 6.0, -1.0])
    A = sparse.bsr_array(sparse.diags_array(stiffness), blocksize=(3, 3))
    same = LinearOperator(A.shape, matvec=lambda r: r, dtype=A.dtype)
    hierarchy = multigrid._Hierarchy(np.ones(6), A, np.zeros(6, bool), same)
    rhs = np.repeat(loaded, 3)[None]
    with pytest.raises(multigrid._NegativeCurvature):
        multigrid._solve_with(hierarchy, A, rhs)


def test_a_solution_that_is_not_accurate_is_refused(monkeypatch):
    monkeypatch.setattr(multigrid, "_MAX_ITERATIONS", 3)
    monkeypatch.setattr(multigrid, "_kept", None)
    assert not bool(compiled(model(), HANGING, REST, RHS).ok)
    lanes = configuration_arrays(MESH, [hanging()])
    solution = solve(model(), lanes)
    assert not bool(jnp.any(solution.converged))
    assert bool(jnp.all(solution.result == RESULTS.singular))
    assert "iterative solver" in RESULTS[RESULTS.singular]


@pytest.mark.parametrize("direction", [0, 2])
def test_a_slender_body_is_solved_to_rounding(direction):
    """Its residual cannot reach the aim of the iterations, with no solver."""
    mesh = beam(3.0, SIDE, SIDE, (300, 2, 2))
    weight = jnp.zeros((1, mesh.n_nodes, 3)).at[..., direction].set(-1.0)
    held = lane(configuration_arrays(mesh, [hanging()]), 0)
    ours, theirs = (
        compiled(
            build_model(mesh, LAW, density=DENSITY, solver=solver),
            held,
            jnp.zeros(mesh.points.shape),
            weight,
        )
        for solver in ("multigrid", None)
    )
    assert bool(ours.ok)
    scale = float(jnp.max(jnp.abs(theirs.x)))
    np.testing.assert_allclose(ours.x, theirs.x, rtol=0, atol=1e-6 * scale)


FINE = beam(LENGTH, SIDE, SIDE, (40, 8, 8))
"""A body with a matrix between the finest and the coarsest."""


def fine(*configurations):
    """Its model, some lanes, rest and a right-hand side."""
    body = build_model(FINE, LAW, density=DENSITY, solver="multigrid")
    lanes = configuration_arrays(FINE, configurations)
    held = [lane(lanes, index) for index in range(len(configurations))]
    rest = jnp.zeros(FINE.points.shape)
    return body, held, rest, jnp.ones((1, *rest.shape))


def test_a_body_that_nothing_holds_is_refused():
    body, (held,), rest, rhs = fine(hanging())
    loose = eqx.tree_at(lambda c: c.fixed, held, jnp.zeros_like(held.fixed))
    assert not bool(compiled(body, loose, rest, rhs).ok)
    assert multigrid._kept is None  # nobody knows whether it is positive definite


def test_a_matrix_of_nan_is_flagged_and_the_next_is_solved():
    body, (held,), rest, rhs = fine(hanging())
    for u, ok in ((rest + jnp.nan, False), (rest, True)):
        assert bool(compiled(body, held, u, rhs).ok) == ok


@pytest.fixture
def made(monkeypatch):
    """The matrices of which hierarchies are made, none being kept from before."""
    found = []
    make = multigrid._make_hierarchy

    def counting(A, rigid_motions):
        found.append(A)
        return make(A, rigid_motions)

    monkeypatch.setattr(multigrid, "_make_hierarchy", counting)
    monkeypatch.setattr(multigrid, "_kept", None)
    return found


def solve_each(body, states, configurations=(HANGING,)):
    """Solutions at some displacements under some configurations, in turn."""
    return [
        jax.block_until_ready(compiled(body, configuration, u, RHS))
        for configuration in configurations
        for u in states
    ]


def test_similar_matrices_share_a_hierarchy(made):
    states = (REST, -0.03 * AXIAL)
    for u, solved in zip(states, solve_each(model(), states), strict=True):
        theirs = compiled(model(None), HANGING, u, RHS)
        assert bool(solved.ok)
        scale = float(jnp.max(jnp.abs(theirs.x)))
        np.testing.assert_allclose(solved.x, theirs.x, rtol=0, atol=1e-8 * scale)
    assert len(made) == 1


def test_other_matrices_get_another_hierarchy(made):
    solve_each(model(), (REST, -AXIAL, REST))
    assert len(made) == 3


def test_other_supports_get_another_hierarchy(made):
    """Even those that change the matrix as a whole by little."""
    more = hanging("more", supports=(*CLAMP, Support(np.array([FINE.n_nodes // 2]))))
    body, held, rest, rhs = fine(hanging(), more)
    for c in (*held, held[0]):
        jax.block_until_ready(compiled(body, c, rest, rhs))
    assert len(made) == 3


def test_an_indefinite_matrix_leaves_no_hierarchy(made):
    solve_each(model(), (AXIAL, AXIAL))
    assert len(made) == 2


def test_a_hierarchy_that_does_not_serve_is_made_anew(made, monkeypatch):
    far = -10.0 * AXIAL
    fresh = solve_each(model(), (far,))[0]
    monkeypatch.setattr(multigrid, "_kept", None)
    monkeypatch.setattr(multigrid, "_SIMILAR", np.inf)
    monkeypatch.setattr(multigrid, "_MAX_ITERATIONS", 60)
    _, solved = solve_each(model(), (REST, far))
    assert bool(solved.ok)
    np.testing.assert_array_equal(solved.x, fresh.x)
    assert len(made) == 3


def test_the_random_numbers_of_others_stay_as_they_are(monkeypatch):
    found = []
    for seed in (3, 4):
        monkeypatch.setattr(multigrid, "_kept", None)
        numbers = np.random.RandomState(seed).random_sample(3)
        np.random.seed(seed)  # noqa: NPY002
        found.append(solve_each(model(), (REST,))[0].x)
        np.testing.assert_array_equal(np.random.random(3), numbers)  # noqa: NPY002
    np.testing.assert_array_equal(*found)


CLASSICAL = ClassicalCorotational(Isotropic(YOUNG, POISSON))


def test_what_it_cannot_do_is_said():
    with pytest.raises(ValueError, match="for models with a potential"):
        build_model(MESH, CLASSICAL, density=DENSITY, solver="multigrid")


def test_auto_takes_it_for_large_bodies_with_a_potential(monkeypatch):
    direct, iterative = (model(solver).solver.name for solver in (None, "multigrid"))
    assert model("auto").solver.name == direct
    monkeypatch.setattr(_solver_choice, "ITERATIVE_FROM", 3 * MESH.n_nodes)
    assert model("auto").solver.name == iterative
    without = build_model(MESH, CLASSICAL, density=DENSITY, solver="auto")
    assert without.solver.name == direct


def test_without_its_package(monkeypatch):
    monkeypatch.setattr(multigrid, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"pip install 'softcal-jax\[multigrid\]'"):
        model()
