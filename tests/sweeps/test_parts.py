"""Sweeps that run in parts, each a Parquet file."""

import os

import cheap
import numpy as np
import pyarrow.dataset
import pytest
from wording import says

from softcal_jax.cli import main
from softcal_jax.sweeps import grid, run_part, run_sweep

OF = 5


def part(folder, k, function=cheap.measure, of=OF, **more):
    options = {"repeats": ["draw"], "workers": 0, **more}
    return run_part(function, cheap.POINTS, folder, part=k, of=of, **options)


def read(folder):
    return pyarrow.dataset.dataset(folder, format="parquet").to_table()


def test_all_parts_have_the_rows_of_one_database(tmp_path):
    expected = run_sweep(cheap.measure, cheap.POINTS, tmp_path / "s.sqlite", workers=0)
    for k in reversed(range(OF)):  # in any order
        part(tmp_path / "parts", k)
    assert len(os.listdir(tmp_path / "parts")) == OF
    found = read(tmp_path / "parts").sort_by("number").to_pydict()
    assert found["number"] == list(range(len(cheap.POINTS)))
    for i, row in enumerate(expected.rows):
        assert {axis: found[axis][i] for axis in row.point} == row.point
        assert found["state"][i] == row.state
        assert found["reason"][i] == row.reason
        assert found["E found [Pa]"][i] == row.figures.get("E found [Pa]")


def test_numbers_have_one_type_in_all_parts(tmp_path):
    """Also in one where no trial has the figure: else no program would join them."""
    for k in range(len(cheap.POINTS)):
        part(tmp_path, k, of=len(cheap.POINTS))
    types = {
        pyarrow.parquet.read_schema(file).field("draw").type
        for file in tmp_path.glob("*.parquet")
    }
    assert types == {pyarrow.float64()}
    table = read(tmp_path)
    assert table.num_rows == len(cheap.POINTS)
    assert table["E found [Pa]"].null_count == 2


def test_a_part_that_is_there_is_done(tmp_path):
    path = part(tmp_path, 3)
    before = path.stat().st_mtime_ns
    assert part(tmp_path, 3) == path
    assert path.stat().st_mtime_ns == before


def test_a_part_that_is_interrupted_leaves_nothing(tmp_path):
    def stop(now):
        if now.ended == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        part(tmp_path, 0, progress=stop)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("other", [{"seed": 7}, {"of": 4}, {"definitions": {"a": "b"}}])
def test_parts_of_another_sweep_are_refused(tmp_path, other):
    part(tmp_path, 0)
    with pytest.raises(ValueError, match=r"part-0-of-5.* is a part of another sweep"):
        part(tmp_path, 1, **other)


@pytest.mark.parametrize(("k", "of"), [(5, 5), (-1, 5), (0, 0), (0, 25)])
def test_numbers_of_parts(tmp_path, k, of):
    with pytest.raises(ValueError, match=rf"part {k} of {of}: expected a number"):
        part(tmp_path, k, of=of)
    assert os.listdir(tmp_path) == []


def test_millions_of_points_are_made_when_they_are_asked_for(tmp_path):
    points = grid(
        {"a": range(1000), "b": np.linspace(0.0, 1.0, 1000).tolist(), "c": range(10)}
    )
    assert len(points) == 10_000_000
    assert points[-1] == {"a": 999, "b": 1.0, "c": 9}
    with pytest.raises(ValueError, match=r"--part.* 10 000 000 trials.* 100 000"):
        run_sweep(cheap.measure, points, tmp_path / "s.sqlite", workers=0)
    path = run_part(_sum, points, tmp_path, part=9_999, of=10_000, workers=0)
    rows = read(path).to_pydict()
    assert rows["number"] == list(range(9_999_000, 10_000_000))
    assert rows["sum"][-1] == 999 + 1.0 + 9


def _sum(trial):
    return {"sum": trial["a"] + trial["b"] + trial["c"]}


def test_the_command_asks_for_both_numbers(tmp_path, capsys):
    from small_project import write_small_project

    write_small_project(tmp_path)
    path = tmp_path / "sweep.toml"
    path.write_text('project = "project.toml"\n[axes]\n"material.nu" = [0.2, 0.3]\n')
    assert main(["sweep", str(path), "--part", "1"]) == 2
    assert says(capsys.readouterr().err, "--part and --of go together ... --of 1000")
    assert main(["sweep", str(path), "--part", "2", "--of", "2"]) == 2
    assert says(capsys.readouterr().err, "part 2 of 2: expected a number from 0 to 1")
