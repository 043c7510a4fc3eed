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
from softcal_jax.fields import Parameter, ParameterSpace, as_space, exactly_known
from softcal_jax.identifiability import identify
from softcal_jax.layouts import (
    FoldScore,
    ModelComparison,
    ModelScore,
    _compare,
    compare_layouts as compare_layouts_with,
)
from softcal_jax.results import headline
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


@COMPARED
def test_a_fold_is_a_calibration_without_that_configuration(comparison, data):
    """`calibrate` with the last one held out, which shares no loop with the folds."""
    points = LAYOUTS["two"]
    alone = calibrate(
        bar(CELLS),
        as_space(moduli(points)),
        data[:2],
        validation=data[2],
        uncertain=exactly_known(),
    )
    fold = comparison.models[0].folds[2]
    held_out = alone.configurations[2]
    assert fold.held_out == held_out.name == "swap"
    np.testing.assert_allclose(fold.rms, held_out.rms_after, rtol=1e-3)
    squares = (held_out.error_after / STD) ** 2
    np.testing.assert_allclose(fold.noise_rms, np.sqrt(squares.mean()), rtol=1e-3)
    both = [c.error_after for c in alone.configurations[:2]]
    rms = np.sqrt(np.mean(np.sum(np.concatenate(both) ** 2, axis=1)))
    np.testing.assert_allclose(fold.fit_rms, rms, rtol=1e-3)


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


@COMPARED
def test_what_is_held_out_cannot_touch_the_fit(data):
    """Its measurement may be anything: the fit ends where it did, begun elsewhere."""
    problem = build_problem(bar(CELLS), as_space(moduli(ONE)), data)
    settings, z = _compare.FOR_PREDICTION, []
    for shift in (0.0, 0.1):
        wild = eqx.tree_at(
            lambda p: p.configurations.effectors.measured,
            problem,
            problem.configurations.effectors.measured.at[1].add(shift),
        )
        fits = _compare._fit(wild, settings, [problem.space.start()])
        z.append(np.array([fit.run.z for fit in fits]))
    np.testing.assert_allclose(z[0][1], z[1][1], rtol=0, atol=2.0 * settings.tol)
    assert np.all(z[0][[0, 2, 3]] != z[1][[0, 2, 3]])


def test_folds_begin_where_the_fit_to_all_ended(data, monkeypatch):
    """One that does not converge from there begins at the start, with its images."""
    problem = build_problem(bar(CELLS), as_space(moduli(ONE)), data)
    start, settings = problem.space.start(), _compare.FOR_PREDICTION
    real, begun = _compare.run_start, []

    def recorded(evaluator, settings, z, **more):
        run = real(evaluator, settings, z, **more)
        held_out = ~np.any(
            evaluator.problem.configurations.effectors.inverse_std, (1, 2)
        )
        begun.append((tuple(np.flatnonzero(held_out)), float(z[0])))
        if begun[-1][0] == (1,) and begun[-1][1] != float(start[0]):
            run = run._replace(best=replace(run.best, converged=False))
        return run

    monkeypatch.setattr(_compare, "run_start", recorded)
    *folds, last = _compare._fit(problem, settings, [start])
    assert begun[0] == ((), float(start[0]))
    of_fold = lambda k: [z for held_out, z in begun[1:] if held_out == (k,)]
    end = float(last.run.z[0])
    assert of_fold(0)[0] == of_fold(1)[0] == of_fold(2)[0] == end
    assert of_fold(1)[-1] == float(start[0]) not in of_fold(0)
    assert all(fold.run.converged for fold in folds)


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
    real = _compare._fit

    def unfinished(problem, *rest):
        fits = real(problem, *rest)
        if len(problem.space.names) == 2:
            lost = replace(fits[0].run, converged=False)
            fits[0] = fits[0]._replace(run=lost)
        return fits

    monkeypatch.setattr(_compare, "_fit", unfinished)
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
