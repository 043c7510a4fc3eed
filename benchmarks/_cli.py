"""The driver: `list` the benchmarks, `run` them, `compare` with the records, `plot`."""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import benchmarks
from benchmarks._compare import RECORDS, BadRecord, compare, fresh_files, read_record
from benchmarks._problem import Options, UnknownProblem, discover, load
from benchmarks._record import load_average, record, renewed, write_json

_RESULTS = Path("benchmark-results")
"""Folder of everything that a run writes, where nothing else is asked for."""

_PEERS = ("felupe", "lupa", "pypardiso", "tensortrax")
_WORSE, _WRONG_CALL = 1, 2


class NotWritable(ValueError):
    """The record cannot be written where it was asked for."""


class WrongCall(ValueError):
    """The arguments do not go together."""


def main(argv: Sequence[str], package: ModuleType = benchmarks) -> int:
    """Run the command line.

    Args:
        argv: Arguments after `python -m benchmarks`.
        package: Where the problems are.

    Returns:
        The exit status: 0; 1 where a comparison found something worse, or one problem
        of all failed; 2 after a wrong call.
    """
    arguments = _parser().parse_args(argv)
    try:
        return arguments.command(arguments, package)
    except (UnknownProblem, NotWritable, BadRecord, WrongCall) as error:
        _say(str(error))
        return _WRONG_CALL


def _list(arguments: argparse.Namespace, package: ModuleType) -> int:
    del arguments
    known = discover(package)
    width = max(map(len, known), default=0)
    for name, line in known.items():
        print(f"{name:<{width}}  {line}")
    return 0


def _run(arguments: argparse.Namespace, package: ModuleType) -> int:
    if arguments.all == (arguments.name is not None):
        raise WrongCall("name one benchmark, or give --all; `list` names them.")
    if arguments.all:
        if arguments.count:
            raise WrongCall("--count belongs to one benchmark: name it.")
        return _run_all(arguments, package)
    name, json = arguments.name, arguments.json
    if json is not None:
        _check_writable(json)
    old = None
    if arguments.renew:
        if json is None or not arguments.count:
            raise WrongCall("--renew needs --count, the parts, and --json, the record.")
        old = read_record(json)
        if old["name"] != name:
            raise WrongCall(
                f"--json {json} is a record of {old['name']!r}, not {name!r}."
            )
    try:
        output = arguments.output or _RESULTS / name
        _run_one(package, name, json, output, dict(arguments.count), old)
    except ModuleNotFoundError as error:
        if error.name not in _PEERS:
            raise
        raise WrongCall(
            f"{name} needs {error.name}, which is not installed: "
            "pip install softcal-jax[benchmarks]"
        ) from error
    return 0


def _run_one(
    package: ModuleType,
    name: str,
    json: Path | None,
    output: Path,
    counts: dict[str, int],
    old: dict[str, Any] | None,
) -> None:
    """Run a problem, print what it found, write the record and the page of plots.

    With an old record the figures of the parts that ran are renewed in it.
    """
    problem = load(package, name)
    for part in counts:
        if part not in problem.counts:
            known = ", ".join(problem.counts) or "none"
            raise WrongCall(f"{name} has no part {part!r} to count. It has: {known}.")
    before = load_average()
    begin = time.perf_counter()
    _enable_float64()
    outcome = problem.run(options := Options(output, _say, counts))
    from benchmarks._page import plot_page
    from benchmarks._show import show_outcome

    show_outcome(name, outcome)
    content = record(name, outcome, before)
    if old is not None:
        content = renewed(old, content, counts)
    if json is not None:
        write_json(json, content)
    page = options.folder() / f"{name}.png"
    plot_page(content, page)
    _say(f"{name} took {time.perf_counter() - begin:.0f} s; plots: {page}")


def _run_all(arguments: argparse.Namespace, package: ModuleType) -> int:
    """Run every problem in a process of its own: none inherits memory or programs."""
    json = arguments.json or _RESULTS
    output = arguments.output or _RESULTS
    json.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in discover(package):
        _say(f"== {name}")
        command = [sys.executable, "-c", _ALONE.format(package.__name__), "run", name]
        command += ["--json", str(json / f"{name}.json"), "--output"]
        command += [str(output / name)]
        path = os.pathsep.join(
            [str(Path(__file__).parents[1]), *filter(None, sys.path)]
        )
        done = subprocess.run(command, env={**os.environ, "PYTHONPATH": path})
        if done.returncode:
            failed.append(name)
    if failed:
        _say(f"failed: {', '.join(failed)}")
    _say(f"records: {json}; `python -m benchmarks compare {json}` judges them")
    return _WORSE if failed else 0


_ALONE = (
    "import sys, {0} as package; from benchmarks._cli import main; "
    "sys.exit(main(sys.argv[1:], package))"
)
"""Program of one problem in a process of its own."""


def _compare(arguments: argparse.Namespace, package: ModuleType) -> int:
    """Print figures over those of the records; say at the end what got worse."""
    del package
    from benchmarks._show import show_comparison

    worse = []
    for path in fresh_files(arguments.fresh or [_RESULTS]):
        now = read_record(path)
        committed = arguments.records / f"{now['name']}.json"
        if not committed.exists():
            _say(f"{now['name']}: new, there is no record {committed}")
            continue
        comparison = compare(read_record(committed), now)
        show_comparison(comparison)
        worse += [f"{comparison.name}: {c.figure}" for c in comparison.worse]
    for line in worse:
        _say(f"worse: {line}")
    return _WORSE if worse else 0


def _plot(arguments: argparse.Namespace, package: ModuleType) -> int:
    """Draw the pages of records that are there."""
    del package
    from benchmarks._page import plot_page

    arguments.output.mkdir(parents=True, exist_ok=True)
    for path in fresh_files(arguments.fresh or [RECORDS]):
        content = read_record(path)
        page = arguments.output / f"{content['name']}.png"
        plot_page(content, page)
        _say(f"plots: {page}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Benchmarks of softcal_jax."
    )
    commands = parser.add_subparsers(required=True)
    commands.add_parser("list", help="name the benchmarks").set_defaults(command=_list)
    run = commands.add_parser("run", help="run one benchmark, or all")
    run.set_defaults(command=_run)
    run.add_argument(
        "name", nargs="?", metavar="NAME", help="one of those that `list` names"
    )
    run.add_argument("--all", action="store_true", help="run every benchmark")
    run.add_argument(
        "--count",
        type=_part_and_count,
        metavar="PART=N",
        action="append",
        default=[],
        help="run this part alone, so many times (several times for several)",
    )
    run.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="write the result here; with --all a folder, for one file per benchmark "
        f"(default: {_RESULTS})",
    )
    run.add_argument(
        "--renew",
        action="store_true",
        help="with --count and --json: replace only the figures of these parts in that "
        "record, and note there which commit and machine they are of",
    )
    run.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for the page of plots and other files "
        f"(default: {_RESULTS}/NAME); with --all one folder in it per benchmark",
    )
    judge = commands.add_parser(
        "compare",
        help="print fresh figures over those of the records",
        description="Prints every figure of fresh runs over that of the committed "
        "record. Exit codes: 0 nothing got worse, 1 something did, 2 wrong call.",
    )
    judge.set_defaults(command=_compare)
    judge.add_argument(
        "--records",
        type=Path,
        default=RECORDS,
        metavar="DIR",
        help="folder of the records (default: benchmarks/records)",
    )
    draw = commands.add_parser("plot", help="draw the page of plots of records")
    draw.set_defaults(command=_plot)
    draw.add_argument(
        "--output",
        type=Path,
        default=_RESULTS,
        metavar="DIR",
        help=f"folder for the pages (default: {_RESULTS})",
    )
    for command, default in ((judge, _RESULTS), (draw, "benchmarks/records")):
        command.add_argument(
            "fresh",
            nargs="*",
            type=Path,
            metavar="FILE",
            help="what `run --json` wrote, or a folder of such files "
            f"(default: {default})",
        )
    return parser


def _part_and_count(text: str) -> tuple[str, int]:
    """Read "kills=6"."""
    part, _, number = text.partition("=")
    if not number.isdecimal() or int(number) < 1:
        raise argparse.ArgumentTypeError(
            f"got {text!r}; expected a part and a whole number from 1 on, like kills=6."
        )
    return part, int(number)


def _check_writable(path: Path) -> None:
    """A long run must not end at a file that cannot be written."""
    if path.is_dir():
        raise NotWritable(f"--json {path} is a folder; name a file.")
    if not path.resolve().parent.is_dir():
        raise NotWritable(f"--json {path}: its folder does not exist.")


def _enable_float64() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
