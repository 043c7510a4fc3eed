"""Fig. 4 of the paper: how many of 30 random starts reach p_target, and what it takes.

Starts are uniform in the whole bounds, theta in +-90 degrees, E_l < E_t; 4
configurations, one effector. Three ways to step from the same starts:

- ours: steps of {E_t, E_l, theta} as tensors, and images of a run that ends with an
  error: its start with mirrored axes, and the axes of its end with all else as the
  space starts it;
- the same trust region without these two cures: theta as a number, mixed linearly,
  E_l <= E_t as a constraint of the QP;
- the paper's loop: every QP step is taken, with one bound.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._paper import (
    CELLS,
    PAPER,
    Cells,
    MeasuredBeam,
    measured_beam,
    paper_settings,
    parameter_errors,
    readable,
    recovered,
)
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax._typing import HostArray
from softcal_jax.calibration import (
    FROM_ANYWHERE,
    CalibrationSettings,
    MultiStartResult,
    multi_start,
)
from softcal_jax.fields import random_starts

STARTS = 30

SEED = 0
"""Seed of the random starts."""

PAPER_BOUND = 0.1
"""Bound on the step of the paper's loop: 100 kPa, 0.1 rad [-]."""

PAPER_STEPS = 60
"""Steps that it is given."""

GOALS = {
    "recovered_of_30": Goal("at least", 30),
    "recovered_of_30_xz": Goal("at least", 30),
    "seconds_30_starts": Goal("at most", 10),
    "search_over_all_alone": Goal("at most", 0.45),
    "search_over_all_alone_xz": Goal("at most", 0.45),
}


class Way(NamedTuple):
    """A way to step.

    Attributes:
        title: For tables and the picture.
        choices: Arguments of `anisotropic_beam`.
        settings: Settings of the outer loop.
        mirror: Whether runs go on from their mirror images.
    """

    title: str
    choices: dict[str, Any]
    settings: CalibrationSettings
    mirror: bool


WAYS = {
    "": Way("ours", {}, FROM_ANYWHERE, True),
    "_without": Way("without the cures", PAPER, CalibrationSettings(), False),
    "_paper": Way(
        "the paper's loop", PAPER, paper_settings(PAPER_BOUND, PAPER_STEPS), False
    ),
}
"""Ways to step, by what they add to the name of a figure."""


class Ends(NamedTuple):
    """All runs of one way.

    Attributes:
        measured: The calibration.
        result: Its runs.
        errors: Error of each parameter at the end of each run, relative or [rad].
    """

    measured: MeasuredBeam
    result: MultiStartResult
    errors: HostArray

    @property
    def hits(self) -> HostArray:
        """Which runs ended at p_target."""
        return np.array([recovered(row) for row in self.errors])


def run(options: Options) -> Outcome:
    """Both print planes with our steps, "xy" with the others too."""
    options.say("ours, print plane xy")
    ours = runs_from_random(WAYS[""], "xy", CELLS, STARTS)
    seconds = _timed(ours.measured)
    options.say("ours, print plane xz")
    runs = {"": ours, "_xz": runs_from_random(WAYS[""], "xz", CELLS, STARTS)}
    for suffix in ("_without", "_paper"):
        options.say(f"{WAYS[suffix].title}, print plane xy")
        runs[suffix] = runs_from_random(WAYS[suffix], "xy", CELLS, STARTS)
    figures: dict[str, Figure] = {
        f"recovered_of_30{suffix}": int(ends.hits.sum())
        for suffix, ends in runs.items()
    }
    figures["seconds_30_starts"] = seconds
    for suffix in ("", "_xz"):
        result = runs[suffix].result
        figures[f"optima{suffix}"] = sum(bool(o.starts) for o in result.optima)
        figures[f"median_steps{suffix}"] = float(np.median(result.steps))
        figures[f"most_steps{suffix}"] = int(result.steps.max())
        figures[f"search_over_all_alone{suffix}"] = _over_alone(runs[suffix].measured)
    picture = options.folder() / "fig4.png"
    plot({WAYS[s].title: runs[s] for s in ("", "_without")}, picture)
    options.say(f"picture: {picture}")
    titles = {
        "": "ours, print plane xy",
        "_xz": "ours, print plane xz",
        "_without": "without the cures, print plane xy",
        "_paper": "the paper's loop, print plane xy",
    }
    tables = [_table(titles[suffix], ends) for suffix, ends in runs.items()]
    samples = {
        f"largest_error{suffix}": [float(e.max()) for e in ends.errors]
        for suffix, ends in runs.items()
    }
    return Outcome(figures, samples, GOALS, tables)


def runs_from_random(way: Way, plane: str, cells: Cells, n: int) -> Ends:
    """Runs from n random starts; the same p_init for every way.

    Args:
        way: How to step.
        plane: Print plane.
        cells: Cells of the beam.
        n: How many starts.
    """
    measured = measured_beam(cells, plane=plane, **way.choices)
    starts = random_starts(measured.space, n, seed=SEED)
    result = multi_start(
        measured.problem, starts, settings=way.settings, mirror=way.mirror, enough=0.0
    )
    errors = [
        parameter_errors(measured.space, jnp.asarray(z), measured.target)
        for z in result.z
    ]
    return Ends(measured, result, np.array(errors))


def _timed(measured: MeasuredBeam) -> float:
    """Wall time of all starts, compiled before [s]."""
    starts = random_starts(measured.space, STARTS, seed=SEED)
    jax.block_until_ready(starts)
    begin = time.perf_counter()
    multi_start(measured.problem, starts, enough=0.0)
    return time.perf_counter() - begin


def _over_alone(measured: MeasuredBeam) -> float:
    """Steps of a search that ends by itself, over those of all starts alone."""
    starts = random_starts(measured.space, STARTS, seed=SEED)
    search = multi_start(measured.problem, starts)
    alone = [multi_start(measured.problem, start[None]) for start in starts]
    return int(search.steps.sum()) / sum(int(one.steps[0]) for one in alone)


def _table(title: str, ends: Ends) -> Table:
    """Distinct optima, and the runs that found none."""
    result = ends.result
    rows = []
    for optimum in result.optima:
        if not optimum.starts:  # only passed on the way to another one
            continue
        at_target = bool(ends.hits[optimum.starts[0]])
        rows.append(
            [
                "p_target"
                if at_target
                else readable(result.names, np.array(list(optimum.values.values()))),
                f"{optimum.cost:.1e}",
                str(len(optimum.starts)),
            ]
        )
    lost = np.flatnonzero(~result.converged)
    if lost.size:
        finite = result.cost[lost][np.isfinite(result.cost[lost])]
        lowest = f"{finite.min():.1e} or more" if finite.size else "infinite"
        rows.append(["not converged", lowest, str(lost.size)])
    title = f"Fig. 4, {title}: {ends.hits.sum()} of {len(ends.hits)} reach p_target"
    return Table(title, ["optimum", "cost", "starts"], rows)


def plot(rows: Mapping[str, Ends], path: Path) -> None:
    """Every run from its start to its end, one panel per parameter."""
    from matplotlib.figure import Figure as Drawing
    from matplotlib.lines import Line2D

    from softcal_jax.plotting._figure import BAD, GOOD, TEXT

    first = next(iter(rows.values()))
    names = first.result.names
    drawing = Drawing(figsize=(15.0, 4.2 * len(rows)), dpi=100, layout="constrained")
    panels = drawing.subplots(len(rows), len(names), squeeze=False)
    for line, (title, ends) in zip(panels, rows.items(), strict=True):
        hits = ends.hits
        for i, (axes, name) in enumerate(zip(line, names, strict=True)):
            angle = "theta" in name
            factor = np.rad2deg(1.0) if angle else 1e-3
            pairs = factor * np.stack(
                [ends.result.starts[:, i], ends.result.values[:, i]], axis=1
            )
            for pair, good in zip(pairs, hits, strict=True):
                axes.plot(
                    [0, 1],
                    pair,
                    "o-" if good else "X--",
                    ms=4 if good else 7,
                    lw=1.1,
                    alpha=0.75,
                    color=GOOD if good else BAD,
                )
            target = factor * ends.measured.beam.target[name]
            axes.axhline(target, color=TEXT, ls="--", lw=1.4, zorder=0)
            axes.set(xlim=(-0.15, 1.15), ylim=(-95, 95) if angle else (0, 1050))
            axes.set_xticks([0, 1], ["start", "end"], fontsize=12)
            axes.set_title(f"{name} [{'deg' if angle else 'kPa'}]", fontsize=12)
        line[0].set_ylabel(
            f"{title}:\n{hits.sum()} of {len(hits)} reach p_target", fontsize=14
        )
    handles = [
        Line2D([], [], color=GOOD, marker="o", label="ends at p_target"),
        Line2D([], [], color=BAD, marker="X", ls="--", label="ends elsewhere"),
        Line2D([], [], color=TEXT, ls="--", label="p_target"),
    ]
    drawing.legend(
        handles=handles, loc="outside lower center", ncols=3, fontsize=13, frameon=False
    )
    drawing.suptitle(
        "Fig. 4: random starts in the whole bounds, 4 configurations, one effector",
        fontsize=17,
    )
    drawing.savefig(path, dpi=100, format="png")
