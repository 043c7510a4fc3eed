"""Fresh figures against the committed record: what counts as worse."""

import copy
import json

import pytest
from wording import says

from benchmarks import _cli, _compare, _page, _problem, _record

GOALS = {
    "vs_peer": _problem.Goal("at least", 3.0),
    "recovered": _problem.Goal("at least", 30),
    "coverage": _problem.Goal("between", 0.9, 0.98),
}


@pytest.fixture
def old():
    outcome = _problem.Outcome(
        {
            "solve_ms": 10.0,
            "setup_s": 2.0,
            "peak_mb": 10.0,
            "model_mb": 2.0,
            "peer_ms": 40.0,
            "vs_peer": 4.0,
            "recovered": 30,
            "coverage": 0.95,
            "size": 7.0,
            "solver": "PARDISO",
        },
        {"solve_s": [0.009, 0.010, 0.010, 0.012], "peak_mb": [9.0, 10.0, 10.0, 12.0]},
        GOALS,
        better={"peer_ms": "either"},
    )
    return _record.record("beam", outcome, 0.1)


def judged(old, **figures):
    """Verdicts after some figures have changed; None takes one away."""
    now = copy.deepcopy(old)
    for name, value in figures.items():
        now["figures"][name] = value
        now.get("better", {}).setdefault(name, "lower")
        if value is None:
            del now["figures"][name]
    comparison = _compare.compare(old, now)
    return {c.figure: c.verdict for c in comparison.changes if c.verdict != "same"}


def test_nothing_changed(old):
    assert judged(old) == {}


@pytest.mark.parametrize(
    ("name", "value", "verdict"),
    [
        # The quartiles of the samples are 9.75 and 10.5: 3.75 % on each side and run.
        ("peak_mb", 10.74, None),
        ("peak_mb", 10.76, "worse"),
        ("peak_mb", 9.2, "better"),
        # Without samples: a tenth.
        ("model_mb", 2.19, None),
        ("model_mb", 2.21, "worse"),
        # The same machine takes up to twice as long on another day.
        ("solve_ms", 19.9, None),
        ("solve_ms", 20.1, "worse"),
        ("vs_peer", 3.5, "worse"),
        ("vs_peer", 4.5, "better"),
        # Another program's time, and a number that may go either way.
        ("peer_ms", 81.0, "changed"),
        ("size", 14.0, "changed"),
        # A count has no noise.
        ("recovered", 29, "worse"),
        # Within its range, any value is as good.
        ("coverage", 0.901, None),
        ("coverage", 0.89, "worse"),
        ("solver", "KLU", "changed"),
        ("recovered", "not reached", "worse"),
        ("solve_ms", None, "gone"),
        ("extra_s", 1.0, "new"),
    ],
)
def test_verdicts(old, name, value, verdict):
    assert judged(old, **{name: value}) == ({name: verdict} if verdict else {})


def test_more_noise_allows_more(old):
    now = copy.deepcopy(old)
    now["figures"]["peak_mb"] = 10.76
    now["samples"]["peak_mb"] = [8.0, 11.0, 11.0, 16.0]
    assert _compare.compare(old, now).worse == []


def test_ratios(old):
    now = copy.deepcopy(old)
    now["figures"] |= {"setup_s": 1.0, "solver": "KLU"}
    ratios = {c.figure: c.ratio for c in _compare.compare(old, now).changes}
    assert ratios["setup_s"] == 0.5
    assert ratios["solver"] is None


def test_records_of_old_know_what_is_usual(old):
    """Records that do not say which way is better: goals and units do."""
    del old["better"]
    assert judged(old, setup_s=5.0, vs_peer=3.0, size=14.0) == {
        "setup_s": "worse",
        "vs_peer": "worse",
        "size": "changed",
    }


def test_another_machine_is_said(old):
    now = copy.deepcopy(old)
    now["hardware"] |= {"cpu": "Z80", "load_before": 1.5, "cores": 2}
    now["versions"] |= {"jax": "9.9", "commit": "other"}
    old["hardware"]["cores"] = 2
    cpu, jax, busy = _compare.compare(old, now).warnings
    assert says(cpu, "cpu is Z80", old["hardware"]["cpu"])
    assert says(jax, "jax is 9.9", old["versions"]["jax"])
    assert says(busy, "load 1.5 ... 2 cores")


def test_two_problems_do_not_compare(old):
    with pytest.raises(_compare.BadRecord, match=r"'beam', .*fresh .*'other'"):
        _compare.compare(old, old | {"name": "other"})


def test_command(tmp_path, old, capsys):
    """Exit code 1 and the names of what got worse; 0 where nothing did."""
    records, fresh = tmp_path / "records", tmp_path / "fresh"
    records.mkdir()
    fresh.mkdir()
    _record.write_json(records / "beam.json", old)
    _record.write_json(fresh / "beam.json", old)
    argv = ["compare", str(fresh), "--records", str(records)]
    assert _cli.main(argv) == 0
    old["figures"]["setup_s"] = 5.0
    _record.write_json(fresh / "beam.json", old)
    _record.write_json(fresh / "second.json", old | {"name": "second"})
    capsys.readouterr()
    assert _cli.main(argv) == 1
    printed = capsys.readouterr()
    assert "2.5" in next(x for x in printed.out.splitlines() if "setup_s" in x)
    assert says(printed.err, f"second: new ... {records / 'second.json'}")
    assert printed.err.endswith("worse: beam: setup_s\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is no JSON: "),
        ('{"name": "beam"}', "no record ... no hardware"),
        ("[]", "no record ... no name"),
        (None, "cannot be read ... No such file"),
    ],
)
def test_what_is_no_record(tmp_path, capsys, text, message):
    path = tmp_path / "x.json"
    if text is not None:
        path.write_text(text)
    assert _cli.main(["compare", str(path)]) == 2
    assert says(capsys.readouterr().err, message)


def test_an_empty_folder(tmp_path, capsys):
    assert _cli.main(["compare", str(tmp_path)]) == 2
    assert says(capsys.readouterr().err, f"{tmp_path} ... no records; ... run --all")


def test_committed_records_are_what_they_are_compared_with():
    """Every record is whole, has the name of its file, and equals itself."""
    files = sorted(_compare.RECORDS.glob("*.json"))
    known = _problem.discover(_cli.benchmarks)
    assert len(files) > 10
    for path in files:
        content = _compare.read_record(path)
        assert content["name"] == path.stem
        assert content["name"] in known
        assert _compare.compare(content, content).worse == []


def test_better_belongs_to_a_figure():
    with pytest.raises(ValueError, match=r"better 'y' .*no figure"):
        _problem.Outcome({"x": 1.0}, better={"y": "lower"})


@pytest.mark.parametrize("goal", GOALS.values(), ids=str)
def test_goals_are_read_as_written(goal):
    assert _problem.Goal.read(str(goal)) == goal


def test_a_text_that_is_no_goal():
    with pytest.raises(ValueError, match=r"'soon' .*'at least 3'"):
        _problem.Goal.read("soon")


@pytest.mark.parametrize(
    ("name", "unit"),
    [("solve_ms", "ms"), ("seconds_30_starts", "s"), ("n525_vs_felupe", "felupe")],
)
def test_units_stand_in_names(name, unit):
    assert _problem.unit_of(name) == unit


@pytest.mark.parametrize(
    ("value", "goal", "margin"),
    [
        (6.0, _problem.Goal("at least", 3.0), 2.0),
        (6.0, _problem.Goal("at most", 3.0), 0.5),
        (0, _problem.Goal("at most", 0), 1.0),
        (5, _problem.Goal("at most", 0), 0.1),
        (1e9, _problem.Goal("at least", 3.0), 10.0),
        (0.95, _problem.Goal("between", 0.9, 0.98), 1.0),
        (0.45, _problem.Goal("between", 0.9, 0.98), 0.5),
        (1.96, _problem.Goal("between", 0.9, 0.98), 0.5),
    ],
)
def test_margins_of_goals(value, goal, margin):
    assert _page._margin(value, goal) == pytest.approx(margin)


def test_the_page_has_a_line_for_everything(old):
    panels = _page._panels(old)
    lines = [(p.title.partition(": how")[0], name) for p in panels for name in p.values]
    assert lines == [
        ("goals", "vs_peer"),
        ("goals", "recovered"),
        ("goals", "coverage"),
        ("figures: time [ms]", "solve_ms"),
        ("figures: time [ms]", "peer_ms"),
        ("figures: time [s]", "setup_s"),
        ("figures: memory [MB]", "peak_mb"),
        ("figures: memory [MB]", "model_mb"),
        ("figures: others [-]", "size"),
        ("samples: time [s]", "solve_s"),
        ("samples: memory [MB]", "peak_mb"),
    ]
    assert "solver: PARDISO" in _page._head(old)


def test_plot_draws_records(tmp_path, capsys):
    records = [
        _compare.RECORDS / f"{n}.json" for n in ("static_beam", "noise_coverage")
    ]
    assert _cli.main(["plot", *map(str, records), "--output", str(tmp_path)]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {
        "static_beam.png",
        "noise_coverage.png",
    }
    assert "plots: " in capsys.readouterr().err


def test_an_outcome_says_which_way_is_better(old):
    assert json.loads(json.dumps(old["better"])) == {
        "solve_ms": "lower",
        "setup_s": "lower",
        "peak_mb": "lower",
        "model_mb": "lower",
        "peer_ms": "either",
        "vs_peer": "higher",
        "recovered": "higher",
        "coverage": "between",
        "size": "either",
        "solver": "either",
    }
