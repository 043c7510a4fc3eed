"""Inverse control of the arm: goals, limits, energy."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest
from arm import EFFECTORS, REST, arm, check_only, pose, tips
from export.handmade import make_fit, small_model
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.calibration import Evaluator
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import (
    OUTCOMES,
    ControlSettings,
    ControlWarning,
    InverseResult,
    Limits,
    follow_trajectory,
    solve_inverse,
)
from softcal_jax.results import headline
from softcal_jax.results._goals import goal_table, off_words

FINE = ControlSettings(tol=1e-6)
FEW = ControlSettings(other_starts=3)


def robot(gravity=REST, **actuation):
    return pose(gravity, EFFECTORS, **actuation)


def check(result):
    """What holds of every search: its QPs were solved, and its cost fell.

    It may rise where a step overshot a limit, and the next one goes back.
    """
    assert max(step.kkt_residual for step in result.steps) < 1e-9
    kept = [step for step in result.steps if step.accepted]
    for before, after in pairwise(kept):
        falls = after.cost <= before.cost * (1.0 + 1e-12)  # rounding
        assert falls or after.violation < before.violation
    assert kept[-1].violation <= 1e-6
    assert bool(result.solution.converged)


def test_reachable_goal_is_met_and_its_actuation_found():
    """Made by simulation with another actuation; in z and x it is the only one."""
    (goal,) = tips(robot(top=0.0, motor=0.0), [[1.5, 0.4]])
    result = solve_inverse(
        arm(), robot(top=0.0, motor=0.0), goals={"tip": goal}, settings=FINE
    )
    check(result)
    assert result.outcome == OUTCOMES.met
    assert result.met
    np.testing.assert_allclose(result.inputs, [1.5, 0.4], rtol=1e-5)
    np.testing.assert_allclose(result.forces["top"], result.inputs[0])
    np.testing.assert_allclose(result.goals[0].simulated, goal, rtol=0, atol=1e-9)
    assert result.active_limits == ()
    assert len(result.steps) <= 8
    # The configuration found is one that a user can simulate again.
    (again,) = tips(result.configuration, [result.inputs])
    np.testing.assert_allclose(again, goal, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_imposed_shortening_is_found():
    """The same by displacement: two lengths for a bend with little co-contraction."""
    start = robot(top=ImposedDisplacement(0.0), bottom=ImposedDisplacement(0.0))
    (goal,) = tips(robot(top=0.0, bottom=0.0), [[1.5, 0.5]])
    result = solve_inverse(arm(), start, goals={"tip": goal}, settings=FINE)
    check(result)
    assert result.met
    # Forces and lengths of cables are dual: the tensions come back.
    np.testing.assert_allclose(
        [result.forces["top"], result.forces["bottom"]], [1.5, 0.5], rtol=1e-4
    )
    np.testing.assert_allclose(result.displacements["top"], result.inputs[0])


@pytest.mark.parametrize(
    ("goal", "limits"),
    [
        ((0.11, 0.01, 0.04), {}),  # farther than the arm is long
        ((0.08, 0.01, 0.06), {"top": Limits(force=(0.0, 1.0))}),
        ((0.09, 0.01, -0.03), {"motor": Limits(displacement=(-0.1, 0.5))}),
    ],
)
def test_unreachable_goal_ends_at_the_nearest_point(goal, limits):
    """No point of a grid over all actuations is nearer."""
    start = robot(top=0.0, motor=0.0)
    result = solve_inverse(
        arm(), start, goals={"tip": goal}, limits=limits, settings=FEW
    )
    check(result)
    assert result.outcome == OUTCOMES.nearest
    assert "nearest reachable point" in headline(result)
    assert "'tip'" in headline(result)
    force = limits.get("top", Limits()).force
    angle = limits.get("motor", Limits()).displacement
    top = np.linspace(0.0, min(force[1], 3.0), 7)
    motor = np.linspace(max(angle[0], -0.7), min(angle[1], 0.7), 10)
    inputs = np.stack(np.meshgrid(top, motor), axis=-1).reshape(-1, 2)
    distance = lambda tip: np.linalg.norm(tip - np.array(goal), axis=-1)
    off = distance(tips(start, inputs))
    nearest = distance(result.goals[0].simulated)
    np.testing.assert_allclose(nearest, np.linalg.norm(result.goals[0].residual))
    assert 1e-3 < nearest <= off.min() + 1e-12
    # And the grid is fine enough to see the same minimum.
    assert off.min() < nearest + 2e-3
    for name, limit in limits.items():
        assert any(repr(name) in text for text in result.active_limits), limit
    # To the last digit, as the next command begins there.
    assert 0.0 <= result.inputs[0] <= force[1]
    assert angle[0] <= result.inputs[1] <= angle[1]


@pytest.mark.slow
def test_cables_never_push():
    """To bend down with the upper cable alone: it goes slack, and says so."""
    start = robot(top=1.0)
    result = solve_inverse(arm(), start, goals={"bend": -0.3}, settings=FEW)
    check(result)
    assert result.outcome == OUTCOMES.nearest
    assert 0.0 <= result.inputs[0] < 1e-12
    check_only(result.active_limits, "force ... 'top' ... lower")
    # By its length: it is let out until it is just taut, and no further.
    start = robot(top=ImposedDisplacement(0.002))
    result = solve_inverse(arm(), start, goals={"bend": -0.3}, settings=FEW)
    check(result)
    assert result.outcome == OUTCOMES.nearest
    assert abs(result.forces["top"]) < 1e-5
    np.testing.assert_allclose(result.inputs[0], 0.0, atol=1e-7)
    check_only(result.active_limits, "force ... 'top' ... lower")


@pytest.mark.slow
def test_slack_cable_is_wound_up_first():
    """A cable let out by 5 mm has no effect that a derivative could see."""
    start = robot(bottom=ImposedDisplacement(-0.005))
    result = solve_inverse(arm(), start, goals={"bend": -0.2}, settings=FINE)
    assert result.met
    assert result.inputs[0] > 0.0


def test_limits_of_what_follows_hold():
    """The shortening of a cable that is driven by force; see below for the other."""
    bent = {"goals": {"bend": 0.6}, "settings": FEW}
    limit = Limits(displacement=(-0.001, 0.002))
    result = solve_inverse(arm(), robot(top=0.0), limits={"top": limit}, **bent)
    check(result)
    assert result.outcome == OUTCOMES.nearest
    np.testing.assert_allclose(result.displacements["top"], 0.002, atol=1e-7)
    check_only(result.active_limits, "displacement ... 'top' ... upper")


@pytest.mark.slow
def test_limits_of_a_held_cable_hold():
    """The upper cable keeps its length while the lower one yields; its force rises."""
    d = 0.004
    run = lambda most: solve_inverse(
        arm(),
        robot(top=ImposedDisplacement(d), bottom=1.0),
        goals={"bend": 1.0},
        limits={"top": Limits(displacement=(d, d), force=(0.0, most))},
        settings=FEW,
    )
    free = run(np.inf)
    check_only(free.held_by, "force ... 'bottom' ... lower")
    most = 0.99 * free.forces["top"]
    held = run(most)
    check(held)
    np.testing.assert_allclose(held.forces["top"], most, rtol=1e-4)
    check_only(held.held_by, "force ... 'top' ... upper")


def test_epsilon_ends_co_contraction():
    """Two opposite cables, one angle: without it both stay tense, with it one does."""
    start = robot(top=2.0, bottom=2.0)
    goals = {"bend": 0.25}
    tense = solve_inverse(arm(), start, goals=goals)
    assert tense.met
    assert tense.inputs[1] > 0.5
    frugal = solve_inverse(
        arm(), start, goals=goals, settings=ControlSettings(epsilon=1e-4)
    )
    check(frugal)
    assert frugal.met
    assert 0.0 <= frugal.inputs[1] < 1e-9
    np.testing.assert_allclose(frugal.goals[0].simulated[0], 0.25, atol=1e-4)


def test_trajectory_starts_where_it_was():
    """Neighbouring goals take few iterations, and inputs keep their steps."""
    start = robot(top=0.0, motor=0.0)
    inputs = np.stack([np.linspace(0.5, 1.0, 3), np.linspace(0.1, 0.2, 3)], axis=1)
    goals = [{"tip": tip} for tip in tips(start, inputs)]
    path = follow_trajectory(arm(), start, goals)
    assert path.unmet == ()
    np.testing.assert_allclose(path.inputs, inputs, rtol=0, atol=5e-3)
    assert max(len(point.steps) for point in path.points[1:]) <= 3
    # A motor that is too slow falls behind, and says so.
    slow = {"motor": Limits(step=0.02)}
    direct = ControlSettings(other_starts=0)
    path = follow_trajectory(arm(), start, goals, limits=slow, settings=direct)
    np.testing.assert_allclose(np.diff(path.inputs[:, 1]), 0.02, rtol=1e-6)
    assert path.unmet == (0, 1, 2)
    check_only(path.points[0].active_limits, "step ... 'motor' ... longest")


def test_one_program_for_all_goals_and_models():
    """Of the same actuators: other goals, materials and limits need none."""
    solve_inverse(arm(), robot(top=0.0, motor=0.0), goals={"bend": 0.1})
    stiff = arm(4e5)
    with Compilations() as seen:
        result = solve_inverse(
            eqx.tree_at(lambda m: m.law, arm(), stiff.law),
            robot(top=0.2, motor=0.1),
            goals={"tip": (0.09, 0.01, 0.03)},
            limits={"top": Limits(force=(0.0, 9.0))},
            settings=ControlSettings(epsilon=1e-6, max_steps=40, other_starts=3),
        )
    assert len(result.steps) > 0
    assert seen.programs == []


def test_a_turned_motor_is_near_its_prediction(monkeypatch):
    """Bodies turn where the guess moves them along lines: no solve from afar."""
    (goal,) = tips(robot(top=0.0, motor=0.0), [[1.5, 0.4]])
    solved, equilibria = [], Evaluator.equilibria

    def counted(*args, **kwargs):
        solved.append(1)
        return equilibria(*args, **kwargs)

    monkeypatch.setattr(Evaluator, "equilibria", counted)
    result = solve_inverse(
        arm(), robot(top=0.1, motor=0.0), goals={"tip": goal}, settings=FINE
    )
    assert result.met
    assert len(solved) <= 1  # the start, from rest


def test_limits_that_leave_no_room_are_an_error():
    limits = {"top": Limits(force=(1.0, 1.0))}
    with pytest.raises(ValueError, match="'arm' leave no actuator any room"):
        solve_inverse(arm(), robot(top=1.0), goals={"bend": 0.1}, limits=limits)


def test_search_that_does_not_end_says_so():
    settings = ControlSettings(max_steps=1, other_starts=0)
    with pytest.raises(RuntimeError, match=r"'arm': .*max_steps; raise"):
        solve_inverse(arm(), robot(top=0.0), goals={"bend": 0.6}, settings=settings)
    result = solve_inverse(
        arm(), robot(top=0.0), goals={"bend": 0.6}, settings=settings, throw=False
    )
    assert result.outcome == OUTCOMES.max_steps


def test_a_start_without_equilibrium_reaches_nothing():
    """Its goals are not met, and their distance is unknown, not nan or 0."""
    (point, _) = make_fit(small_model().mesh).points
    goal = replace(point, simulated=np.full(3, np.nan))
    inverse = SimpleNamespace(goals=(goal,), tol=0.01)
    assert InverseResult.unmet.fget(inverse) == (goal,)
    assert off_words(goal) == "x unknown, y unknown, z unknown"
    table = str(goal_table([goal]).rows())
    assert "unknown" in table
    assert "nan" not in table


def test_a_start_without_equilibrium_gives_way_to_the_nearest_that_has_one():
    """A cable pulled far harder than the arm bears; its goal needs a thirtieth."""
    with pytest.warns(ControlWarning, match=r"no equilibrium: .* at \d.* %"):
        result = solve_inverse(arm(), robot(top=60.0), goals={"bend": 0.2})
    check(result)
    assert result.met
    assert "nan" not in str(result)


def test_out_of_reach_of_one_input_takes_hardly_longer(monkeypatch):
    """At most as many equilibria as three goals within reach; what stops it is said."""
    count, evaluated = [0], Evaluator.__call__

    def counted(*args, **kwargs):
        count[0] += 1
        return evaluated(*args, **kwargs)

    monkeypatch.setattr(Evaluator, "__call__", counted)
    start, limit = robot(top=0.1), {"top": Limits(force=(0.0, 10.0))}
    used = []
    for bend in (0.2, 0.6, 1.2, 3.0):
        before = count[0]
        result = solve_inverse(arm(), start, goals={"bend": bend}, limits=limit)
        used.append(count[0] - before)
        assert result.met == (bend < 2.0)
    assert used[-1] <= sum(used[:3])
    check_only(result.held_by, "force ... 'top' ... upper limit, 10 N")
    assert says(str(result), "'bend' is off by -", "held by", "Commanded: top = 10 N")
