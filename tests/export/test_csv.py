import csv
import dataclasses

import pytest
from export.handmade import make_fit, make_result, small_model, with_points

from softcal_jax.results import write_csv, write_json
from softcal_jax.results._poses import csv_tables


def written(folder, configurations):
    for name, table in csv_tables(configurations).items():
        write_csv(folder / name, table)


def test_one_line_per_marker_and_configuration(tmp_path):
    written(tmp_path, make_result().configurations)
    with (tmp_path / "markers.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["configuration"], r["role"], r["marker"]) for r in rows] == [
        ("droop", "calibration", "left"),
        ("droop", "calibration", "right"),
        ("held out", "validation", "left"),
        ("held out", "validation", "right"),
    ]
    first = rows[0]
    assert first["measured_x_mm"] == "100.000000"
    assert first["simulated_before_x_mm"] == "104.000000"
    assert first["simulated_x_mm"] == "101.000000"
    assert first["residual_x_mm"] == "1.000000"
    assert first["distance_mm"] == "1.000000"


def test_what_was_not_measured_is_empty(tmp_path):
    fit = make_fit(small_model().mesh, error=(0.0, 0.0, 0.0), axes="yz")
    written(tmp_path, [fit])
    with (tmp_path / "markers.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert row["measured_x_mm"] == row["residual_x_mm"] == ""
    assert row["measured_y_mm"] == "20.000000"
    assert row["distance_mm"] == "0.000000"


def test_no_name_is_a_formula_for_a_spreadsheet(tmp_path):
    """Numbers stay numbers, negative ones too."""
    (fit,) = make_result().configurations[:1]
    fit = dataclasses.replace(fit, name="=cmd|' /C calc'!A0")
    fit = with_points(fit, simulated=lambda p: -p.measured)
    written(tmp_path, [fit])
    with (tmp_path / "markers.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {r["configuration"] for r in rows} == {"'=cmd|' /C calc'!A0"}
    cells = [cell for row in rows for cell in row.values()]
    assert any(cell.startswith("-") for cell in cells)
    assert all(float(cell) <= 0.0 for cell in cells if cell.startswith("-"))
    assert not any(cell.startswith(("=", "@", "+")) for cell in cells)


def test_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"value": float("nan")})
    assert not (tmp_path / "a.json").exists()
