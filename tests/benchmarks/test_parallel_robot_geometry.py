"""The parallel robot of Sec. VI: its numbers, meshes, control points and arms."""

import numpy as np
import pytest
from arms import arm_pose

from benchmarks._parallel_robot_geometry import ParallelRobotGeometry
from benchmarks._tripod import tripod
from softcal_jax.mesh import check_mesh, volumes

ROBOT = ParallelRobotGeometry()
ARMS = ROBOT.arms()
ANGLES = np.deg2rad([0.0, 25.0, 45.0, 65.0, 90.0])


def moved(pose, origin, points):
    return (points - origin) @ pose.matrix.T + origin + pose.translation


def frame(arm):
    """Outward direction of the arm's branch, and the one towards the middle."""
    sheet, branch = arm.name.split()
    azimuth = np.deg2rad(120.0 * (int(branch) - 1))
    side = {"lower": -1.0, "upper": 1.0}[sheet]
    return np.array([np.cos(azimuth), 0.0, np.sin(azimuth)]), side


def test_density_and_pull():
    # The reference rounds it down to 1169.
    np.testing.assert_allclose(ROBOT.density, 1169.6, atol=0.1)
    np.testing.assert_allclose(ROBOT.rod_pull, 0.020)
    volume = volumes(tripod(size=0.0025, order=1)).sum()
    # The mesh has a polygon of 48 corners for a hole.
    np.testing.assert_allclose(ROBOT.density * volume, ROBOT.sheet_mass, rtol=1e-4)


def test_two_sheets():
    mesh = ROBOT.mesh(size=0.0075, order=1)
    y = mesh.points[:, 1]
    for sheet, middle in (("lower", -0.060), ("upper", 0.060)):
        nodes = mesh.nodes(sheet)
        np.testing.assert_allclose(
            [y[nodes].min(), y[nodes].max()], [middle - 0.0025, middle + 0.0025]
        )
        x, _, z = mesh.points[mesh.nodes(f"{sheet}/centre")].T
        np.testing.assert_allclose(np.hypot(x, z).max(), 0.0075)
    assert {arm.end for arm in ARMS} <= set(mesh.node_groups)
    check_mesh(tripod(size=0.0075, order=1))


def test_order_and_size_reach_the_mesh():
    assert ROBOT.mesh(size=0.0075).order == 2
    linear = ROBOT.mesh(order=1)
    finer = ROBOT.mesh(order=1, size=0.004)
    assert finer.n_nodes > linear.n_nodes


def test_control_points_and_start():
    points = ROBOT.control_points()
    assert points.axes == "xz"
    assert points.names == (
        "CP branch 1 inner",
        "CP branch 1 outer",
        "CP branch 2 inner",
        "CP branch 2 outer",
        "CP branch 3 inner",
        "CP branch 3 outer",
        "CP ring 30 deg",
        "CP ring 90 deg",
        "CP ring 150 deg",
        "CP ring 210 deg",
        "CP ring 270 deg",
        "CP ring 330 deg",
    )
    x, y, z = np.asarray(points.positions).T
    np.testing.assert_array_equal(y, 0.0)
    radii = [0.026, 0.042] * 3 + [0.013] * 6
    np.testing.assert_allclose(np.hypot(x, z), radii, rtol=1e-12)
    azimuth = np.repeat([0.0, 120.0, 240.0], 2).tolist() + list(range(30, 360, 60))
    turn = np.angle(np.exp(1j * (np.arctan2(z, x) - np.deg2rad(azimuth))))
    np.testing.assert_allclose(turn, 0.0, atol=1e-12)
    # Branch 2, at 120 degrees, lies towards +z.
    np.testing.assert_allclose((x[3], z[3]), (-0.021, 0.042 * np.sqrt(0.75)))

    theta = np.rad2deg(ROBOT.start_angles())
    np.testing.assert_allclose(theta, np.array(azimuth) + 60.0)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
@pytest.mark.parametrize("angle", ANGLES)
def test_the_arm_carries_the_end_where_the_text_says(arm, angle):
    """Reference 6: the point at s = 58.5 mm, and the direction inwards."""
    e_r, side = frame(arm)
    e_a = np.array([0.0, -side, 0.0])
    axis = 0.066 * e_r + [0.0, side * 0.090, 0.0]
    flat = 0.0585 * e_r + [0.0, side * 0.060, 0.0]
    towards = -np.cos(angle) * e_r + np.sin(angle) * e_a
    pose = arm_pose(arm, float(angle))
    np.testing.assert_allclose(arm.origin, flat, atol=1e-15)
    np.testing.assert_allclose(
        moved(pose, arm.origin, flat), axis + 0.030 * towards, atol=1e-15
    )
    np.testing.assert_allclose(
        flat + pose.translation, axis + 0.030 * towards, atol=1e-15
    )
    np.testing.assert_allclose(pose.matrix @ -e_r, towards, atol=1e-15)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_mounting_then_rotation_about_the_axis(arm):
    """Rodrigues' formula, about the motor axis, on the mounted end."""
    e_r, side = frame(arm)
    np.testing.assert_array_equal(arm.mounting.matrix, np.eye(3))
    np.testing.assert_allclose(
        arm.mounting.translation, -0.0225 * e_r + [0.0, side * 0.030, 0.0], atol=1e-15
    )
    np.testing.assert_allclose(arm.axis_direction @ e_r, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(arm.axis_direction), 1.0, rtol=1e-15)
    flat = arm.origin + np.random.default_rng(0).normal(0.0, 0.01, (5, 3))
    mounted = moved(arm.mounting, arm.origin, flat)
    np.testing.assert_allclose(
        moved(arm_pose(arm, 0.0), arm.origin, flat), mounted, atol=1e-15
    )
    angle, k, lever = 0.7, arm.axis_direction, mounted - arm.axis_point
    turned = (
        np.cos(angle) * lever
        + np.sin(angle) * np.cross(k, lever)
        + (1.0 - np.cos(angle)) * np.outer(lever @ k, k)
    )
    np.testing.assert_allclose(
        moved(arm_pose(arm, angle), arm.origin, flat),
        arm.axis_point + turned,
        atol=1e-15,
    )


def test_the_end_group_is_about_its_origin():
    mesh = ROBOT.mesh(size=0.0075, order=1)
    for arm in ARMS:
        X = mesh.points[mesh.nodes(arm.end)]
        middle = (X.min(axis=0) + X.max(axis=0)) / 2.0
        distance = np.linalg.norm(X - arm.origin, axis=1)
        # Half the diagonal of 15 x 30 x 5 mm, at its eight corners.
        np.testing.assert_allclose(
            distance.max(), np.linalg.norm([0.0075, 0.015, 0.0025]), rtol=1e-12
        )
        np.testing.assert_allclose(middle[1], arm.origin[1], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arm_length": 0.0}, "arm_length .*got 0.0"),
        ({"E_t": float("nan")}, "E_t .*got nan"),
        ({"rod_half_length": 0.07}, "rod_half_length 0.07 m .*sheet_height 0.06 m"),
    ],
)
def test_refuses(change, message):
    with pytest.raises(ValueError, match=message):
        ParallelRobotGeometry(**change)
