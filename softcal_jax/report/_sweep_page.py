"""The page of a sweep, beside its database."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from softcal_jax import sweeps
from softcal_jax._places import replacing
from softcal_jax.export import file_dict, made_dict
from softcal_jax.report._html import (
    CHART,
    REPEATED,
    Html,
    Part,
    Section,
    bullets,
    chart,
    closing,
    node,
    page,
)
from softcal_jax.report._verdict import RunVerdict

KIND = "Sweep"  # said on the page; an earlier page of a sweep is recognised by it
MOST_TRIALS, MOST_CHARTED = 100, 6  # in the table, and figures in charts


def sweep_page_of(database: str | os.PathLike[str]) -> Path:
    """Return where the page of a sweep is: sweep_report.html beside sweep.sqlite."""
    database = Path(database)
    return database.parent / f"{database.stem}_report.html"


def check_sweep_page(database: str | os.PathLike[str]) -> None:
    """Raise unless the page of a sweep can be written; call it before a long run.

    Raises:
        FileExistsError: If another file has the name of the page.
    """
    path = sweep_page_of(database)
    if not path.exists():
        return
    head = path.read_bytes()[:200_000] if path.is_file() else b""
    if str(node("p", KIND, class_="kind")).encode() not in head:
        raise FileExistsError(
            f"{path} is not a page of a sweep and would be overwritten. Move it away, "
            "or give the database another name."
        )


def write_sweep(
    result: sweeps.SweepResult,
    database: str | os.PathLike[str],
    *,
    sweep: sweeps.Sweep | None = None,
    timing_s: Mapping[str, float] | None = None,
) -> Path:
    """Write the page of a sweep beside its database, whole or not at all.

    Trials that failed or did not converge are in no mean or chart. With `sweep`, the
    page also has settings, files with their SHA-256 and the command that repeats it.

    Args:
        result: The sweep, finished or not.
        database: Its SQLite file; the page of `sweep.sqlite` is `sweep_report.html`.
        sweep: The sweep file as it was loaded; None for a function of your own.
        timing_s: Wall time per part [s].

    Returns:
        The page.

    Raises:
        FileExistsError: If another file has the name of the page.
        OSError: If the page cannot be written.
    """
    check_sweep_page(database)
    path = sweep_page_of(database)
    text = _sweep_page(result, Path(database), sweep, timing_s or {})
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def _sweep_page(
    result: sweeps.SweepResult,
    database: Path,
    sweep: sweeps.Sweep | None,
    timing_s: Mapping[str, float],
) -> str:
    made = made_dict(None if sweep is None else sweep.made, database.parent)
    data = {**made, "timing_s": timing_s, "files": [database.name]}
    files = [] if sweep is None else [file_dict(sweep.file, database.parent)]
    figures = sweeps.figures_of_the_robot(result)
    means, spread, trials = [], [], []
    groups = result.groups()
    if any(len(group.rows) > 1 for group in groups):
        table = sweeps.tabulated("Means", result, figures, groups)
        means = ["Mean ± standard deviation over the trials that converged.", table]
    if result.rows:
        trials = _trials(result, figures)
        spread = ["No trial has converged: there is nothing to average."]
    if (table := sweeps.spread_table(result)).rows:
        spread = [table]
    swept, varied = sweeps.swept(result, figures[:MOST_CHARTED])
    axes = [
        Section(f"axis{k}", f"By {axis}", [_drawn(result, axis, varied)])
        for k, axis in enumerate(swept if varied else ())
    ]
    again = f"{REPEATED}.sqlite"
    sections = [
        Section("notes", "Notes", [bullets(sweeps.notes_of_trials(result))]),
        Section("varied", "What was varied", [sweeps.varied_table(result)]),
        Section("best", "Best trials", sweeps.best_trials(result) or ()),
        Section("means", "Means over repetitions", means),
        Section("spread", "Spread of all trials", spread),
        *axes,
        Section("trials", "All trials", trials),
        *closing("sweep", data, [made["source"]], files=files, out=again),
    ]
    good = len(result.of_state("converged"))
    bad = len(result.rows) - good
    tone = "plain" if not bad else "doubtful" if good else "bad"
    verdict = RunVerdict(result.headline, tone, tuple(sweeps.doubts(result)))
    return page(result.name, KIND, verdict, sections, index=database.name, units="SI")


def _drawn(result: sweeps.SweepResult, axis: str, figures: Sequence[str]) -> Html:
    """Draw the trials over an axis, as `softcal sweep show` does."""
    heads = [sweeps.readable_figure(result, figure)[1] for figure in figures]
    about = {"by": [axis], "figures": figures, "style": CHART}
    plot = lambda path: sweeps.plot_sweep(result, path, **about)
    return chart(plot, f"{', '.join(heads)} over {axis}", "One dot per trial.")


def _trials(result: sweeps.SweepResult, figures: tuple[str, ...]) -> list[Part]:
    words = []
    if (more := len(result.rows) - MOST_TRIALS) > 0:
        text = "more are in the database; softcal sweep show lists all of them with"
        words.append(f"{more} {text} --all.")
    if not_drawn := figures[MOST_CHARTED:]:
        words.append(f"In this table but not plotted: {', '.join(not_drawn)}.")
    table = sweeps.tabulated("Trials", result, figures, result.rows[:MOST_TRIALS])
    return [table, *words]
