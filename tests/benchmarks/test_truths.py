"""Benchmarks that ask whether printed intervals hold: their parts and small runs."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import _random_beams, _wrong_models, random_truths, silent_errors
from benchmarks._printed import Printed
from benchmarks._problem import Goal, Options
from benchmarks._wrong_models import DOWN, Wrong
from softcal_jax.calibration import calibrate


def interval(lower, upper, turn=0.0, kind: Any = "first-order"):
    return Printed("p", lower, upper, kind, turn)


def test_distance_from_an_interval_in_half_widths():
    assert interval(1.0, 3.0).off(2.0) == 0.0
    assert interval(1.0, 3.0).off(3.0) == 1.0
    assert interval(1.0, 3.0).off(12.0) == 10.0
    assert np.isnan(interval(np.nan, np.nan).off(1.0))


def test_an_axis_is_counted_modulo_half_a_turn():
    """An axis at 91 degrees is the one at -89."""
    axis = interval(*np.deg2rad([89.0, 93.0]), turn=np.pi)
    assert axis.off(np.deg2rad(-89.0)) == pytest.approx(0.0, abs=1e-12)
    assert axis.off(np.deg2rad(-86.0)) == pytest.approx(1.5)


def truth_trial(number, offs, identified=True, kind: Any = "first-order"):
    """Intervals of half-width one about `offs`, where the truth is zero."""
    return random_truths.Trial(
        layout="beam",
        noise=random_truths.NOISES[0].title,
        number=number,
        truth={"p": 0.0},
        intervals=tuple(interval(off - 1.0, off + 1.0, kind=kind) for off in offs),
        converged=True,
        identified=identified,
    )


def test_figures_of_random_truths():
    trials = [
        truth_trial(0, [0.1, 0.9, -0.5, 1.1]),
        truth_trial(1, [0.0, 6.0, 0.0, 0.0], identified=False),
        truth_trial(1, [0.0, -7.0], identified=True),
        truth_trial(2, [9.0, 9.0], kind="none"),
    ]
    # Truth 2 has no intervals, of truth 1 four in six hold, of truth 0 three in four.
    assert random_truths.worst(trials, 1) == [1]
    again = [truth_trial(1, [0.0] * 9 + [2.0]), truth_trial(0, [0.0])]
    figures = random_truths.outcome(trials, again).figures
    assert figures["coverage_95_printed"] == pytest.approx(70.0)
    assert figures["worst_truth_coverage"] == pytest.approx(90.0)
    assert figures["far_off"] == 2
    assert figures["far_off_unflagged"] == 1
    assert figures["intervals_printed_percent"] == pytest.approx(1000.0 / 12.0)


def test_noise_has_the_stated_sizes():
    """Jitter of each coordinate; offset and share in common for a configuration."""
    layout = _random_beams.LAYOUTS[2]
    _, _, poses = _random_beams.problem(layout)
    quiet = _random_beams.Noise("quiet", 0.0, 0.0)
    random = np.random.default_rng(0)
    for noise, expected in (
        (quiet, _random_beams.JITTER),
        (_random_beams.NOISES[1], np.hypot(5e-4, 0.02 * 0.01)),
    ):
        errors = []
        for _ in range(200):
            drawn: Any = _random_beams.noisy(_measured(poses, 0.01), noise, random)
            errors += [c.measured - c.markers.positions - 0.01 for c in drawn]
        scatter = np.array(errors) if noise is quiet else np.mean(errors, axis=1)
        # Of 800 recordings the standard deviation is known to 1 / sqrt(1600).
        assert np.std(scatter) == pytest.approx(expected, rel=0.1)


def _measured(poses, moved):
    return [replace(c, measured=c.markers.positions + moved) for c in poses]


def test_true_values_keep_bounds_and_order():
    _, space, _ = _random_beams.problem(_random_beams.LAYOUTS[0])
    for truth in _random_beams.true_values(space, 20):
        for point in ("CP 1", "CP 2"):
            assert truth[f"E_l of {point}"] <= truth[f"E_t of {point}"]
        for q in space.parameters:
            assert q.lower <= truth[q.name] <= q.upper


def silent_trial(error, half_width, off, identified=False, reasons=()):
    space = SimpleNamespace(names=("p",))
    problem: Any = SimpleNamespace(title="t", space=space, truth={"p": 0.0})
    assessment: Any = SimpleNamespace(identified=identified, reasons=reasons)
    return silent_errors.Trial(
        problem=problem,
        error=error,
        size=1.0,
        intervals=(interval(off - half_width, off + half_width),),
        assessment=assessment,
    )


def test_figures_of_silent_errors():
    wrong = [
        silent_trial("nu", 1.0, 0.6, identified=True),
        silent_trial("clamp", 1.0, -1.4, identified=True),
        silent_trial(silent_errors.LINEAR, 6.0, 3.0),
    ]
    right = [
        silent_trial("", 1.0, 0.1, reasons=("The data determine only weakly: p.",)),
        silent_trial("", 1.0, 0.1, reasons=("The model cannot match the data.",)),
    ]
    figures = silent_errors.outcome(wrong, right).figures
    assert figures["covered_percent"] == pytest.approx(200.0 / 3.0)
    assert figures["called_identified_but_wrong"] == 1
    assert figures["right_model_flagged"] == 1
    # The root mean square of 0.6 and 1.4 is 1.077; linear tets are on their own.
    needed = np.sqrt(0.5 * (0.6**2 + 1.4**2))
    expected = np.median([1.0 / needed, 1.0 / needed, 2.0])
    assert figures["median_interval_over_needed"] == pytest.approx(expected)


def test_tilted_gravity_keeps_its_size():
    tilted = _wrong_models._tilted(np.array(DOWN), np.deg2rad(2.0))
    assert np.linalg.norm(tilted) == pytest.approx(9.81)
    cosine = tilted @ np.array(DOWN) / 9.81**2
    assert cosine == pytest.approx(np.cos(np.deg2rad(2.0)))
    assert abs(tilted[0]) == pytest.approx(abs(tilted[1]))


SMALL = 0.05
"""Share of a width, whose effect is its derivative but for that share or so."""


@pytest.fixture(scope="module")
def one_modulus():
    """The first problem, and its budget from exact measurements."""
    problem, *_ = _wrong_models.problems()
    return problem, fitted(problem, Wrong())


def fitted(problem, wrong):
    return calibrate(
        problem.fitted_model(2),
        problem.space,
        problem.measured(wrong, None),
        noise="stated",
    )


@pytest.mark.slow  # compiles a calibration
@pytest.mark.parametrize(
    ("error", "cause"),
    [
        ("nu", "nu"),
        ("density", "density"),
        ("clamp", "clamp"),
        ("tilt", "gravity"),
        ("loads", "loads"),
    ],
)
def test_an_error_that_is_put_in_is_a_width_of_the_budget(one_modulus, error, cause):
    """Refitted to a robot that is really a bit wrong, E moves as the budget says."""
    problem, right = one_modulus
    wrong = fitted(problem, Wrong(**{error: SMALL}))
    moved = abs(float(wrong.z[0] - right.z[0])) / SMALL
    (dz,) = [c.deviations[0] for c in right.budget.causes if c.name == cause]
    # Gravity is tilted half about each of two axes.
    expected = abs(dz.sum()) if len(dz) == 1 else np.abs(dz[0] + dz[1]) / 2**0.5
    other = expected if len(dz) == 1 else np.abs(dz[0] - dz[1]) / 2**0.5
    nearest = min(expected, other, key=lambda size: abs(size - moved))
    assert moved == pytest.approx(nearest, rel=0.1)


@pytest.mark.slow  # compiles a calibration
def test_a_small_run_of_random_truths(tmp_path):
    trials = random_truths.study(range(2), draws=[0], options=Options(tmp_path))
    assert len(trials) == 2 * len(random_truths.NOISES)
    outcome = random_truths.outcome(trials, trials[:2])
    assert outcome.figures["fits"] == len(trials) + 2
    assert set(outcome.goals) <= set(outcome.figures)


@pytest.mark.slow  # compiles two calibrations
def test_a_small_run_of_silent_errors():
    problem, *_ = _wrong_models.problems()
    wrong = silent_errors.with_errors(problem, (1.0,))
    assert len(wrong) == 6
    outcome = silent_errors.outcome(wrong, [silent_errors.fit(problem, "", 0.0, 0)])
    assert Goal("at least", 80.0).met(outcome.figures["covered_percent"])
    assert outcome.figures["right_models"] == 1
