"""Poses that are hard to reach from rest are solved from the nearest equilibrium."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import lane
from wording import says

from softcal_jax.actuators import Cable
from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Support,
    SurfaceForce,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    RESULTS,
    Known,
    NewtonSettings,
    Workers,
    build_model,
    equilibria,
    no_equilibrium,
    solve_equilibrium,
)
from softcal_jax.equilibrium._continuation import approach, detours, distances, unloaded
from softcal_jax.equilibrium._path import WANTED_ITERATIONS
from softcal_jax.equilibrium._solve import (
    begin_newton,
    continue_newton,
    without_readings,
)
from softcal_jax.materials import Isotropic, NeoHookean, StVenantKirchhoff
from softcal_jax.mesh import beam

NONE = (0.0, 0.0, 0.0)
MESH = beam(0.06, 0.01, 0.01, (6, 1, 1))
LAW = NeoHookean(2e5, 0.3)
GRIPPED = build_model(MESH, LAW, density=1e3, bodies=(RigidBody("tip", "x_max"),))
SLENDER = build_model(MESH, LAW, density=1e3)
HARD = 1.2
"""A force on the end that bends the slender beam far beyond one step of Newton [N]."""


def bent(name, height):
    """The tip held higher than at rest."""
    held = {"tip": BodyState("held", Pose((0.0, 0.0, height)))}
    return Configuration(name, "x_min", gravity=NONE, bodies=held)


def pulled(name, force):
    return Configuration(name, "x_min", NONE, SurfaceForce("x_max", (0.0, 0.0, force)))


def solved(model, poses, cores=None, known=(), **more):
    """Solve poses; `known` are indices of some of them with their displacements."""
    lanes = configuration_lanes(model.mesh, poses, model.mechanism).arrays
    more["known"] = [Known(lane(lanes, c), u) for c, u in known]
    with Workers(model, len(poses), cores) as workers:
        return equilibria(workers, model, lanes, NewtonSettings(), **more)


def test_poses_of_a_robot_begin_at_the_nearest_one():
    """The farthest waits for the one between, in whatever order they are given."""
    low, middle, high = bent("low", 0.01), bent("middle", 0.019), bent("high", 0.02)
    ended = []
    note = lambda c, solution: ended.append((c, int(solution.steps)))
    solution = solved(GRIPPED, [low, high, middle], ended=note)
    assert np.all(solution.converged)
    assert [c for c, _ in ended] == [0, 2, 1]
    first, second, third = (steps for _, steps in ended)
    assert third < second <= first


def test_the_first_one_begins_where_one_is_known():
    rest = solved(GRIPPED, [bent("once", 0.02)])
    again = solved(GRIPPED, [bent("again", 0.02)], known=[(0, rest.displacement[0])])
    assert int(again.steps[0]) < int(rest.steps[0])
    np.testing.assert_allclose(again.displacement, rest.displacement, atol=1e-9)


def test_a_state_of_newton_keeps_its_types():
    """Or each call of the loop would be compiled once more."""
    # Where lengths are imposed there is no potential, and the loop keeps more.
    wound = {cable.name: ImposedDisplacement(1e-3) for cable in CABLES}
    pose = Configuration("wound", "x_min", NONE, actuation=wound)
    lanes = configuration_lanes(MESH, [pose], ACTUATED.mechanism).arrays
    one, settings = lane(lanes, 0), NewtonSettings()
    begin = lambda u: begin_newton(ACTUATED, settings, one, u)
    before = jax.eval_shape(begin, jnp.zeros((ACTUATED.n_points, 3)))
    more = lambda state, n: continue_newton(ACTUATED, settings, n, one, state)[0]
    after = jax.eval_shape(more, before, jnp.asarray(2))
    types = lambda state: [
        (leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(state)
    ]
    assert before.iterate.merit_before is not None
    assert types(after) == types(before)


def test_a_far_pose_is_the_same_by_load_steps_from_rest():
    """On one core and on two; the next one, from there, takes few steps."""
    poses = [pulled("hard", HARD), pulled("harder", 1.1 * HARD)]
    lanes = configuration_lanes(MESH, poses, SLENDER.mechanism).arrays
    one, two = (solved(SLENDER, poses, cores) for cores in (1, 2))
    np.testing.assert_array_equal(one.displacement, two.displacement)
    alone = [solve_equilibrium(SLENDER, lane(lanes, c)) for c in (0, 1)]
    for c in (0, 1):
        assert bool(alone[c].converged)
        reference = alone[c].displacement
        np.testing.assert_allclose(one.displacement[c], reference, atol=1e-8)
    assert int(one.steps[1]) < 0.5 * int(one.steps[0])
    assert np.all(one.approached == 1.0)


def test_how_far_a_way_led_is_told():
    """The bar in compression of `test_begin`: it carries 0.19245 E at most."""
    mesh, push = beam(2.0, 1.0, 1.0, (2, 1, 1)), 0.3
    model = build_model(mesh, StVenantKirchhoff(Isotropic(1.0, 0.0)), density=1.0)
    supports = Support("x_min"), Support(np.arange(12), axes="yz")
    load = SurfaceForce("x_max", (-push, 0.0, 0.0))
    pose = Configuration("pushed", supports, NONE, load)
    share = 0.19245 / push
    solution = solved(model, [pose])
    assert float(solution.approached[0]) == pytest.approx(share, abs=1 / 32)
    assert np.isnan(solution.along_path[0])
    solution = solved(model, [pose], arc_length=True)
    assert float(solution.along_path[0]) == pytest.approx(share, rel=0.02)
    text = no_equilibrium(solution, ("pushed",))
    assert says(text, "'pushed'", "nearest equilibrium", "Along its path", "at most")


def test_only_poses_that_hold_the_same_are_near():
    first = pulled("first", 1.0)
    other = replace(first, name="other", supports=(Support("x_max"),))
    poses = [first, replace(first, name="same"), pulled("half", 0.5), other]
    each = list(configuration_lanes(MESH, poses, SLENDER.mechanism).arrays)
    apart = distances([unloaded(each[0]).configuration, *each])
    rest, same, half, held_elsewhere = apart[1, [0, 2, 3, 4]]
    assert same == 0.0
    assert rest == pytest.approx(2.0 * half) == 1.0
    assert held_elsewhere == np.inf


def test_a_way_is_followed_on_a_parabola():
    """Once three states are known, those of a parabola are guessed exactly."""
    lanes = configuration_lanes(MESH, [pulled("end", 1.0)], SLENDER.mechanism).arrays
    end, guesses = without_readings(lane(lanes, 0)), []
    curve = lambda s: np.full(end.imposed.shape, 0.3 * s - 0.2 * s**2)
    whole = solve_equilibrium(SLENDER, end)

    def at_once(pose, guess):
        share = float(np.max(pose.loads.force) / np.max(end.loads.force))
        guesses.append(np.max(np.abs(guess - curve(share))))
        refused = share > 0.2 and len(guesses) < 4
        steps = jnp.asarray(WANTED_ITERATIONS)
        good = replace(whole, displacement=jnp.asarray(curve(share)), steps=steps)
        return solved_nothing if refused else good

    solved_nothing = replace(
        solve_equilibrium(SLENDER, end, settings=NewtonSettings(max_steps=1)),
        steps=jnp.asarray(8),
    )
    told = []
    way = approach(
        at_once,
        unloaded(end),
        [end],
        first=1.0,
        most=100,
        report=lambda *now: told.append(now),
    )
    assert way.solution is not None
    good = len(guesses) - 3
    assert way.steps == 3 * 8 + good * WANTED_ITERATIONS
    np.testing.assert_allclose(guesses[5:], 0.0, atol=1e-12)
    assert guesses[4] > 1e-3  # by two states alone
    shares = [share for share, _ in told]
    assert shares[:4] == [0.0] * 4
    assert shares[4:] == pytest.approx(np.arange(1, 8) / 8)


CABLES = tuple(
    Cable(f"cable {side}", [(0.0, y, 0.005), (0.06, y, 0.005)])
    for side, y in (("left", 0.0), ("right", 0.01))
)
ACTUATED = build_model(MESH, LAW, density=1e3, actuators=CABLES)


def commanded(name, left, right, force=0.0, gravity=NONE):
    inputs = {"cable left": ImposedForce(left), "cable right": ImposedForce(right)}
    load = SurfaceForce("x_max", (0.0, 0.0, force))
    return Configuration(name, "x_min", gravity, load, actuation=inputs)


def test_detours_turn_where_actuators_or_loads_are_done():
    poses = [commanded("a", 1.0, 2.0), commanded("b", 3.0, 5.0, 0.4, (0, 0, -9.81))]
    lanes = configuration_lanes(MESH, poses, ACTUATED.mechanism).arrays
    a, b = (without_readings(lane(lanes, c)) for c in (0, 1))
    state = lambda c: (*np.asarray(c.actuation.value).tolist(), np.any(c.gravity))
    ways = [[state(stop) for stop in way] for way in detours(a, b)]
    end = (3.0, 5.0, True)
    assert ways == [
        [(3.0, 2.0, True), end],
        [(1.0, 2.0, True), end],
        [(3.0, 5.0, False), end],
    ]
    for way in detours(a, b):
        assert all(np.array_equal(stop.key, b.key) for stop in way)
    assert detours(a, a) == []
    one = eqx.tree_at(lambda c: c.actuation.value, a, np.array([1.0, 4.0]))
    assert detours(a, one) == []


def test_a_pose_behind_a_limit_is_reached_around_it():
    """Nothing converges where both cables pull by halves; one by one leads on."""
    poses = [commanded("a", 0.0, 0.0), commanded("b", 0.2, 0.2)]
    lanes = configuration_lanes(MESH, poses, ACTUATED.mechanism).arrays
    a, b = (without_readings(lane(lanes, c)) for c in (0, 1))

    def at_once(pose, guess):
        left, right = np.asarray(pose.actuation.value)
        solution = solve_equilibrium(ACTUATED, pose, guess=guess)
        barred = 0.05 < left < 0.15 and 0.05 < right < 0.15
        far = np.hypot(left - at_once.at[0], right - at_once.at[1]) > 0.21
        if barred or far:
            return replace(solution, result=RESULTS.max_steps)
        at_once.at = left, right
        return solution

    more = {"first": 1.0, "most": 1000, "report": lambda *_: None}
    known = Known(a, solve_equilibrium(ACTUATED, a).displacement)
    at_once.at = 0.0, 0.0
    straight = approach(at_once, known, [b], **more)
    assert straight.solution is None
    assert straight.share == pytest.approx(0.25, abs=1 / 32)
    at_once.at = 0.0, 0.0
    (way,) = detours(a, b)
    end = approach(at_once, known, way, **more)
    assert end.solution is not None
    expected = solve_equilibrium(ACTUATED, b).displacement
    np.testing.assert_allclose(end.solution.displacement, expected, atol=1e-9)
