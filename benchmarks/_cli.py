"""The driver: `list` the benchmarks, `run` one."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import benchmarks
from benchmarks._problem import Options, Outcome, UnknownProblem, discover, load
from benchmarks._record import load_average, record, write_json

_PEERS = ("felupe", "pypardiso")
_WRONG_CALL = 2


class NotWritable(ValueError):
    """The record cannot be written where it was asked for."""


def main(argv: Sequence[str], package: ModuleType = benchmarks) -> int:
    """Run the command line.

    Args:
        argv: Arguments after `python -m benchmarks`.
        package: Where the problems are.

    Returns:
        The exit status: 0, or 2 after a wrong call.
    """
    arguments = _parser().parse_args(argv)
    if arguments.command == "list":
        known = discover(package)
        width = max(map(len, known), default=0)
        for name, line in known.items():
            print(f"{name:<{width}}  {line}")
        return 0
    try:
        if arguments.json is not None:
            _check_writable(arguments.json)
        _run(package, arguments.name, arguments.json, arguments.output)
    except (UnknownProblem, NotWritable) as error:
        _say(str(error))
        return _WRONG_CALL
    except ModuleNotFoundError as error:
        if error.name not in _PEERS:
            raise
        _say(
            f"{arguments.name} compares with {error.name}, which is not installed: "
            "pip install softcal-jax[benchmarks]"
        )
        return _WRONG_CALL
    return 0


def _run(
    package: ModuleType, name: str, json: Path | None, output: Path | None
) -> None:
    """Run a problem, print what it found, and write the record."""
    run = load(package, name)
    before = load_average()
    begin = time.perf_counter()
    _enable_float64()
    outcome = run(Options(output or Path("benchmark-results") / name, _say))
    _print(name, outcome)
    if json is not None:
        write_json(json, record(name, outcome, before))
    _say(f"{name} took {time.perf_counter() - begin:.0f} s")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Benchmarks of softcal_jax."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="name the benchmarks")
    run = commands.add_parser("run", help="run one benchmark")
    run.add_argument("name", metavar="NAME", help="one of those that `list` names")
    run.add_argument("--json", type=Path, metavar="FILE", help="write the result here")
    run.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for pictures and other files (default: benchmark-results/NAME)",
    )
    return parser


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


def _print(name: str, outcome: Outcome) -> None:
    from rich.console import Console
    from rich.table import Table

    # In a file or a pipe, a name that is cut helps no one.
    console = Console(width=None if sys.stdout.isatty() else 120)
    for given in outcome.tables:
        table = Table(title=given.title, title_justify="left")
        for i, column in enumerate(given.columns):
            table.add_column(column, justify="right" if i else "left")
        for row in given.rows:
            table.add_row(*row)
        console.print(table)
    figures = Table(title=f"{name}: figures", title_justify="left")
    figures.add_column("figure")
    figures.add_column("value", justify="right")
    if outcome.goals:
        figures.add_column("goal")
    for figure, value in outcome.figures.items():
        goal = outcome.goals.get(figure)
        shown = value if isinstance(value, str) else f"{value:.4g}"
        verdict = "" if goal is None else f"{goal}: {_verdict(goal.met(value))}"
        figures.add_row(figure, shown, *([verdict] if outcome.goals else []))
    console.print(figures)


def _verdict(met: bool) -> str:
    return "met" if met else "MISSED"
