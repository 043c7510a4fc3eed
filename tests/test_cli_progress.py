"""What a command says while it runs, and what programs read of it."""

import io
import json
import os
import re
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_result
from small_project import write_small_project
from wording import says

from softcal_jax.calibration import MultiStartResult, Optimum
from softcal_jax.cli import _display, main
from softcal_jax.cli._display import Compiling, Display
from softcal_jax.cli._shared import so_far


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def test_a_log_says_what_is_under_way_in_plain_lines(monkeypatch, capsys):
    """After each silence, with the time so far, and without carriage returns."""
    monkeypatch.setattr(_display, "SILENCE_S", 0.3)
    with Display(time.time() - 60.0) as show:
        show.now("equilibrium of droop: 40 % of the load", log=False, count=(2, 5))
        time.sleep(1.6)
    text, errors = capsys.readouterr()
    assert errors == ""
    lines = text.splitlines()
    assert 3 <= len(lines) <= 5
    pattern = r"  equilibrium of droop: 40 % of the load \(2 of 5\); 6\d s so far"
    assert all(re.fullmatch(pattern, line) for line in lines)
    assert not set("\r\x1b") & set(text)


def test_quiet_leaves_progress_out_and_keeps_what_counts(monkeypatch, capsys):
    monkeypatch.setattr(_display, "SILENCE_S", 0.1)
    with Display(time.time(), quiet=True) as show:
        show.now("solving")
        show.note("step 1")
        show.warning("odd data")
        show.line("E = 1 kPa")
        time.sleep(0.5)
    assert capsys.readouterr().out == "warning: odd data\nE = 1 kPa\n"
    assert show.warnings == ["odd data"]


def test_a_terminal_has_a_moving_line_with_a_bar(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "stdout", terminal := Terminal())
    with Display(time.time() - 61.0) as show:
        show.now("drawing pictures", count=(1, 4))
        show.progress.refresh()
    text = terminal.getvalue()
    assert "drawing pictures" in text
    assert "\u2501" in text
    assert "0:01:01" in text


def test_forced_colours_move_nothing_in_a_file(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys, "stdout", file := io.StringIO())
    with Display(time.time()) as show:
        show.now("solving")
        time.sleep(0.2)
    assert file.getvalue() == "solving ...\n"


def test_compiling_is_told_while_it_lasts(monkeypatch):
    """From its beginning: JAX only reports durations when they have passed."""
    reports = []
    compiling = Compiling()
    compiling.start()
    try:

        @jax.jit
        def slow(x):
            time.sleep(0.7)  # traced once
            reports.append(compiling.words())
            return jnp.sin(x) + len(reports)

        slow(1.0)
        slow(1.0)
        assert compiling.words() == ""
    finally:
        compiling.stop()
    (words,) = reports
    assert re.fullmatch(r"preparing .*, \d s", words)


def test_a_program_from_the_disk_is_not_compiled(monkeypatch):
    """The first run alone compiles, and is told so."""
    compiling = Compiling()
    monkeypatch.setattr("softcal_jax.cli._display.NOTICED_S", 0.0)
    event = "/jax/core/compile/backend_compile_duration"
    compiling._begins(event, 0.0)
    assert says(compiling.words(), "compiling ... first run", "0 s")
    compiling._ends("/jax/compilation_cache/cache_hits")
    assert compiling.words() == ""
    compiling._ends(event, 0.1)
    compiling._begins(event, 0.0)
    assert compiling.words().startswith("compiling")
    compiling._ends(event, 0.1)
    assert compiling.words() == ""


def test_json_of_a_calibration_is_its_result(tmp_path, out, capsys):
    """Nothing else on standard output, and the pictures may stay away."""
    path = write_small_project(tmp_path)
    command = ["calibrate", str(path), "-o", str(out), "--json", "--no-pictures"]
    assert main(command) == 0
    text, errors = capsys.readouterr()
    assert json.loads(text) == json.loads((out / "result.json").read_text())
    assert "step 1 " in errors
    assert not [*out.glob("*.png"), *out.glob("*.svg")]
    assert (out / "report.html").is_file()
    svg = ["simulate", str(path), "-o", str(out), "--force", "--quiet"]
    assert main([*svg, "--pictures", "svg"]) == 0
    said = capsys.readouterr().out
    assert "reading" not in said
    assert "weight" in said


def test_json_of_an_error(tmp_path, out, capsys):
    assert main(["simulate", str(tmp_path / "no"), "-o", str(out), "--json"]) == 2
    text, errors = capsys.readouterr()
    said = json.loads(text)
    assert said["exit_code"] == 2
    assert "no does not exist" in said["error"]
    assert said["error"] in errors


def test_json_of_identify_and_check(tmp_path, capsys):
    path = str(write_small_project(tmp_path))
    assert main(["identify", path, "--json", "-q"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["identifiability"]["parameters"][0]["name"] == "E"
    assert main(["check", path, "--json", "--no-pictures"]) == 0
    read = json.loads(capsys.readouterr().out)
    assert read["configurations"] == {"weight": "fitted", "pulled": "held out"}
    assert read["parameters"] == ["E"]
    assert read["picture"] is None


def searched(*ends):
    """A search whose starts ended at E, with costs that rise."""
    optima = {E: ends.count(E) for E in dict.fromkeys(ends)}
    first = np.cumsum([0, *optima.values()])
    n = len(ends)
    return MultiStartResult(
        names=("E", "nu"),
        starts=np.zeros((n, 2)),
        values=np.zeros((n, 2)),
        z=np.zeros((n, 2)),
        cost=np.ones(n),
        steps=np.full(n, 4),
        converged=np.ones(n, bool),
        errors=np.ones((n, 1)),
        optima=tuple(
            Optimum(1.0 + k, {"E": E, "nu": 0.4}, tuple(range(first[k], first[k] + m)))
            for k, (E, m) in enumerate(optima.items())
        ),
    )


@pytest.mark.parametrize(
    ("starts", "first"),
    [
        (None, "Preliminary values, from one start; the error budget to come"),
        (searched(2e5, 2e5), "Preliminary values, from 2 of 2 starts"),
        (searched(2e5, 3e5, 3e5), "starts disagree: 1 of 3 ... 2 at E = 300.00 kPa"),
    ],
    ids=["one", "agree", "disagree"],
)
def test_what_is_not_known_for_certain_is_shown_as_such(starts, first, capsys):
    """Without an error; starts that disagree come first."""
    result = make_result(starts=starts, left_out=("the error budget",))
    with Display(time.time()) as show:
        so_far(result, show)
    lines = capsys.readouterr().out.splitlines()
    assert says(lines[0], first)
    assert says(lines, "Preliminary values", "to come")
    assert says(lines, "E = 240 kPa")
    assert not any(sign in line for line in lines for sign in ("±", "+-"))


def test_no_text_of_jax_or_xla_reaches_the_user(tmp_path):
    """What they log for their developers; a developer can still ask for it."""
    code = (
        "import logging, os, sys; from softcal_jax.cli import _main\n"
        "def run(args, show):\n"
        "    import jax, warnings\n"
        "    logging.getLogger('jax._src.xla_bridge').warning('of jax')\n"
        "    warnings.warn('of jax', UserWarning)\n"
        "    print(os.environ['TF_CPP_MIN_LOG_LEVEL'])\n"
        "assert 'jax' not in sys.modules\n"
        "import softcal_jax.cli._new as t; t.tags = run\n"
        "sys.exit(_main.main(['tags', '-o', 'x']))"
    )
    clean = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=clean
    )
    # A slow machine says that it is importing.
    lines = [x for x in done.stdout.splitlines() if not x.startswith("  importing; ")]
    assert (done.returncode, lines, done.stderr) == (0, ["3"], "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion(shell, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--print-completion", shell])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for word in ("calibrate", "sweep", "no-pictures"):
        assert word in text
