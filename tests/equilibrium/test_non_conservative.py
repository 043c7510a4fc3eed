"""A law without a potential: full tangent, residual norm, transposed solves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    TIGHT,
    factor_solve,
    force_jacobian,
    lane,
    solve,
    solve_as_users,
    stiffness,
)
from classical_beam import (
    E_T,
    ELASTICITIES,
    HUNDRED_G,
    LANES,
    LENGTH,
    LIFTED_50_G,
    LIFTED_200_G,
    LINEAR,
    MESH,
    ONE_G,
    TIP,
    TWENTY_G,
    assert_same_shapes,
    body,
    hanging,
    solution,
)
from problems import nearest_node

from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import (
    RESULTS,
    NewtonSettings,
    build_model,
    linearise,
    residual,
    solve_equilibrium,
)
from softcal_jax.materials import ClassicalCorotational, Corotational, Isotropic

PACKAGES = {"pardiso": "pardiso_mkl_jax", "klu": "klujax"}
each_solver = pytest.mark.parametrize(
    "solver", ["pardiso", pytest.param("klu", marks=pytest.mark.slow)]
)


@pytest.mark.slow
def test_the_model_has_the_property_not_the_name_of_the_law():
    assert body(Corotational).conservative
    classical = body(ClassicalCorotational)
    assert not classical.conservative
    # It stays in full, whatever law it is given; exact tangents go either way.
    with_potential = classical.with_law(Corotational(ELASTICITIES["fibre"]))
    assert not with_potential.conservative
    both = solve(with_potential, LANES, TIGHT)
    assert bool(jnp.all(both.converged))
    assert_same_shapes(both, solution(Corotational))


def test_all_lanes_converge_and_nothing_is_said_about_stability():
    classical = solution(ClassicalCorotational)
    assert bool(jnp.all(classical.converged))
    assert bool(jnp.all(classical.residual <= TIGHT.rtol))
    assert bool(jnp.all(classical.n_negative == -1))
    # Full steps: the residual goes up by four orders at first, and is let.
    assert bool(jnp.all(classical.load_steps[:HUNDRED_G] == 1))
    assert bool(jnp.all(classical.steps[:HUNDRED_G] <= 12))


def assert_sound(index):
    """No tet nearly inverted, and on the branch of the law with a potential."""
    classical = lane(solution(ClassicalCorotational), index)
    assert float(classical.min_det_F) > 0.5
    exact = lane(solution(Corotational), index)
    off = jnp.max(jnp.abs(classical.displacement - exact.displacement))
    assert float(off) < 0.05 * LENGTH


def test_no_step_turns_a_tet_inside_out():
    """At 100 g whole steps would end at det F = -0.5, a state that is not sound."""
    assert_sound(HUNDRED_G)


def test_load_steps_lead_where_full_steps_do_not():
    """At 200 g with its end lifted, where no part of a step lowers the residual."""
    assert int(solution(ClassicalCorotational).load_steps[LIFTED_200_G]) > 1
    assert_sound(LIFTED_200_G)
    at_once = NewtonSettings(rtol=1e-12, smallest_load_step=0.6)
    refused = lane(solve(body(ClassicalCorotational), LANES, at_once), LIFTED_200_G)
    assert refused.result == RESULTS.inverted  # what every step would end in
    assert int(refused.load_steps) == 0


def test_isotropic_classical_is_the_energy_consistent_law():
    """The term that the classical law drops is zero there; the paths differ.

    Isotropic by equal moduli, so that it takes the programs of the other tests.
    """
    strain = jnp.asarray([[0.3, 0.1, -0.2], [0.1, -0.1, 0.05], [-0.2, 0.05, 0.2]])
    equal, isotropic = (
        ELASTICITIES[name].stress(strain) for name in ("equal moduli", "isotropic")
    )
    np.testing.assert_allclose(equal, isotropic, rtol=0, atol=1e-9 * E_T)
    classical = solution(ClassicalCorotational, "equal moduli")
    assert bool(jnp.all(classical.converged))
    assert_same_shapes(classical, solution(Corotational, "equal moduli"))


def test_how_far_the_classical_tip_is_off():
    """Measured 1.11 mm on a deflection of 60 mm under weight, mostly out of plane."""
    tip = nearest_node(MESH, TIP)
    exact, classical = (
        1e3 * solution(law).displacement[ONE_G, tip]
        for law in (Corotational, ClassicalCorotational)
    )
    off = classical - exact
    np.testing.assert_allclose(jnp.linalg.norm(exact), 60.3, rtol=1e-2)
    np.testing.assert_allclose(jnp.linalg.norm(off), 1.11, rtol=1e-2)
    np.testing.assert_allclose(off[2], 1.11, rtol=1e-2)


def relative_asymmetry(model, u):
    K = stiffness(model, u)
    return np.linalg.norm(K - K.T) / np.linalg.norm(K)


def bent(mesh):
    """A displacement with large rotations and some strain [m]."""
    x, y, _ = mesh.points.T
    return jnp.asarray(np.stack([-8.0 * x * y, 4.0 * x**2, 0.05 * x], axis=1))


def test_the_assembled_tangent_is_the_jacobian_of_the_force():
    """All of it, also what is not symmetric; nothing is where C is isotropic."""
    model, u = body(ClassicalCorotational, mesh="linear"), bent(LINEAR)
    K = stiffness(model, u)
    exact = np.asarray(force_jacobian(model, u)).reshape(K.shape)
    np.testing.assert_allclose(K, exact, rtol=0, atol=1e-12 * np.abs(K).max())
    v = np.linspace(-1.0, 1.0, model.n_dof)
    pose = lane(configuration_arrays(LINEAR, [hanging(1.0)]), 0)
    Kv = linearise(model, pose, u).stiffness(jnp.asarray(v).reshape(u.shape))
    np.testing.assert_allclose(
        np.ravel(Kv), K @ v, rtol=0, atol=1e-12 * np.abs(K).max()
    )
    assert relative_asymmetry(model, u) > 1e-3
    isotropic = body(ClassicalCorotational, "isotropic", mesh="linear")
    assert relative_asymmetry(isotropic, u) < 1e-14


@each_solver
@pytest.mark.parametrize("transpose", [False, True])
def test_solves_with_the_matrix_and_its_transpose(solver, transpose):
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    model, u = body(ClassicalCorotational, mesh="linear", solver=solver), bent(LINEAR)
    c = lane(configuration_arrays(LINEAR, [hanging(1.0)]), 0)
    rhs = np.random.default_rng(0).normal(size=(3, LINEAR.n_nodes, 3))
    compiled = jax.jit(factor_solve, static_argnames="transpose")
    solved = compiled(model, c, u, jnp.asarray(rhs), transpose=transpose)
    assert bool(solved.ok)
    assert int(solved.n_negative) == -1
    free = ~np.asarray(c.fixed).ravel()
    K = stiffness(model, u)[np.ix_(free, free)]
    x = np.linalg.solve(K.T if transpose else K, rhs.reshape(3, -1)[:, free].T).T
    ours = np.asarray(solved.x).reshape(3, -1)
    np.testing.assert_allclose(ours[:, free], x, rtol=0, atol=1e-9 * np.abs(x).max())
    np.testing.assert_array_equal(ours[:, ~free], 0.0)


@each_solver
def test_bad_matrices_are_flagged(solver):
    """Not finite, and singular; the process lives."""
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    model = body(ClassicalCorotational, mesh="linear", solver=solver)
    c = lane(configuration_arrays(LINEAR, [hanging(1.0)]), 0)
    rhs, rest = jnp.ones((1, LINEAR.n_nodes, 3)), jnp.zeros(LINEAR.points.shape)
    compiled = jax.jit(factor_solve)
    where = lambda m: m.law.elasticity.E_t
    broken = eqx.tree_at(where, model, jnp.asarray(jnp.nan, float))
    solved = compiled(broken, c, rest, rhs)
    assert not bool(solved.ok)
    np.testing.assert_array_equal(solved.x, 0.0)
    loose = eqx.tree_at(lambda c: c.fixed, c, jnp.zeros(LINEAR.points.shape, bool))
    solved = compiled(model, loose, rest, rhs)
    # Rounding may hide the singularity; then the solution is huge, not plausible.
    assert not bool(solved.ok) or float(jnp.max(jnp.abs(solved.x))) > 1e6


def test_the_tangent_at_equilibrium_is_not_symmetric():
    """Measured 0.10 % of its norm under weight and 0.45 % at 20 g."""
    states = solution(ClassicalCorotational).displacement
    model = body(ClassicalCorotational)
    ours = [relative_asymmetry(model, states[i]) for i in (ONE_G, TWENTY_G)]
    np.testing.assert_allclose(ours, [9.8e-4, 4.5e-3], rtol=0.02)


@pytest.mark.parametrize("law", [ClassicalCorotational, Corotational])
def test_newton_steps_converge_quadratically(law):
    """From a nearby shape; with the symmetric part alone they converge linearly."""
    model, c = body(law), lane(LANES, TWENTY_G)
    goal = solution(law).displacement[TWENTY_G]

    @jax.jit
    def step(u):
        return u + factor_solve(model, c, u, -residual(model, c, u)[None]).x[0]

    errors, u = [], 1.01 * goal
    for _ in range(4):
        u = step(u)
        errors.append(float(jnp.max(jnp.abs(u - goal))) / LENGTH)
    before, after = np.array(errors[:-1]), np.array(errors[1:])
    # A slender body has a large constant: a rotation stretches it at second order.
    assert np.all(after <= 1e3 * before**2 + 1e-12)
    assert errors[-1] < 1e-12


@each_solver
def test_the_solvers_agree(solver):
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    ours = solution(ClassicalCorotational, solver=solver)
    assert bool(jnp.all(ours.converged))
    assert_same_shapes(ours, solution(ClassicalCorotational))


def test_load_stepping_ends_where_full_steps_end():
    """At 50 g, with too few Newton steps for the whole load at once."""
    hurried = NewtonSettings(rtol=1e-12, max_steps_per_load=7)
    stepped = lane(solve(body(ClassicalCorotational), LANES, hurried), LIFTED_50_G)
    assert bool(stepped.converged)
    assert int(stepped.load_steps) > 2
    at_once = lane(solution(ClassicalCorotational), LIFTED_50_G)
    assert int(at_once.load_steps) == 1
    tip = nearest_node(MESH, TIP)
    assert float(at_once.displacement[tip, 1]) < -0.9 * LENGTH
    assert_same_shapes(stepped, at_once)


# For a law with a potential it is in test_batch.py.
@pytest.mark.slow
def test_a_member_alone_gives_bit_for_bit_the_same():
    together = solve_as_users(body(ClassicalCorotational), LANES, TIGHT)
    for index in range(6):
        one = lane(LANES, np.array([index]))
        alone = solve_as_users(body(ClassicalCorotational), one, TIGHT)
        np.testing.assert_array_equal(
            alone.displacement[0], together.displacement[index]
        )
        np.testing.assert_array_equal(alone.steps[0], together.steps[index])


def test_a_law_without_potential_is_not_taken_where_one_is_needed():
    model, law = (
        body(Corotational, mesh="linear"),
        ClassicalCorotational(ELASTICITIES["fibre"]),
    )
    message = r"ClassicalCorotational .*potential, .*build_model"
    with pytest.raises(ValueError, match=message):
        model.with_law(law)
    # Also where the law was put in past `with_law`.
    smuggled = eqx.tree_at(lambda m: m.law, model, law)
    c = lane(configuration_arrays(LINEAR, [hanging(1.0)]), 0)
    with pytest.raises(ValueError, match=message):
        solve_equilibrium(smuggled, c)


def test_mean_dilatation_needs_a_potential():
    message = r'"mean-dilatation" .*potential.*="displacement"'
    law = ClassicalCorotational(Isotropic(E_T, 0.495))
    for formulation in ("mean-dilatation", "auto"):
        with pytest.raises(ValueError, match=message):
            build_model(MESH, law, density=1.0, formulation=formulation)
    model = build_model(MESH, law, density=1.0, formulation="displacement")
    assert model.formulation == "displacement"
