"""What a calibration may claim, on fits of one beam to data made for each verdict."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import numpy as np
import pytest
from two_part_beam import SPACE, two_part_beam
from wording import says

from softcal_jax.calibration import (
    CalibrationSettings,
    MultiStartResult,
    Optimum,
    calibrate,
)
from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ParameterSpace, Uncertain, exactly_known
from softcal_jax.identifiability import assess
from softcal_jax.inference import UNLIKELY, Cause, ErrorColumns
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.results import sections, text
from softcal_jax.robots import synthetic_measurements
from softcal_jax.unknowns import MESH

TARGET = {"E of root": 1.5e5, "E of tip": 0.8e5}
POINTS = ((0.05, 0.01, 0.02), (0.1, 0.01, 0.0))
N_DATA = 2 * 2 * 3
STD = 2e-5

fit = partial(calibrate, uncertain=exactly_known(), intervals=None)


def space(root_upper=1e6):
    root, tip = SPACE.entries
    return ParameterSpace((replace(root, upper=root_upper), tip))


def poses(std=STD):
    return [
        Configuration(
            name,
            (Support("x_min"),),
            (0.0, 0.0, -9.81),
            SurfaceForce("x_max", (0.0, side, 0.0)),
            Markers(("middle", "tip"), POINTS, std),
        )
        for name, side in (("hang", 0.0), ("pull", 0.2))
    ]


@pytest.fixture(scope="module")
def model():
    return two_part_beam()


@pytest.fixture(scope="module")
def data(model):
    """Measured with the noise that is stated."""
    return synthetic_measurements(model, space(), poses(), TARGET, noise=True, seed=4)


@pytest.fixture(scope="module")
def good(model, data):
    return fit(model, space(), data, noise="stated")


def test_a_good_fit_is_identified(good):
    verdict = assess(good)
    assert verdict.identified
    assert verdict.reasons == ()
    assert verdict.identifiability.verdict == "identifiable"
    assert verdict.outcome == "trust"
    assert not verdict.contradicted
    assert str(verdict).startswith("Trust")
    assert says(verdict, "Identifiable", "12 measured")
    # And it may say so: two standard errors around what made the data.
    for estimate in good.parameters:
        off = abs(estimate.value - TARGET[estimate.name])
        assert off < 2.0 * estimate.standard_error < 0.1 * estimate.value


def test_probability_of_the_misfit_is_that_of_chi_squared(good):
    """Even degrees of freedom: a Poisson sum, exp(-x) sum of x^k / k!, x half of it."""
    half = 0.5 * good.uncertainty.chi_squared
    terms = [half**k / float(np.prod(np.arange(1, k + 1))) for k in range(5)]
    assert good.uncertainty.degrees_of_freedom == 2 * len(terms) == N_DATA - 2
    expected = np.exp(-half) * sum(terms)
    assert assess(good).misfit_probability == pytest.approx(expected, rel=1e-9)
    assert expected > UNLIKELY


def test_model_error_shows_above_the_stated_noise(model, data):
    """A marker is 0.2 mm, ten standard deviations, from where any modulus puts it."""
    off = data[1].measured + np.array([[0.0, 0.0, 0.0], [2e-4, 0.0, 0.0]])
    wrong = [data[0], replace(data[1], measured=off)]
    stated = assess(fit(model, space(), wrong, noise="stated"))
    assert not stated.identified
    assert stated.misfit_probability < 1e-6
    (reason,) = stated.reasons
    assert says(reason, "stated errors", "10 degrees of freedom", "cannot match")
    assert says(stated, "with care", "cannot match")
    assert stated.contradicted
    # Estimated from these residuals the noise holds the error, but not as stated.
    estimated = assess(fit(model, space(), wrong))
    assert estimated.misfit_probability is None
    assert says(estimated.reasons, "residuals", "stated std")
    right = assess(fit(model, space(), data))
    assert not any("stated std" in reason for reason in right.reasons)


def test_a_default_std_states_nothing(model, data):
    """A marker is off by twenty times a std that was typed, or that nobody typed."""
    off = data[1].measured + np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    wrong = [data[0], replace(data[1], measured=off)]
    names = "middle", "tip"
    unstated = [replace(c, markers=Markers(names, POINTS)) for c in wrong]
    stated = [replace(c, markers=Markers(names, POINTS, 1e-3)) for c in wrong]
    assert not unstated[0].states_noise
    assert stated[0].states_noise
    verdicts = [assess(fit(model, space(), posed)) for posed in (unstated, stated)]
    shown = [any("stated std" in reason for reason in v.reasons) for v in verdicts]
    assert shown == [False, True]


def test_what_is_held_fixed_and_not_seen_is_named(good):
    """One error changes nothing, one mostly what no parameter does, one is no constant.

    Of the second, orthogonal to the parameters, 1 / sqrt(1 + a^2) is left.
    """
    a = 3.0
    basis, _ = np.linalg.qr(np.column_stack([good.linear.W, np.eye(N_DATA)]))
    across = a * good.linear.scale * basis[:, 2]
    nothing = np.zeros(N_DATA)
    names = "nu", "density", "clamp"
    columns = np.stack([nothing, across, nothing], axis=1)
    linear = replace(good.linear, considered=ErrorColumns(columns, names, names))
    left = np.sqrt(np.diag(linear.considered_covariance()))
    np.testing.assert_allclose(left, [1.0, 1.0 / np.hypot(1.0, a), 1.0], rtol=1e-9)
    verdict = assess(replace(good, linear=linear))
    assert verdict.held == ("nu",)
    assert says(verdict, "not identifiable from these data: nu.")
    assert assess(good).held_fixed == ""


def test_a_pose_that_is_not_explained_reaches_the_verdict(model, data):
    """Pulled to the wrong side, which an estimated noise would call large noise."""
    pulled = data[1]
    rest = np.asarray(POINTS)
    wrong = replace(pulled, measured=rest - (pulled.measured - rest) * [1.0, 1.0, -1.0])
    verdict = assess(fit(model, space(), [data[0], wrong]))
    assert not verdict.identified
    assert says(verdict.reasons, "pull", "fitted", "check its load")
    assert verdict.contradicted
    held_out = assess(fit(model, space(), data[:1], validation=wrong))
    assert says(held_out.reasons, "pull", "predicted")


def test_a_pose_at_rest_is_described_without_its_motion(good):
    """Its markers are measured where they are on the undeformed robot."""
    fitted = good.configurations[0]
    still = tuple(replace(e, measured=e.at_rest) for e in fitted.points)
    result = replace(good, configurations=(replace(fitted, effectors=still),))
    (reason,) = assess(result).reasons
    assert says(reason, "mm off", "check its load")
    assert "%" not in reason


def test_what_the_stated_noise_explains_is_no_misfit(model):
    """As large as the motion, by noise that was stated and drawn from it."""
    rough = poses(std=8e-3)
    noisy = synthetic_measurements(model, space(), rough, TARGET, noise=True, seed=2)
    stated = fit(model, space(), noisy, noise="stated")
    assert max(c.rms_share for c in stated.configurations) > 0.25
    assert not assess(stated).contradicted
    # Where the markers hardly leave the noise, an estimated one says no more.
    estimated = fit(model, space(), noisy)
    assert not assess(estimated).contradicted
    assert not assess(estimated).identified


def test_what_is_considered_explains_a_pose(good):
    """Fitted 1 mm too low and worse than before, by a load that moves it so far."""
    fitted, up = good.configurations[0], np.array([0.0, 0.0, 1e-3])
    low = tuple(
        replace(e, measured=e.simulated + up, simulated_before=e.simulated + up)
        for e in fitted.points
    )
    fitted = replace(fitted, effectors=low)
    assert fitted.misfit("stated", 1.0)
    for of_pose, explained in ((0, True), (1, False)):
        rows = good.linear.pose == of_pose
        column = np.zeros((N_DATA, 1))
        column[rows, 0] = np.concatenate([up / e.std for e in low])
        errors = ErrorColumns(column, ("loads",), ("load",))
        with_load = fitted.with_considered(replace(good.linear, considered=errors))
        assert with_load.misfit("stated", 1.0) is not explained


def test_another_optimum_that_fits_as_well_reaches_the_verdict(good):
    """95 % of chi-squared with one degree of freedom: 3.84, twice the cost."""
    optima = lambda rise: tuple(
        Optimum(cost, values, (index,))
        for index, (cost, values) in enumerate(
            [(5.0, TARGET), (5.0 + rise, {"E of root": 3e5, "E of tip": 4e4})]
        )
    )
    none = np.zeros((2, 2))
    starts = MultiStartResult(
        names=tuple(TARGET),
        starts=none,
        values=none,
        z=none,
        cost=none[0],
        steps=np.ones(2, int),
        converged=np.ones(2, bool),
        errors=none,
        optima=optima(1.9),
    )
    (reason,) = assess(replace(good, starts=starts)).reasons
    assert says(reason, "E of root = 300 kPa, E of tip = 40 kPa", "6.9", "best 5")
    repeated = replace(good, starts=starts, repeated="A reading stands twice.")
    assert assess(repeated).reasons == (reason, "A reading stands twice.")
    far = replace(good, starts=replace(starts, optima=optima(1.95)))
    assert assess(far).identified


def test_threshold_of_the_misfit(good):
    """10 degrees of freedom: 23.21 is exceeded in one case of a hundred."""
    for chi_squared, identified in ((23.1, True), (23.3, False)):
        where = lambda r: r.uncertainty.chi_squared
        assert assess(eqx.tree_at(where, good, chi_squared)).identified is identified


def test_fit_that_did_not_converge(model, data):
    settings = CalibrationSettings(max_steps=1)
    result = fit(model, space(), data, settings=settings)
    verdict = assess(result)
    assert verdict.outcome == "do not use"
    assert says(verdict.reasons[0], "not converge")


@pytest.mark.parametrize(
    ("times", "outcome"), [(9.9, "take with care"), (10.1, "do not use")]
)
def test_residuals_ten_times_the_noise_are_too_large(good, times, outcome):
    where = lambda r: r.uncertainty.chi_squared
    wrong = eqx.tree_at(where, good, 10 * times**2)  # 10 degrees of freedom
    assert assess(wrong).outcome == outcome


def test_what_contradicts_the_model_makes_no_parameter_identifiable(good):
    """Not in a row of its own either."""
    assert assess(good).seen("identifiable") == "identifiable"
    wrong = assess(eqx.tree_at(lambda r: r.uncertainty.chi_squared, good, 50.0))
    assert wrong.seen("identifiable") == "identifiable if the model is right"
    assert wrong.seen("not identifiable") == "not identifiable"
    assert says(wrong, "with care ... If the model is right: Identifiable")
    assert "If the model" not in str(assess(good))


def test_noise_that_did_not_settle(good):
    verdict = assess(eqx.tree_at(lambda r: r.noise_settled, good, False))
    assert not verdict.identified
    assert says(verdict.reasons, "noise did not settle")


def test_parameter_on_its_bound(model, data):
    verdict = assess(fit(model, space(root_upper=1.2e5), data))
    assert not verdict.identified
    assert says(verdict.reasons, "E of root ended", "bound")
    assert not any("E of tip ended" in reason for reason in verdict.reasons)


def test_a_bound_that_the_data_exclude_makes_values_useless(model, data, good):
    """The fit without the bound is five standard errors beyond it, or half of one."""
    wanted, error = good.parameters[0].value, good.parameters[0].standard_error
    for beyond, outcome in ((5.0, "do not use"), (0.5, "take with care")):
        for noise in ("stated", "estimated"):
            upper = wanted - beyond * error
            result = fit(model, space(root_upper=upper), data, noise=noise)
            verdict = assess(result)
            assert verdict.outcome == outcome
            assert verdict.contradicted == (outcome == "do not use")
            (reason, *_) = [r for r in verdict.reasons if "bound" in r]
            assert "nan" not in text(sections(result, verdict)[:3])
            if outcome == "do not use":
                assert reason == verdict.reasons[0]
                assert says(reason, "E of root ended on a bound", "data push")


def test_a_budget_without_a_standard_error_has_no_nan(good):
    budget = replace(good.budget, noise=np.full((2, 2), np.nan))
    assert says(budget.advice("E of root"), "E of root has no standard error")
    assert budget.readable(0, np.nan) == "an unknown amount"


def test_poses_of_one_reason_share_it(model, data):
    """Both are pulled to the wrong side; the farthest comes first."""
    rest = np.asarray(POINTS)
    wrong = [
        replace(c, measured=rest - (c.measured - rest) * [1.0, 1.0, -1.0]) for c in data
    ]
    result = fit(
        model,
        space(),
        data,
        validation=[replace(c, name=f"wrong {c.name}") for c in wrong],
    )
    first, second = sorted(result.configurations[2:], key=lambda c: -c.rms_after)
    (reason,) = [r for r in assess(result).reasons if "check" in r]
    assert says(reason, first.name, "mm off", second.name, "mm off", "for each, check")


def test_reasons_stand_by_what_they_may_change(good):
    """A mesh that may change a value by 18 % of it, a bound by as much as its error."""
    mesh = beam(0.1, 0.02, 0.02, (4, 1, 1), order=2)
    model = build_model(mesh, NeoHookean(1e5, 0.3), density=1e3)
    on_bound = replace(good.parameters[1], at_bound=True)
    for error, first in ((0.05, "two quadratic tets"), (0.05, "on a bound")):
        refinement = Cause(MESH, ("refinement",), np.array([[error], [0.01]]))
        changed = {"causes": (refinement,)}
        linear = good.linear
        if first == "on a bound":
            linear = linear.with_scale(100.0 * linear.scale)
            linear = replace(linear, r=0.0 * linear.r)
        result = replace(
            good,
            model=model,
            budget=replace(good.budget, **changed),
            parameters=(good.parameters[0], on_bound),
            uncertainty=replace(good.uncertainty, noise_scale=linear.scale),
        )
        reasons = assess(result).reasons
        found = [k for k in reasons if "quadratic tets" in k or "on a bound" in k]
        assert first in found[0]
        assert len(found) == 2


def test_data_too_coarse_to_tell(model, data):
    """The same positions, stated to be known to a decimetre only."""
    coarse = [
        replace(pose, measured=fine.measured)
        for pose, fine in zip(poses(std=0.1), data, strict=True)
    ]
    verdict = assess(fit(model, space(), coarse, noise="stated"))
    assert not verdict.identified
    assert verdict.identifiability.verdict == "not identifiable"
    assert says(verdict.reasons, "not determine", "E of")
    wide = [r for r in verdict.reasons if "wider" in r and "bounds" in r]
    assert len(wide) == 2
    assert not any("cannot match" in reason for reason in verdict.reasons)


def test_estimated_noise_of_a_good_fit(model, data):
    verdict = assess(fit(model, space(), data))
    assert verdict.identified
    assert verdict.misfit_probability is None


def test_data_without_any_residual(model):
    """Made by the model itself, from the start: there is no noise to estimate."""
    at_start = dict.fromkeys(TARGET, 1e5)
    exact = synthetic_measurements(model, space(), poses(), at_start)
    result = fit(model, space(), exact)
    assert result.uncertainty.noise_scale < 1e-3
    verdict = assess(result)
    assert verdict.identified
    as_stated = assess(fit(model, space(), exact, noise="stated"))
    for ours, theirs in zip(
        verdict.identifiability.parameters,
        as_stated.identifiability.parameters,
        strict=True,
    ):
        assert ours.standard_error == pytest.approx(theirs.standard_error, rel=1e-6)


def test_what_is_held_fixed_counts_in_the_verdict(model, good, data):
    """The data are as good as before, but they are not all that there is to know."""
    result = fit(model, space(), data, noise="stated", uncertain=Uncertain())
    verdict = assess(result)
    for param, alone, estimate in zip(
        verdict.identifiability.parameters,
        assess(good).identifiability.parameters,
        result.parameters,
        strict=True,
    ):
        assert param.ratio > 3.0 * alone.ratio
        # The one standard error that there is, in the verdict and in the table.
        assert param.standard_error == pytest.approx(estimate.standard_error, rel=1e-6)


def test_linear_tets_reach_the_verdict(good):
    """With their error, where it is known: 20 % of a modulus per logarithm of 0.2."""
    locking = Cause(MESH, ("locking",), np.array([[0.05], [0.2]]))
    with_error = lambda **changed: replace(good, budget=replace(good.budget, **changed))
    (reason,) = assess(with_error(causes=(locking,))).reasons
    assert says(reason, "Linear tets", "E of tip", "20 %", "to_quadratic")
    on_bounds = replace(locking, deviations=np.full((2, 1), np.nan))
    (reason,) = assess(with_error(causes=(on_bounds,))).reasons
    assert says(reason, "Linear tets", "unknown")


@pytest.mark.parametrize(
    ("across", "error", "doubted"),
    [(1, 0.05, True), (2, 0.05, True), (3, 0.05, False), (2, 0.02, False)],
)
def test_two_quadratic_tets_across_are_few(good, across, error, doubted):
    """Where 3.6 times the estimated error is more than the asked 10 %."""
    mesh = beam(0.1, 0.02, 0.02, (4, across, across), order=2)
    model = build_model(mesh, NeoHookean(1e5, 0.3), density=1e3)
    refinement = Cause(MESH, ("refinement",), np.array([[error], [0.01]]))
    budget = replace(good.budget, causes=(refinement,))
    reasons = assess(replace(good, model=model, budget=budget)).reasons
    few = [reason for reason in reasons if "two quadratic tets thick" in reason]
    assert bool(few) == doubted
    assert not few or says(few, "E of root may be off by 18 %", "Refine")


def test_the_precision_that_is_asked_for_decides(good):
    """The fit knows its moduli to some percent."""
    relative = max(p.relative for p in assess(good).identifiability.parameters)
    asked_less = assess(good, precision=1.01 * relative)
    assert asked_less.identified
    assert not assess(good, precision=0.99 * relative).identified
    assert not assess(replace(good, precision=0.99 * relative)).identified
    with pytest.raises(ValueError, match=r"precision.*got 0"):
        assess(good, precision=0.0)


def test_poses_are_predicted_with_the_error_of_the_parameters(good):
    """Rows of Eq. (9) around the covariance, in mm, and in a sentence."""
    rows = STD * good.linear.W
    variance = np.diag(rows @ good.budget.covariance @ rows.T).reshape(2, -1)
    n_markers = len(POINTS)
    expected = np.sqrt(variance.sum(axis=1) / n_markers)
    verdict = assess(good)
    assert [p.name for p in verdict.predictions] == ["hang", "pull"]
    np.testing.assert_allclose([p.std for p in verdict.predictions], expected)
    mm = 1e3 * np.sqrt(np.mean(expected**2))
    assert says(verdict, f"{mm:.2g} mm in the fitted poses")


def test_a_pose_that_stays_at_rest_is_compared_with_the_noise(good):
    """There is no motion to compare with, and the noise was found from all poses."""
    guessed = replace(good.uncertainty, noise="estimated")
    hang, pull = good.configurations
    still = tuple(
        replace(
            e,
            measured=e.at_rest + STD,
            simulated=e.at_rest,
            simulated_before=e.at_rest + 0.9 * STD,
        )
        for e in hang.points
    )
    result = replace(
        good,
        uncertainty=guessed,
        configurations=(replace(hang, effectors=still), pull),
    )
    assert assess(result).identified
    finer = eqx.tree_at(lambda r: r.uncertainty.noise_scale, result, 0.1)
    assert says(assess(finer).reasons, "hang", "fitted")


@pytest.mark.parametrize(("share", "contradicted"), [(0.49, False), (0.51, True)])
def test_a_far_prediction_contradicts_the_model(good, share, contradicted):
    """Nor does its estimate hold for another robot, though it is within the noise."""
    fitted = good.configurations[0]
    short = tuple(
        replace(
            e,
            simulated=e.measured - share * (e.measured - e.at_rest),
            std=1.0 + 0 * e.std,
        )
        for e in fitted.points
    )
    held_out = replace(fitted, role="validation", effectors=short)
    result = replace(good, configurations=(*good.configurations, held_out))
    assert not result.doubts
    assert result.missed == pytest.approx(share)
    assert assess(result).contradicted is result.estimate.contradicted is contradicted
