"""Change of frame and means of measured poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import Pose
from softcal_jax.readings import PoseTable


def rows(positions, rotations, names=None):
    n = len(positions)
    names = ("s",) * n if names is None else names
    lines = tuple(range(2, n + 2))
    return PoseTable(
        names, np.asarray(positions, float), np.asarray(rotations, float), lines, "file"
    )


def random_pose(rng):
    return Pose(rng.normal(size=3), rng.normal(size=3))


def homogeneous(R, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def test_place_of_the_base_by_hand():
    """A base 1 m up, its x along the robot's y."""
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    base = Pose(np.array([0.0, 0.0, 1.0]), turn.as_rotvec())
    robot = rows([[1.0, 0.0, 0.0]], [np.eye(3)]).in_frame(base)
    np.testing.assert_allclose(robot.positions[0], [0.0, 1.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(robot.rotations[0], turn.as_matrix(), atol=1e-15)


def test_body_comes_back_from_what_the_tracker_reads():
    """T_reading = T_base^-1 T_body, by homogeneous matrices."""
    rng = np.random.default_rng(3)
    base = random_pose(rng)
    bodies = [random_pose(rng) for _ in range(4)]
    T_base = homogeneous(base.matrix, base.translation)
    readings = [
        np.linalg.inv(T_base) @ homogeneous(body.matrix, body.translation)
        for body in bodies
    ]
    table = rows([T[:3, 3] for T in readings], [T[:3, :3] for T in readings])
    back = table.in_frame(base)
    for i, body in enumerate(bodies):
        np.testing.assert_allclose(back.positions[i], body.translation, atol=1e-14)
        np.testing.assert_allclose(back.rotations[i], body.matrix, atol=1e-14)
    assert (back.names, back.lines, back.source) == (
        table.names,
        table.lines,
        table.source,
    )


MEAN = Rotation.from_rotvec([0.4, -1.1, 0.6])


def scattered():
    """Six readings: pairs of opposite deviations, known in the axes of the table."""
    steps = 1e-3 * np.array(
        [
            [1.0, 0.0, 0.0, 5.0, 0.0, 0.0],
            [0.0, 2.0, 0.0, 0.0, 0.0, 3.0],
            [0.0, 0.0, 1.0, 2.0, 4.0, 0.0],
        ]
    )
    deviations = np.vstack([steps, -steps])
    turned = Rotation.from_rotvec(deviations[:, 3:]) * MEAN
    return rows([1.0, 2.0, 3.0] + deviations[:, :3], turned.as_matrix())


def test_mean_of_known_deviations():
    mean = scattered().means()["s"]
    np.testing.assert_allclose(mean.translation, [1.0, 2.0, 3.0], rtol=1e-14)
    np.testing.assert_allclose(mean.matrix, MEAN.as_matrix(), atol=1e-14)


def test_each_sensor_for_itself():
    table = scattered()
    both = PoseTable(
        ("a", "b", "a", "a", "b", "a"),
        table.positions,
        table.rotations,
        table.lines,
        "file",
    )
    means = both.means()
    assert list(means) == ["a", "b"]
    np.testing.assert_allclose(
        means["b"].translation, table.positions[[1, 4]].mean(axis=0)
    )


def test_one_reading_is_its_mean():
    mean = rows([[1.0, 2.0, 3.0]], [MEAN.as_matrix()]).means()["s"]
    np.testing.assert_allclose(mean.matrix, MEAN.as_matrix(), atol=1e-15)


def test_readings_of_two_poses_are_refused():
    turned = Rotation.from_rotvec(np.deg2rad([[0, 0, 0], [0, 0, 0], [90, 0, 0]]))
    table = rows(np.zeros((3, 3)), turned.as_matrix())
    # The mean of 0, 0 and 90 degrees is atan2(1, 2) = 26.6 degrees.
    with pytest.raises(ValueError, match=r"line 4: .*'s' .* 63\.4 deg .*select"):
        table.means()
