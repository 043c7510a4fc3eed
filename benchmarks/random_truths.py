"""Do printed intervals hold? 40 random truths, three beams, two kinds of noise.

Three beams with {E_t, E_l, theta} at two control points, posed by gravity and weights,
with five markers. True values are uniform between the bounds, and both control points
have their own; the truths are dealt to the beams in turn. Each is measured

- with jitter of 0.1 mm on each coordinate;
- with jitter, an offset of 0.5 mm of each recording, which is a pose here, along each
  axis, and 2 % of the motion of its markers more or less,

and calibrated from the same start as a user would: `calibrate` with its defaults, told
how large offsets and shares are, and told that nothing else is uncertain, which is so:
the model is right. What is asked is the 95 % interval that is printed.

`coverage_95_printed` is the share of the intervals that hold the truth, one-sided ones
up to the bound. A truth has twelve intervals, too few to judge it by; the three that
come out worst are measured again four times, and `worst_truth_coverage` is the smallest
share of theirs. `far_off_unflagged` counts the intervals whose middle is more than five
half-widths off in a fit that `assess` calls identified; `far_off` counts all of them.
`intervals_printed_percent` is the share of parameters that have an interval.

The mesh is coarse, since all fits share it with their data, and their programs.

Intervals are far off where a body is nearly isotropic at a control point: noise then
makes an axis there, and the angle has no regular likelihood.
"""

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple, get_args

import numpy as np

from benchmarks._paper import readable
from benchmarks._printed import Printed, printed, share_percent
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._random_beams import (
    LAYOUTS,
    NOISES,
    Layout,
    Noise,
    noisy,
    problem,
    true_values,
)
from softcal_jax.calibration import CalibrationResult, calibrate
from softcal_jax.calibration._result import IntervalKind
from softcal_jax.identifiability import assess
from softcal_jax.robots import synthetic_measurements

TRUTHS = 40

WORST = 3
"""Truths that are measured again."""

AGAIN = 4
"""How often they are."""

FAR_OFF = 5.0
"""Half-widths from which an interval is far off [-]."""


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
    """All truths with both kinds of noise, then the worst ones again."""
    options.say(f"{TRUTHS} truths with {len(NOISES)} kinds of noise")
    first = study(range(TRUTHS), draws=[0], options=options)
    numbers = worst(first, WORST)
    options.say(f"truths {', '.join(map(str, numbers))} again, {AGAIN} times")
    again = study(numbers, draws=range(1, AGAIN + 1), options=options)
    return outcome(first, again)


def study(
    numbers: Sequence[int], *, draws: Sequence[int], options: Options
) -> list[Trial]:
    """Measure and calibrate some of the truths, with both kinds of noise.

    Args:
        numbers: Indices of the truths, which say on which beam they are.
        draws: Seeds of the noise.
        options: Who is told how far it is.
    """
    begin, trials = time.perf_counter(), []
    for done, number in enumerate(numbers, start=1):
        layout = LAYOUTS[number % len(LAYOUTS)]
        model, space, poses = problem(layout)
        truth = true_values(space, number + 1)[number]
        exact = synthetic_measurements(model, space, poses, truth)
        for draw in draws:
            for k, noise in enumerate(NOISES):
                random = np.random.default_rng((number, k, draw))
                measured = noisy(exact, noise, random)
                fit = calibrate(model, space, measured, uncertain=noise.uncertain)
                trials.append(_trial(layout, noise, number, truth, fit))
        seconds = time.perf_counter() - begin
        options.say(f"  {done} of {len(numbers)} truths, {seconds:.0f} s")
    return trials


def worst(trials: Sequence[Trial], n: int) -> list[int]:
    """The truths of which the smallest shares of intervals hold, the worst first."""
    shares = {}
    for number in sorted({t.number for t in trials}):
        held = _held([t for t in trials if t.number == number])
        if held:
            shares[number] = float(np.mean(held))
    return sorted(shares, key=lambda number: shares[number])[:n]


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


def outcome(trials: Sequence[Trial], again: Sequence[Trial]) -> Outcome:
    """The figures of all fits.

    Args:
        trials: Fits to all truths.
        again: Further fits to the worst ones.
    """
    far = [t for t in (*trials, *again) if t.far_off]
    of_worst = [
        share_percent(_held([t for t in again if t.number == number]))
        for number in sorted({t.number for t in again})
    ]
    shares = [share for share in of_worst if not isinstance(share, str)]
    asked = sum(len(t.intervals) for t in trials)
    figures: dict[str, Figure] = {
        "coverage_95_printed": share_percent(_held(trials)),
        "worst_truth_coverage": min(shares) if shares else "no intervals",
        "far_off_unflagged": sum(t.far_off for t in far if t.identified),
        "far_off": sum(t.far_off for t in far),
        "intervals_printed_percent": 100.0 * len(_held(trials)) / asked,
        "fits": len(trials) + len(again),
        "not_converged": sum(not t.converged for t in trials),
        "identified_percent": share_percent([t.identified for t in trials]),
    }
    samples = {
        f"off_{noise.title}": [
            off for t in trials if t.noise == noise.title for off in t.offs
        ]
        for noise in NOISES
    }
    tables = [_shares(trials), _kinds(trials), _again(again), _listed(far)]
    return Outcome(figures, samples, GOALS, tables)


def _held(trials: Sequence[Trial]) -> list[bool]:
    """Whether each interval holds the truth."""
    return [off <= 1.0 for t in trials for off in t.offs]


def _shares(trials: Sequence[Trial]) -> Table:
    rows = []
    for layout in dict.fromkeys(t.layout for t in trials):
        for noise in dict.fromkeys(t.noise for t in trials):
            group = [t for t in trials if (t.layout, t.noise) == (layout, noise)]
            asked = sum(len(t.intervals) for t in group)
            rows.append(
                [
                    layout,
                    noise,
                    f"{len(_held(group))} of {asked}",
                    _percent(_held(group)),
                    _percent([t.identified for t in group]),
                    str(sum(not t.converged for t in group)),
                ]
            )
    columns = ["beam", "noise", "intervals", "hold the truth"]
    columns += ["called identified", "not converged"]
    return Table("95 % intervals of random truths", columns, rows)


def _kinds(trials: Sequence[Trial]) -> Table:
    """How the kinds of intervals do."""
    rows = []
    for kind in get_args(IntervalKind):
        pairs = [(t, i) for t in trials for i in t.intervals if i.kind == kind]
        held = [i.off(t.truth[i.name]) <= 1.0 for t, i in pairs if kind != "none"]
        rows.append([kind, str(len(pairs)), _percent(held)])
    columns = ["kind", "intervals", "hold the truth"]
    return Table("Kinds of intervals", columns, rows)


def _again(again: Sequence[Trial]) -> Table:
    rows = []
    for number in dict.fromkeys(t.number for t in again):
        group = [t for t in again if t.number == number]
        values = readable(list(group[0].truth), np.array([*group[0].truth.values()]))
        rows.append([str(number), group[0].layout, values, _percent(_held(group))])
    columns = ["truth", "beam", "values", "hold the truth"]
    return Table("The worst truths, measured again", columns, rows)


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
