"""The folder of a sweep: what it refuses, and what a full disk or a kill does to it."""

import json
import os
import resource
import sqlite3
import time

import cheap
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rows import substance

from softcal_jax.sweeps import grid, read_sweep, run_sweep


def one(path, function=cheap.measure, **more):
    points = grid({"E": [1.0], "kind": ["u"], "draw": [0]})
    return run_sweep(function, points, path, workers=0, **more)


@pytest.mark.parametrize(
    ("again", "message"),
    [
        ({"seed": 1}, r"seed is 0, .* 1\. .*another folder"),
        ({"function": cheap.where}, "function is measure, .* where"),
        ({"definitions": {"mesh": "b"}}, "mesh is a, .* is b"),
        ({"part": (0, 1)}, "mesh is a"),
    ],
)
def test_another_sweep_is_refused(again, message, tmp_path):
    path = tmp_path / "s"
    before = one(path, definitions={"mesh": "a"})
    with pytest.raises(ValueError, match=message):
        one(path, **{"definitions": {"mesh": "b"}} | again)
    assert substance(read_sweep(path)) == substance(before)
    # What was not known before is no contradiction.
    assert len(one(path, definitions={"layout three": "c"}).rows) == 1


def test_other_axes_are_another_sweep(tmp_path):
    one(tmp_path)
    with pytest.raises(ValueError, match=r"axes .* E, draw, kind, .* E\."):
        run_sweep(cheap.measure, grid({"E": [1.0]}), tmp_path, workers=0)


def test_a_database_of_an_earlier_version_is_refused(tmp_path):
    """By name, with the command that makes its rows anew."""
    (tmp_path / "s.toml").touch()
    path = tmp_path / "s.sqlite"
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE trials (key TEXT)")
    file.close()
    for use in (one, read_sweep):
        with pytest.raises(ValueError, match=r"s\.sqlite .*softcal sweep .*s\.toml -o"):
            use(path)


def test_what_is_no_folder_of_a_sweep(tmp_path):
    text, other = tmp_path / "text", tmp_path / "other"
    text.write_text("a diary")
    other.mkdir()
    pq.write_table(pa.table({"name": ["Ada"]}), other / "addresses.parquet")
    for use in (one, read_sweep):
        with pytest.raises(ValueError, match=r"text is a file"):
            use(text)
        with pytest.raises(ValueError, match=r"addresses\.parquet .*another folder"):
            use(other)
    with pytest.raises(FileNotFoundError, match=r"sweep .*none does not"):
        read_sweep(tmp_path / "none")
    for use in (one, read_sweep):
        with pytest.raises(ValueError, match="no rows"):
            use(tmp_path)


def test_two_sweeps_do_not_share_a_file(tmp_path):
    def meddling(trial):
        with pytest.raises(BlockingIOError, match="another sweep"):
            one(tmp_path)
        assert read_sweep(tmp_path).rows == ()  # reading is fine
        return {"x": 1}

    (row,) = one(tmp_path, meddling).rows
    assert (row["state"], row["reason"]) == ("converged", "")
    assert os.listdir(tmp_path) == ["rows.parquet"]


@pytest.fixture
def full_disk():
    """Files have room for 100 kB."""
    import signal

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    lift = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, before)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    yield lift
    lift()
    signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_called_that_and_loses_no_row_before(tmp_path, full_disk):
    def fat(trial):
        if trial["a"]:
            time.sleep(1.5)  # the rows so far are written
        return {"text": os.urandom(30_000 * (trial["a"] + 1)).hex()}

    run = lambda: run_sweep(fat, grid({"a": range(4)}), tmp_path, workers=0)
    with pytest.raises(OSError, match=r"cannot be written .*too large.* resumes"):
        run()
    assert 0 < len(read_sweep(tmp_path).rows) < 4
    full_disk()
    assert len(run().rows) == 4


@pytest.mark.parametrize(
    "change",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(path.read_bytes().replace(b"conv", b"cone")),
        lambda path: pq.write_table(pq.read_table(path).drop_columns("reason"), path),
        lambda path: pq.write_table(
            pq.read_table(path).set_column(3, "state", pa.array(["great"])), path
        ),
        lambda path: pq.write_table(
            pq.read_table(path).replace_schema_metadata({"softcal_jax.sweep": "[]"}),
            path,
        ),
    ],
    ids=["cut", "bits", "column", "state", "metadata"],
)
def test_a_file_that_was_damaged_or_edited_is_named(tmp_path, change):
    one(tmp_path)
    change(tmp_path / "rows.parquet")
    for use in (one, read_sweep):
        with pytest.raises(ValueError, match=r"rows\.parquet"):
            use(tmp_path)


def test_a_row_is_on_disk_within_a_second(tmp_path):
    """Also while the next trial goes on, and as a file that other programs read."""
    seen = []

    def function(trial):
        if trial["n"] == 3:
            end = time.monotonic() + 10.0
            while len(seen) < 3 and time.monotonic() < end:
                time.sleep(0.05)
                seen[:] = pq.read_table(tmp_path)["x"].to_pylist() if on_disk() else []
        return {"x": trial["n"]}

    on_disk = lambda: "x" in pq.read_schema(tmp_path / "rows.parquet").names
    run_sweep(function, grid({"n": range(4)}), tmp_path, workers=0)
    assert seen == [0, 1, 2]
    assert pq.read_table(tmp_path)["x"].to_pylist() == [0, 1, 2, 3]


def odd(trial):
    """Figures of every kind, under names that are taken."""
    if trial["draw"] == 3:
        raise ArithmeticError("no value")
    of_draw = [True, "word", 1.5, None, 2**70, None][trial["draw"]]
    return {"mixed": of_draw, "state": 1.5, "draw": 1, "n": 2 if trial["draw"] else 0.5}


def test_columns_are_of_numbers_or_of_texts(tmp_path):
    """Whatever comes first, and when a sweep goes on with values of another kind."""
    points = lambda E: grid({"E": E, "list": [["a", "b"]], "draw": range(6)})
    run_sweep(odd, points([0, 2.5]), tmp_path, workers=0)
    types = lambda: {f.name: str(f.type) for f in pq.read_schema(file)}
    file = tmp_path / "rows.parquet"
    assert types()["E"] == types()["n"] == types()["state of the trial"] == "double"
    assert types()["draw of the trial"] == "int64"
    assert {types()[name] for name in ("list", "mixed", "state")} == {"string"}
    result = run_sweep(odd, points([0, 2.5, "1 deg"]), tmp_path, workers=0)
    assert types()["E"] == "string"
    assert len(result.rows) == 18
    assert result.rows[0]["list"] == "a + b"
    assert json.loads(result.rows[0]["point"])["list"] == ["a", "b"]
    assert [row["mixed"] for row in result.rows[:3]] == ["True", "word", "1.5"]
    assert len(result.groups(["E"])) == 3
