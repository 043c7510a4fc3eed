"""Change of frame and means of measured poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softcal_jax.bodies import Pose
from softcal_jax.configurations import PoseTable, average_poses, in_frame


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


def test_offset_of_the_sensor_by_hand():
    """A sensor 10 mm ahead of the body along its x, turned by 90 degrees about z."""
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    sensor = Pose(np.array([0.010, 0.0, 0.0]), turn.as_rotvec())
    # The sensor reads the base's axes, so the body is turned by -90 degrees: its x
    # points along -y, and its origin lies 10 mm behind, at +y.
    table = rows([[1.0, 2.0, 3.0]], [np.eye(3)])
    body = in_frame(table, sensor=sensor)
    np.testing.assert_allclose(body.rotations[0], turn.inv().as_matrix(), atol=1e-15)
    np.testing.assert_allclose(body.positions[0], [1.0, 2.010, 3.0], rtol=1e-15)


def test_place_of_the_base_by_hand():
    """A base 1 m up, its x along the robot's y."""
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    base = Pose(np.array([0.0, 0.0, 1.0]), turn.as_rotvec())
    robot = in_frame(rows([[1.0, 0.0, 0.0]], [np.eye(3)]), base=base)
    np.testing.assert_allclose(robot.positions[0], [0.0, 1.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(robot.rotations[0], turn.as_matrix(), atol=1e-15)


def test_body_comes_back_from_what_the_tracker_reads():
    """T_reading = T_base^-1 T_body T_sensor, by homogeneous matrices."""
    rng = np.random.default_rng(3)
    base, sensor = random_pose(rng), random_pose(rng)
    bodies = [random_pose(rng) for _ in range(4)]
    T_base = homogeneous(base.matrix, base.translation)
    T_sensor = homogeneous(sensor.matrix, sensor.translation)
    readings = [
        np.linalg.inv(T_base) @ homogeneous(body.matrix, body.translation) @ T_sensor
        for body in bodies
    ]
    table = rows([T[:3, 3] for T in readings], [T[:3, :3] for T in readings])
    back = in_frame(table, base=base, sensor=sensor)
    for i, body in enumerate(bodies):
        np.testing.assert_allclose(back.positions[i], body.translation, atol=1e-14)
        np.testing.assert_allclose(back.rotations[i], body.matrix, atol=1e-14)
    assert (back.names, back.lines, back.source) == (
        table.names,
        table.lines,
        table.source,
    )


def test_without_transforms_nothing_changes():
    table = rows([[1.0, 2.0, 3.0]], [np.eye(3)])
    same = in_frame(table)
    np.testing.assert_array_equal(same.positions, table.positions)
    np.testing.assert_array_equal(same.rotations, table.rotations)


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
    return deviations, rows([1.0, 2.0, 3.0] + deviations[:, :3], turned.as_matrix())


def test_mean_and_covariance_of_known_deviations():
    deviations, table = scattered()
    mean = average_poses(table)["s"]
    assert mean.n_readings == 6
    np.testing.assert_allclose(mean.position, [1.0, 2.0, 3.0], rtol=1e-14)
    np.testing.assert_allclose(mean.rotation, MEAN.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(mean.deviations, deviations, atol=1e-14)
    covariance = sum(np.outer(d, d) for d in deviations) / 5.0
    np.testing.assert_allclose(mean.reading_covariance, covariance, atol=1e-16)
    np.testing.assert_allclose(mean.mean_covariance, covariance / 6.0, atol=1e-16)


def test_each_sensor_for_itself():
    _, table = scattered()
    both = PoseTable(
        ("a", "b", "a", "a", "b", "a"),
        table.positions,
        table.rotations,
        table.lines,
        "file",
    )
    means = average_poses(both)
    assert {name: mean.n_readings for name, mean in means.items()} == {"a": 4, "b": 2}
    np.testing.assert_allclose(
        means["b"].position, table.positions[[1, 4]].mean(axis=0)
    )


def test_covariance_comes_from_noise_of_that_covariance():
    """Of many readings with noise of a known covariance, within its sampling error."""
    rng = np.random.default_rng(11)
    std = np.array([1e-4, 2e-4, 1e-4, 1e-3, 2e-3, 3e-3])
    n = 4000
    noise = std * rng.normal(size=(n, 6))
    turned = Rotation.from_rotvec(noise[:, 3:]) * MEAN
    mean = average_poses(rows(noise[:, :3], turned.as_matrix()))["s"]
    # A sample standard deviation is off by 1 / sqrt(2 n) = 1.1 %; four times that.
    found = np.sqrt(np.diag(mean.reading_covariance))
    np.testing.assert_allclose(found, std, rtol=4.0 / np.sqrt(2 * n))
    assert np.all(np.abs(mean.position) < 4.0 * std[:3] / np.sqrt(n))


def test_one_reading_has_a_mean_and_no_covariance():
    mean = average_poses(rows([[1.0, 2.0, 3.0]], [MEAN.as_matrix()]))["s"]
    np.testing.assert_allclose(mean.rotation, MEAN.as_matrix(), atol=1e-15)
    with pytest.raises(ValueError, match="'s' has one reading: a covariance needs two"):
        _ = mean.reading_covariance
    with pytest.raises(ValueError, match="'s' has one reading"):
        _ = mean.mean_covariance


def test_readings_of_two_poses_are_refused():
    turned = Rotation.from_rotvec(np.deg2rad([[0, 0, 0], [0, 0, 0], [90, 0, 0]]))
    table = rows(np.zeros((3, 3)), turned.as_matrix())
    # The mean of 0, 0 and 90 degrees is atan2(1, 2) = 26.6 degrees.
    with pytest.raises(ValueError, match=r"line 4: .* 's' turns by 63\.4 deg from the"):
        average_poses(table)


@pytest.mark.usefixtures("unchecked")
def test_a_table_that_does_not_fit():
    with pytest.raises(
        ValueError, match=r"2 names need as many .* \(1, 3\), \(1, 3, 3"
    ):
        PoseTable(("a", "b"), np.zeros((1, 3)), np.zeros((1, 3, 3)), (1,), "file")
