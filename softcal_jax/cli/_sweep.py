"""`softcal sweep`: many calibrations, side by side; `softcal sweep show`."""

import argparse
import time
from typing import TYPE_CHECKING

from softcal_jax.cli._display import Display
from softcal_jax.cli._shared import (
    BAD_INPUT,
    INTERRUPTED,
    NOT_CONVERGED,
    OK,
    Stop,
    bad_input,
    times_line,
)

if TYPE_CHECKING:
    from softcal_jax.sweeps import Progress, SweepResult

QUIET_S = 30.0
"""Shortest time between lines of progress in a log [s]."""


def sweep(args: argparse.Namespace, show: Display) -> int:
    """Run a sweep file, or resume it."""
    import jax

    from softcal_jax.sweeps import load_sweep

    # Only a program may set this, for itself and its workers; a library must not.
    jax.config.update("jax_enable_x64", True)
    show.lap("import")
    show.now(f"reading {args.sweep.name}")
    with bad_input():
        loaded = load_sweep(args.sweep)
    show.lap("reading")
    database = args.output or loaded.database
    ended = 0

    tell = _progress_lines(show)

    def progress(now: "Progress") -> None:
        nonlocal ended
        ended = now.ended
        tell(now)

    try:
        with bad_input():
            result = loaded.run(
                database,
                workers=args.workers,
                cores_per_worker=args.cores_per_worker,
                scheduler=args.scheduler,
                retry_failed=args.retry_failed,
                progress=progress,
            )
    except KeyboardInterrupt:
        raise Stop(
            INTERRUPTED,
            f"interrupted: {ended} of {len(loaded.points)} trials are in {database}; "
            "the same command goes on from there.",
        ) from None
    except RuntimeError as error:
        raise Stop(BAD_INPUT, f"error: {error}") from error
    show.lap("trials")
    return _print_result(result, str(database), show)


def _print_result(result: "SweepResult", database: str, show: Display) -> int:
    from softcal_jax.sweeps import sweep_table

    show.line()
    show.line(sweep_table(result, width=show.console.width))
    show.line(f"Rows in {database}; `softcal sweep show {database}` has more.")
    show.line(times_line(show))
    bad = len(result.rows) - len(result.of_state("converged"))
    if bad:
        what = "trial" if bad == 1 else "trials"
        raise Stop(NOT_CONVERGED, f"{bad} {what} failed or did not converge.")
    return OK


def _progress_lines(show: Display):
    """Return a callback that prints failures at once, and progress now and then."""
    last = -QUIET_S

    def progress(now: "Progress") -> None:
        nonlocal last
        row = now.row
        if row is None:
            done = f", {now.before} of them before" if now.before else ""
            show.line(f"{now.total} trials{done}")
        elif row.state == "failed":
            point = ", ".join(f"{axis} = {value}" for axis, value in row.point.items())
            show.line(f"failed: {point}: {row.reason.splitlines()[0]}")
        if now.ended == now.total:
            return
        begin = "the first trial compiles" if row is None else ""
        tick = time.monotonic()
        due = row is not None and tick - last >= QUIET_S
        last = tick if due or row is None else last
        show.now(f"{now}{', ' if begin else ''}{begin}", log=due)

    return progress


def show_sweep(args: argparse.Namespace, show: Display) -> int:
    """Tabulate a sweep, even while it runs, and plot it on request."""
    from softcal_jax.sweeps import plot_sweep, read_sweep, sweep_table, write_sweep_csv

    with bad_input():
        result = read_sweep(args.database)
        show.line(
            sweep_table(
                result,
                by=args.by,
                figures=args.figure,
                every=args.all,
                width=show.console.width,
            )
        )
        if args.csv is not None:
            write_sweep_csv(result, args.csv)
            show.line(f"One line per trial in {args.csv}.")
        if args.plot is not None:
            plot_sweep(result, args.plot, by=args.by, figures=args.figure)
            show.line(f"Picture in {args.plot}.")
    return OK
