"""Running functions: rows, resuming, dying workers."""

import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import cheap
import jax
import jax.numpy as jnp
import pytest
from killable import kill, started, wait_for
from rows import ends, substance
from wording import says

from softcal_jax.sweeps import Trial, grid, read_sweep, run_sweep
from softcal_jax.sweeps._workers import set_up


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """All rows, one after the other in this process."""
    path = tmp_path_factory.mktemp("undisturbed") / "sweep"
    return run_sweep(cheap.measure, cheap.POINTS, path, repeats=["draw"], workers=0)


def test_every_trial_is_a_row(undisturbed):
    assert len(undisturbed.rows) == len(cheap.POINTS) == 24
    assert [row["point"] for row in undisturbed.rows] == [
        Trial(point).key for point in cheap.POINTS
    ]
    assert not undisturbed.missing
    failed = undisturbed.of_state("failed")
    assert [row["draw"] for row in failed] == [3, 3]
    assert failed[0]["reason"] == "ArithmeticError: no value at E = 200000"
    assert "in measure" in failed[0]["traceback"]
    assert failed[0]["E found [Pa]"] is None
    bad = undisturbed.of_state("not converged")
    assert {row["reason"] for row in bad} == {"draw 4"}
    # Neither counts in a mean.
    assert len(undisturbed.numbers("E found [Pa]")) == 24 - 2 - 4


def test_workers_give_the_same_rows(undisturbed, tmp_path, monkeypatch):
    """Two processes, in another order, from another function of the same numbers."""
    backwards, place = cheap.POINTS[::-1], tmp_path / "meeting"
    place.mkdir()
    monkeypatch.setenv("SWEEP_MEETING", str(place))
    result = run_sweep(cheap.together, backwards, tmp_path / "s", workers=2)
    assert sorted(map(str, substance(result))) == sorted(
        map(str, substance(undisturbed))
    )
    assert len({row["worker"] for row in result.rows}) == 2
    assert str(os.getpid()) not in {row["worker"].split()[1] for row in result.rows}


def test_resuming_runs_only_what_is_missing(undisturbed, tmp_path):
    path, progress = tmp_path / "s", []
    first = run_sweep(cheap.measure, cheap.POINTS[:10], path, workers=0)
    run_sweep(
        cheap.measure, cheap.POINTS, path, repeats=["draw"], workers=0,
        progress=progress.append,
    )  # fmt: skip
    result = read_sweep(path)
    assert substance(result) == substance(undisturbed)
    assert ends(first).items() <= ends(result).items()
    assert (progress[0].before, progress[0].row) == (10, None)
    assert [now.ended for now in progress] == list(range(10, 25))
    assert "left" not in str(progress[-1])
    # A smaller plan keeps the rows that it does not ask for.
    smaller = run_sweep(cheap.measure, cheap.POINTS[:5], path, workers=0)
    assert len(smaller.rows) == 24
    assert not smaller.missing


def test_failed_trials_are_tried_again_only_if_asked(tmp_path):
    path, points = tmp_path / "s", grid({"a": [1, 2]})
    cure = []

    def function(trial):
        if trial["a"] == 1 and not cure:
            raise OSError("out of space")
        return {"x": trial["a"]}

    run = lambda **more: run_sweep(function, points, path, workers=0, **more)
    assert [row["state"] for row in run().rows] == ["failed", "converged"]
    cure.append(True)
    assert [row["state"] for row in run().rows] == ["failed", "converged"]
    again = run(retry_failed=True)
    assert [row["state"] for row in again.rows] == ["converged", "converged"]


def children(pid):
    """Worker processes of a driver; its resource tracker is none."""
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(pid)],
        capture_output=True,
        text=True,
    )
    lines = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    return [int(number) for number, words in lines if "spawn_main" in words]


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    return state != "Z"


@pytest.mark.slow
def test_kill_a_worker_and_then_the_driver(undisturbed, tmp_path):
    """kill -9 of either loses no row on the disk, and no other changes by it."""
    path = tmp_path / "s"
    driver = started(path, "2")
    workers = children(driver.pid)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    before = len(read_sweep(path).rows)
    wait_for(driver, path, before + 4)
    workers = children(driver.pid)
    kill(driver)
    # Nobody computes on for a driver that is gone.
    end = time.monotonic() + 20.0
    while any(map(is_alive, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(is_alive, workers))

    left = read_sweep(path)
    assert 7 <= len(left.rows) < 24
    assert len(left.missing) == 24 - len(left.rows)
    assert set(map(str, substance(left))) <= set(map(str, substance(undisturbed)))
    result = run_sweep(cheap.slowly, cheap.POINTS, path, repeats=["draw"], workers=2)
    assert substance(result) == substance(undisturbed)
    assert ends(left).items() <= ends(result).items()


@pytest.mark.slow
def test_a_worker_ends_in_the_middle_of_a_trial_with_its_driver(tmp_path):
    """A trial may take hours, which nobody waits for when the driver is gone."""
    pid_file, path = tmp_path / "worker", tmp_path / "s"
    program = (
        "import cheap, softcal_jax.sweeps as s\n"
        f"s.run_sweep(cheap.asleep, [{{'file': {str(pid_file)!r}}}], {str(path)!r}, "
        "workers=1)"
    )
    driver = subprocess.Popen([sys.executable, "-c", program])
    while not (pid_file.exists() and pid_file.read_text()):
        assert driver.poll() is None
        time.sleep(0.05)
    driver.kill()
    driver.wait()
    end = time.monotonic() + 60.0
    while is_alive(int(pid_file.read_text())) and time.monotonic() < end:
        time.sleep(0.05)
    assert not is_alive(int(pid_file.read_text()))


@pytest.mark.slow
def test_a_trial_that_kills_its_worker_fails_alone(undisturbed, tmp_path):
    points = [p for p in cheap.POINTS if p["E"] == 2e5 and p["kind"] == "u"]
    result = run_sweep(cheap.deadly, points, tmp_path / "s", workers=2)
    assert [row["state"] for row in result.rows] == [
        "converged", "converged", "failed", "converged", "not converged", "converged",
    ]  # fmt: skip
    assert says(result.rows[2]["reason"], "died 2 times")
    others = [row for row in substance(result) if row["state"] != "failed"]
    assert all(row in substance(undisturbed) for row in others)


def test_workers_compute_as_this_process_does(tmp_path):
    """float64 as here, and one thread each; a program serves all trials of a shape."""
    points = grid({"length": [5, 6], "draw": [1, 2, 3]})
    result = run_sweep(cheap.compiled, points, tmp_path / "s", workers=1)
    assert set(result.numbers("float64")) == {1.0}
    assert set(result.numbers("cores")) == {1.0}
    assert len(set(result.numbers("process"))) == 1
    assert "OMP_NUM_THREADS" not in os.environ
    assert [*result.numbers("sum")] == [30.0] * 3 + [55.0] * 3
    compiled = [row["compile_seconds"] > 0.0 for row in result.rows]
    assert compiled == [True, False, False] * 2


def timed(function, folder):
    """Wall time of one trial, and the part of it that JAX took to compile."""
    (row,) = run_sweep(function, grid({"a": [1]}), folder, workers=0).rows
    return row["seconds"], row["compile_seconds"]


def test_compiling_is_told_from_the_rest(tmp_path):
    slow_to_compile = jax.jit(lambda x: sum(jnp.sin(i * x) for i in range(200)))

    def function(trial):
        value = slow_to_compile(1.0).block_until_ready()
        time.sleep(0.05)
        return {"x": float(value)}

    whole, compiling = timed(function, tmp_path / "first")
    assert compiling > 0.02
    assert whole - compiling >= 0.05
    assert timed(function, tmp_path / "again")[1] == 0.0


def test_nested_traces_are_counted_once(tmp_path):
    inner = jax.jit(lambda x: sum(jnp.cos(i * x) for i in range(100)))
    outer = jax.jit(lambda x: inner(x) + inner(2.0 * x))
    whole, compiling = timed(lambda trial: {"x": float(outer(1.0))}, tmp_path)
    # Were one counted twice, less than nothing would be left for solving.
    assert 0.0 < compiling < whole + 0.01


def test_workers_of_another_version_are_refused():
    with pytest.raises(RuntimeError, match=r" 0\.0\.1: .*Install the same version"):
        set_up(x64=True, sweep="0.0.1")


def test_functions_that_cannot_be_sent(tmp_path):
    points, path = grid({"a": [1]}), tmp_path / "s"
    with pytest.raises(ValueError, match=r"cannot be sent .*workers=0"):
        run_sweep(lambda trial: {"x": 1}, points, path, workers=1)
    # In this process it can be anything.
    result = run_sweep(lambda trial: {"x": 1}, points, tmp_path / "t", workers=0)
    assert result.numbers("x") == [1.0]


def test_functions_that_cannot_be_imported(tmp_path, monkeypatch):
    monkeypatch.setattr(cheap.measure, "__module__", "cheap", raising=False)
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.setattr(sys, "path", [p for p in sys.path if "tests" not in p])
    with pytest.raises(RuntimeError, match=r"cannot import .*'cheap'.*workers=0"):
        run_sweep(cheap.measure, grid({"E": [1.0]}), tmp_path / "s", workers=1)


@pytest.mark.parametrize(
    ("returned", "reason"),
    [
        (3.0, "TypeError: ... mapping"),
        ({"x": [1, 2]}, "TypeError: figure 'x' ... got list"),
    ],
)
def test_wrong_returns_are_failures(returned, reason, tmp_path):
    result = run_sweep(
        lambda trial: returned, grid({"a": [1]}), tmp_path / "s", workers=0
    )
    assert result.rows[0]["state"] == "failed"
    assert says(result.rows[0]["reason"], reason)


def test_figures_that_do_not_exist_and_warnings(tmp_path):
    def function(trial):
        warnings.warn("the mesh locks", stacklevel=1)
        warnings.warn("for developers", DeprecationWarning, stacklevel=1)
        return {"x": float("nan"), "y": float("inf"), "z": None, "word": "yes"}

    path = tmp_path / "s"
    (row,) = run_sweep(function, grid({"a": [1]}), path, workers=0).rows
    assert row["word"] == "yes"
    assert not {"x", "y", "z"} & row.keys()  # a figure that no trial has is no column
    assert row["notes"] == ["the mesh locks"]


def test_half_a_compiled_program_is_thrown_away(tmp_path):
    """What a killed worker left on the disk is no matter of the trial."""
    folder = tmp_path / "programs"
    folder.mkdir()
    half, other = folder / "jit_f-12-cache", folder / "jit_g-12-cache"
    half.write_bytes(b"ha")
    other.write_bytes(b"whole")
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(folder))

    def function(trial):
        text = "Error reading persistent compilation cache entry for 'jit_f': cut off"
        warnings.warn(text, stacklevel=1)
        return {"x": 1}

    try:
        result = run_sweep(function, grid({"a": [1]}), tmp_path / "s", workers=0)
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert result.rows[0]["notes"] == []
    assert list(folder.iterdir()) == [other]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": []}, "no trials"),
        ({"points": [{"a": 1}, {"a": 1}]}, "a = 1 twice"),
        ({"points": [{"a": 1}, {"b": 1}]}, "same axes"),
        ({"repeats": ["draws"]}, "axis 'draws'.* Known: 'a'"),
        ({"workers": -1}, "workers .* 0 or more, got -1"),
        ({"cores_per_worker": 0}, "cores_per_worker .*got 0"),
        ({"executor": "tcp://a:1", "workers": 2}, "workers .*executor.*Give one"),
        ({"points": [{"state": 1}]}, "axis .*'state'.*column"),
    ],
)
def test_bad_arguments(arguments, message, tmp_path):
    given = {"points": grid({"a": [1, 2]}), **arguments}
    with pytest.raises(ValueError, match=message):
        run_sweep(cheap.measure, folder=tmp_path / "s", **given)
    assert list(tmp_path.iterdir()) == []
