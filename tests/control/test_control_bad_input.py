"""What a user gets wrong is refused before anything is solved, in words."""

import numpy as np
import pytest
from arm import arm, pose

from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    BodyAngle,
    BodyFrame,
    Centroid,
    ContactForce,
    ImposedDisplacement,
    Markers,
)
from softcal_jax.control import (
    ControlSettings,
    ControlWarning,
    Limits,
    follow_trajectory,
    solve_inverse,
    with_goals,
)

EFFECTORS = [
    BodyFrame("frame", "tip"),
    Centroid("tip", "x_max"),
    BodyAngle("bend", "tip", "base", (0, -1, 0)),
]
START = pose(effectors=EFFECTORS, top=1.0, motor=0.1)
GOAL = {"tip": (0.1, 0.0, 0.0)}


def test_a_trajectory_has_a_goal():
    with pytest.raises(ValueError, match="goals is empty"):
        follow_trajectory(arm(), START, [])


def test_a_force_along_one_axis_has_a_goal_of_one_number():
    cell = ContactForce("cell", "probe", axis=(0, 0, 1))
    force = {"cell": 1.5}
    (aimed,) = with_goals(pose(effectors=[cell]), force).effectors
    assert aimed.measured == 1.5


@pytest.mark.parametrize(
    ("goals", "message"),
    [
        ({"tip": (0.1, 0.0)}, "'tip' has 2 numbers, expected 3"),
        ({"bend": (0.1, 0.2)}, "'bend' has 2 numbers, expected 1"),
        ({"tip": Pose()}, "'tip' .*Pose of 6 .* 3 numbers"),
        ({"bend": Pose()}, "'bend' .*Pose of 6 .* 1 number"),
        ({"frame": np.zeros(3)}, "'frame' .*array.* Pose, of 6"),
        ({"tpi": (0.1, 0.0, 0.0)}, "effector .*'tpi'.* mean 'tip'"),
        ({"tip": (0.1, np.nan, 0.0)}, "'tip' .*nan .*three finite"),
        ({}, "goal: .*'frame', 'tip', 'bend'"),
    ],
)
def test_goals(goals, message):
    with pytest.raises(ValueError, match=message):
        solve_inverse(arm(), START, goals=goals)


def test_a_goal_many_body_lengths_away():
    """A goal in millimetres; here a warning is an error, so nothing is solved."""
    with pytest.raises(ControlWarning, match=r"'tip' .* 99\.9 m .* 961 times"):
        solve_inverse(arm(), START, goals={"tip": (100.0, 0.0, 0.0)})


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"top": Limits(force=(5.0, 2.0))}, "force .*'top' .* 5 N, .* 2 N"),
        ({"top": Limits(force=(-3.0, -1.0))}, "'top' .* -1 N, .*only pulls"),
        ({"motor": Limits(displacement=(0.2, 0.5))}, "'motor' .*outside .* 0.1 rad"),
        ({"top": Limits(displacement=(0.01, 0.0))}, "'top' .* 0.01 m, .* 0 m"),
        ({"top": Limits(step=-1.0)}, "cable 'top': step .*got -1"),
        ({"bottom": Limits()}, "'bottom' has limits"),
        ({"topp": Limits()}, "limits 'topp'.* mean 'top'"),
    ],
)
def test_limits_that_clash_are_named(limits, message):
    with pytest.raises(ValueError, match=message):
        solve_inverse(arm(), START, goals=GOAL, limits=limits)


def test_a_command_without_an_actuator():
    with pytest.raises(ValueError, match=r"no actuator.*'top', 'bottom'"):
        solve_inverse(arm(), pose(effectors=EFFECTORS), goals=GOAL)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"tol": 0.0}, "tol .*positive, got 0"),
        ({"step_bound": -1.0}, "step_bound .*positive, got -1"),
        ({"max_steps": 0}, "max_steps .*least 1, got 0"),
        ({"epsilon": -1.0}, "epsilon .*not .*negative, got -1"),
    ],
)
def test_settings(setting, message):
    with pytest.raises(ValueError, match=message):
        ControlSettings(**setting)


def test_goals_of_every_kind():
    """Each lands in the measured value of its effector, and no other value counts."""
    markers = Markers(["a", "b"], [(0.05, 0.01, 0.0), (0.05, 0.01, 0.02)])
    start = pose(effectors=EFFECTORS, motor=ImposedDisplacement(0.0))
    start = type(start)(**{**vars(start), "markers": markers})
    aimed = with_goals(
        start,
        {
            "frame": Pose((0.01, 0, 0)),
            "tip": [0.1, 0, 0],
            "bend": 0.2,
            "a": (1.0, 2.0, 3.0),
            "b": (4.0, 5.0, 6.0),
        },
    )
    measured = [getattr(effector, "measured", None) for effector in aimed.effectors]
    assert isinstance(measured[0], Pose)
    np.testing.assert_array_equal(measured[0].translation, [0.01, 0, 0])
    np.testing.assert_array_equal(measured[1], [0.1, 0, 0])
    assert measured[2] == 0.2
    np.testing.assert_array_equal(aimed.measured, [[1, 2, 3], [4, 5, 6]])
    # As on the command line: other markers and effectors are free, and so is a nan.
    again = with_goals(aimed, {"b": (np.nan, 8.0, np.nan)})
    assert (again.markers.names, again.markers.axes) == (("b",), "y")
    assert again.measured[0, 1] == 8.0
    assert [effector.measured for effector in again.effectors] == [None] * 3
    with pytest.raises(ValueError, match="'a' leaves every coordinate free"):
        with_goals(start, {"a": (np.nan,) * 3})
    with pytest.raises(ValueError, match="'a' and 'b' leave different coordinates"):
        with_goals(start, {"a": (1.0, 2.0, np.nan), "b": (1.0, 2.0, 3.0)})
