"""A batch gives what its members give alone; failing lanes are named, not averaged."""

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
    YOUNG,
    force,
    hanging,
    lane,
    solve,
    solve_as_users,
)
from problems import nearest_node
from wording import says

from softcal_jax.configurations import (
    Configuration,
    Support,
    SurfaceForce,
    SurfaceTraction,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    RESULTS,
    NewtonSettings,
    build_model,
    check_converged,
    gravity_load,
    solve_equilibrium,
)
from softcal_jax.materials import Corotational, Isotropic, StVenantKirchhoff
from softcal_jax.mesh import beam

PULL = SurfaceForce("x_max", (0.1, 0.2, -0.1))
CONFIGURATIONS = [
    hanging("down"),
    hanging("held right", supports=(Support("x_max"),), loads=(PULL,)),
    hanging("up, moved", 0.3, supports=(*CLAMP, Support("x_max", "z", (0, 0, 0.01)))),
    Configuration("idle", CLAMP, gravity=(0.0, 0.0, 0.0)),
]


MESH = beam(LENGTH, SIDE, SIDE, (10, 2, 2))
LAW = StVenantKirchhoff(Isotropic(YOUNG, POISSON))
MODEL = build_model(MESH, LAW, density=DENSITY)


@pytest.fixture(scope="module")
def batch():
    return configuration_arrays(MESH, CONFIGURATIONS)


@pytest.fixture(scope="module")
def together(batch):
    return solve_as_users(MODEL, batch)


def assert_same(one, other):
    np.testing.assert_array_equal(one.displacement, other.displacement)
    assert bool(one.result == other.result)
    of_newton = ("steps", "load_steps", "residual", "rounding", "at_rounding")
    for name in (*of_newton, "min_det_F", "n_negative"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("index", range(len(CONFIGURATIONS)))
def test_a_member_alone_gives_bit_for_bit_the_same(batch, together, index):
    alone = solve_as_users(MODEL, lane(batch, np.array([index])))
    assert_same(lane(alone, 0), lane(together, index))


def test_all_lanes_converged_and_say_how(together):
    check_converged(together, tuple(c.name for c in CONFIGURATIONS))
    assert bool(jnp.all(together.converged))
    assert bool(jnp.all(together.residual <= NewtonSettings().rtol))
    assert bool(jnp.all(together.min_det_F > 0.5))
    assert bool(jnp.all(together.n_negative == 0))


def test_a_body_without_load_stays_where_it_is(together):
    np.testing.assert_array_equal(together.displacement[3], 0.0)
    np.testing.assert_array_equal(together.min_det_F[3], 1.0)


@jax.jit
def load_on_nodes(model, lane):
    return lane.dead_loads + gravity_load(model, lane.acceleration)


def test_reactions_carry_the_load(batch, together):
    """On held nodes internal minus external force; their sum is minus all loads."""
    weight = DENSITY * LENGTH * SIDE**2 * 9.81 * np.array([1.0, 1.0, 0.3])
    for index, extra in enumerate([np.zeros(3), np.array(PULL.force)]):
        one = lane(batch, index)
        out = force(MODEL, together.displacement[index]) - load_on_nodes(MODEL, one)
        reaction = np.where(one.fixed, out, 0.0).sum(axis=0)
        load = np.array([0.0, 0.0, -weight[index]]) + extra
        # What Newton leaves on some hundred free nodes, 1e-8 of the norm of all forces.
        np.testing.assert_allclose(reaction, -load, rtol=0, atol=1e-6 * weight[index])


def test_a_failing_lane_does_not_disturb_the_others(batch, together):
    """A NaN force is flagged; the process lives and the other lanes do not change."""
    force = batch.loads.force.at[1, 0, 7, 2].set(jnp.nan)
    broken = eqx.tree_at(lambda c: c.loads.force, batch, force)
    solution = solve_as_users(MODEL, broken)
    assert not bool(lane(solution, 1).converged)
    assert bool(jnp.all(jnp.isnan(solution.displacement[1])))
    for index in (0, 2, 3):
        assert_same(lane(solution, index), lane(together, index))
    with pytest.raises(RuntimeError) as error:
        check_converged(solution, tuple(c.name for c in CONFIGURATIONS))
    assert "configuration 'held right'" in str(error.value)
    assert "'down'" not in str(error.value)


def test_a_nan_in_the_law_is_flagged(batch):
    """Also where a traced parameter went wrong, past all checks at construction."""
    model = eqx.tree_at(
        lambda m: m.law.elasticity.E, MODEL, jnp.asarray(jnp.nan, float)
    )
    solution = solve_as_users(model, batch)
    assert not bool(jnp.any(solution.converged))


def block(*configurations, solver=None):
    """Two cubes of linear tets in a row, St. Venant-Kirchhoff with nu = 0."""
    mesh = beam(2.0, 1.0, 1.0, (2, 1, 1))
    law = StVenantKirchhoff(Isotropic(1.0, 0.0))
    model = build_model(mesh, law, density=1.0, solver=solver)
    return model, configuration_arrays(mesh, configurations)


def test_a_body_that_nothing_holds_is_singular_in_its_lane_alone():
    """Its stiffness is of whole numbers times 1 / 24: KLU meets a pivot of zero."""
    pytest.importorskip("klujax", reason="not installed on this platform")
    poses = [hanging(name, 1e-4) for name in ("held", "loose", "held too")]
    model, lanes = block(*poses, solver="klu")
    fixed = np.asarray(lanes.fixed) & (np.arange(3) != 1)[:, None, None]
    solution = solve(model, eqx.tree_at(lambda c: c.fixed, lanes, fixed))
    np.testing.assert_array_equal(solution.converged, [True, False, True])
    assert bool(lane(solution, 1).result == RESULTS.singular)
    assert_same(lane(solution, 0), lane(solution, 2))


PUSHED = ("below", "beyond")


def pushed():
    """A bar of this law carries at most 0.19245 E in compression, at 1/sqrt(3)."""
    everywhere = Support(np.arange(12), axes="yz")
    push = lambda name, load: Configuration(
        name,
        (Support("x_min"), everywhere),
        gravity=(0.0, 0.0, 0.0),
        loads=(SurfaceForce("x_max", (-load, 0.0, 0.0)),),
    )
    return block(*map(push, PUSHED, (0.19, 0.21)))


def test_a_load_beyond_the_limit_point_is_reported_with_its_lane():
    model, lanes = pushed()
    solution = solve(model, lanes)
    # Homogeneous: E s (s^2 - 1) / 2 = -0.19 between 1/sqrt(3) and 1.
    s = np.roots([0.5, 0.0, -0.5, 0.19])
    s = s[(s > 1 / np.sqrt(3)) & (s < 1)].item()
    end = nearest_node(model.mesh, (2.0, 0.0, 0.0))
    below = lane(solution, 0)
    assert bool(below.result == RESULTS.converged)
    np.testing.assert_allclose(below.displacement[end, 0], 2.0 * (s - 1.0), rtol=1e-6)
    assert not bool(lane(solution, 1).converged)
    with pytest.raises(RuntimeError) as error:
        check_converged(solution, PUSHED)
    why = RESULTS[lane(solution, 1).result]
    assert says(error.value, "no equilibrium ... 'beyond'", why, "Newton steps")
    assert "'below'" not in str(error.value)


def test_too_few_steps_are_reported():
    solution = solve(*pushed(), NewtonSettings(max_steps=2))
    assert bool(lane(solution, 0).result == RESULTS.max_steps)
    assert int(solution.steps[0]) == 2
    with pytest.raises(RuntimeError, match=r"'below': .*not converge .*raise"):
        check_converged(solution, PUSHED)


@pytest.mark.parametrize(
    ("supports", "loads"),
    [
        ((Support("x_max", displacement=(-2.5, 0.0, 0.0)),), ()),
        ((), (SurfaceTraction("x_max", (-1e6, 0.0, 0.0)),)),
    ],
    ids=["pulled through", "crushed"],
)
@pytest.mark.parametrize("from_there", [False, True], ids=["rest", "inside out"])
def test_an_inverted_state_is_reported(supports, loads, from_there):
    """Neither the way there nor a guess that lies there passes for an equilibrium."""
    turned = Configuration(
        "turned", (Support("x_min"), *supports), loads=loads, gravity=(0.0, 0.0, 0.0)
    )
    mesh = beam(1.0, 1.0, 1.0, (2, 2, 2))
    model = build_model(mesh, Corotational(Isotropic(1e5, 0.3)), density=DENSITY)
    there = jnp.asarray(mesh.points * np.array([-2.0, 0.0, 0.0]))
    pose = lane(configuration_arrays(mesh, [turned]), 0)
    guess = there if from_there else jnp.zeros_like(there)
    solution = jax.jit(solve_equilibrium)(model, pose, guess=guess)
    assert bool(solution.result == RESULTS.inverted)
    with pytest.raises(RuntimeError, match=r"'turned': .*inverted \(det F <= 0\)"):
        check_converged(solution, ("turned",))
