"""The search goes on from elsewhere, and says what holds it where nothing helps."""

import signal
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from arm import EFFECTORS, LENGTH, REST, SIDE, TIGHT, arm, check_only, pose, tips
from wording import says

from softcal_jax.actuators import Cable, Guide
from softcal_jax.calibration import _runs
from softcal_jax.configurations import (
    Centroid,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Markers,
)
from softcal_jax.control import (
    OUTCOMES,
    ControlSettings,
    Limits,
    _search,
    follow_trajectory,
    solve_inverse,
)
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam
from softcal_jax.results import headline

DIRECT, FEW = ControlSettings(other_starts=0), ControlSettings(other_starts=3)


def robot(gravity=REST, **actuation):
    return pose(gravity, EFFECTORS, **actuation)


@pytest.mark.slow
def test_a_goal_on_the_other_side_of_a_fold_is_met():
    """x of the tip is l cos(angle): downhill from -0.05 is the limit at -0.1.

    The goal is met at +0.5 alone, behind the angle 0 where the motor does not move x.
    """
    model, start, goal, more = behind_a_fold()
    run = lambda settings: solve_inverse(
        model, start, goals=goal, settings=settings, **more
    )
    local = run(DIRECT)
    assert local.outcome == OUTCOMES.nearest
    check_only(local.held_by, "displacement ... 'motor' ... lower")
    assert len(local.attempts) == 1
    result = run(ControlSettings())
    assert result.met
    np.testing.assert_allclose(result.inputs, [0.5], rtol=1e-3)
    assert result.attempts[0].outcome != OUTCOMES.met
    assert result.attempts[-1].way.startswith("other start")
    assert result.held_by == ()
    assert result.blind is None


def test_a_goal_far_away_is_found_to_be_so_early(monkeypatch):
    """Few of the other starts are needed, and all of them lead hardly closer."""
    limits = {
        "top": Limits(force=(0.0, 3.0)),
        "motor": Limits(displacement=(-0.5, 0.5)),
    }
    far = {"tip": (2.0 * LENGTH, 0.0, LENGTH)}
    run = lambda: solve_inverse(
        arm(), robot(top=0.8, motor=0.1), goals=far, limits=limits
    )
    early = run()
    assert early.outcome == OUTCOMES.nearest
    assert len(early.attempts) == _search.AGREEING
    monkeypatch.setattr(_search, "AGREEING", 100)
    whole = run()
    assert len(whole.attempts) > 20
    size = lambda result: np.linalg.norm(result.goals[0].residual)
    assert size(early) <= 1.01 * size(whole)


def interrupted_at(monkeypatch, step):
    """From the step of this number on, of all descents, Ctrl-C is pressed in one."""
    count, decide = iter(range(1, 1000)), _runs.decide

    def decided(*args):
        if next(count) == step:
            signal.raise_signal(signal.SIGINT)
        return decide(*args)

    monkeypatch.setattr(_runs, "decide", decided)


def behind_a_fold():
    """Model, start, goal and limits of the search above."""
    at_end = Markers(["end"], [(LENGTH, SIDE / 2, SIDE / 2)], axes="x")
    start = replace(pose(REST, EFFECTORS[1:], motor=-0.05), markers=at_end)
    goal = {"end": (LENGTH * np.cos(0.5), 0.0, 0.0)}
    limits = {"motor": Limits(displacement=(-0.1, 0.8))}
    more: dict[str, Any] = {"limits": limits}
    return arm(), start, goal, more


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_an_interrupted_search_gives_the_best_so_far(monkeypatch, step):
    model, start, goal, more = behind_a_fold()
    interrupted_at(monkeypatch, step)
    result = solve_inverse(model, start, goals=goal, throw=False, **more)
    assert result.outcome == OUTCOMES.interrupted
    assert says(headline(result), "interrupted", "'end' is off by")
    assert not result.met
    assert sum(tried.n_steps for tried in result.attempts) == step - 1
    least = min(tried.error for tried in result.attempts)
    (end,) = result.goals
    assert end.worst == pytest.approx(least, rel=1e-3)
    at = solve_equilibrium(model, result.configuration).displacement
    np.testing.assert_allclose(result.solution.displacement, at, atol=1e-9)


def test_a_continuation_that_is_interrupted_is_judged_by_the_goals(monkeypatch):
    """Its own goals lie nearer than the real ones, to which the start comes closest."""
    limits = {"top": Limits(force=(0.0, 3.0)), "motor": Limits(displacement=(-1, 1))}
    goals = {"tip": (0.08, 0.01, 0.09)}
    over_goals = _search._over_goals

    def interrupted(robot, first):
        interrupted_at(monkeypatch, 2)
        return over_goals(robot, first)

    monkeypatch.setattr(_search, "AGREEING", 100)
    monkeypatch.setattr(_search, "_over_goals", interrupted)
    result = solve_inverse(
        arm(),
        robot(top=0.8, motor=0.1),
        goals=goals,
        limits=limits,
        settings=FEW,
        throw=False,
    )
    assert result.outcome == OUTCOMES.interrupted
    (end,) = result.goals
    error = end.worst
    assert error == pytest.approx(min(t.error for t in result.attempts), rel=1e-3)


def test_an_interrupted_call_or_trajectory_does_not_pass_for_a_whole_one(monkeypatch):
    model, start, goal, more = behind_a_fold()
    more |= {"settings": DIRECT}
    near = {"end": (LENGTH * np.cos(0.06), 0.0, 0.0)}
    whole = solve_inverse(model, start, goals=near, **more)
    with monkeypatch.context() as patch:
        interrupted_at(patch, 1)
        with pytest.raises(KeyboardInterrupt, match="interrupted"):
            solve_inverse(model, start, goals=goal, **more)
    goals = [near, goal, near]
    with monkeypatch.context() as patch:
        interrupted_at(patch, len(whole.steps) + 1)
        result = follow_trajectory(model, start, goals, throw=False, **more)
    assert [point.outcome == OUTCOMES.met for point in result.points] == [True, False]
    assert result.points[1].outcome == OUTCOMES.interrupted
    # Before the second goal has an equilibrium: the only point that there is was met.
    once = iter([_search.begin])

    def begun(*args):
        for begin in once:
            return begin(*args)
        raise KeyboardInterrupt

    monkeypatch.setattr(_search, "begin", begun)
    (point,) = follow_trajectory(model, start, goals, throw=False, **more).points
    assert point.outcome == OUTCOMES.interrupted


def test_a_direction_that_nothing_moves_is_named():
    """Two inputs move the tip on a surface; a goal beside it is off that way."""
    at, h = np.array([1.0, 0.2]), 1e-3
    steps = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    tip, *sides = tips(robot(top=0.0, motor=0.0), at + h * steps)
    normal = np.cross(sides[0] - sides[1], sides[2] - sides[3])
    normal /= np.linalg.norm(normal)
    aside = 5e-4
    result = solve_inverse(
        arm(),
        robot(top=0.8, motor=0.1),
        goals={"tip": tip + aside * normal},
        settings=FEW,
    )
    assert result.outcome == OUTCOMES.nearest
    assert result.held_by == ()
    np.testing.assert_allclose(result.inputs, [1.0, 0.2], rtol=0.01)
    blind = result.blind
    assert blind is not None
    assert blind.coordinates == ("x of 'tip'", "y of 'tip'", "z of 'tip'")
    # From the goal to the tip.
    np.testing.assert_allclose(blind.direction, -normal, atol=2e-3)
    np.testing.assert_allclose(blind.off, -aside * normal, atol=2e-6)
    assert blind.gain < 1e-6
    np.testing.assert_allclose(result.goals[0].residual, blind.off, atol=5e-6)
    assert says(headline(result), "'tip' is off by x ... blind direction x of 'tip'")


def test_the_limit_that_holds_is_named_and_another_is_not():
    """Both are reached; only one pushes back, and lifting it brings the tip nearer."""
    (goal,), tension = tips(robot(top=0.0, motor=0.0), [[1.0, 0.4]]), 1.0
    limits = {
        "top": Limits(force=(0.0, tension)),
        "motor": Limits(displacement=(-0.1, 0.2)),
    }
    distance = lambda result: np.linalg.norm(result.goals[0].residual)
    run = lambda **wider: solve_inverse(
        arm(),
        robot(top=0.5, motor=0.1),
        goals={"tip": goal},
        limits=limits | wider,
        settings=FEW,
    )
    held = run()
    assert held.outcome == OUTCOMES.nearest
    assert says(held.held_by, "displacement ... 'motor' ... upper")
    assert "held by" in headline(held)
    assert distance(run(motor=Limits(displacement=(-0.1, 0.25)))) < distance(held)


@pytest.mark.slow  # a program of its own
def test_two_actuators_that_impose_one_displacement_are_called_singular():
    """How they share the tension is open; an equilibrium is not what is missing."""
    path = [Guide((0.0, SIDE / 2, SIDE), "ground"), Guide((LENGTH, SIDE / 2, SIDE))]
    twins = ("one", "two")
    model = build_model(
        beam(LENGTH, SIDE, SIDE, (2, 1, 1), order=1),
        Corotational(Isotropic(2e5, 0.3)),
        density=0.0,
        actuators=[Cable(name, path) for name in twins],
    )
    start = Configuration(
        "twins",
        "x_min",
        effectors=[Centroid("tip", "x_max")],
        actuation={name: ImposedDisplacement(0.002) for name in twins},
    )
    goals = {"tip": (LENGTH, SIDE / 2, SIDE)}
    result = solve_inverse(model, start, goals=goals, throw=False)
    assert result.outcome == OUTCOMES.singular
    assert result.attempts == ()
    with pytest.raises(RuntimeError, match="start is singular"):
        solve_inverse(model, start, goals=goals)
    # One of them by its force: the same robot, and nothing is open.
    by_force = {"one": ImposedDisplacement(0.002), "two": ImposedForce(0.0)}
    result = solve_inverse(model, replace(start, actuation=by_force), goals=goals)
    assert result.outcome == OUTCOMES.nearest


def test_a_motor_turns_in_one_load_step():
    """Its axis stays, so that there is no screw to follow in small steps."""
    corotational = Corotational(Isotropic(2e5, 0.3))
    model = eqx.tree_at(lambda m: m.law, arm(), corotational)
    solution = solve_equilibrium(model, pose(REST, motor=0.8), settings=TIGHT)
    assert solution.converged
    assert solution.load_steps == 1
