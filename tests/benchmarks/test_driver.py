"""The benchmarks' driver, with a problem that takes no time."""

import importlib
import json
import math
import os
import sys

import pytest
from wording import says

from benchmarks import _cli, _problem, _record, _timing

FAKE = '''
"""How fast nothing is done.

Details.
"""

from benchmarks._problem import Goal, Outcome, Table


def run(options):
    options.say("at work")
    (options.folder() / "picture.txt").write_text("a picture")
    return Outcome(
        {"n": 3, "fast_ms": 1.5, "solver": "none"},
        {"fast_ms": [1.0, 1.5, 2.0]},
        {"fast_ms": Goal("at most", 1.0), "n": Goal("at least", 3)},
        [Table("Nothing", ["what", "ms"], [["nothing", "1.5"]])],
    )
'''


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with two problems, one of which cannot be imported."""
    folder = tmp_path / "fake_benchmarks"
    folder.mkdir()
    (folder / "__init__.py").write_text('"""Fakes."""\n')
    (folder / "_shared.py").write_text("raise AssertionError('not a problem')\n")
    (folder / "nothing.py").write_text(FAKE)
    (folder / "broken.py").write_text('"""Needs a peer."""\n\nimport felupe\n')
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("fake_benchmarks")
    for name in [n for n in sys.modules if n.startswith("fake_benchmarks")]:
        del sys.modules[name]


def call(package, *argv):
    return _cli.main([str(word) for word in argv], package)


def test_list_names_problems_without_importing_them(package, capsys):
    assert call(package, "list") == 0
    assert capsys.readouterr().out.splitlines() == [
        "broken   Needs a peer.",
        "nothing  How fast nothing is done.",
    ]


def test_list_of_the_house():
    """Every problem of the house says in one line what it measures."""
    known = _problem.discover(_cli.benchmarks)
    assert {"static_beam", "compile", "locking", "silicone_mesh", "sweep"} <= set(known)
    assert "peers" in known
    paper = {"paper_fig1", "paper_fig3", "paper_fig4", "paper_table1"}
    assert paper | {"noise_coverage", "model_error", "calibration_beam"} <= set(known)
    assert {"random_truths", "silent_errors", "reliability"} <= set(known)
    assert all(known.values()), known


def test_run_writes_the_record(package, tmp_path, capsys):
    path, output = tmp_path / "out.json", tmp_path / "o"
    assert call(package, "run", "nothing", "--json", path, "--output", output) == 0
    content = json.loads(path.read_text())
    assert set(content) == {
        "name", "hardware", "versions", "figures", "better", "goals", "samples",
    }  # fmt: skip
    assert content["name"] == "nothing"
    assert content["figures"] == {"n": 3, "fast_ms": 1.5, "solver": "none"}
    assert content["better"] == {"n": "higher", "fast_ms": "lower", "solver": "either"}
    assert content["samples"] == {"fast_ms": [1.0, 1.5, 2.0]}
    assert content["goals"]["fast_ms"] == {"goal": "at most 1", "met": False}
    assert content["goals"]["n"]["met"] is True
    assert set(content["hardware"]) == {
        "cpu",
        "cores",
        "memory_gb",
        "os",
        "load_before",
    }
    assert content["hardware"]["cores"] >= 1
    for package_name in ("python", "jax", "jaxlib", "softcal_jax", "felupe", "numpy"):
        assert content["versions"][package_name]
    assert (output / "picture.txt").read_text() == "a picture"
    printed = capsys.readouterr()
    assert "Nothing" in printed.out
    assert "at most 1: MISSED" in printed.out
    assert "at work" in printed.err


def test_without_json_nothing_is_written(package, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.rglob("*.json"))
    assert call(package, "run", "nothing") == 0
    assert set(tmp_path.rglob("*.json")) == before
    assert (tmp_path / "benchmark-results" / "nothing" / "picture.txt").exists()


def test_unknown_name(package, capsys):
    assert call(package, "run", "nothin") == 2
    assert says(capsys.readouterr().err, "'nothin' ... 'nothing' ... broken, nothing")


def test_private_module_is_no_problem(package, capsys):
    assert call(package, "run", "_shared") == 2
    assert "unknown benchmark '_shared'" in capsys.readouterr().err


def test_no_command_is_a_wrong_call(package):
    with pytest.raises(SystemExit) as stop:
        call(package)
    assert stop.value.code == 2


def test_missing_peer(package, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "felupe", None)
    assert call(package, "run", "broken") == 2
    assert says(
        capsys.readouterr().err, "broken ... felupe ... softcal-jax[benchmarks]"
    )


def test_other_missing_modules_are_not_hidden(package, monkeypatch):
    monkeypatch.setattr(_cli, "_PEERS", ())
    monkeypatch.setitem(sys.modules, "felupe", None)
    with pytest.raises(ModuleNotFoundError):
        call(package, "run", "broken")


@pytest.mark.parametrize(
    ("where", "message"),
    [("no/such/out.json", "folder does not exist"), ("", "is a folder")],
)
def test_json_that_cannot_be_written_is_refused_first(
    package, tmp_path, capsys, where, message
):
    assert call(package, "run", "nothing", "--json", tmp_path / where) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert "at work" not in printed.err


def test_json_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "out.json"
    path.write_text("earlier")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        _record.write_json(path, {"name": "new"})
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_json_knows_no_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        _record.write_json(tmp_path / "out.json", {"x": math.nan})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (math.inf, ValueError, "figure 'x' .* inf; JSON"),
        (True, TypeError, "figure 'x' .*got True"),
        ([1.0], TypeError, r"figure 'x' .*got \[1.0\]"),
    ],
)
def test_figures_are_numbers_or_words(value, error, message):
    with pytest.raises(error, match=message):
        _problem.Outcome({"x": value})


def test_a_goal_belongs_to_a_figure():
    with pytest.raises(ValueError, match=r"goal 'y' .*no figure"):
        _problem.Outcome({"x": 1.0}, goals={"y": _problem.Goal("at most", 1.0)})


def test_goals():
    at_least, at_most = _problem.Goal("at least", 3.0), _problem.Goal("at most", 3.0)
    assert at_least.met(3.0)
    assert at_most.met(3.0)
    assert not at_least.met(2.9)
    assert not at_most.met(3.1)
    assert not at_most.met("fast")
    between = _problem.Goal("between", 0.9, 0.98)
    assert [between.met(v) for v in (0.89, 0.9, 0.98, 0.99)] == [
        False,
        True,
        True,
        False,
    ]
    assert str(between) == "between 0.9 and 0.98"


def test_repeats_take_turns():
    calls = []
    seconds = _timing.interleave(
        {"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, repeats=2
    )
    # Each timed call follows one of its own that is not timed.
    assert calls == ["a", "a", "b", "b"] * 2
    assert {name: len(times) for name, times in seconds.items()} == {"a": 2, "b": 2}


def test_ratio_of_medians():
    assert _timing.ratio([2.0, 9.0, 3.0], [1.0, 1.5, 100.0]) == 2.0
    assert _timing.median_ms([1.0, 2.0, 9.0]) == 2000.0


def test_a_process_that_fails_says_why():
    with pytest.raises(RuntimeError, match="too bad"):
        _timing.run_process([sys.executable, "-c", "raise SystemExit('too bad')"])


def test_a_run_draws_its_page(package, tmp_path, capsys):
    assert call(package, "run", "nothing", "--output", tmp_path) == 0
    assert (tmp_path / "nothing.png").read_bytes().startswith(b"\x89PNG")
    assert f"plots: {tmp_path / 'nothing.png'}" in capsys.readouterr().err


@pytest.mark.slow
def test_run_all_goes_on_after_a_failure(package, tmp_path, monkeypatch, capfd):
    """One folder, one process and one record per problem; `compare` reads them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fake_benchmarks" / "broken.py").write_text('"""Breaks."""\n\n1 / 0\n')
    assert call(package, "run", "--all") == 1
    printed = capfd.readouterr()
    assert "ZeroDivisionError" in printed.err
    assert "failed: broken\n" in printed.err
    results = tmp_path / "benchmark-results"
    assert [p.name for p in results.glob("*.json")] == ["nothing.json"]
    assert (results / "nothing" / "nothing.png").exists()
    assert (results / "nothing" / "picture.txt").exists()
    assert call(package, "compare", "--records", results) == 0


@pytest.mark.parametrize("argv", [["run"], ["run", "nothing", "--all"]])
def test_run_takes_one_or_all(package, capsys, argv):
    assert call(package, *argv) == 2
    assert says(capsys.readouterr().err, "one benchmark ... --all")


def test_a_part_is_renewed_in_a_record(package, tmp_path, monkeypatch, capsys):
    """The rest of the record stays, and it says what the part was run with."""
    module = importlib.import_module("fake_benchmarks.nothing")
    monkeypatch.setattr(module, "COUNTS", {"part": 1}, raising=False)
    path, words = tmp_path / "nothing.json", ("--output", tmp_path / "out")
    assert call(package, "run", "nothing", "--json", path, *words) == 0
    before = json.loads(path.read_text())
    before["figures"] |= {"n": 7, "of_another_part": 1}
    before["versions"]["commit"] = "earlier"
    path.write_text(json.dumps(before))
    again = ("run", "nothing", "--renew", "--json", path, *words)
    assert call(package, *again) == 2
    assert "--renew needs --count" in capsys.readouterr().err
    assert call(package, *again, "--count", "part=2") == 0
    after = json.loads(path.read_text())
    assert after["figures"] == before["figures"] | {"n": 3}
    assert after["versions"]["commit"] == "earlier"
    assert after["renewed"]["part"]["versions"]["commit"] != "earlier"
    path.write_text(json.dumps(before | {"name": "other"}))
    assert call(package, *again, "--count", "part=2") == 2
