"""Files of 6-D trackers: what is read, and what is refused with which words."""

import numpy as np
import pytest
from refusals import refused

from softcal_jax.readings import TrackerWarning, read_polhemus, read_poses

HEADER = "sensor,x_mm,y_mm,z_mm,azimuth_deg,elevation_deg,roll_deg\n"
QUATERNIONS = "sensor,x_m,y_m,z_m,qw,qx,qy,qz\n"


def R(axis, degrees):
    """Rotation about an axis, written out."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def test_rows_in_metres_with_repeats_and_selection(table):
    text = HEADER.replace("sensor", "run,sensor") + (
        "1,b,10,20,-30,0,0,0\n# a comment\n\n1,a,1,2,3,90,0,0\n2,a,4,5,6,0,0,0\n"
        "1,a,1,2,4,90,0,0\n"
    )
    poses = read_poses(table(text), select={"run": "1"})
    assert poses.names == ("b", "a", "a")
    assert poses.lines == (2, 5, 7)
    assert poses.source.endswith("table.csv (run = 1)")
    expected = [[0.01, 0.02, -0.03], [0.001, 0.002, 0.003], [0.001, 0.002, 0.004]]
    np.testing.assert_allclose(poses.positions, expected, rtol=1e-15)
    np.testing.assert_allclose(poses.rotations[0], np.eye(3))
    a = poses.readings_of("a")
    assert (a.names, a.lines) == (("a", "a"), (5, 7))
    np.testing.assert_array_equal(a.positions, poses.positions[1:])


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_angles_turn_about_z_then_y_then_x(table, unit):
    """Polhemus: from the sensor's axes to those of the base."""
    angles = np.array([110.0, -35.0, -170.0])
    written = angles if unit == "deg" else np.deg2rad(angles)
    row = "s,0,0,0," + ",".join(map(repr, written.tolist()))
    poses = read_poses(table(HEADER.replace("deg", unit) + row + "\n"))
    expected = R("z", 110.0) @ R("y", -35.0) @ R("x", -170.0)
    np.testing.assert_allclose(poses.rotations[0], expected, atol=1e-15)
    # Azimuth turns the sensor's x axis from the base's x to its y, elevation downwards.
    direction = [np.cos(np.deg2rad(110)), np.sin(np.deg2rad(110))]
    np.testing.assert_allclose(
        poses.rotations[0][:, 0],
        [*(np.cos(np.deg2rad(35)) * np.array(direction)), np.sin(np.deg2rad(35))],
    )


def test_quaternions(table):
    half = np.deg2rad(35.0)
    row = f"s,1,2,3,{np.cos(half):.17g},0,{np.sin(half):.17g},0\n"
    poses = read_poses(table(QUATERNIONS + row + "s,1,2,3,0.7071,0.7071,0,0\n"))
    np.testing.assert_allclose(poses.rotations[0], R("y", 70.0), atol=1e-15)
    # Four digits, and still a rotation.
    np.testing.assert_allclose(poses.rotations[1], R("x", 90.0), atol=1e-15)


def test_quaternion_of_another_length(table):
    with refused("line 3: ... quaternion ... 1.01"):
        read_poses(table(QUATERNIONS + "s,1,2,3,1,0,0,0\ns,1,2,3,1.01,0,0,0\n"))


@pytest.mark.parametrize(
    ("header", "texts"),
    [
        (HEADER.replace("sensor", "marker"), ["column 'sensor' is missing."]),
        (HEADER.replace("x_mm,y_mm,z_mm", "x,y,z"), ["no unit"]),
        (HEADER.replace("y_mm", "y_cm"), ["column 'y_mm' is missing."]),
        (HEADER.replace("_deg", ""), ["unit ... azimuth_deg"]),
        ("sensor,x_m,y_m,z_m\n", ["in 0 forms", "there: sensor"]),
        (
            HEADER.replace("roll_deg", "roll_rad"),
            ["in 2 forms ... there: ... roll_rad"],
        ),
        (HEADER.replace("roll_deg", "qw"), ["in 2 forms ... elevation_deg, qw"]),
        (HEADER.replace("roll_deg", "rol_deg"), ["'roll_deg' ... mean 'rol_deg'"]),
    ],
)
def test_bad_header(table, header, texts):
    row = ",".join("1" for _ in header.split(","))
    with refused(*texts):
        read_poses(table(header + row + "\n"))


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ("s,1,,3,0,0,0", "line 2: y_mm ... 's' is missing ... Leave"),
        ("s,1,2,3,0,nan,0", "elevation_deg ... 's' is missing"),
        ("s,1,2,3,0,0,q", "line 2: roll_deg ... 's' ... 'q', not a number"),
        ("s,1,2,3,361,0,0", "line 2: the azimuth ... 361 deg ... 360 deg"),
        ("s,1,2,3,0,120,0", "line 2: the elevation ... 120 deg ... 90 deg"),
        ("s,1,2,3,0,0", "line 2: 6 cells ... 7 columns"),
    ],
)
def test_bad_rows(table, row, text):
    with refused(text):
        read_poses(table(HEADER + row + "\n"))


def test_degrees_under_a_header_of_radians(table):
    with refused("line 2: the roll ... 45 rad ... 6.283 rad ... unit"):
        read_poses(table(HEADER.replace("deg", "rad") + "s,0,0,0,0,0,45\n"))


def test_radians_under_a_header_of_degrees(table):
    with pytest.warns(TrackerWarning, match=r"not degrees, .*angle_unit"):
        read_poses(table(HEADER + "s,0,0,0,1.57,0,0\ns,0,0,0,-3.1,0.2,0.1\n"))


@pytest.mark.parametrize("angles", ["0.9,0.1,-0.3", "1.57,0,3.2", "0,1.6,0"])
def test_small_angles_are_not_suspect(table, angles):
    read_poses(table(HEADER + f"s,0,0,0,{angles}\n"))


def test_unknown_sensor(table):
    poses = read_poses(table(HEADER + "tip,0,0,0,0,0,0\nbase,0,0,0,0,0,0\n"))
    with refused("'tp' ... mean 'tip' ... tip, base"):
        poses.readings_of("tp")


def test_no_such_file(tmp_path):
    for read in (read_poses, lambda path: read_polhemus(path, length_unit="cm")):
        with pytest.raises(FileNotFoundError, match=r"no\.csv .*not exist"):
            read(tmp_path / "no.csv")


POLHEMUS = """\
01   10.00  -2.50   3.00   90.00   0.00   0.00
02    1.00   0.00   0.00    0.00 -35.00  12.00
# moved
01   11.00  -2.50   3.00   90.00   0.00   0.00
"""


def test_polhemus_text(table):
    poses = read_polhemus(table(POLHEMUS), length_unit="inch")
    assert poses.names == ("station 1", "station 2", "station 1")
    assert poses.lines == (1, 2, 4)
    np.testing.assert_allclose(poses.positions[0], 0.0254 * np.array([10, -2.5, 3.0]))
    np.testing.assert_allclose(poses.rotations[0], R("z", 90.0), atol=1e-15)
    expected = R("y", -35.0) @ R("x", 12.0)
    np.testing.assert_allclose(poses.rotations[1], expected, atol=1e-15)


def test_polhemus_stations_by_name(table):
    path = table(POLHEMUS)
    poses = read_polhemus(path, length_unit="cm", station=1)
    assert poses.names == ("station 1", "station 1")
    with refused("no station 3 ... 1, 2"):
        read_polhemus(path, length_unit="cm", station=3)


def test_polhemus_in_radians(table):
    text = "1 0 0 0 1.5 -0.5 0.2\n"
    poses = read_polhemus(table(text), length_unit="cm", angle_unit="rad")
    angles = np.rad2deg([1.5, -0.5, 0.2])
    expected = R("z", angles[0]) @ R("y", angles[1]) @ R("x", angles[2])
    np.testing.assert_allclose(poses.rotations[0], expected, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "no readings"),
        ("1 0 0 0 0 0\n", "line 1: got '1 0 0 0 0 0' ... 7"),
        ("1 0 0 x 0 0 0\n", "line 1: got '1 0 0 x 0 0 0' ... finite numbers"),
        ("\n1 0 0 0 inf 0 0\n", "line 2: got '1 0 0 0 inf 0 0' ... finite"),
        ("1.5 0 0 0 0 0 0\n", "line 1: got '1.5 0 0 0 0 0 0' ... an integer station"),
    ],
)
def test_bad_polhemus_text(table, text, message):
    with refused(message):
        read_polhemus(table(text), length_unit="cm")


def test_polhemus_units(table):
    path = table(POLHEMUS)
    with refused("'inches' ... mean 'inch'"):
        read_polhemus(path, length_unit="inches")
    with refused("'degree' ... mean 'deg'"):
        read_polhemus(path, length_unit="cm", angle_unit="degree")
    with refused("azimuth ... 90 rad", "angle_unit"):
        read_polhemus(path, length_unit="cm", angle_unit="rad")
