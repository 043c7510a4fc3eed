"""A file has one writer, and one that cannot be written says why."""

import errno
import os
import subprocess
import sys

import pytest

from softcal_jax import _places
from softcal_jax._places import only_writer

# By path, since the rest of the package takes seconds to import.
IN_ANOTHER_PROCESS = f"""\
import runpy, sys, time
from pathlib import Path
only_writer = runpy.run_path({_places.__file__!r})["only_writer"]
path = Path(sys.argv[1])
"""


def another(code, path):
    return subprocess.Popen(
        [sys.executable, "-c", IN_ANOTHER_PROCESS + code, str(path)],
        stdout=subprocess.PIPE,
        text=True,
    )


HOLD = """\
with only_writer(path, "test"):
    print("held", flush=True)
    time.sleep(60.0)
"""


def test_a_second_process_is_refused_at_once_and_a_killed_one_blocks_nobody(tmp_path):
    path = tmp_path / "file"
    with another(HOLD, path) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        with (
            pytest.raises(BlockingIOError, match=r"writing to .*file"),
            only_writer(path, "test"),
        ):
            pass
        first.kill()
    assert (tmp_path / "file.lockfile").exists()  # nobody had time to remove it
    with only_writer(path, "test"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_second_writer_in_one_process_is_refused(tmp_path):
    with only_writer(tmp_path / "file", "test"):
        with (
            pytest.raises(BlockingIOError, match="another test is writing"),
            only_writer(tmp_path / "file", "test"),
        ):
            pass
        with only_writer(tmp_path / "other", "test"):
            pass


ADD = """\
for _ in range(1500):
    try:
        with only_writer(path, "test"):
            path.write_text(str(int(path.read_text()) + 1))
            print(end="+")
    except BlockingIOError:
        pass
"""


def test_two_never_write_at_once_though_the_lock_comes_and_goes(tmp_path):
    path = tmp_path / "count"
    path.write_text("0")
    running = [another(ADD, path) for _ in range(3)]
    added = sum(len(one.communicate()[0]) for one in running)
    assert [one.returncode for one in running] == [0, 0, 0]
    assert int(path.read_text()) == added > 0
    assert list(tmp_path.iterdir()) == [path]


def below_a_file(folder):
    (folder / "file").write_text("")
    return folder / "file" / "fit.npz"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (below_a_file, r"file of fit\.npz .*make it"),
        (lambda folder: folder / "none" / "fit", "none of fit .*make it"),
        (lambda folder: folder, "is a directory"),
        # Longer than 255 letters with the ending of a partial file.
        (lambda folder: folder / ("n" * 248), r"File name too long.*another"),
    ],
)
def test_a_place_that_cannot_be_written_is_found_before(tmp_path, place, message):
    path = place(tmp_path)
    before = list(tmp_path.iterdir())
    with pytest.raises(OSError, match=message), only_writer(path, "test"):
        raise AssertionError("too late")
    assert list(tmp_path.iterdir()) == before


def test_a_full_disk_is_called_that(tmp_path, monkeypatch):
    def full(file, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", full)
    with (
        pytest.raises(OSError, match=r"fit .*not be written.*No space"),
        only_writer(tmp_path / "fit", "test"),
    ):
        raise AssertionError("too late")
    assert list(tmp_path.iterdir()) == []
