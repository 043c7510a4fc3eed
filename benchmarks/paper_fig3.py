"""Fig. 3 of the paper: ||Delta_e|| against steps for one to four configurations.

One effector, the tip. The same data are calibrated with the step limits of the authors'
scene (1 % of S, 0.005 rad) and with ours: an adaptive bound, and steps of {E_t, E_l,
theta} as tensors. One configuration has 3 data for 6 parameters: it fits without error
at wrong values, and `identify` must say so where the run ends.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from benchmarks._paper import (
    CELLS,
    LENGTH,
    PAPER,
    Cells,
    MeasuredBeam,
    error_curve,
    measured_beam,
    one_run,
    paper_settings,
    parameter_errors,
    readable,
    recovered,
    steps_until,
    subset,
)
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax._typing import HostArray
from softcal_jax.calibration import CalibrationSettings
from softcal_jax.fields import exactly_known
from softcal_jax.identifiability import Identifiability, identify

REACHED = 1e-6 * LENGTH
"""||Delta_e|| at which a run counts as having arrived [m]."""

COUNTS = (1, 2, 3, 4)
"""Numbers of configurations, 1 to n of Fig. 2."""

LONGEST_STEP = 1e3
"""Bound on a step that holds nothing back: the authors' limits are per parameter."""

PAPER_STEPS = 250
"""Steps that the runs with the paper's limits are given."""

GOALS = {"steps_4_configurations": Goal("at most", 12)}


class Curve(NamedTuple):
    """A run of Fig. 3.

    Attributes:
        sizes: ||Delta_e|| after each step [m].
        z: Where it ended, scaled [-].
        errors: Errors of its parameters, relative or [rad].
    """

    sizes: HostArray
    z: HostArray
    errors: HostArray

    @property
    def steps(self) -> int | None:
        """Steps until it arrived, if it did."""
        return steps_until(self.sizes, REACHED)


def run(options: Options) -> Outcome:
    """Both kinds of steps, in both print planes for ours."""
    options.say("with our steps")
    ours = {plane: measured_beam(CELLS, plane=plane) for plane in ("xy", "xz")}
    curves = {plane: descend(beam) for plane, beam in ours.items()}
    options.say("with the paper's step limits")
    limited, settings = paper_run(CELLS)
    theirs = descend(limited, settings)
    verdict = verdict_at_end(ours["xy"], curves["xy"][1])
    picture = options.folder() / "fig3.png"
    plot({"steps limited as in the paper": theirs, "our steps": curves["xy"]}, picture)
    options.say(f"picture: {picture}")
    figures: dict[str, Figure] = {}
    for n in COUNTS:
        figures[f"steps_{_count(n)}"] = _steps(curves["xy"][n])
        figures[f"steps_{_count(n)}_xz"] = _steps(curves["xz"][n])
        figures[f"steps_{_count(n)}_paper_limits"] = _steps(theirs[n])
    figures["verdict_1_configuration"] = verdict.verdict
    tables = [
        _table("xy, our steps", ours["xy"], curves["xy"]),
        _table("xz, our steps", ours["xz"], curves["xz"]),
        _table("xy, the paper's step limits", limited, theirs),
        _verdict_table(verdict),
    ]
    samples = {f"ours_{n}_m": list(c.sizes) for n, c in curves["xy"].items()}
    samples |= {f"paper_{n}_m": list(c.sizes) for n, c in theirs.items()}
    return Outcome(figures, samples, GOALS, tables)


def paper_run(
    cells: Cells, max_steps: int = PAPER_STEPS
) -> tuple[MeasuredBeam, CalibrationSettings]:
    """The beam with the step limits of the authors' scene, and the paper's loop."""
    beam = measured_beam(cells, plane="xy", **{**PAPER, "scaling": "paper"})
    return beam, paper_settings(LONGEST_STEP, max_steps)


def descend(
    measured: MeasuredBeam,
    settings: CalibrationSettings | None = None,
    counts: Sequence[int] = COUNTS,
) -> dict[int, Curve]:
    """A run from `START` for each number of configurations."""
    curves = {}
    for n in counts:
        problem = subset(measured.problem, range(n))
        end = one_run(problem, settings or CalibrationSettings(), problem.space.start())
        errors = parameter_errors(problem.space, end.z, measured.target)
        curves[n] = Curve(error_curve(end), np.asarray(end.z), errors)
    return curves


def verdict_at_end(measured: MeasuredBeam, curve: Curve) -> Identifiability:
    """What configuration 1 alone can tell, where its run ended."""
    beam = measured.beam
    return identify(
        beam.model,
        beam.space,
        beam.configurations[:1],
        at=curve.z,
        uncertain=exactly_known(),
    )


def _count(n: int) -> str:
    return f"{n}_configuration{'s' * (n > 1)}"


def _steps(curve: Curve) -> Figure:
    return "not reached" if curve.steps is None else curve.steps


def _table(title: str, measured: MeasuredBeam, curves: Mapping[int, Curve]) -> Table:
    rows = []
    for n, curve in curves.items():
        p = np.asarray(measured.space.from_scaled(jnp.asarray(curve.z)))
        ends = (
            "p_target" if recovered(curve.errors) else readable(measured.space.names, p)
        )
        rows.append([str(n), str(_steps(curve)), f"{curve.sizes[-1]:.1e}", ends])
    columns = ["configurations", "steps to 1.5e-7 m", "last ||Delta_e|| m", "ends at"]
    return Table(f"Fig. 3, print plane {title}", columns, rows)


def _verdict_table(outlook: Identifiability) -> Table:
    rows = [
        [d.words, f"{100.0 * d.ratio:.3g} %", d.verdict] for d in outlook.directions
    ]
    columns = ["direction", "standard error over the asked one", "verdict"]
    return Table(
        f"1 configuration, where its run ended: {outlook.verdict} ({outlook.n_data} "
        f"data, {outlook.n_parameters} parameters)",
        columns,
        rows,
    )


def plot(panels: Mapping[str, Mapping[int, Curve]], path: Path) -> None:
    """Draw one panel per kind of steps, over the same range of ||Delta_e||."""
    from matplotlib.figure import Figure as Drawing

    from softcal_jax.plotting._figure import FAINT, SERIES

    drawing = Drawing(figsize=(13.0, 5.6), dpi=100, layout="constrained")
    axes = drawing.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for panel, (title, curves) in zip(axes, panels.items(), strict=True):
        longest = max(len(curve.sizes) for curve in curves.values())
        for (n, curve), colour in zip(curves.items(), SERIES, strict=False):
            sizes = np.maximum(curve.sizes, 1e-16)  # an error of 0 has no logarithm
            steps = np.arange(len(sizes))
            label = f"{n} configuration{'s' * (n > 1)}"
            # A panel of long runs would be all dots.
            marker = "o" if longest < 40 else ""
            panel.semilogy(
                steps, sizes, lw=2, marker=marker, ms=5, color=colour, label=label
            )
        panel.axhline(REACHED, color=FAINT, ls="--", lw=1.6)
        panel.set_title(title, fontsize=15)
        panel.set_xlabel("step", fontsize=14)
        panel.grid(True, color="#dddddd", lw=0.8)
        panel.tick_params(labelsize=12)
        panel.set_xlim(left=0)
    axes[0].annotate(
        "1e-6 of the length",
        (0.45, REACHED),
        xytext=(0, -16),
        ha="center",
        textcoords="offset points",
        fontsize=12,
        color=FAINT,
        xycoords=("axes fraction", "data"),
    )
    axes[0].set_ylim(1e-14, 1.0)
    axes[0].set_ylabel(r"$\|\Delta_e\|$ [m]", fontsize=14)
    axes[0].legend(fontsize=12, loc="lower center", bbox_to_anchor=(0.4, 0.0))
    drawing.suptitle("Fig. 3: beam of Sec. V, one effector at the tip", fontsize=17)
    drawing.savefig(path, dpi=100, format="png")
