"""Many held-out configurations: few are listed, the others are summed up."""

import dataclasses

import numpy as np
import pytest
from export.handmade import make_fit, make_result, small_model
from matplotlib.figure import Figure
from wording import says

from softcal_jax.plotting import draw_workspace
from softcal_jax.results import held_out_sentences
from softcal_jax.results._poses import MOST_LISTED, error_tables, listed_fits

ERRORS = np.arange(1, 21) * 1e-4  # of 20 poses, mixed [m]


@pytest.fixture(scope="module")
def fits():
    """One that was fitted, and twenty that were held out, in no order."""
    mesh = small_model().mesh
    order = np.random.default_rng(0).permutation(len(ERRORS))
    held_out = [
        make_fit(mesh, f"pose {k}", "validation", (0.01 * k, ERRORS[k], 0.0))
        for k in order
    ]
    return make_result(fits=[make_fit(mesh), *held_out]).configurations


def test_many_are_summed_up_in_a_sentence(fits):
    (sentence,) = held_out_sentences(fits)
    rms = [fit.rms_after for fit in fits[1:]]
    overall = 1e3 * np.sqrt(np.mean(np.square(rms)))
    half, most = 1e3 * np.quantile(rms, [0.5, 0.95])
    assert says(
        sentence, f"20 ... {overall:.2f} mm", f"{half:.2f} mm", f"{most:.2f} mm"
    )
    assert says(sentence, "mm (pose 0) to ... mm (pose 19)")
    assert "deg" not in sentence  # no orientation was measured


def test_orientations_are_summed_up_too(fits):
    angles = np.arange(1, 21) * 0.01  # [rad]
    turned = [_turned(fit, a) for fit, a in zip(fits[1:], angles, strict=True)]
    (sentence,) = held_out_sentences(turned)
    degrees = np.degrees(np.sqrt(np.mean(angles**2)))
    assert says(sentence, f"{degrees:.2f} deg rms in orientation")


def _turned(fit, angle):
    """Add an orientation to a fit, off by an angle [rad] about one axis."""
    simulated = np.array([0.0, 0.0, angle])
    turn = dataclasses.replace(
        fit.effectors[0],
        name="plate",
        quantity="turn",
        unit="rad",
        measured=np.zeros(3),
        simulated=simulated,
    )
    return dataclasses.replace(fit, effectors=(*fit.effectors, turn))


def test_the_worst_and_the_best_are_listed(fits):
    names = [fit.name for fit in listed_fits(fits)]
    assert names == [fits[0].name, "pose 19", "pose 18", "pose 17", "pose 0"]
    (table,) = error_tables(fits, None)
    assert [row[0] for row in table.rows()] == names


def test_a_few_are_listed_one_by_one(fits):
    few = fits[: 1 + MOST_LISTED]
    assert listed_fits(few) == list(few)
    (sentence,) = held_out_sentences(few)
    assert "median" not in sentence


def test_errors_are_drawn_over_the_workspace(fits):
    axes = draw_workspace(Figure().subplots(), fits)
    (circles,) = axes.collections
    ranked = np.argsort([fit.rms_after for fit in fits])
    area = circles.get_sizes()[ranked]
    assert len(area) == len(fits)
    assert np.all(np.diff(area) >= 0.0)
    assert area.max() > 2.0 * area.min()
    shown = np.argsort([int(fit.name.split()[-1]) for fit in fits[1:]])
    assert np.all(np.diff(circles.get_offsets()[1:, 0][shown]) > 0.0)
    filled = np.any(circles.get_facecolors()[:, :3] < 1.0, axis=1)
    assert filled.tolist() == [fit.role == "validation" for fit in fits]
