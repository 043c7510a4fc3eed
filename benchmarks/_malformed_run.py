"""Malformed inputs, many of them in one process: `_malformed_run FOLDER START STOP`.

Prints a JSON line for each. The process that started it ends one that hangs, and goes
on behind it in another process.
"""

import contextlib
import io
import json
import re
import shutil
import sys
import time
import traceback
from pathlib import Path

import numpy as np

from benchmarks import _malformed_files
from benchmarks._demo import COARSE, copy_demo
from benchmarks._malformed import KINDS, Given
from benchmarks._memory import peak_bytes
from softcal_jax.cli import main as softcal

SEED = 22

TEMPLATE = "template"


def prepare(folder: Path) -> None:
    """Make the project without its comments, a checkpoint and a sweep of it."""
    path = copy_demo(folder / TEMPLATE, COARSE)
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r"(?m)[ \t]*#.*$", "", text), encoding="utf-8")
    out = str(folder / "out")
    words = ["calibrate", str(path), "-o", out, "--checkpoint", str(folder / "fit.npz")]
    sweep = folder / "sweep.toml"
    sweep.write_text(f'project = "{path}"\n[axes]\nnoise = {{ count = 1 }}\n')
    again = ["sweep", str(sweep), "--workers", "1"]
    for command in (words, again):
        with contextlib.redirect_stdout(sys.stderr):
            if softcal(command) not in (0, 1):
                raise RuntimeError(f"softcal {' '.join(command)} failed")


def names() -> list[str]:
    """Names of all kinds, in the order in which inputs take turns."""
    assert _malformed_files.__name__  # its kinds are known once it is imported
    return list(KINDS)


def given_in(folder: Path, copy: Path) -> Given:
    """A fresh copy of the project."""
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder / TEMPLATE, copy)
    project = next(copy.glob("*.toml"))
    return Given(copy, project, folder / "fit.npz", folder / "sweep")


def tried(words: list[str]) -> dict[str, object]:
    """Run a command, and say how it ended and what it took."""
    _forget_peak()
    begin, said = time.perf_counter(), io.StringIO()
    code: object = None
    trace = ""
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = softcal(words)
    except SystemExit as end:
        code = end.code
    except BaseException:  # whatever reaches the user as a traceback
        trace = traceback.format_exc()
    if "Traceback (most recent call last)" in said.getvalue():
        trace = said.getvalue()
    return {
        "words": [word[:200] for word in words],
        "code": code,
        "traceback": trace[-4000:],
        "said": said.getvalue()[-2000:],
        "silent": code == 0 and "warning: " not in said.getvalue(),
        "peak_gb": peak_bytes() / 1e9,
        "seconds": time.perf_counter() - begin,
    }


def _forget_peak() -> None:
    """Start anew the largest resident size that Linux keeps of this process."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def main() -> None:
    """Try inputs, or prepare what they are made of where none are asked for."""
    folder, bounds = Path(sys.argv[1]), [int(word) for word in sys.argv[2:]]
    if not bounds:
        prepare(folder)
        return
    kinds = names()
    for i in range(*bounds):
        name = kinds[i % len(kinds)]
        given = given_in(folder, folder / "copy")
        words = KINDS[name](given, np.random.default_rng([SEED, i]))
        print(json.dumps({"index": i, "kind": name} | tried(words)), flush=True)


if __name__ == "__main__":
    main()
