import errno
import hashlib
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from softcal_jax.results import check_results_folder, complete_results, results_folder

LIST = ".softcal-files"


def write(folder, **texts):
    """Files `name.txt` with texts."""
    for name, text in texts.items():
        (folder / f"{name}.txt").write_text(text)


def contents(folder):
    """Texts of all files below a folder but the list of them, by name."""
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != LIST
    }


def test_files_appear_at_the_end(tmp_path):
    target = tmp_path / "a" / "b"
    with results_folder(target) as folder:
        write(folder, one="1")
        assert not target.exists()
    assert contents(tmp_path) == {"a/b/one.txt": "1"}


def test_the_folder_is_as_open_as_any_other(tmp_path):
    """The temporary one is private to its owner; the result must not be."""
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1")
    (tmp_path / "ordinary").mkdir()
    mode = (tmp_path / "ordinary").stat().st_mode
    assert (tmp_path / "a").stat().st_mode == mode


def test_a_shell_in_an_empty_folder_stays_in_it(tmp_path, monkeypatch):
    target = tmp_path / "a"
    target.mkdir()
    monkeypatch.chdir(target)
    with results_folder(".") as folder:
        write(folder, one="1")
    assert Path("one.txt").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_failure_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError, match="disk full"):
        write_and_fail(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []


def write_and_fail(target, error=None, **kwargs):
    with results_folder(target, **kwargs) as folder:
        write(folder, one="new")
        raise error or RuntimeError("disk full")


def test_a_full_folder_is_refused_without_force(tmp_path):
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1")
    for check in (check_results_folder, lambda d: results_folder(d).__enter__()):
        with pytest.raises(FileExistsError, match=r"\ba .*not empty.*--force"):
            check(tmp_path / "a")
    assert contents(tmp_path) == {"a/one.txt": "1"}


def test_force_replaces_results_and_keeps_what_a_user_added(tmp_path):
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1", two="2")
    (tmp_path / "a" / "notes.md").write_text("mine")
    with results_folder(tmp_path / "a", force=True) as folder:
        write(folder, two="new", three="3")
        assert contents(tmp_path / "a")["two.txt"] == "2"
    assert contents(tmp_path) == {
        "a/notes.md": "mine",
        "a/two.txt": "new",
        "a/three.txt": "3",
    }


def test_force_keeps_the_old_results_if_the_new_ones_fail(tmp_path):
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1")
    with pytest.raises(RuntimeError, match="disk full"):
        write_and_fail(tmp_path / "a", force=True)
    assert contents(tmp_path) == {"a/one.txt": "1"}


@pytest.mark.parametrize("fails_at", range(5))
def test_a_move_that_fails_is_undone(tmp_path, monkeypatch, fails_at):
    """Four files move in, with the list, and one moves out; any may fail."""
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1", two="2", left_out="3")
    before, files = contents(tmp_path), (tmp_path / "a" / LIST).read_text()
    moves = []
    replace = os.replace

    def failing(source, target):
        moves.append(target)
        if len(moves) == fails_at + 1:
            raise OSError("no permission")
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    with (
        pytest.raises(OSError, match="no permission"),
        results_folder(tmp_path / "a", force=True) as folder,
    ):
        write(folder, one="new", two="new", another="new")
    assert contents(tmp_path) == before
    assert (tmp_path / "a" / LIST).read_text() == files


FORMAT = "softcal_jax.files/1"
OF_THESIS = {"size": 13, "sha256": hashlib.sha256(b"years of work").hexdigest()}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("result.json", '{"files": ["thesis.tex"]}'),
        ("result.json", '{"files": [1]}'),
        (LIST, "{"),
        (LIST, "[]"),
        (LIST, "[" * 100_000),
        (LIST, "\xff"),
        (LIST, '{"files": {"thesis.tex": {}}}'),
        (LIST, json.dumps({"format": "other/1", "files": {"thesis.tex": OF_THESIS}})),
        (LIST, json.dumps({"format": FORMAT})),
        (LIST, json.dumps({"format": FORMAT, "files": 3})),
        (LIST, json.dumps({"format": FORMAT, "files": ["thesis.tex"]})),
        (LIST, json.dumps({"format": FORMAT, "files": {"thesis.tex": 1}})),
        (LIST, json.dumps({"format": FORMAT, "files": {"thesis.tex": {"size": 13}}})),
    ],
)
def test_force_does_not_touch_what_is_not_ours(tmp_path, name, text):
    """Whatever the index or the list of another program says, or a broken one."""
    home = tmp_path / "home"
    home.mkdir()
    (home / "thesis.tex").write_text("years of work")
    (home / name).write_text(text, encoding="latin-1")
    with pytest.raises(FileExistsError, match=r"home "):
        check_results_folder(home, force=True)
    with (
        pytest.raises(FileExistsError, match=r"home "),
        results_folder(home, force=True) as folder,
    ):
        write(folder, one="1")
    assert (home / "thesis.tex").read_text() == "years of work"
    assert (home / name).read_text(encoding="latin-1") == text
    assert len(list(tmp_path.rglob("*"))) == 3


def test_force_does_not_remove_what_a_user_changed(tmp_path):
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1", two="2", three="3")
    before = contents(tmp_path) | {"a/two.txt": "mine"}
    (tmp_path / "a" / "two.txt").write_text("mine")
    with pytest.raises(FileExistsError, match=r"\ba .*changed.*\(two\.txt\)"):
        check_results_folder(tmp_path / "a", force=True)
    assert contents(tmp_path) == before
    (tmp_path / "a" / "two.txt").rename(tmp_path / "a" / "mine.txt")
    with results_folder(tmp_path / "a", force=True) as folder:
        write(folder, two="new")
    assert contents(tmp_path) == {"a/two.txt": "new", "a/mine.txt": "mine"}


def test_force_takes_no_files_that_were_not_written_as_results(tmp_path):
    """Like the project and the data of `softcal new`."""
    with results_folder(tmp_path / "a", replaceable=False) as folder:
        write(folder, project="mine")
    with pytest.raises(FileExistsError, match=r"\ba .*earlier results"):
        check_results_folder(tmp_path / "a", force=True)


def test_force_does_not_overwrite_a_users_file(tmp_path):
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="1")
    (tmp_path / "a" / "two.txt").write_text("mine")
    with (
        pytest.raises(FileExistsError, match=r"two\.txt"),
        results_folder(tmp_path / "a", force=True) as folder,
    ):
        write(folder, one="new", two="new")
    assert contents(tmp_path) == {"a/one.txt": "1", "a/two.txt": "mine"}


def test_a_list_cannot_point_out_of_the_folder(tmp_path):
    (tmp_path / "outside.txt").write_text("mine")
    with results_folder(tmp_path / "a") as folder:
        write(folder, one="mine")
    path = tmp_path / "a" / LIST
    path.write_text(path.read_text().replace("one.txt", "../outside.txt"))
    with results_folder(tmp_path / "a", force=True) as folder:
        write(folder, two="2")
    assert (tmp_path / "outside.txt").read_text() == "mine"


def test_the_second_of_two_into_one_new_folder_is_told(tmp_path):
    """At its end, if both began at once; and before, if the first is writing."""
    target = tmp_path / "a"
    for _ in range(2):
        check_results_folder(target)
    with results_folder(target) as folder:
        write(folder, one="first")
        with pytest.raises(BlockingIOError, match=r"another process .*\ba: wait"):
            check_results_folder(target, force=True)
    with (
        pytest.raises(FileExistsError, match=r"\ba .*not empty"),
        results_folder(target) as folder,
    ):
        write(folder, one="second")
    assert contents(tmp_path) == {"a/one.txt": "first"}


def kept_at_each_moment(monkeypatch, work, kept):
    """Before each change of the disk, copy what a process that is killed would leave.

    Returns the copies, a list that grows.
    """
    copies = []

    def watched(owner, name):
        really = getattr(owner, name)

        def watch(*args, **more):
            copies.append(kept / str(len(copies)))
            copytree(work, copies[-1])
            return really(*args, **more)

        monkeypatch.setattr(owner, name, watch)

    copytree = shutil.copytree
    for owner, name in ((os, "replace"), (os, "rename"), (shutil, "rmtree")):
        watched(owner, name)
    for name in ("write_text", "unlink", "mkdir"):
        watched(Path, name)
    return copies


def write_with_index(folder, **texts):
    write(folder, **texts)
    (folder / "index.json").write_text(json.dumps([f"{name}.txt" for name in texts]))


NEW = {"a/one.txt": "new", "a/two.txt": "new", "a/another.txt": "new"}
NEW["a/index.json"] = '["one.txt", "two.txt", "another.txt"]'


@pytest.mark.parametrize("earlier", [False, True])
def test_a_killed_process_leaves_results_whole_or_not_at_all(
    tmp_path, monkeypatch, earlier
):
    """Whoever looks next finds the old ones or the new ones, and can replace them."""
    target, old = tmp_path / "work" / "a", {}
    target.parent.mkdir()
    if earlier:
        with results_folder(target) as folder:
            write_with_index(folder, one="1", two="2", left_out="3")
        (target / "notes.md").write_text("mine")
        old = contents(target.parent)
    with monkeypatch.context() as watched:
        copies = kept_at_each_moment(watched, target.parent, tmp_path / "kept")
        with results_folder(target, force=True) as folder:
            write_with_index(folder, one="new", two="new", another="new")
    notes = {name: old[name] for name in old if "notes" in name}
    seen = []
    for copy in copies:
        if not earlier:  # a folder is renamed once
            assert contents(copy / "a") in ({}, contents(target))
        else:  # there is an index at any moment, and all files that it lists
            index = json.loads((copy / "a" / "index.json").read_text())
            assert {*index} <= {*contents(copy / "a")}
        complete_results(copy / "a")
        seen.append(contents(copy))
        assert seen[-1] in (old, NEW | notes)
        with results_folder(copy / "a", force=True) as folder:
            write(folder, last="new")
        assert contents(copy) == {"a/last.txt": "new"} | notes
    assert old in seen
    assert NEW | notes in seen


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "a").write_text("text")
    with pytest.raises(FileExistsError, match=r"\ba is a file"):
        check_results_folder(tmp_path / "a", force=True)


def below_a_file(folder):
    (folder / "file").write_text("")
    return folder / "file" / "out"


@pytest.mark.parametrize(
    ("place", "why"),
    [
        (below_a_file, "Not a directory"),
        (lambda folder: folder / ("n" * 300), "File name too long"),
        (lambda folder: folder / "a" / ("n" * 300) / "b", "File name too long"),
    ],
)
def test_a_place_that_cannot_be_written_is_found_before(tmp_path, place, why):
    target = place(tmp_path)
    before = list(tmp_path.iterdir())
    with pytest.raises(OSError, match=re.escape(f"{target} ({why}): choose another")):
        check_results_folder(target)
    assert list(tmp_path.iterdir()) == before


def test_the_longest_name_is_no_problem(tmp_path):
    target = tmp_path / ("n" * 255)
    check_results_folder(target)
    with results_folder(target) as folder:
        write(folder, one="1")
    assert contents(target) == {"one.txt": "1"}


def test_to_try_a_place_leaves_nothing(tmp_path):
    check_results_folder(tmp_path / "a" / "b" / "c")
    (tmp_path / "there").mkdir()
    check_results_folder(tmp_path / "there")
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_full_disk_is_called_that(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "markers.csv")
    with pytest.raises(OSError, match=r"\ba \(No space .*\): choose"):
        write_and_fail(tmp_path / "a", error=full)
    assert list(tmp_path.iterdir()) == []
