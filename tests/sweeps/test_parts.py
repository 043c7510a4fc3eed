"""Sweeps that run in parts, each a file of one folder."""

import os
from collections.abc import Sequence

import cheap
import numpy as np
import pyarrow.parquet as pq
import pytest
from rows import ends, substance
from wording import says

from softcal_jax.cli import main
from softcal_jax.sweeps import Range, grid, read_sweep, run_sweep, sample

OF = 5


def part(folder, k, function=cheap.measure, of=OF, points=cheap.POINTS, **more):
    options = {"repeats": ["draw"], "workers": 0, **more}
    return run_sweep(function, points, folder, part=(k, of), **options)


def test_all_parts_have_the_rows_of_one_sweep(tmp_path):
    expected = run_sweep(cheap.measure, cheap.POINTS, tmp_path / "one", workers=0)
    folder = tmp_path / "parts"
    for k in reversed(range(OF)):  # in any order
        part(folder, k)
    assert sorted(os.listdir(folder)) == [f"rows-{k}-of-5.parquet" for k in range(OF)]
    assert substance(read_sweep(folder)) == substance(expected)
    assert len(pq.read_table(folder)) == len(cheap.POINTS)


def test_a_column_is_of_one_kind_in_all_parts(tmp_path):
    points = grid({"E": [0, "1 deg"], "n": [1, 2.5], "draw": [0]})
    for k in range(2):
        run_sweep(lambda trial: {"x": 1}, points, tmp_path, part=(k, 2), workers=0)
    one, other = (pq.read_schema(file) for file in sorted(tmp_path.iterdir()))
    assert one.types == other.types


def test_a_part_that_was_interrupted_goes_on(tmp_path):
    def stop(now):
        if now.ended == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        part(tmp_path, 0, progress=stop)
    left = read_sweep(tmp_path)
    assert (len(left.rows), len(left.missing)) == (2, 2)
    whole = part(tmp_path, 0)
    assert len(whole.rows) == 4
    assert ends(left).items() <= ends(whole).items()
    assert part(tmp_path, 0).table.equals(whole.table)  # nothing is left to do


@pytest.mark.parametrize("other", [{"seed": 7}, {"of": 4}, {"definitions": {"a": "b"}}])
def test_parts_of_another_sweep_are_refused(tmp_path, other):
    part(tmp_path, 0, definitions={"a": "a"})
    with pytest.raises(ValueError, match=r"rows-0-of-5.* another sweep.*folder"):
        part(tmp_path, 1, **other)


def test_parts_of_other_points_are_refused(tmp_path):
    axes = {"E": Range(1.0, 2.0), "kind": ["u"], "draw": [0]}
    run = lambda points: part(tmp_path, 0, of=2, points=points)
    run(sample(axes, 4, seed=1))
    others = [sample({**axes, "E": Range(1.0, 2.0 + 1e-12)}, 4, seed=1)]
    for points in (sample(axes, 4, seed=2), *others, [*sample(axes, 4, seed=2)]):
        with pytest.raises(ValueError, match=r"another sweep: .*points"):
            run(points)


@pytest.mark.parametrize(("k", "of"), [(5, 5), (-1, 5), (0, 0), (0, 25)])
def test_numbers_of_parts(tmp_path, k, of):
    with pytest.raises(ValueError, match=rf"part {k} of {of}: .* 0 to {of - 1},"):
        part(tmp_path, k, of=of)
    assert os.listdir(tmp_path) == []


class Counted(Sequence):
    """Ten million points, and the number of those that were made."""

    made = 0

    def __len__(self):
        return 10_000_000

    def __getitem__(self, index):
        self.made += 1
        return {"a": index}


def test_millions_of_points_are_made_when_they_are_asked_for(tmp_path):
    points = grid(
        {"a": range(1000), "b": np.linspace(0.0, 1.0, 1000).tolist(), "c": range(10)}
    )
    assert len(points) == 10_000_000
    assert points[-1] == {"a": 999, "b": 1.0, "c": 9}
    many = Counted()
    with pytest.raises(ValueError, match=r"--part.* 10 000 000 trials.* 100 000"):
        run_sweep(cheap.measure, many, tmp_path / "s", workers=0)
    assert many.made < 100  # by the check of types
    total = lambda trial: {"sum": trial["a"] + trial["b"] + trial["c"]}
    rows = run_sweep(total, points, tmp_path, part=(9_999, 10_000), workers=0).rows
    assert len(rows) == 1000
    assert rows[-1]["sum"] == 999 + 1.0 + 9


def test_the_command_asks_for_both_numbers(tmp_path, capsys):
    from small_project import write_small_project

    write_small_project(tmp_path)
    path = tmp_path / "sweep.toml"
    path.write_text('project = "project.toml"\n[axes]\n"material.nu" = [0.2, 0.3]\n')
    assert main(["sweep", str(path), "--part", "1"]) == 2
    assert says(capsys.readouterr().err, "--part and --of ... --of 1000")
    assert main(["sweep", str(path), "--part", "2", "--of", "2"]) == 2
    assert says(capsys.readouterr().err, "part 2 of 2: ... 0 to 1")
