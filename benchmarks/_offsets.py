"""Whether intervals hold where each recording has an offset of its own."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from benchmarks._paper import STD, Cells
from benchmarks._printed import Printed, printed
from benchmarks._problem import Options, Table
from benchmarks.paper_table1 import all_markers, with_known
from softcal_jax.calibration import calibrate
from softcal_jax.fields import exactly_known
from softcal_jax.robots import synthetic_measurements

OFFSET = 0.5e-3
"""Standard deviation of the offset of each recording, along each axis [m]."""


class Offsets(NamedTuple):
    """Fits to draws of jitter and offsets.

    Attributes:
        truth: True values by parameter, in SI units.
        fits: What each fit printed.
        not_converged: How many fits did not converge; they count all the same.
    """

    truth: dict[str, float]
    fits: list[tuple[Printed, ...]]
    not_converged: int

    @property
    def offs(self) -> list[float]:
        """Distances of the truth from the middle, in half-widths."""
        shown = [i for fit in self.fits for i in fit if i.kind != "none"]
        return [i.off(self.truth[i.name]) for i in shown]

    @property
    def coverage(self) -> float:
        """Share of the intervals that hold the truth [-]."""
        return float(np.mean(np.array(self.offs) <= 1.0))

    def table(self) -> Table:
        """The share for each parameter."""
        rows = []
        for name, truth in self.truth.items():
            intervals = [i for fit in self.fits for i in fit if i.name == name]
            shown = [i.off(truth) <= 1.0 for i in intervals if i.kind != "none"]
            share = f"{100 * np.mean(shown):.0f} %" if shown else "none"
            rows.append([name, f"{len(shown)} of {len(intervals)}", share])
        title = f"{1e3 * STD:g} mm of jitter, recordings off by {1e3 * OFFSET:g} mm"
        columns = ["parameter", "intervals", "hold p_target"]
        return Table(title, columns, rows)


def with_offsets(
    cells: Cells,
    fields: tuple[str, ...],
    bounds: tuple[float, float],
    *,
    draws: int,
    options: Options,
) -> Offsets:
    """Calibrate draws of noise in which every pose is a recording with an offset.

    Fits are told the size of the offsets, and start at p_target.

    Args:
        cells: Cells of the beam.
        fields: Fields that are unknown, at both control points.
        bounds: Bounds of the moduli [Pa].
        draws: How many.
        options: Who is told how far it is.
    """
    beam, poses = all_markers(cells, "xy")
    exact = synthetic_measurements(beam.model, beam.space, poses, beam.target)
    space = with_known(beam.space, fields, beam.target, bounds)
    truth = {name: beam.target[name] for name in space.names}
    target = space.to_scaled(jnp.asarray([*truth.values()]))
    uncertain = replace(exactly_known(), recordings=OFFSET)
    random, fits, not_converged = np.random.default_rng(5), [], 0
    for number in range(1, draws + 1):
        measured = []
        for c in exact:
            assert c.measured is not None
            jitter = STD * random.standard_normal(c.measured.shape)
            offset = OFFSET * random.standard_normal(3)
            measured.append(replace(c, measured=c.measured + jitter + offset))
        fit = calibrate(
            beam.model,
            space,
            measured,
            noise="stated",
            uncertain=uncertain,
            start=target,
        )
        fits.append(printed(fit))
        not_converged += not fit.converged
        if number % 20 == 0:
            options.say(f"  {number} draws")
    return Offsets(truth, fits, not_converged)
