"""Equilibrium from a good guess: what the careful solve gives, in fewer steps."""

from dataclasses import replace
from functools import partial
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import TIGHT, factor_solve, lane, solve

from softcal_jax.configurations import (
    Configuration,
    Support,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    build_model,
    continue_equilibrium,
    internal_force,
    residual,
    solve_equilibrium,
    tangent_values,
)
from softcal_jax.equilibrium._assembly import newton_terms, no_strains, predict
from softcal_jax.equilibrium._continuation import MAX_QUICK_STEPS, SHARP
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._sparsity import Sparsity, product
from softcal_jax.materials import (
    Corotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
)
from softcal_jax.mesh import TetMesh, beam

MESH = beam(4.0, 1.0, 1.0, (4, 1, 1))
# Of unit modulus and no Poisson's ratio: a bar carries 0.19245 in compression at most,
# at 1 / sqrt(3) of its length.
MODEL = build_model(MESH, StVenantKirchhoff(Isotropic(1.0, 0.0)), density=1.0)
CLAMP = Support("x_min")
STRAIGHT = Support(np.arange(MESH.n_nodes), axes="yz")


def hanging(weight, *supports):
    name = f"{weight} {len(supports)}"
    return Configuration(name, (CLAMP, *supports), (0.0, 1e-3, -weight))


def pressed(displacement=None, load=0.0, weight=0.0):
    """A bar that can only be shortened, by a support that moves or by a force."""
    end = () if displacement is None else (Support("x_max", "x", displacement),)
    push = SurfaceForce("x_max", (-load, 0.0, 0.0))
    return Configuration(
        f"{displacement} {load}", (CLAMP, STRAIGHT, *end), (weight, 0.0, 0.0), push
    )


LIFTED = Support("x_max", "z", (0.0, 0.0, 0.3))
LANES = configuration_arrays(
    MESH,
    [
        hanging(4e-3),
        hanging(4.2e-3),
        hanging(4e-3, LIFTED),
        pressed((-2.4, 0.0, 0.0), weight=1e-3),
        pressed((-8.0, 0.0, 0.0)),
        pressed(load=0.25),
    ],
)
HANGING, HEAVIER, MOVED, UNSTABLE, TURNED, CRUSHED = range(6)
SHAPE = MESH.points.shape
DEAD = jax.random.normal(jax.random.key(0), SHAPE)


def forces(model, configuration, u):
    """One that is always the same, one that follows u, and one that vanishes."""
    return jnp.stack([DEAD, u * DEAD, residual(model, configuration, u)])


class Continued(NamedTuple):
    """An equilibrium, solutions for further right-hand sides there, and K x."""

    equilibrium: EquilibriumSolution
    x: jax.Array
    ok: jax.Array
    pull: jax.Array


def with_solutions(done, right_hand_sides) -> Continued:
    """Solve for nodal forces that are a function of the displacement."""
    equilibrium, lin = done
    b = jax.vmap(lin.free)(right_hand_sides(lin.u))
    solved = lin.solve(b, jnp.zeros((len(b), lin.system.active.size)))
    x = lin.scatter(solved.x)
    return Continued(equilibrium, x, solved.ok, lin.stiffness(x[0]))


def continued(model, configuration, guess, settings=TIGHT, precise=False):
    return _continued(model, configuration, guess, settings, precise)


@jax.jit
def _continued(model, configuration, guess, settings, precise):
    done = continue_equilibrium(
        model, configuration, guess, settings=settings, precise=precise
    )
    return with_solutions(done, lambda u: forces(model, configuration, u))


@jax.jit
def further(model, configuration, u):
    return factor_solve(model, configuration, u, forces(model, configuration, u))


@pytest.fixture(scope="module")
def careful():
    """All lanes from rest, to rounding."""
    return solve(MODEL, LANES, TIGHT)


def assert_same(done, index, careful, *, rtol):
    """Displacement to the residual, solutions to the last Newton step's size."""
    u = careful.displacement[index]
    size = float(jnp.max(jnp.abs(u)))
    assert bool(done.ok)
    assert bool(done.equilibrium.result == RESULTS.converged)
    np.testing.assert_allclose(
        done.equilibrium.displacement, u, rtol=0, atol=rtol * size
    )
    expected = further(MODEL, lane(LANES, index), u).x
    for ours, theirs in zip(done.x[:2], expected[:2], strict=True):
        size = float(jnp.max(jnp.abs(theirs)))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.01 * size)
    np.testing.assert_array_equal(
        np.where(LANES.fixed[index], np.asarray(done.x), 0.0), 0.0
    )


def test_a_step_on_the_factor_takes_a_solution_to_rounding(careful):
    """It costs no factorization: the compliances need the factor anyway."""
    loose = replace(TIGHT, rtol=1e-5)
    solved = lane(solve(MODEL, LANES, loose), HANGING)
    done = continued(MODEL, lane(LANES, HANGING), solved.displacement, settings=loose)
    assert int(done.equilibrium.steps) == 1
    before, after = float(solved.residual), float(done.equilibrium.residual)
    assert 1e-9 < before <= loose.rtol
    assert after < 1e-2 * before
    assert_same(done, HANGING, careful, rtol=1e-6)
    expected = further(MODEL, lane(LANES, HANGING), done.equilibrium.displacement).x
    scale = float(jnp.max(jnp.abs(expected)))
    np.testing.assert_allclose(done.x, expected, rtol=0, atol=1e-4 * scale)


def test_from_a_good_guess_in_a_few_steps(careful):
    """From the equilibrium under a tenth less weight."""
    done = continued(MODEL, lane(LANES, HEAVIER), careful.displacement[HANGING])
    solution = done.equilibrium
    assert 1 < int(solution.steps) <= 3 < int(careful.steps[HEAVIER])
    assert float(solution.residual) <= TIGHT.rtol
    assert int(solution.n_negative) == 0
    assert (int(solution.load_steps), float(solution.load_reached)) == (1, 1.0)
    np.testing.assert_allclose(
        solution.min_det_F, careful.min_det_F[HEAVIER], rtol=0, atol=1e-5
    )
    # A slender body: rtol of the forces is some hundred times that of the shape.
    assert_same(done, HEAVIER, careful, rtol=1e-4)


def test_right_hand_sides_are_those_of_the_equilibrium(careful):
    """The residual as one: it gives the next Newton step, not the last one."""
    guess = careful.displacement[HANGING]
    done = continued(MODEL, lane(LANES, HEAVIER), guess)
    moved = float(jnp.max(jnp.abs(done.equilibrium.displacement - guess)))
    assert float(jnp.max(jnp.abs(done.x[2]))) < 1e-4 * moved


def test_forces_of_a_motion_are_those_of_the_equilibrium(careful):
    """Those of the last Newton step are off by its way, like the solutions."""
    there = lane(LANES, HEAVIER)
    done = continued(MODEL, there, careful.displacement[HANGING])
    u = done.equilibrium.displacement
    slope = jax.jit(lambda u, x: jax.jvp(partial(residual, MODEL, there), (u,), (x,)))
    _, pull = slope(u, done.x[0])
    scale = np.max(np.abs(pull))
    np.testing.assert_allclose(done.pull, pull, rtol=0, atol=1e-11 * scale)


def test_solutions_are_those_of_the_end_where_they_shall_be_precise(careful):
    """By the factor before the last step and refinement; else off by its way."""
    guess, there = careful.displacement[HANGING], lane(LANES, HEAVIER)
    quick, exact = (continued(MODEL, there, guess, precise=p) for p in (False, True))
    assert int(exact.equilibrium.steps) == int(quick.equilibrium.steps)
    off = []
    for done in (quick, exact):
        expected = further(MODEL, there, done.equilibrium.displacement).x[:2]
        gap = jnp.max(jnp.abs(done.x[:2] - expected))
        off.append(float(gap / jnp.max(jnp.abs(expected))))
    assert off[1] < 1e-6 < off[0]


def test_the_last_digits_come_from_the_factor_that_is_there(careful):
    """Where Newton's method factorizes a second time."""
    u, heavier = careful.displacement[HANGING], careful.displacement[HEAVIER]
    guess = heavier + 1e-3 * (u - heavier)
    done = continued(MODEL, lane(LANES, HEAVIER), guess)
    assert int(done.equilibrium.steps) == 1
    assert float(done.equilibrium.residual) <= TIGHT.rtol
    plain = solve_equilibrium(MODEL, lane(LANES, HEAVIER), guess=guess, settings=TIGHT)
    assert int(plain.steps) == 2
    assert_same(done, HEAVIER, careful, rtol=1e-6)


def test_at_the_equilibrium_one_step_is_enough(careful):
    done = continued(MODEL, lane(LANES, HANGING), careful.displacement[HANGING])
    assert int(done.equilibrium.steps) == 1
    assert_same(done, HANGING, careful, rtol=1e-9)


SLENDER = beam(4.0, 0.1, 0.1, (20, 1, 1), order=2)
BEAM = build_model(SLENDER, Corotational(Isotropic(1.0, 0.3)), density=1.0)
SOFTER = 0.6
UNDER_WEIGHT = lane(
    configuration_arrays(SLENDER, [Configuration("w", (CLAMP,), (0.0, 0.0, -3e-5))]), 0
)


@jax.jit
def softened(E, guess, before):
    model = BEAM.with_law(Corotational(Isotropic(E, 0.3)))
    done = continue_equilibrium(
        model, UNDER_WEIGHT, guess, settings=TIGHT, before=before
    )
    return with_solutions(done, lambda u: -internal_force(BEAM, u)[None])


@pytest.mark.slow
def test_a_long_step_of_a_slender_beam_is_closed_in_quick_steps():
    """From an extrapolation in the modulus, with and without where it began.

    The modulus falls by 40 %, and the tip sinks by more than an eighth of the length.
    """
    law = lambda E: BEAM.with_law(Corotational(Isotropic(jnp.asarray(E), 0.3)))
    u, expected = (
        solve_equilibrium(law(E), UNDER_WEIGHT, settings=TIGHT).displacement
        for E in (1.0, SOFTER)
    )
    first = softened(1.0, u, u)
    # Per unit of the modulus: K du/dE = -f, the internal force at E = 1.
    guess = u + (SOFTER - 1.0) * first.x[0]
    plain, ours = (softened(SOFTER, guess, before) for before in (guess, u))
    moved = float(jnp.max(jnp.abs(expected - u)))
    assert moved > 0.5
    assert bool(ours.ok)
    np.testing.assert_allclose(
        ours.equilibrium.displacement, expected, rtol=0, atol=1e-4 * moved
    )
    assert not bool(plain.equilibrium.converged)


def terms(model, u, strains):
    """Tangent and force of a step with strains of its own."""
    return newton_terms(model, u, jnp.zeros_like(u), strains, jnp.zeros((), bool))


def test_the_tangent_keeps_the_stress_that_a_step_foresaw():
    """For St. Venant-Kirchhoff by hand: S is linear in E, and E quadratic in F.

    K(u, strains) - K(u) = -sum w (dN_a . D dN_b) I, D = C : dF^T dF / 2 of the step;
    the force is that of u, since S(E) + C : (E(u) - E) = S(E(u)).
    """
    tet = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)[None])
    model = build_model(tet, StVenantKirchhoff(Isotropic(1.0, 0.0)), density=1.0)
    before, u = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4, 3)) * 0.1)
    change = (u - before)[1:].T - (u - before)[:1].T  # dF: the gradients are the axes
    D = 0.5 * change.T @ change  # without Poisson's ratio stress is E times strain
    dN = np.vstack([-np.ones(3), np.eye(3)])
    expected = -np.kron(dN @ D @ dN.T, np.eye(3)) / 6.0
    pattern = model.pattern
    yes = jnp.ones((), bool)
    strains, sound = predict(model, before, u - before, no_strains(model), yes)
    assert bool(sound)
    force, exact = internal_force(model, u), tangent_values(model, u)
    values, same_force = terms(model, u, strains)
    ours = np.asarray(expected)[pattern.rows, pattern.indices]
    np.testing.assert_allclose(values - exact, ours, rtol=0, atol=1e-15)
    np.testing.assert_allclose(same_force, force, rtol=0, atol=1e-15)
    for here, there in zip(
        newton_terms(model, u, force, strains, yes), (exact, force), strict=True
    ):
        np.testing.assert_array_equal(here, there)


LAWS = {
    "displacement": NeoHookean(1.0, 0.3),
    "mean-dilatation": NeoHookean(1.0, 0.49),
    "fibre": FibreReinforced(NeoHookean(1.0, 0.49), 5.0, Fibre(0.3, plane="xy")),
}


def turned_cube(name):
    """A model of one cube, a large displacement, and a step."""
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1), order=2)
    formulation = "displacement" if name == "displacement" else "mean-dilatation"
    model = build_model(mesh, LAWS[name], density=1.0, formulation=formulation)
    rng = np.random.default_rng(1)
    return model, *jnp.asarray(0.05 * rng.normal(size=(2, *mesh.points.shape)))


def along(model, values, d):
    return product(model.pattern, values, d.ravel()).reshape(d.shape)


@pytest.mark.parametrize("name", LAWS)
def test_what_a_step_takes_of_strains_turns_with_the_body(name):
    model, u, d = turned_cube(name)
    x, no = jnp.asarray(model.mesh.points), jnp.zeros((), bool)
    R, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    R = R * np.linalg.det(R)
    turned = lambda u: (x + u) @ R.T - x
    start, _ = predict(model, 0.0 * u, u, no_strains(model), no)
    here, _ = predict(model, u, d, start, no)
    there, _ = predict(model, turned(u), d @ R.T, start, no)
    for ours, theirs in zip(there, here, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
    values, force = terms(model, u + d, here)
    same, turned_force = terms(model, turned(u + d), here)
    np.testing.assert_allclose(turned_force, force @ R.T, rtol=0, atol=1e-12)
    moved = along(model, values, d) @ R.T
    ours = along(model, same, d @ R.T)
    np.testing.assert_allclose(ours, moved, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_a_newton_step_balances_the_stress_that_it_predicts(name):
    """The first row of the linear system of Hu and Washizu, with all unknowns.

    Stiffness and force of a step d give B(u)^T S_new and the old stress on d.
    """
    model, u, d = turned_cube(name)
    no = jnp.zeros((), bool)
    strains, _ = predict(model, 0.0 * u, u, no_strains(model), no)
    values, force = terms(model, u, strains)
    after, _ = predict(model, u, d, strains, no)
    gradients = lambda u: jnp.einsum(
        "baki,bqaJk->bqiJk", u[model.nodes], model.shape_gradients
    )
    F = gradients(u) + jnp.eye(3)[None, None, :, :, None]
    P = jnp.einsum("bqiMk,bqMJk->bqiJk", F, after.stress)
    P = P + jnp.einsum("bqiMk,bqMJk->bqiJk", gradients(d), strains.stress)
    nodal = jnp.einsum("bqiJk,bqaJk->bkai", P, model.shape_gradients)
    nodal = nodal * model.active[:, :, None, None]
    nodes = jnp.moveaxis(model.nodes, 1, 2)
    balanced = jnp.zeros_like(u).at[nodes].add(nodal)
    foreseen = force + along(model, values, d)
    np.testing.assert_allclose(foreseen, balanced, rtol=0, atol=1e-12)


GUESSES = {
    "of the other sign": lambda u: -3.0 * u,
    "rough": lambda u: u + 0.3 * jax.random.normal(jax.random.key(1), u.shape),
    "not finite": lambda u: u.at[-1, 1].set(jnp.nan),
}


@pytest.mark.parametrize("name", GUESSES)
def test_a_bad_guess_is_no_equilibrium(name, careful):
    fixed = np.asarray(LANES.fixed[HANGING])
    guess = GUESSES[name](careful.displacement[HANGING])
    guess = jnp.where(fixed, 0.0, guess)
    solution = continued(MODEL, lane(LANES, HANGING), guess).equilibrium
    assert bool(solution.result == RESULTS.max_steps)
    assert int(solution.steps) <= MAX_QUICK_STEPS
    assert bool(jnp.all(jnp.isnan(solution.displacement)))


def test_a_guess_that_is_a_little_rough_is_closed_in_quick_steps(careful):
    """A tenth of the rough one: each step brings the residual down a little."""
    u = careful.displacement[HANGING]
    rough = u + 0.03 * jax.random.normal(jax.random.key(1), u.shape)
    guess = jnp.where(LANES.fixed[HANGING], 0.0, rough)
    done = continued(MODEL, lane(LANES, HANGING), guess)
    assert 1 < int(done.equilibrium.steps) <= MAX_QUICK_STEPS
    assert float(done.equilibrium.residual) <= TIGHT.rtol
    assert_same(done, HANGING, careful, rtol=1e-5)


class Forgetful(AbstractLinearSolver):
    """A solver whose factors are always those of another program."""

    sparsity: Sparsity
    real: AbstractLinearSolver
    name: ClassVar[str] = "forgetful"
    keeps_factors: ClassVar[bool] = MODEL.solver.keeps_factors
    can_count: ClassVar[bool] = MODEL.solver.can_count

    @classmethod
    def analyse(cls, sparsity):
        return cls(sparsity, MODEL.solver)

    def _factor_solve(self, values, rhs):
        return self.real._factor_solve(values, rhs)

    def solve_again(self, values, rhs):
        return 2.0 * self.real.solve_again(values, rhs)


def test_factors_of_another_program_are_noticed(careful):
    forgetful = Forgetful.analyse(MODEL.solver.sparsity)
    model = eqx.tree_at(lambda m: m.solver, MODEL, forgetful)
    guess = careful.displacement[HANGING]
    done, expected = (
        continued(m, lane(LANES, HEAVIER), guess, precise=True) for m in (model, MODEL)
    )
    assert int(done.equilibrium.steps) > int(expected.equilibrium.steps)
    assert bool(done.ok)
    scale = float(jnp.max(jnp.abs(expected.x)))
    np.testing.assert_allclose(done.x, expected.x, rtol=0, atol=SHARP * scale)


def test_one_factorization_is_enough_from_close_by(careful):
    u = careful.displacement[HANGING]
    for factor in (1.0005, 1.0 + 1e-9):
        done = continued(MODEL, lane(LANES, HANGING), factor * u, precise=True)
        assert int(done.equilibrium.steps) == 1
        assert float(done.equilibrium.residual) <= TIGHT.rtol
        assert_same(done, HANGING, careful, rtol=1e-6)
    # That a step arrives says nothing of the tangent where it began.
    loose = replace(TIGHT, rtol=1e-2)
    done = continued(MODEL, lane(LANES, HANGING), 1.005 * u, loose, True)
    expected = further(MODEL, lane(LANES, HANGING), done.equilibrium.displacement).x[:2]
    scale = float(jnp.max(jnp.abs(expected)))
    np.testing.assert_allclose(done.x[:2], expected, rtol=0, atol=1e-4 * scale)


def test_from_rest_one_step_is_all():
    """Several could end on another branch."""
    solution = continued(MODEL, lane(LANES, HANGING), jnp.zeros(SHAPE)).equilibrium
    assert not bool(solution.converged)
    assert int(solution.steps) == 1


def test_a_support_that_has_moved_since_the_guess(careful):
    """Full steps are not trusted with a jump of what is held."""
    there = lane(LANES, MOVED)
    done = continued(MODEL, there, careful.displacement[HANGING])
    assert not bool(done.equilibrium.converged)
    assert int(done.equilibrium.steps) == 0
    # From where it already is they are.
    again = continued(MODEL, there, careful.displacement[MOVED])
    assert int(again.equilibrium.steps) == 1
    assert_same(again, MOVED, careful, rtol=1e-6)


def shortened(factor):
    """A guess: every section moved along, the length times `factor`."""
    return jnp.asarray(MESH.points * np.array([factor - 1.0, 0.0, 0.0]))


def test_an_unstable_guess_is_left():
    """Pressed beyond the limit point; full Newton steps would end right there."""
    solution = continued(MODEL, lane(LANES, UNSTABLE), shortened(0.4)).equilibrium
    assert not bool(solution.converged)


def test_an_inverted_guess_does_not_pass_for_an_equilibrium():
    """Turned inside out this law has no stress: residual zero, tangent definite."""
    guess = shortened(-1.0)
    solution = continued(MODEL, lane(LANES, TURNED), guess).equilibrium
    assert not bool(solution.converged)
    np.testing.assert_allclose(solution.min_det_F, -1.0, rtol=1e-9)


def test_a_load_that_the_body_cannot_carry(careful):
    """From rest and from a guess."""
    assert not bool(lane(careful, CRUSHED).converged)
    for factor in (1.0, 0.9):
        done = continued(MODEL, lane(LANES, CRUSHED), shortened(factor))
        assert not bool(done.equilibrium.converged)


def no_law():
    nan = jnp.asarray(jnp.nan, float)
    return eqx.tree_at(lambda m: m.law.elasticity.E, MODEL, nan), lane(LANES, HANGING)


def no_force():
    one = lane(LANES, HANGING)
    force = one.loads.force.at[0, -1, 2].set(jnp.nan)
    return MODEL, eqx.tree_at(lambda c: c.loads.force, one, force)


@pytest.mark.parametrize("broken", [no_law, no_force])
def test_without_equilibrium_there_are_no_solutions(broken, careful):
    done = continued(*broken(), careful.displacement[HANGING])
    assert not bool(done.equilibrium.converged)
    assert bool(jnp.all(jnp.isnan(done.equilibrium.displacement)))
    assert not bool(done.ok)
    np.testing.assert_array_equal(done.x, 0.0)
