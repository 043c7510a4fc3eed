"""Do the predicted standard errors hold? 100 draws of noise at three levels.

The beam of Sec. V, print plane "xy", 6 configurations with 5 effectors each (the tip
and the four of the published scene). Noise of 0.1, 0.3 and 1 mm is added to exact
positions, each draw is calibrated with the noise as stated, and the interval value +-
1.96 standard errors is asked whether it holds p_target.

Standard errors are of first order, so they can only hold where the data determine the
parameters well. They do for 4 parameters, {E_l, theta} at both control points with E_t
known (p4), which is what `coverage_95` stands for. With all 6 (p6) E_t of CP 1 has a
standard error of more than a tenth at 0.1 mm and of its own size at 1 mm; those figures
show where the theory ends. There the intervals of `profile_intervals`, from the
likelihood itself, are asked as well (`coverage_95_profile`). A calibration whose
profile finds a lower cost is begun again from there, as its message says.

Bounds are wide (10 kPa to 10 MPa), since they cut the normal law. Fits start at
p_target: what is tested is the statistics at the optimum, not the way to it. The mesh
is coarse for the same reason; data and fits share it. A draw that does not converge,
or ends on a bound, has no interval; it is counted, and the coverage is that of the
others. All draws of a level are one compiled program.

Errors within a recording are not independent. `coverage_95_offsets` is that of p4 where
each pose is a recording that is off by 0.5 mm along each axis, beside the jitter of 0.1
mm: of the intervals that `calibrate` prints when told so.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._offsets import with_offsets
from benchmarks._paper import STD, Cells, run_each
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._profiles import Profiles, profiles
from benchmarks.paper_table1 import all_markers, with_known
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import CalibrationSettings, build_problem, evaluate
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import independent
from softcal_jax.robots import synthetic_measurements
from softcal_jax.unknowns import Problem

LEVELS = (0.1e-3, 0.3e-3, 1.0e-3)
"""Standard deviations of the markers [m]."""

CELLS: Cells = (6, 1, 1)
"""Coarse, since hundreds of fits share it with their data."""

DRAWS = 100

QUANTILE = 1.959964
"""Half the width of the 95 % interval, in standard errors [-]."""

DESIGNS = {"p4": ("E_l", "theta"), "p6": ("E_t", "E_l", "theta")}
"""Fields that are unknown, at both control points; E_t is known in the first."""

BOUNDS = (10e3, 10e6)
"""Bounds of the moduli, ten times as wide as those of Sec. V [Pa]."""

MAX_STEPS = 40
"""Steps after which a fit counts as not converged."""

GOALS = {
    "coverage_95": Goal("between", 0.90, 0.98),
    "coverage_95_profile": Goal("between", 0.90, 0.98),
    "coverage_95_offsets": Goal("between", 0.90, 0.98),
}


class Draws(NamedTuple):
    """Fits to the draws of one level of noise.

    Attributes:
        error: Error of each parameter in each draw, in SI units.
        standard_error: What the fit predicts for it; nan without an interval.
        predicted: What is predicted at p_target, before anything is measured.
        converged: Whether the fit converged.
        on_bound: Whether it ended on a bound.
    """

    error: HostArray
    standard_error: HostArray
    predicted: HostArray
    converged: HostArray
    on_bound: HostArray

    @property
    def usable(self) -> HostArray:
        """Draws that have an interval for every parameter."""
        return np.isfinite(self.standard_error).all(axis=1) & self.converged

    @property
    def inside(self) -> HostArray:
        """Whether the interval holds p_target, for the usable draws."""
        reach = QUANTILE * self.standard_error[self.usable]
        return np.abs(self.error[self.usable]) <= reach


def run(options: Options) -> Outcome:
    """All levels of noise, for both sets of parameters."""
    figures: dict[str, Figure] = {"coverage_95": 0.0}
    samples: dict[str, list[float]] = {}
    tables: list[Table] = []
    for design, fields in DESIGNS.items():
        problem, target = clean_problem(CELLS, fields)
        names = problem.space.names
        levels = {}
        for std in LEVELS:
            options.say(f"{design}: {DRAWS} draws with {1e3 * std:g} mm")
            begin = time.perf_counter()
            levels[std] = draw(problem, target, std, DRAWS)
            options.say(f"  {time.perf_counter() - begin:.0f} s")
            name = f"{design}_{1e3 * std:g}mm".replace(".", "p")
            figures |= _figures(levels[std], name)
            samples |= {
                f"error_{name}_{parameter.replace(' ', '_')}": [
                    float(v) for v in errors
                ]
                for parameter, errors in zip(names, levels[std].error.T, strict=True)
            }
        if design == "p4":
            inside = np.concatenate([draws.inside for draws in levels.values()])
            figures["coverage_95"] = _share(inside)
        picture = options.folder() / f"noise_coverage_{design}.png"
        plot(levels, names, picture)
        options.say(f"picture: {picture}")
        tables += [_table(levels, names), _lost(levels, len(names))]
        if design == "p6":
            std = max(LEVELS)
            options.say(f"{design}: profiles of {DRAWS} draws with {1e3 * std:g} mm")
            weighed, measured = noisy(problem, std, DRAWS)
            profiled = profiles(weighed, target, measured, QUANTILE, options)
            figures |= _profile_figures(profiled)
            tables.append(_profile_table(profiled, names, std))
    options.say(f"p4: {DRAWS} draws with offsets of recordings")
    off = with_offsets(CELLS, DESIGNS["p4"], BOUNDS, draws=DRAWS, options=options)
    figures["coverage_95_offsets"] = off.coverage
    figures["not_converged_offsets"] = off.not_converged
    samples["off_offsets"] = off.offs
    tables.append(off.table())
    return Outcome(figures, samples, GOALS, tables)


def clean_problem(
    cells: Cells, fields: Sequence[str]
) -> tuple[Problem, Float[Array, " n_p"]]:
    """The calibration of some fields without noise, and its p_target, scaled."""
    beam, poses = all_markers(cells, "xy")
    poses = synthetic_measurements(beam.model, beam.space, poses, beam.target)
    space = with_known(beam.space, fields, beam.target, BOUNDS)
    problem = build_problem(beam.model, space, poses)
    p = jnp.asarray([beam.target[name] for name in space.names])
    return problem, space.to_scaled(p)


def _figures(draws: Draws, name: str) -> dict[str, Figure]:
    figures: dict[str, Figure] = {
        f"coverage_95_{name}": _share(draws.inside),
        f"not_converged_{name}": int(np.sum(~draws.converged)),
        f"on_a_bound_{name}": int(np.sum(draws.on_bound)),
    }
    if draws.usable.any():
        figures[f"error_over_predicted_{name}"] = float(np.mean(_ratios(draws)))
    return figures


def _share(inside: HostArray) -> Figure:
    return float(np.mean(inside)) if inside.size else "no fit has intervals"


def draw(clean: Problem, target: Float[Array, " n_p"], std: float, n: int) -> Draws:
    """Fit n draws of normal noise.

    Args:
        clean: The calibration with exact positions, their std `STD`.
        target: p_target, scaled [-].
        std: Standard deviation of the noise [m].
        n: How many draws.
    """
    problem, measured = noisy(clean, std, n)
    settings = CalibrationSettings(step_bound=0.3, max_steps=MAX_STEPS)
    where = lambda p: p.configurations.effectors.measured
    draws = [eqx.tree_at(where, problem, row) for row in measured]
    runs = run_each(draws, settings, target)
    space = problem.space
    p_target = np.asarray(space.from_scaled(target))
    errors, standard, on_bound = [], [], []
    for drawn, run in zip(draws, runs, strict=True):
        z = jnp.asarray(run.z)
        down, up = map(np.asarray, space.room(z))
        at_bound = (down >= -1e-9) | (up <= 1e-9)
        errors.append(_wrapped(space, np.asarray(space.from_scaled(z)) - p_target))
        standard.append(_standard_errors(drawn, z, at_bound))
        on_bound.append(at_bound.any())
    none = np.zeros(len(space.names), bool)
    predicted = _standard_errors(problem, target, none)
    return Draws(
        np.array(errors),
        np.array(standard),
        predicted,
        np.array([run.converged for run in runs]),
        np.array(on_bound),
    )


def noisy(clean: Problem, std: float, n: int) -> tuple[Problem, HostArray]:
    """The calibration that knows its noise, and n draws of what is measured."""
    weight = clean.configurations.effectors.inverse_std * (STD / std)
    problem = eqx.tree_at(
        lambda p: p.configurations.effectors.inverse_std, clean, weight
    )
    exact = np.asarray(clean.configurations.effectors.measured)
    noise = np.random.default_rng(round(1e6 * std)).standard_normal((n, *exact.shape))
    return problem, exact + std * noise


def _standard_errors(problem: Problem, z, at_bound) -> HostArray:
    """As `calibrate` gives them with noise="stated", in SI units."""
    rows, space = evaluate(problem, z).rows, problem.space
    linear = independent(np.asarray(rows.W), tuple(space.names))
    linear = replace(linear, held=np.asarray(at_bound))
    slope = np.asarray(jnp.diag(jax.jacfwd(space.from_scaled)(z)))
    return np.abs(slope) * np.sqrt(np.diag(linear.covariance()))


def _wrapped(space: ParameterSpace, gap: HostArray) -> HostArray:
    """Differences of parameters, those of angles modulo 180 degrees."""
    angles = np.array([q.unit == "rad" for q in space.parameters])
    turn = np.mod(gap + 0.5 * np.pi, np.pi) - 0.5 * np.pi
    return np.where(angles, turn, gap)


def _ratios(draws: Draws) -> HostArray:
    """Root mean square error over the standard error predicted at p_target."""
    size = np.sqrt(np.mean(draws.error[draws.usable] ** 2, axis=0))
    return size / draws.predicted


def _table(levels: dict[float, Draws], names: list[str]) -> Table:
    rows = []
    for std, draws in levels.items():
        if not draws.usable.any():
            continue
        shares, ratios = draws.inside.mean(axis=0), _ratios(draws)
        for i, name in enumerate(names):
            angle = "theta" in name
            size = np.rad2deg(1.0) if angle else 1e-3
            rows.append(
                [
                    f"{1e3 * std:g} mm",
                    name,
                    f"{size * draws.predicted[i]:.3g} {'deg' if angle else 'kPa'}",
                    f"{ratios[i]:.2f}",
                    f"{100 * shares[i]:.0f} %",
                ]
            )
    columns = ["noise", "parameter", "predicted standard error"]
    columns += ["rms error over it", "95 % interval holds p_target"]
    title = f"{len(names)} parameters: errors of {DRAWS} fits against their prediction"
    return Table(title, columns, rows)


def _lost(levels: dict[float, Draws], n_parameters: int) -> Table:
    rows = [
        [
            f"{1e3 * std:g} mm",
            str(int(draws.usable.sum())),
            _listed(~draws.converged),
            _listed(draws.on_bound),
            _percent(draws.inside),
        ]
        for std, draws in levels.items()
    ]
    columns = ["noise", "fits used", "not converged (draws)", "on a bound (draws)"]
    title = f"{n_parameters} parameters: draws and coverage"
    return Table(title, [*columns, "coverage"], rows)


def _percent(inside: HostArray) -> str:
    return f"{100 * np.mean(inside):.1f} %" if inside.size else "none"


def _profile_figures(profiled: Profiles) -> dict[str, Figure]:
    return {
        "coverage_95_profile": profiled.coverage,
        "profile_intervals_found": int(profiled.both_ends.sum()),
        "profile_intervals_asked": int(profiled.both_ends.size),
        "profile_calibrated_again": profiled.again,
    }


def _profile_table(profiled: Profiles, names: list[str], std: float) -> Table:
    rows = [
        [
            name,
            str(int(profiled.both_ends[:, i].sum())),
            _percent(profiled.inside[profiled.both_ends[:, i], i]),
        ]
        for i, name in enumerate(names)
    ]
    columns = ["parameter", "intervals with both ends", "hold p_target"]
    title = f"Profile likelihood, {1e3 * std:g} mm, {len(profiled.inside)} draws"
    return Table(title, columns, rows)


def _listed(flags: HostArray) -> str:
    numbers = np.flatnonzero(flags)
    return f"{len(numbers)}: {', '.join(map(str, numbers))}" if len(numbers) else "none"


def plot(levels: dict[float, Draws], names: list[str], path: Path) -> None:
    """Errors in units of their predicted standard errors, against the normal law."""
    from matplotlib.figure import Figure as Drawing

    from softcal_jax.plotting._figure import SERIES, TEXT

    drawing = Drawing(figsize=(14.0, 5.2), dpi=100, layout="constrained")
    panels = drawing.subplots(1, len(levels), sharey=True, squeeze=False)[0]
    for axes, (std, draws) in zip(panels, levels.items(), strict=True):
        scaled = draws.error[draws.usable] / draws.standard_error[draws.usable]
        n = len(scaled)
        expected = np.sqrt(2.0) * _erfinv(2.0 * (np.arange(n) + 0.5) / n - 1.0)
        for i, (name, colour) in enumerate(zip(names, SERIES, strict=False)):
            axes.plot(
                expected, np.sort(scaled[:, i]), ".", ms=5, color=colour, label=name
            )
        axes.plot([-3, 3], [-3, 3], color=TEXT, lw=1.2, label="as predicted")
        axes.set_title(
            f"{1e3 * std:g} mm: {_percent(draws.inside)} covered", fontsize=15
        )
        axes.set_xlabel("quantile of the normal law", fontsize=13)
        axes.grid(True, color="#dddddd", lw=0.8)
        axes.set(xlim=(-3.2, 3.2), ylim=(-5, 5))
    panels[0].set_ylabel("error / its standard error", fontsize=13)
    panels[0].legend(fontsize=11, loc="upper left")
    drawing.suptitle("Errors of the parameters over repeated noise", fontsize=17)
    drawing.savefig(path, dpi=100, format="png")


def _erfinv(x: HostArray) -> HostArray:
    from scipy.special import erfinv

    return erfinv(x)
