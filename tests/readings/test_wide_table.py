"""Recordings that motion capture exports as text: their headers are honoured."""

import numpy as np
import pytest
from recordings import NAMES, RATE, motion, write_motive, write_qualisys, write_vicon

from softcal_jax.readings import (
    TrackerWarning,
    is_recording,
    read_recording,
)


def seen():
    """The motion of the tip, which is not seen in two frames, away from the origin."""
    positions = motion() + 5.0
    positions[[3, 30], 1] = np.nan
    return positions


def check(recording, labels=NAMES, metres=1e-3):
    assert recording.names == labels
    np.testing.assert_allclose(recording.times, np.arange(40) / RATE, atol=1e-9)
    np.testing.assert_allclose(recording.positions, metres * seen(), atol=1e-9)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("Meters", 1.0), ("Centimeters", 1e-2), ("Millimeters", 1e-3)],
)
def test_motive(tmp_path, unit, metres):
    """Measured markers are read, and not the solved ones 7 mm beside them."""
    path = write_motive(tmp_path / "take.csv", seen(), unit=unit)
    check(read_recording(path), metres=metres)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0)])
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_vicon(tmp_path, unit, metres, delimiter):
    """The section of the trajectories, between others."""
    path = tmp_path / "trial.csv"
    write_vicon(path, seen(), unit=unit, delimiter=delimiter)
    check(read_recording(path), labels=("arm:base", "arm:tip"), metres=metres)


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("titles", [True, False])
@pytest.mark.parametrize("decimal", [".", ","])
def test_qualisys(tmp_path, timed, titles, decimal):
    """With time and titles of columns or without, in English and German."""
    events = (("valve opens", 0.2),)
    path = write_qualisys(
        tmp_path / "run.tsv",
        seen(),
        timed=timed,
        titles=titles,
        decimal=decimal,
        events=events,
    )
    recording = read_recording(path, length_unit="mm")
    check(recording)
    assert recording.events == events


def test_a_cropped_recording_of_qualisys(tmp_path):
    """Times of frames and events count from the first frame that is left."""
    path = tmp_path / "run.tsv"
    events = (("valve opens", 3.2),)
    write_qualisys(path, seen(), events=events, start=3.0)
    recording = read_recording(path, length_unit="mm")
    check(recording)
    assert recording.time_of("valve opens") == pytest.approx(0.2)


def test_zeros_are_gaps_only_where_all_three_are(tmp_path):
    """A marker that moves in a plane of the frame is seen."""
    path = write_qualisys(tmp_path / "run.tsv", motion())
    positions = read_recording(path, length_unit="mm").positions
    np.testing.assert_allclose(positions, 1e-3 * motion(), atol=1e-9)


@pytest.mark.parametrize("write", [write_motive, write_vicon, write_qualisys])
def test_zeros_are_gaps(tmp_path, write):
    positions = motion()
    positions[:20, 1] = 0.0
    path = write(tmp_path / "a.csv", positions)
    unit = "mm" if write is write_qualisys else None
    positions = read_recording(path, length_unit=unit).positions
    assert np.isnan(positions[:20, 1]).all()
    assert np.isfinite(positions[20:]).all()
    assert np.isfinite(positions[:, 0]).all()


@pytest.mark.parametrize("titles", [True, False])
@pytest.mark.parametrize("write", [write_motive, write_vicon, write_qualisys])
def test_markers_without_a_name_are_left_out(tmp_path, write, titles):
    """Those that have one keep their columns."""
    more = {"titles": titles, "timed": titles} if write is write_qualisys else {}
    three = np.concatenate([seen()[:, :1], seen() + 1.0], axis=1)
    labels = ("base", "", "tip")
    path = write(tmp_path / "a.csv", three, labels=labels, **more)
    if write is write_vicon:
        path.write_text(path.read_text().replace("arm:,", ","))
    unit = "mm" if write is write_qualisys else None
    with pytest.warns(TrackerWarning, match=r"a\.csv: 1 of 3 markers"):
        recording = read_recording(path, length_unit=unit)
    assert [name[-3:] for name in recording.names] == ["ase", "tip"]
    np.testing.assert_allclose(recording.positions, 1e-3 * three[:, ::2], atol=1e-9)


@pytest.mark.parametrize("gap", ["", "NaN", "NULL"])
def test_gaps(tmp_path, gap):
    """As programs write what was not seen; at the end of a row it may lack."""
    path = write_vicon(tmp_path / "a.csv", motion())
    whole = read_recording(path).positions
    text = path.read_text()
    row = next(row for row in text.splitlines() if row.startswith("131,"))
    ends = row.rsplit(",", 3)[0]
    for changed in (",".join([ends, gap, gap, gap]), ends):
        path.write_text(text.replace(row, changed))
        positions = read_recording(path).positions
        assert np.isnan(positions[30, 1]).all()
        assert np.isfinite(np.delete(positions, 30, axis=0)).all()
        np.testing.assert_array_equal(positions[:30], whole[:30])


def test_the_dialect_of_a_file_can_be_stated(tmp_path):
    """Where some numbers have a comma and others a point, nothing is guessed."""
    path = write_qualisys(tmp_path / "a.tsv", motion())
    path.write_text(path.read_text().replace("\t", "|").replace("3.000000", "3,000000"))
    with pytest.raises(ValueError, match=r"line 10: .*'0\.00000', .*decimal commas"):
        read_recording(path, length_unit="mm")
    with pytest.raises(ValueError, match=r"'3,000000', .*decimal point"):
        read_recording(path, length_unit="mm", delimiter="|", decimal=".")
    with pytest.raises(ValueError, match=r"delimiter .*'-'; .*','"):
        read_recording(path, length_unit="mm", delimiter="-")
    with pytest.raises(ValueError, match="both a comma"):
        read_recording(path, length_unit="mm", delimiter=",", decimal=",")


REFUSED = {
    "unknown": (write_vicon, "Trajectories", "Model Outputs", "no table of motion"),
    "twice": (write_vicon, "arm:tip", "arm:base", "label 'arm:base' .*another"),
    "no unit": (write_vicon, "mm,mm,mm,", "mm,,mm,", "unit .*', mm'; expected"),
    "unknown unit": (write_vicon, ",mm", ",deg", "unit .*'deg'; expected"),
    "no rate": (write_vicon, "\n100\n,", "\nfast\n,", "'fast'.*Trajectories .*Nexus"),
    "no number": (write_vicon, "\n102,0,1.0", "\n102,0,one", "line 14: .*NULL.*'one0"),
    "time": (write_vicon, "\n102,0", "\n99,0", r"0\.99 s, .*not after .* 1\.01 s"),
    "feet": (write_motive, "Millimeters", "Feet", "unit .*'Feet'; expected"),
    "solved": (write_motive, ",Marker", ",Bone Marker", "only Bone Marker, .*export"),
    "rate of zero": (write_vicon, "\n100\n,", "\n0\n,", "rate .* 0, not positive"),
    "no time": (write_motive, "Time (Seconds)", "Timecode", "Time.*export Markers"),
    "2D": (write_qualisys, "\t3D", "\t2D", "2D data.*export 3D"),
    "untimed": (write_qualisys, "Frame\tTime\t", "Frame\t", "8 columns for 2"),
}


@pytest.mark.parametrize(
    ("write", "old", "new", "message"), REFUSED.values(), ids=REFUSED
)
def test_refused(tmp_path, write, old, new, message):
    path = write(tmp_path / "a.csv", motion())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    unit = "mm" if write is write_qualisys else None
    with pytest.raises(ValueError, match=message):
        read_recording(path, length_unit=unit)


def test_units_are_stated_once(tmp_path):
    qualisys = write_qualisys(tmp_path / "a.tsv", motion())
    with pytest.raises(ValueError, match=r"give length_unit .* mm"):
        read_recording(qualisys)
    with pytest.raises(ValueError, match="unknown length unit 'furlong'"):
        read_recording(qualisys, length_unit="furlong")
    motive = write_motive(tmp_path / "a.csv", motion())
    assert read_recording(motive, length_unit="mm").names == NAMES
    with pytest.raises(ValueError, match=r"'Millimeters': .*length_unit = 'm' out"):
        read_recording(motive, length_unit="m")
    with pytest.raises(ValueError, match="for tables; leave it"):
        read_recording(tmp_path / "a.c3d", length_unit="m")


@pytest.mark.parametrize("before", [("t",), ("frame", "t")])
def test_numbers_alone(tmp_path, before):
    """As scripts write them: markers are named by place, from the first frame on."""
    path = tmp_path / "run.csv"
    columns = {"frame": np.arange(40.0), "t": 2.0 + np.arange(40) / RATE}
    firsts = np.stack([columns[name] for name in before], axis=1)
    table = np.concatenate([firsts, seen().reshape(40, -1)], axis=1)
    np.savetxt(path, table, delimiter=",", fmt="%.9g")
    assert is_recording(path)
    check(read_recording(path, length_unit="mm"), labels=("1", "2"))
    with pytest.raises(ValueError, match="give length_unit"):
        read_recording(path)


@pytest.mark.parametrize("gap", ["", "nan"])
def test_numbers_alone_may_begin_with_a_gap(tmp_path, gap):
    """A marker that was not seen in the first frame."""
    path = tmp_path / "run.csv"
    path.write_text(f"0,1,2,3,{gap},{gap},{gap}\n0.1,1,2,3,4,5,6\n")
    positions = read_recording(path, length_unit="m").positions
    assert np.isnan(positions[0, 1]).all()
    np.testing.assert_array_equal(positions[1, 1], [4.0, 5.0, 6.0])


def test_numbers_alone_need_the_time(tmp_path):
    path = tmp_path / "run.csv"
    np.savetxt(path, seen().reshape(40, -1), delimiter=",")
    with pytest.raises(ValueError, match=r"6 columns.* the time, .*x, y, z by marker"):
        read_recording(path, length_unit="mm")


def test_a_table_of_rows_is_none(tmp_path):
    path = tmp_path / "markers.csv"
    path.write_text("marker,x_mm,y_mm,z_mm\ntip,1,2,3\n")
    with pytest.raises(ValueError, match=r"of rows, .*column marker"):
        read_recording(path)
