"""Rows of a sweep for a spreadsheet."""

import csv

from cheap import measure

from softcal_jax.sweeps import run_sweep, write_sweep_csv


def test_no_text_is_a_formula_and_numbers_stay_numbers(tmp_path):
    points = [{"E": -2e5, "kind": kind, "draw": 0} for kind in ("=1+1", "-u", "plain")]
    result = run_sweep(measure, points, tmp_path / "s", workers=0)
    write_sweep_csv(result, tmp_path / "s.csv")
    with (tmp_path / "s.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["'=1+1", "'-u", "plain"]
    assert {float(row["E"]) for row in rows} == {-2e5}
