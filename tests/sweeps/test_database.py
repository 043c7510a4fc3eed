"""What a database of a sweep refuses, and what a full disk or an edit does to it."""

import io
import sqlite3
import time

import cheap
import pytest
from rich.console import Console
from rows import substance

from softcal_jax.report import console as drawn, sweep_sections
from softcal_jax.sweeps import (
    _database as database_module,
    grid,
    read_sweep,
    run_sweep,
)
from softcal_jax.sweeps._row import run_trial
from softcal_jax.sweeps._trial import as_trials


def one(path, function=cheap.measure, **more):
    points = grid({"E": [1.0], "kind": ["u"], "draw": [0]})
    return run_sweep(function, points, path, workers=0, **more)


@pytest.mark.parametrize(
    ("again", "message"),
    [
        ({"seed": 1}, r"seed is 0, .* 1\. .*another file"),
        ({"function": cheap.where}, "function is measure, .* where"),
        ({"definitions": {"mesh": "b"}}, "mesh is a, .* is b"),
    ],
)
def test_another_sweep_is_refused(again, message, tmp_path):
    path = tmp_path / "s.sqlite"
    before = one(path, definitions={"mesh": "a"})
    with pytest.raises(ValueError, match=message):
        one(path, **again)
    assert substance(read_sweep(path)) == substance(before)
    # What was not known before is no contradiction.
    assert len(one(path, definitions={"layout three": "c"}).rows) == 1


def test_other_axes_are_another_sweep(tmp_path):
    path = tmp_path / "s.sqlite"
    one(path)
    with pytest.raises(ValueError, match=r"axes .* E, draw, kind, .* E\."):
        run_sweep(cheap.measure, grid({"E": [1.0]}), path, workers=0)


def test_files_that_are_no_database_of_a_sweep(tmp_path):
    text = tmp_path / "text.sqlite"
    text.write_text("a diary, long enough to be taken for something else" * 30)
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as file:
        file.execute("CREATE TABLE addresses (name TEXT)")
    file.close()
    for use in (one, read_sweep):
        with pytest.raises(ValueError, match=r"not a database .*another file"):
            use(text)
        with pytest.raises(ValueError, match=r"something else.*another file"):
            use(other)
    with pytest.raises(FileNotFoundError, match=r"sweep .*none\.sqlite does not"):
        read_sweep(tmp_path / "none.sqlite")
    with pytest.raises(FileNotFoundError, match=r"folder .*/no .*make it"):
        one(tmp_path / "no" / "s.sqlite")
    with pytest.raises(IsADirectoryError, match="is a directory; name a file"):
        one(tmp_path)


def test_two_sweeps_do_not_share_a_database(tmp_path):
    path = tmp_path / "s.sqlite"

    def meddling(trial):
        with pytest.raises(BlockingIOError, match=r"another sweep .*another file"):
            one(path)
        assert read_sweep(path).rows == ()  # reading is fine
        return {"x": 1}

    (row,) = one(path, meddling).rows
    assert (row.state, row.reason) == ("converged", "")
    assert list(tmp_path.iterdir()) == [path]


def test_a_locked_database_says_so(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    one(path)
    monkeypatch.setattr(database_module, "WAIT_S", 0.1)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(BlockingIOError, match=r"s\.sqlite is locked .*close it"):
        one(path)
    other.close()
    assert len(one(path).rows) == 1


def on_a_full_disk(monkeypatch, pages):
    """Databases have room for so many pages of 4096 bytes."""
    really = database_module._open

    def opened(*args, **options):
        file = really(*args, **options)
        file.execute(f"PRAGMA max_page_count = {pages}")
        return file

    monkeypatch.setattr(database_module, "_open", opened)


@pytest.mark.parametrize("n_trials", [3, 5000])
def test_a_full_disk_is_called_that(tmp_path, monkeypatch, n_trials):
    """Where a row does not fit any more, and where the plan does not."""
    path = tmp_path / "s.sqlite"
    points = grid({"a": range(n_trials)})
    fat = lambda trial: {"x": 1, "text": "x" * 20_000}
    with monkeypatch.context() as patch:
        on_a_full_disk(patch, pages=20)
        with pytest.raises(OSError, match="disk is full"):
            run_sweep(fat, points, path, workers=0)
    assert list(tmp_path.iterdir()) == [path]
    if n_trials == 3:
        assert 0 < len(read_sweep(path).rows) < 3
        assert len(run_sweep(fat, points, path, workers=0).rows) == 3


@pytest.mark.usefixtures("unchecked")  # a check of annotations asks for everything
@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE trials SET state = 'great'", "state.*great"),
        ("UPDATE trials SET figures = '{'", "Expecting property name"),
        ("UPDATE trials SET notes = '3'", "notes"),
        ("UPDATE trials SET point = '{\"E\": 2}'", r"point is \{'E': 2\}"),
        ("UPDATE plan SET point = '{'", "Expecting property name"),
        (f"UPDATE trials SET notes = '{'[' * 3000}'", "recursion"),
        ("UPDATE sweep SET value = '[\"kind\", \"b\"]' WHERE what = 'axes'", "'b'"),
    ],
)
def test_a_database_that_was_edited_names_the_trial(tmp_path, statement, message):
    path = tmp_path / "s.sqlite"
    (row,) = one(path).rows
    with sqlite3.connect(path) as file:
        file.execute(statement)
    file.close()
    refused = rf"(?s)s\.sqlite, trial {row.key}: .*{message}.*earlier copy"
    with pytest.raises(ValueError, match=refused):
        read_sweep(path).groups()


@pytest.mark.parametrize("number", ["1e400", "-1e400", "9" * 400])
def test_a_figure_out_of_range_is_shown_as_that(tmp_path, number):
    path = tmp_path / "s.sqlite"
    run_sweep(lambda trial: {"x": 1.5}, grid({"E": [1, 2]}), path, workers=0)
    with sqlite3.connect(path) as file:
        changed = f"UPDATE trials SET figures = '{{\"x\": {number}}}' WHERE rowid = 1"
        file.execute(changed)
    file.close()
    result = read_sweep(path)
    for every in (False, True):
        console = Console(width=80, record=True, file=io.StringIO())
        console.print(drawn(sweep_sections(result, every=every)))
        assert console.export_text().count("out of range") == 1
    assert result.numbers("x").tolist() == [1.5]


@pytest.mark.parametrize(
    ("statement", "message"),
    [("DELETE FROM sweep", "'name'"), ("UPDATE sweep SET value = '['", "Expecting")],
)
def test_a_database_without_its_description_says_so(tmp_path, statement, message):
    path = tmp_path / "s.sqlite"
    one(path)
    with sqlite3.connect(path) as file:
        file.execute(statement)
    file.close()
    with pytest.raises(ValueError, match=rf"s\.sqlite, .*sweep: .*{message}.*earlier"):
        read_sweep(path)


@pytest.mark.usefixtures("unchecked")  # a check of annotations asks for everything
def test_what_is_not_asked_for_is_not_parsed(tmp_path):
    """A row that cannot be read keeps nobody from what the others hold."""
    path = tmp_path / "s.sqlite"
    *others, broken = rows_of(path)
    with sqlite3.connect(path) as file:
        file.execute("UPDATE trials SET figures = '{' WHERE key = ?", (broken.key,))
        file.execute("UPDATE plan SET point = '{' WHERE key = ?", (broken.key,))
    file.close()
    result = read_sweep(path)
    assert len(result.states) == 200
    assert [result.states[row.key] for row in others] == [r.state for r in others]
    assert not result.missing
    assert [result.ended[row.key] for row in others] == others
    assert [result.planned[row.key] for row in others] == [r.point for r in others]
    for read in (lambda: result.ended[broken.key], lambda: result.rows):
        with pytest.raises(ValueError, match=f"trial {broken.key}: Expecting"):
            read()


def rows_of(path):
    """Rows of a sweep in this process, and the points of them."""
    points = grid({"E": [1.0], "kind": ["u"], "draw": range(200)})
    return run_sweep(cheap.measure, points, path, workers=0).rows


def test_rows_that_come_fast_share_a_transaction(tmp_path, monkeypatch):
    written = []
    write = database_module.SweepDatabase._write

    def seen(self, table, rows):
        if table == "trials":
            written.append(len(rows))
        write(self, table, rows)

    monkeypatch.setattr(database_module.SweepDatabase, "_write", seen)
    rows = rows_of(tmp_path / "s.sqlite")
    assert len(rows) == sum(written) == 200
    assert len(written) < 10


def begun(database, n):
    """A sweep under way, and rows of it that have ended."""
    points = grid({"E": [1.0], "kind": ["u"], "draw": range(n)})
    trials = as_trials(points, 0)
    database.begin(trials, {"name": "s", "repeats": ()}, {"seed": "0"})
    return [run_trial(cheap.measure, trial) for trial in trials]


def test_a_row_is_written_in_time_though_no_other_comes(tmp_path, monkeypatch):
    monkeypatch.setattr(database_module, "APART_S", 3.0)
    path = tmp_path / "s.sqlite"
    with database_module.sweep_database(path) as database:
        for row in begun(database, 3):
            database.add(row)
        assert len(read_sweep(path).rows) == 1
        end = time.monotonic() + 10.0
        while len(read_sweep(path).rows) < 3 and time.monotonic() < end:
            time.sleep(0.05)
        assert len(read_sweep(path).rows) == 3


@pytest.mark.parametrize("passes", [False, True])
def test_rows_that_cannot_be_written_wait(passes, tmp_path, monkeypatch):
    """A disk that stays full stops the sweep; none is lost where it has room again."""
    path = tmp_path / "s.sqlite"
    monkeypatch.setattr(database_module, "APART_S", 0.2)
    kind, tried = database_module.SweepDatabase, []
    write = kind._write

    def full(self, table, rows):
        tried.append(table)
        if not passes or len(tried) < 2:
            raise sqlite3.OperationalError("database or disk is full")
        write(self, table, rows)

    def sweep():
        with database_module.sweep_database(path) as database:
            first, second, third = begun(database, 3)
            database.add(first)
            monkeypatch.setattr(kind, "_write", full)
            database.add(second)
            end = time.monotonic() + 10.0
            while not tried and time.monotonic() < end:
                time.sleep(0.01)
            database.add(third)

    if passes:
        sweep()
    else:
        with pytest.raises(OSError, match="disk is full"):
            sweep()
    assert len(read_sweep(path).rows) == (3 if passes else 1)
