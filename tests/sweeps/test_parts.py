"""Sweeps that run in parts, each a Parquet file."""

import os

import cheap
import numpy as np
import pyarrow.dataset
import pytest
from wording import says

from softcal_jax.cli import main
from softcal_jax.sweeps import Range, grid, run_part, run_sweep, sample

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
    columns = read(tmp_path / "parts").sort_by("number").to_pydict()
    assert columns["number"] == list(range(len(cheap.POINTS)))
    for i, row in enumerate(expected.rows):
        assert {axis: columns[axis][i] for axis in row.point} == row.point
        assert columns["state"][i] == row.state
        assert columns["reason"][i] == row.reason
        assert columns["E found [Pa]"][i] == row.figures.get("E found [Pa]")


def test_points_without_an_index_are_refused(tmp_path, unchecked):
    with pytest.raises(ValueError, match="from `grid` or `sample`"):
        run_part(cheap.measure, list(cheap.POINTS), tmp_path, part=0, of=2, workers=0)


def odd(trial):
    """Figures of every kind, and none where all trials of a part fail."""
    if trial["draw"] == 3:
        raise ArithmeticError("no value")
    of_draw = [True, "word", 1.0, None, 2**70, None][trial["draw"]]
    return {"mixed": of_draw, "state": 1.5, "same": 1.0}


def test_columns_are_of_numbers_or_of_texts(tmp_path):
    points = grid({"E": [0, "1 deg"], "n": [1, 2.5], "b": [True, False], "l": [[1, 2]]})
    points = grid({**points.axes, "draw": range(6)})
    for k in range(2):
        run_part(odd, points, tmp_path, part=k, of=2, workers=0)
    tables = [pyarrow.parquet.read_table(file) for file in sorted(tmp_path.iterdir())]
    kinds = [dict(zip(t.column_names, t.schema.types, strict=True)) for t in tables]
    assert kinds[0] == kinds[1]
    texts = {name for name, kind in kinds[0].items() if kind == pyarrow.string()}
    assert {"E", "b", "l", "mixed", "state", "reason"} <= texts
    assert kinds[0]["n"] == kinds[0]["state of the trial"] == pyarrow.float64()
    rows = tables[0].to_pydict()
    assert rows["mixed"][:3] == ["True", "word", "1"]
    assert rows["l"][0] == "1 + 2"


def test_a_figure_that_no_trial_has_is_no_column(tmp_path):
    points = grid({"E": [1.0], "draw": [3, 0]})
    run = lambda k: run_part(odd, points, tmp_path, part=k, of=2, workers=0)
    one, other = run(0), run(1)
    assert "same" not in pyarrow.parquet.read_schema(one).names
    assert pyarrow.parquet.read_table(other)["same"].to_pylist() == [1.0]


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
    with pytest.raises(ValueError, match=r"part-0-of-5.* another sweep.*folder"):
        part(tmp_path, 1, **other)


def test_parts_of_other_points_are_refused(tmp_path):
    """Also for a part that is there."""
    axes = {"a": Range(0.0, 1.0), "b": ["u", "v"]}
    run = lambda points: run_part(_none, points, tmp_path, part=0, of=2, workers=0)
    run(sample(axes, 4, seed=1))
    run(sample(axes, 4, seed=1))
    others = [sample({**axes, "b": ["u", "w"]}, 4, seed=1)]
    others += [sample({**axes, "a": Range(0.0, 1.0 + 1e-12)}, 4, seed=1)]
    for points in (sample(axes, 4, seed=2), *others):
        with pytest.raises(ValueError, match=r"another sweep: .*points"):
            run(points)


def _none(trial):
    return {}


@pytest.mark.parametrize(
    "end", [b"x", b"\xff" * 60 + b"\x3c\0\0\0PAR1"], ids=["no_parquet", "bad_footer"]
)
def test_a_part_that_is_damaged(tmp_path, end):
    """Arrow raises ValueError or OSError: no Parquet file, or one with a bad footer."""
    (tmp_path / "part-x.parquet").write_bytes(b"PAR1" + end)
    with pytest.raises(ValueError, match=r"part-x\.parquet cannot be read .* Remove"):
        part(tmp_path, 0)


@pytest.mark.parametrize(("k", "of"), [(5, 5), (-1, 5), (0, 0), (0, 25)])
def test_numbers_of_parts(tmp_path, k, of):
    with pytest.raises(ValueError, match=rf"part {k} of {of}: .* 0 to {of - 1},"):
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
    assert says(capsys.readouterr().err, "--part and --of ... --of 1000")
    assert main(["sweep", str(path), "--part", "2", "--of", "2"]) == 2
    assert says(capsys.readouterr().err, "part 2 of 2: ... 0 to 1")
