"""The trade-off of Sec. V-C: too few points misfit, too many have blind directions.

The bar is made of two zones, 200 and 80 kPa, and measured with noise. One point cannot
represent it, two can, six (one per slice of the mesh) can as well, but three poses with
two markers hardly see all of them.
"""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import numpy as np
import pytest
from bars import MID, ROOT, STD, TIP, bar, moduli, on_axis, pose
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.calibration import build_problem, calibrate as calibrate_with
from softcal_jax.export import headline
from softcal_jax.fields import Parameter, ParameterSpace, as_space, exactly_known
from softcal_jax.identifiability import identify
from softcal_jax.layouts import (
    FoldScore,
    ModelComparison,
    ModelScore,
    _compare,
    compare_layouts as compare_layouts_with,
)
from softcal_jax.robots import synthetic_measurements

calibrate = partial(calibrate_with, starts=1, intervals=None)
compare_layouts = partial(compare_layouts_with, starts=1)

CELLS = (6, 1, 1)
HANG = pose("hang", (MID, TIP))
PULL = pose("pull", (MID, TIP), force=(0.0, 0.05, 0.0))
SWAP = pose("swap", (MID, ROOT), clamp="x_max")
ZONES = ParameterSpace(
    (
        Parameter("root", "E", 1e5, 3e4, 1e6, region="root"),
        Parameter("tip", "E", 1e5, 3e4, 1e6, region="tip"),
    )
)
ONE = on_axis(0.05)
SLICES = (np.arange(6) + 0.5) / 60.0
LAYOUTS = {
    "one": ONE,
    "two": on_axis(0.025, 0.075, nearest=1),
    "six": on_axis(*SLICES, nearest=1),
}


def measured(*poses, root=2e5, tip=8e4, noise=True):
    values = {"root": root, "tip": tip}
    return synthetic_measurements(bar(CELLS), ZONES, poses, values, noise=noise, seed=1)


@pytest.fixture(scope="module")
def data():
    return measured(HANG, PULL, SWAP)


COMPARED = pytest.mark.slow
"""Three layouts are three programs, which compile for minutes."""


@pytest.fixture(scope="module")
def comparison(data):
    return compare_layouts(bar(CELLS), LAYOUTS, data, make_parameters=moduli)


@COMPARED
def test_two_points_predict_best(comparison):
    one, two, six = (
        next(s for s in comparison.models if s.name == name) for name in LAYOUTS
    )
    assert comparison.best is two
    assert [s.n_parameters for s in (one, two, six)] == [1, 2, 6]
    # Noise of size one, or nearly so with as few data.
    assert two.held_out_noise_rms < 2.0
    assert two.identifiability.blind == ()
    # Too few misfit what they are fitted to.
    assert one.fit_noise_rms > 5.0
    assert one.held_out_noise_rms > 5.0
    # Too many fit closer still, but predict worse, along directions nobody sees.
    assert six.fit_noise_rms < two.fit_noise_rms
    assert six.held_out_noise_rms > 1.5 * two.held_out_noise_rms
    assert six.identifiability.blind
    assert six.verdict == "not identifiable"
    assert not any(s.failed for s in comparison.models)


@COMPARED
def test_layouts_with_as_many_points_share_a_program(comparison, data):
    names = ["near", "far"]
    moved = on_axis(0.03, 0.08, nearest=1, names=names)
    with Compilations() as seen:
        compared = compare_layouts(
            bar(CELLS), {"moved": moved}, data, make_parameters=moduli
        )
    assert seen.programs == []
    assert compared.best.name == "moved"


@COMPARED
def test_words_and_table(comparison):
    text = str(comparison)
    assert says(text, "'two' ... best")
    assert says(text, "parameters", "held-out error ... mm")


def refit(points, data, k):
    """`calibrate` with one held out, from the start: it shares no loop with the folds.

    Returns squared errors of its prediction in units of the noise, and both rms [m].
    """
    alone = calibrate(
        bar(CELLS),
        as_space(moduli(points)),
        [c for i, c in enumerate(data) if i != k],
        validation=data[k],
        uncertain=exactly_known(),
        noise="stated",
    )
    *fitted, held_out = alone.configurations
    errors = np.concatenate([c.error_after for c in fitted])
    rms = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    return (held_out.error_after / STD) ** 2, held_out.rms_after, rms


def test_the_first_order_leave_one_out_is_that_of_refits():
    """One modulus for two zones: what is left out moves it by a tenth or more.

    Of pure linear estimates the largest error would be of second order in these moves.
    """
    data, told = measured(HANG, PULL, SWAP), []
    options = {"make_parameters": moduli, "progress": told.append}
    compared = compare_layouts(bar(CELLS), {"one": ONE}, data, **options)
    for k, fold in enumerate(compared.models[0].folds):
        squares, held_out, fitted = refit(ONE, data, k)
        assert fold.held_out == data[k].name
        np.testing.assert_allclose(fold.noise_rms, squares.mean() ** 0.5, rtol=CLOSE)
        np.testing.assert_allclose(fold.rms, held_out, rtol=CLOSE)
        np.testing.assert_allclose(fold.fit_rms, fitted, rtol=CLOSE)
        steps = [
            text for text in told if text.startswith(f"one: without {data[k].name}")
        ]
        assert len(steps) <= 1
    assert told[0] == "one: all configurations, start 1 of 1, step 0"


CLOSE = 0.1 * _compare.SHARE
"""What steps left out may change of an error: a tenth of the last, as they shrink."""


def test_models_as_good_as_each_other_are_refitted():
    data, told = measured(HANG, PULL), []
    options = {"make_parameters": moduli, "progress": told.append}
    same = {"a": ONE, "b": ONE}
    compared = compare_layouts(bar(CELLS), same, data, **options)
    first, second = (m.score for m in compared.models)
    assert first == second
    whole = compare_layouts(bar(CELLS), {"a": ONE}, data, make_parameters=moduli)
    refits = [text for text in told if text.startswith("a: without hang")]
    assert len(refits) >= 2  # to the end, and not by one step
    np.testing.assert_allclose(first, whole.models[0].score, rtol=2 * CLOSE)


@COMPARED
def test_the_verdict_is_that_of_refits(comparison, data):
    scores = []
    for name, points in LAYOUTS.items():
        folds = []
        for k, c in enumerate(data):
            squares, held_out, fitted = refit(points, data, k)
            fold = FoldScore(c.name, held_out, squares.mean() ** 0.5, fitted)
            folds.append(fold)
        n = len(points.positions)
        scores.append(ModelScore(name, n, tuple(folds), 1e-3, 1.0, "", None))
    refits = ModelComparison.ranked(scores)
    assert [m.name for m in comparison.models] == [m.name for m in refits.models]
    assert comparison.undecided == refits.undecided
    for ours, theirs in zip(comparison.models, refits.models, strict=True):
        np.testing.assert_allclose(ours.score, theirs.score, rtol=2 * _compare.SHARE)


@COMPARED
def test_fit_of_everything_and_its_identifiability(comparison, data):
    points = LAYOUTS["two"]
    whole = calibrate(
        bar(CELLS), as_space(moduli(points)), data, uncertain=exactly_known()
    )
    errors = np.concatenate([c.error_after for c in whole.configurations])
    two = comparison.models[0]
    np.testing.assert_allclose(
        two.fit_rms, np.sqrt(np.mean(np.sum(errors**2, axis=1))), rtol=1e-3
    )
    outlook = identify(
        bar(CELLS), moduli(points), data, at=whole.z, uncertain=exactly_known()
    )
    np.testing.assert_allclose(
        two.identifiability.covariance, outlook.covariance, rtol=1e-2
    )


def test_what_is_held_out_cannot_touch_the_fit(data):
    """Its measurement may be anything, though the fit begins at the optimum of all."""
    k, rms = 1, []
    for shift in (0.0, 0.01):
        wild = [replace(c, measured=c.measured + shift * (c is data[k])) for c in data]
        compared = compare_layouts(
            bar(CELLS), {"one": ONE}, wild, make_parameters=moduli
        )
        rms.append([fold.fit_rms for fold in compared.models[0].folds])
    np.testing.assert_allclose(rms[1][k], rms[0][k], rtol=CLOSE)
    assert np.abs(rms[1][0] / rms[0][0] - 1.0) > 0.1


def test_a_fold_repeats_another_pose_without_weight(data):
    """The middle one held out: its lane is the last one again, weighing nothing."""
    problem = build_problem(bar(CELLS), as_space(moduli(ONE)), data)
    folds = [*~np.eye(3, dtype=bool), np.ones(3, bool)]
    whole = problem.configurations
    fold = _compare._fold_problem(problem, folds[1])
    fitted = fold.configurations
    repeated = whole.loads.force[np.array([0, 2, 2])]
    np.testing.assert_array_equal(fitted.loads.force, repeated)
    weight = fitted.effectors.inverse_std
    np.testing.assert_array_equal(weight[1], 0.0)
    np.testing.assert_allclose(weight[[0, 2]], 1.0 / STD)
    fold = _compare._fold_problem(problem, folds[3])
    for ours, theirs in zip(
        jax.tree.leaves(fold.configurations), jax.tree.leaves(whole), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def soft_and_stiff(start=1e5):
    """A soft bar (40 kPa), whose third pose bears its load only if it is stiff."""
    push = pose("push", (MID, TIP), force=(-4.0, 0.0, 0.0), g=0.0, guided=True)
    (push,) = measured(push, root=2e5, tip=2e5)
    # So precise that it decides every fit it takes part in.
    push = eqx.tree_at(lambda c: c.markers.std, push, 1e-7)
    data = (*measured(HANG, PULL, root=4e4, tip=4e4), push)
    return compare_layouts(
        bar(CELLS),
        {"one": ONE},
        data,
        make_parameters=lambda points: moduli(points, start),
    )


@COMPARED
def test_a_pose_that_the_fit_cannot_carry_is_named():
    compared = soft_and_stiff()
    (score,) = compared.models
    (failed,) = score.failed
    assert failed.held_out == "push"
    assert says(failed.failure, "no equilibrium")
    # It counts in no average.
    good = [f.rms for f in score.folds[:2]]
    np.testing.assert_allclose(score.held_out_rms, np.sqrt(np.mean(np.square(good))))
    assert compared.best is None
    text = str(compared)
    assert says(text, "none ... preferred")
    assert "1 of 3" in text
    assert says(text, "push ... no equilibrium")


@COMPARED
def test_a_start_without_equilibrium_is_named():
    (score,) = soft_and_stiff(start=3.1e4).models
    for failure in (*(fold.failure for fold in score.folds[:2]), score.fit_failure):
        assert says(failure, "no equilibrium ... start")
    assert score.verdict == "not known"
    assert np.isnan(score.held_out_rms)
    compared = ModelComparison.ranked([score])
    assert says(compared, f"'one', all configurations ... {score.fit_failure}")


@COMPARED
def test_a_fold_that_did_not_converge_is_named(comparison, data, monkeypatch):
    """The best layout, with one fold that did not end, ranks last."""
    real = _compare._Fits.of_folds

    def unfinished(self, *rest):
        fits = real(self, *rest)
        if len(self.problem.space.names) == 2:
            lost = replace(fits[0].run, converged=False)
            fits[0] = fits[0]._replace(run=lost)
        return fits

    monkeypatch.setattr(_compare._Fits, "of_folds", unfinished)
    compared = compare_layouts(bar(CELLS), LAYOUTS, data, make_parameters=moduli)
    two = compared.models[-1]
    assert two.name == "two"
    first, *others = [fold.failure for fold in two.folds]
    assert says(first, "not converge")
    assert others == ["", ""]
    rms = [f.rms for f in comparison.models[0].folds[1:]]
    np.testing.assert_allclose(two.held_out_rms, np.sqrt(np.mean(np.square(rms))))
    assert compared.best.name == "six"
    assert says(compared, "hang ... not converge")


def score(name, n_parameters, squares):
    folds = [
        FoldScore(f"{i}", 1e-3, float(s**0.5), 1e-3) for i, s in enumerate(squares)
    ]
    return ModelScore(name, n_parameters, tuple(folds), 1e-3, 1.0, "", None)


def test_the_smallest_of_those_that_are_not_told_apart():
    """By hand: scores 1, 2 and 3."""
    best = score("best", 6, [0.0, 0.0, 3.0])
    assert best.score == pytest.approx(1.0)
    near = score("near", 4, [2.0, 2.0, 1.9])
    small = score("small", 2, [3.0, 3.0, 3.0])
    compared = ModelComparison.ranked([small, near, best])
    assert [s.name for s in compared.models] == ["best", "near", "small"]
    assert compared.best.name == "best"
    assert compared.undecided == ("near", "small")
    assert says(headline(compared), "Of these, 'small'")


@pytest.mark.parametrize(
    ("layouts", "n", "options", "text"),
    [
        ({}, 3, {}, "at least one model"),
        ({"one": ONE}, 1, {}, r"at least 2 .* 1\."),
        ({"one": ONE}, 3, {"starts": 0}, "starts .* 1, got 0"),
        ({"far": on_axis(9.0)}, 3, {}, r"'far': .*'CP 1' of E .* 8\.9 m "),
    ],
)
def test_bad_input(layouts, n, options, text):
    poses = (HANG, PULL, SWAP)[:n]
    data = [replace(c, measured=c.markers.positions) for c in poses]
    with pytest.raises(ValueError, match=text):
        compare_layouts(bar(CELLS), layouts, data, make_parameters=moduli, **options)


def test_an_unmeasured_pose_is_named():
    with pytest.raises(ValueError, match=r"'hang' .*give `markers`"):
        compare_layouts(bar(CELLS), {"one": ONE}, (HANG, PULL), make_parameters=moduli)
