"""Marker files: what is read, and what is refused with which words."""

import re

import numpy as np
import pytest
from refusals import refused

from softcal_jax.readings import read_markers

TABLE = """\
# Two states of one run.
phase,marker,x_mm,y_mm,z_mm

rest,tip,0,1.5,-2e1
rest,base,10,11,12
# lost: the tip under load
pulled,tip,,1,2
pulled,base,11,11,12
"""


def test_selected_rows_in_metres(table):
    markers = read_markers(table(TABLE), select={"phase": "rest"})
    assert markers.names == ("tip", "base")
    assert markers.places == ("line 4", "line 5")
    expected = [[0.0, 0.0015, -0.02], [0.010, 0.011, 0.012]]
    np.testing.assert_allclose(markers.positions, expected, rtol=1e-15)


def test_positions_come_in_the_order_of_the_names(table):
    markers = read_markers(table(TABLE), select={"phase": "rest"})
    np.testing.assert_array_equal(
        markers.positions_of(["base", "tip"]), markers.positions[::-1]
    )


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("inch", 0.0254)]
)
def test_unit_from_outside_or_from_the_columns(table, unit, metres):
    bare = table("marker,x,y,z\na,1,2,3\n")
    np.testing.assert_allclose(
        read_markers(bare, length_unit=unit).positions,
        [[metres, 2 * metres, 3 * metres]],
    )
    named = table(f"marker,x_{unit},y_{unit},z_{unit}\na,1,2,3\n")
    np.testing.assert_allclose(
        read_markers(named, length_unit=unit).positions,
        read_markers(named).positions,
    )
    np.testing.assert_allclose(read_markers(named).positions[0, 2], 3 * metres)


def test_a_byte_order_mark_and_spaces_are_forgiven(table):
    path = table("\ufeffmarker, x_mm, y_mm, z_mm\r\n a, 1, 2, 3\r\n")
    assert read_markers(path).names == ("a",)


def test_a_lost_marker_is_refused_only_where_it_is_asked_for(table):
    markers = read_markers(table(TABLE), select={"phase": "pulled"})
    np.testing.assert_allclose(markers.positions_of(["base"]), [[0.011, 0.011, 0.012]])
    with refused("(phase = pulled), line 7: ... 'tip'"):
        markers.positions_of(["base", "tip"])


@pytest.mark.parametrize("cell", ["nan", "inf", ""])
def test_what_is_not_finite(table, cell):
    markers = read_markers(table(f"marker,x_mm,y_mm,z_mm\na,1,{cell},3\n"))
    with refused("line 2: ... 'a' is missing"):
        markers.positions_of(["a"])


def test_no_such_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no\.csv .*not exist"):
        read_markers(tmp_path / "no.csv")


def test_directory(tmp_path):
    with refused("is a directory"):
        read_markers(tmp_path)


def test_not_a_text(tmp_path):
    path = tmp_path / "markers.csv"
    path.write_bytes(b"marker,x\n\xff\xfe\x00")
    with refused(f"{path} cannot be read"):
        read_markers(path)


@pytest.mark.parametrize("text", ["", "# a comment\n", "marker,x_mm,y_mm,z_mm\n"])
def test_no_rows(table, text):
    with refused("table.csv ... no rows"):
        read_markers(table(text))


@pytest.mark.parametrize(
    ("header", "texts"),
    [
        ("markr,x_mm,y_mm,z_mm", ["'marker' ... mean 'markr' ... there ... markr"]),
        ("marker,x_mm,z_mm,n", ["column 'y_mm' is missing."]),
        ("marker,x_mm,y_cm,z_mm", ["'y_mm' is missing ... mean"]),
        ("marker,a,b,c", ["column 'x' is missing."]),
        ("marker x_mm y_mm z_mm", ["separated by commas, semicolons"]),
        ("marker,x_mm,x_cm,z_mm", ["cm, mm; keep one"]),
        ("marker,x,y,z", ["no unit ... x_mm ... length_unit"]),
        ("marker,x_mm,x_mm,z_mm", ["'x_mm' ... more than once"]),
    ],
)
def test_bad_header(table, header, texts):
    row = ",".join("1" for _ in header.split(","))
    with refused(*texts):
        read_markers(table(f"{header}\n{row}\n"))


def test_units_that_contradict(table):
    with refused("'mm' (x_mm) ... length_unit is 'm'"):
        read_markers(table(TABLE), length_unit="m", select={"phase": "rest"})


def test_unknown_unit(table):
    with refused("'milimm' ... mean 'mm' ... 'cm', 'inch', 'm'"):
        read_markers(table(TABLE), length_unit="milimm")


def test_selection_that_matches_nothing(table):
    with refused("phase = puled ... there: rest, pulled."):
        read_markers(table(TABLE), select={"phase": "puled"})
    with refused("'phas' is missing ... mean 'phase'"):
        read_markers(table(TABLE), select={"phas": "rest"})
    path = table("run,marker,x,y,z\n1,a,0,0,0\n2,b,0,0,0\n")
    with refused("run = 1, marker = b"):
        read_markers(path, length_unit="m", select={"run": "1", "marker": "b"})


def test_not_a_number_names_the_line(table):
    path = table(TABLE.replace("1.5", "1;5"))
    with refused("line 4: y_mm ... 'tip' ... '1;5', not a number"):
        read_markers(path, select={"phase": "rest"})


GERMAN = """\
phase;marker;x_mm;y_mm;z_mm
rest;tip;0;1,5;-2e1
rest;base;10,25;11;12
"""


def test_a_german_table(table):
    """Semicolons between columns, commas before decimals."""
    markers = read_markers(table(GERMAN))
    expected = [[0.0, 0.0015, -0.02], [0.01025, 0.011, 0.012]]
    np.testing.assert_allclose(markers.positions, expected, rtol=1e-15)
    tabs = read_markers(table(GERMAN.replace(";", "\t")))
    np.testing.assert_array_equal(tabs.positions, markers.positions)
    points = read_markers(table(GERMAN.replace(",", ".")))
    np.testing.assert_array_equal(points.positions, markers.positions)


def test_a_thousand_is_not_taken_for_one(table):
    path = table(GERMAN.replace("1,5", "1.234,5"))
    with refused("line 2: y_mm ... 'tip' ... '1.234,5'"):
        read_markers(path)
    path = table(GERMAN.replace("1,5", "1.5"))
    with refused("decimal commas"):
        read_markers(path)


def test_decimal_commas_between_commas_are_explained(table):
    with refused("'1,5', not a number ... decimal point"):
        read_markers(table('marker,x_mm,y_mm,z_mm\ntip,0,"1,5",2\n'))
    with refused("5 cells ... 4 columns", "decimal commas ... ;"):
        read_markers(table("marker,x_mm,y_mm,z_mm\ntip,0,1,5,2\n"))


def test_another_encoding_is_explained(table):
    path = table("marker,x_mm,y_mm,z_mm\n")
    path.write_bytes("marker,x_mm,y_mm,z_mm\nRücken,1,2,3\n".encode("latin-1"))
    with refused("'utf-8' codec", "UTF-8"):
        read_markers(path)


def test_no_column_is_proposed_that_is_there_for_itself(table):
    with refused("'z_mm' is missing ... marker, x_mm, y_mm"):
        read_markers(table("marker,x_mm,y_mm\ntip,1,2\n"))
    with refused("'x_mm' is missing ... mean 'X_mm'"):
        read_markers(table("marker,X_mm,y_mm,z_mm\ntip,1,2,3\n"))


def test_a_control_character_names_the_line(table):
    with refused("line 2: ... 'tip\\x1b[2J,1,2,3' ... character '\\x1b'"):
        read_markers(table("marker,x_mm,y_mm,z_mm\ntip\x1b[2J,1,2,3\n"))


def test_names_as_spreadsheets_get_them_from_us(table):
    markers = read_markers(table("marker,x_mm,y_mm,z_mm\n'-tip,1,2,3\n'a,1,2,3\n"))
    assert markers.names == ("-tip", "'a")


def test_a_row_of_another_length(table):
    with refused("line 5: 4 cells ... 5 columns"):
        read_markers(table(TABLE.replace("10,11", "10")), select={"phase": "rest"})


def test_a_marker_twice(table):
    with refused("'tip' ... twice ... 4 and 7; select"):
        read_markers(table(TABLE))


def test_a_marker_that_is_not_there(table):
    markers = read_markers(table(TABLE), select={"phase": "rest"})
    message = "no marker 'tp' ... mean 'tip' ... tip, base ... project file"
    with refused(message):
        markers.positions_of(["tp"])
    assert re.search(r"table\.csv \(phase = rest\)$", markers.source)
