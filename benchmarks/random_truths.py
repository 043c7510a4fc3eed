"""Do printed intervals hold? 40 random truths, three layouts, two kinds of noise.

Three beams with {E_t, E_l, theta} at two control points, posed by gravity and weights,
with five markers. True values are uniform between the bounds, and both control points
have their own. Each truth is measured on every beam

- with jitter of 0.1 mm on each coordinate;
- with jitter, an offset of 0.5 mm of each recording, which is a pose here, along each
  axis, and 2 % of the motion of its markers more or less,

and calibrated from the same start as a user would: `calibrate` with its defaults, told
how large the offsets are, and told that nothing else is uncertain, which is so: the
model is right. What is asked is the 95 % interval that is printed.

`coverage_95_printed` is the share of the intervals that hold the truth, one-sided ones
up to the bound. `worst_truth_coverage` is that of the truth for which it is smallest,
over all beams, kinds of noise and parameters. `far_off_unflagged` counts the intervals
whose middle is more than five half-widths off in a fit that `assess` calls identified;
`far_off` counts all of them. `intervals_printed_percent` is the share of parameters
that have an interval.

The mesh is coarse, since hundreds of fits share it with their data; all of them share
their programs.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks._printed import Printed, printed, share_percent
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax._typing import HostArray
from softcal_jax.calibration import (
    CalibrationResult,
    calibrate,
    random_starts,
    synthetic_measurements,
)
from softcal_jax.configurations import Configuration, Markers, SurfaceForce
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    Uncertain,
    exactly_known,
)
from softcal_jax.identifiability import assess
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

TRUTHS = 40

CELLS = (4, 1, 1)
"""Cells along, up and across, of quadratic tets."""

BOUNDS = {"E_t": (100e3, 1e6), "E_l": (100e3, 1e6), "theta": (-np.pi / 2, np.pi / 2)}
"""Bounds of the fits and of the true values [Pa, rad]."""

START = {"E_t": 500e3, "E_l": 300e3, "theta": 0.0}
"""Start of all fits [Pa, rad]."""

DENSITY = 1000.0
"""Density of the beams [kg/m3]."""

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""

JITTER = 1e-4
"""Standard deviation of each coordinate [m]."""

FAR_OFF = 5.0
"""Half-widths from which an interval is far off [-]."""


class Pose(NamedTuple):
    """How a beam is posed: the held end, its turn [deg], a weight on its end [N]."""

    held: str
    turn: float
    weight: float = 0.0

    def down(self) -> HostArray:
        """Where down is: the beam turns about its axis, seen from it gravity turns."""
        angle = np.deg2rad(self.turn)
        return np.array([0.0, -np.cos(angle), np.sin(angle)])


class Layout(NamedTuple):
    """A beam and its poses: length, height and width [m], the markers along it [-]."""

    title: str
    size: tuple[float, float, float]
    poses: tuple[Pose, ...]
    markers: tuple[float, ...]


LAYOUTS = (
    Layout(
        "two ends",
        (0.12, 0.015, 0.015),
        tuple(Pose(h, t) for h in ("x_min", "x_max") for t in (0.0, 90.0)),
        (0.0, 0.35, 0.5, 0.65, 1.0),
    ),
    Layout(
        "weights",
        (0.10, 0.012, 0.012),
        tuple(Pose("x_min", t, w) for t in (0.0, 90.0) for w in (0.0, 0.03)),
        (0.2, 0.4, 0.6, 0.8, 1.0),
    ),
    Layout(
        "flat section",
        (0.12, 0.012, 0.020),
        (*(Pose("x_min", t) for t in (0.0, 45.0, 90.0)), Pose("x_max", 45.0)),
        (0.0, 0.25, 0.5, 0.75, 1.0),
    ),
)
"""Each with four poses and five markers, so that they share their programs."""


class Noise(NamedTuple):
    """A kind of noise: offset of a recording [m], share of the motion [-]."""

    title: str
    offset: float = 0.0
    share: float = 0.0

    @property
    def uncertain(self) -> Uncertain:
        """What a fit is told about it."""
        return replace(exactly_known(), recordings=self.offset)


NOISES = (Noise("jitter"), Noise("offsets", 5e-4, 0.02))

GOALS = {
    "coverage_95_printed": Goal("between", 92.0, 98.0),
    "worst_truth_coverage": Goal("at least", 85.0),
    "far_off_unflagged": Goal("at most", 0),
    "intervals_printed_percent": Goal("at least", 80.0),
}


class Trial(NamedTuple):
    """A fit to one truth, and what it printed.

    Attributes:
        layout: Title of the beam.
        noise: Title of the noise.
        number: Index of the truth.
        truth: True values by parameter [Pa, rad].
        intervals: What is printed.
        converged: Whether the fit converged.
        identified: Whether `assess` calls it identified.
    """

    layout: str
    noise: str
    number: int
    truth: Mapping[str, float]
    intervals: tuple[Printed, ...]
    converged: bool
    identified: bool

    @property
    def offs(self) -> list[float]:
        """Distances of the truth from the middles of its intervals, in half-widths."""
        return [i.off(self.truth[i.name]) for i in self.intervals if i.kind != "none"]

    @property
    def far_off(self) -> int:
        """How many of them are far off."""
        return sum(off > FAR_OFF for off in self.offs)


def run(options: Options) -> Outcome:
    """All truths on all beams, with both kinds of noise."""
    trials = []
    for layout in LAYOUTS:
        options.say(f"{layout.title}: {TRUTHS} truths with {len(NOISES)} noises")
        begin = time.perf_counter()
        trials += study(layout, TRUTHS)
        options.say(f"  {time.perf_counter() - begin:.0f} s")
    return outcome(trials)


def study(layout: Layout, n_truths: int) -> list[Trial]:
    """Measure and calibrate a number of truths on one beam, with both noises."""
    model, space, poses = problem(layout)
    trials = []
    for number, truth in enumerate(true_values(space, n_truths)):
        exact = synthetic_measurements(model, space, poses, truth)
        for noise in NOISES:
            seed = (number, NOISES.index(noise), LAYOUTS.index(layout))
            measured = noisy(exact, noise, np.random.default_rng(seed))
            fit = calibrate(model, space, measured, uncertain=noise.uncertain)
            trials.append(_trial(layout, noise, number, truth, fit))
    return trials


def problem(
    layout: Layout,
) -> tuple[Model, ParameterSpace, tuple[Configuration, ...]]:
    """A beam, its parameters and its poses, without measurements."""
    length, height, width = layout.size
    law = ReducedTransverseIsotropic(
        START["E_t"], START["E_l"], 0.3, Fibre(0.0, plane="xy")
    )
    mesh = beam(length, height, width, CELLS, order=2)
    model = build_model(mesh, Corotational(law), density=DENSITY)
    centre = (0.5 * height, 0.5 * width)
    points = ControlPoints([(0.0, *centre), (length, *centre)])
    entries = [
        ControlPointParameters(
            field,
            points,
            start=START[field],
            lower=low,
            upper=high,
            unit="rad" if field == "theta" else "Pa",
            scale="linear" if field == "theta" else "log",
            S=1.0 if field == "theta" else None,
            interpolation="director" if field == "theta" else "linear",
        )
        for field, (low, high) in BOUNDS.items()
    ]
    space = ParameterSpace(entries, axes=[("E_l", "E_t", "theta")])
    names = tuple(f"at {100 * s:g} %" for s in layout.markers)
    # On the bottom midline, so that turns about the axis of the beam show.
    places = [(s * length, 0.0, 0.5 * width) for s in layout.markers]
    markers = Markers(names, places, JITTER)
    return model, space, tuple(_configuration(p, markers) for p in layout.poses)


def _configuration(pose: Pose, markers: Markers) -> Configuration:
    free = "x_max" if pose.held == "x_min" else "x_min"
    down = pose.down()
    weight = f" with {pose.weight:g} N" if pose.weight else ""
    return Configuration(
        f"{pose.held} turned {pose.turn:g}{weight}",
        pose.held,
        gravity=tuple(map(float, GRAVITY * down)),
        loads=[SurfaceForce(free, tuple(map(float, pose.weight * down)))],
        markers=markers,
    )


def true_values(space: ParameterSpace, n: int) -> list[dict[str, float]]:
    """Random values of all parameters, uniform between the bounds, E_l below E_t."""
    drawn = random_starts(space, n, seed=2)
    values = [np.asarray(space.from_scaled(row)) for row in drawn]
    return [dict(zip(space.names, map(float, v), strict=True)) for v in values]


def noisy(
    exact: Sequence[Configuration], noise: Noise, random: np.random.Generator
) -> list[Configuration]:
    """Exact measurements with one draw of noise."""
    drawn = []
    for c in exact:
        assert c.markers is not None
        assert c.measured is not None
        motion = c.measured - c.markers.positions
        jitter = JITTER * random.standard_normal(motion.shape)
        offset = noise.offset * random.standard_normal(3)
        share = noise.share * random.standard_normal() * motion
        measured = c.measured + jitter + offset + share
        drawn.append(replace(c, measured=measured, relative_std=noise.share))
    return drawn


def _trial(
    layout: Layout,
    noise: Noise,
    number: int,
    truth: Mapping[str, float],
    fit: CalibrationResult,
) -> Trial:
    return Trial(
        layout=layout.title,
        noise=noise.title,
        number=number,
        truth=truth,
        intervals=printed(fit),
        converged=fit.converged,
        identified=assess(fit).identified,
    )


def outcome(trials: Sequence[Trial]) -> Outcome:
    """The figures of all fits."""
    far = [t for t in trials if t.far_off]
    by_truth = [
        share_percent(_held([t for t in trials if t.number == number]))
        for number in sorted({t.number for t in trials})
    ]
    shares = [share for share in by_truth if not isinstance(share, str)]
    asked = sum(len(t.intervals) for t in trials)
    figures: dict[str, Figure] = {
        "coverage_95_printed": share_percent(_held(trials)),
        "worst_truth_coverage": min(shares) if shares else "no intervals",
        "far_off_unflagged": sum(t.far_off for t in far if t.identified),
        "far_off": sum(t.far_off for t in far),
        "intervals_printed_percent": 100.0 * len(_held(trials)) / asked,
        "fits": len(trials),
        "not_converged": sum(not t.converged for t in trials),
        "identified_percent": share_percent([t.identified for t in trials]),
    }
    samples = {
        f"off_{noise.title}": [
            off for t in trials if t.noise == noise.title for off in t.offs
        ]
        for noise in NOISES
    }
    return Outcome(figures, samples, GOALS, [_shares(trials), _listed(far)])


def _held(trials: Sequence[Trial]) -> list[bool]:
    """Whether each interval holds the truth."""
    return [off <= 1.0 for t in trials for off in t.offs]


def _shares(trials: Sequence[Trial]) -> Table:
    rows = []
    for layout in dict.fromkeys(t.layout for t in trials):
        for noise in dict.fromkeys(t.noise for t in trials):
            own = [t for t in trials if (t.layout, t.noise) == (layout, noise)]
            asked = sum(len(t.intervals) for t in own)
            rows.append(
                [
                    layout,
                    noise,
                    f"{len(_held(own))} of {asked}",
                    _percent(_held(own)),
                    _percent([t.identified for t in own]),
                    str(sum(not t.converged for t in own)),
                ]
            )
    columns = ["beam", "noise", "intervals", "hold the truth"]
    columns += ["called identified", "not converged"]
    return Table("95 % intervals of random truths", columns, rows)


def _percent(flags: Sequence[bool]) -> str:
    share = share_percent(flags)
    return share if isinstance(share, str) else f"{share:.1f} %"


def _listed(far: Sequence[Trial]) -> Table:
    rows = [
        [
            t.layout,
            t.noise,
            str(t.number),
            f"{max(t.offs):.1f}",
            "yes" if t.identified else "no",
        ]
        for t in far
    ]
    columns = ["beam", "noise", "truth", "half-widths off", "called identified"]
    return Table(f"Fits more than {FAR_OFF:g} half-widths off", columns, rows)
