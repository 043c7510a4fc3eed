"""Contacts in the tables, in CSV, JSON and for ParaView."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
import pyvista
from export.handmade import make_fit, make_result
from obstacle_results import FORCE, beside_obstacles, pressed
from rich.console import Console

from softcal_jax.calibration import SimulationResult
from softcal_jax.results import (
    console as drawn,
    result_dict,
    sections,
    write_csv,
    write_robot_vtu,
)
from softcal_jax.results._poses import csv_tables, robot_tables


@pytest.fixture(scope="module")
def model():
    return beside_obstacles()


def test_a_simulation_tabulates_them(model):
    result = SimulationResult(model, (pressed(model, sliding=0.3),))
    console = Console(width=80, file=io.StringIO())
    console.print(drawn(sections(result)))
    rows = [
        [cell.strip() for cell in line.split("│")[1:-1]]
        for line in console.file.getvalue().splitlines()
    ]
    assert ["a", "probe", "(3, 0, 4) mN", "(0, 0.02, 0) N mm"] in rows
    assert ["a", "table", "not touched", "-"] in rows
    assert ["a", "probe", "3 mm2", "0.01 mm", "30 %"] in rows


def test_bodies_that_are_absent_fill_no_table(model):
    result = SimulationResult(model, (pressed(model, present=("probe",)),))
    (bodies,) = [t for t in robot_tables(result.configurations) if "bod" in t.title]
    assert [row[1] for row in bodies.rows()] == ["probe"]


def test_csv_has_a_line_per_value(model, tmp_path):
    poses = [pressed(model), pressed(model, name="off", present=())]
    write_csv(tmp_path / "robot.csv", csv_tables(poses)["robot.csv"])
    with (tmp_path / "robot.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["part"] == "contact"]
    assert {row["configuration"] for row in rows} == {"a"}
    of_probe = {r["quantity"]: r for r in rows if r["name"] == "probe"}
    force = [float(of_probe[f"force_{axis}"]["value"]) for axis in "xyz"]
    np.testing.assert_allclose(force, FORCE, rtol=1e-8)
    assert float(of_probe["area"]["value"]) == pytest.approx(3e-6)
    assert of_probe["moment_y"]["unit"] == "N m"
    assert {"depth", "sliding"} <= of_probe.keys()


def test_csv_calls_surfaces_that_touch_no_obstacle(model, tmp_path):
    fit = pressed(model)
    probe, table = fit.robot.contacts
    contacts = (probe, replace(table, name="low on high"))
    touching = replace(fit, robot=replace(fit.robot, contacts=contacts))
    write_csv(tmp_path / "robot.csv", csv_tables([touching])["robot.csv"])
    with (tmp_path / "robot.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["part"] == "contact"]
    of = {row["name"]: row["what"] for row in rows}
    assert of == {"probe": "obstacle", "low on high": "pair of surfaces"}


def test_json_of_simulations_and_calibrations(model):
    fit = pressed(model, sliding=0.3)
    (entry,) = result_dict(SimulationResult(model, (fit,)))["configurations"]
    probe, table = entry["robot"]["contacts"]
    assert probe == {
        "name": "probe",
        "force": FORCE.tolist(),
        "moment": [0.0, 2e-5, 0.0],
        "area": 3e-6,
        "depth": 1e-5,
        "sliding": 0.3,
    }
    assert table["area"] == 0.0
    calibrated = make_result(model=model, fits=[make_fit(model.mesh), fit])
    written = result_dict(calibrated)["configurations"][1]["robot"]
    assert written["contacts"] == [probe, table]


def test_paraview_sees_the_forces(model, tmp_path):
    fit = pressed(model)
    write_robot_vtu(tmp_path / "a.vtu", model, fit.robot)
    grid = pyvista.read(tmp_path / "a.vtu")
    np.testing.assert_allclose(grid.point_data["contact_force"], [FORCE, np.zeros(3)])
    moved = grid.points + grid.point_data["displacement"]
    np.testing.assert_allclose(moved[0], [0.091, 0.01, 0.038], rtol=1e-6)
