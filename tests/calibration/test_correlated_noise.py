"""Correlated noise in a fit: weights, standard errors, what is estimated."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from optimisers import levenberg_marquardt
from scipy.stats import chi2
from wording import says

from softcal_jax.calibration import (
    CalibrationWarning,
    _weighing,
    build_problem,
    calibrate,
    evaluate,
)
from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    SurfaceForce,
    configuration_lanes,
)
from softcal_jax.equilibrium import NewtonSettings, build_model
from softcal_jax.fields import Parameter, exactly_known
from softcal_jax.identifiability import assess, identify
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.results import held_out_sentences
from softcal_jax.robots import simulated_measurements
from softcal_jax.unknowns import read_once

STD, OFFSET = 1e-4, 0.5e-3
MARKERS = Markers(
    ("a", "b", "c"),
    [[0.06, 0.01, 0.01], [0.09, 0.01, 0.02], [0.1, 0.0, 0.0]],
    std=STD,
)
MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, NeoHookean(5e5, 0.3), density=1000.0)
E = Parameter("E", "E", 5e5, 1e5, 2e6, unit="Pa")
ONLY_OFFSETS = replace(exactly_known(), recordings=OFFSET)
LOADS = (0.0, -0.1, -0.2, -0.3)


def poses(**changed):
    return [
        Configuration(
            f"load {i}",
            Support("x_min"),
            (0.0, 0.0, -9.81),
            SurfaceForce("x_max", (0.0, 0.1 * force, force)),
            MARKERS,
            MARKERS.positions,
            **changed,
        )
        for i, force in enumerate(LOADS)
    ]


@cache
def clean():
    return simulated_measurements(MODEL, poses(), newton=NewtonSettings(rtol=1e-12))


def measured(seed=0, *, offset=OFFSET, share=0.0, jitter=STD, **changed):
    """Data with an offset of each pose, a share of its motion, and jitter."""
    random = np.random.default_rng(seed)
    data = []
    for c in clean():
        motion = c.measured - MARKERS.positions
        read = c.measured + offset * random.standard_normal((1, 3))
        read = read + share * random.standard_normal() * motion
        read = read + jitter * random.standard_normal(read.shape)
        data.append(replace(c, measured=read, **changed))
    return data


def fit(data, uncertain=ONLY_OFFSETS, noise="stated", **changed):
    options = {"noise": noise, "uncertain": uncertain, "intervals": None}
    return calibrate(MODEL, E, data, **options, **changed)


def covariance_of(data, offset, *, share=0.0, jitter=STD, motion=None):
    """V, written out element by element."""
    names = [c.recording or c.name for c in data]
    n = 3 * len(MARKERS.names)
    V = np.zeros((len(data) * n, len(data) * n))
    if motion is None:
        motion = [c.measured - MARKERS.positions for c in data]
    moved = [np.ravel(shift) for shift in motion]
    for i in range(len(V)):
        for k in range(len(V)):
            (c, a), (d, b) = divmod(i, n), divmod(k, n)
            same = names[c] == names[d] and a % 3 == b % 3
            V[i, k] = jitter**2 * (i == k) + offset**2 * same
            V[i, k] += share**2 * (c == d) * moved[c][a] * moved[c][b]
    return V


@pytest.mark.parametrize(
    ("changed", "share"),
    [({}, 0.0), ({"recording": "monday"}, 0.0), ({"relative_std": 0.03}, 0.03)],
)
def test_the_standard_error_is_that_of_generalised_least_squares(changed, share):
    data = measured(**changed)
    result = fit(data)
    at = evaluate(build_problem(MODEL, E, data), result.z)
    error, W = np.ravel(at.delta_e), np.concatenate(at.response.W_ep)
    motion = np.asarray(result.noise.motion)
    simulated = np.asarray(at.effectors) - MARKERS.positions
    if share:  # it settles to a hundredth
        np.testing.assert_allclose(motion, simulated, atol=0.01 * np.max(-simulated))
    V = covariance_of(data, OFFSET, share=share, motion=motion)
    information = W.T @ np.linalg.solve(V, W)
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(result.uncertainty.covariance, expected, rtol=1e-4)
    # Nothing is counted twice: the causes sum to the same.
    np.testing.assert_allclose(result.budget.covariance, expected, rtol=1e-4)
    gain = expected @ W.T @ np.linalg.inv(V)
    jitter = STD**2 * gain @ gain.T
    np.testing.assert_allclose(result.budget.noise, jitter, rtol=1e-4)
    causes = {"recordings"} | ({"creep"} if share else set())
    assert {cause.name for cause in result.budget.causes} == causes
    # The optimum is where the weighted errors have no slope, and chi-squared is of V.
    slope = gain @ error
    # The loop ends where the cost would fall by less than a hundred-millionth.
    assert abs(slope[0]) < 1e-2 * np.sqrt(expected[0, 0])
    chi_squared = error @ np.linalg.solve(V, error)
    np.testing.assert_allclose(result.uncertainty.chi_squared, chi_squared, rtol=1e-3)


def test_offsets_of_one_recording_count_once():
    """Four poses of one recording tell less than four recordings of their mean."""
    apart, together = (fit(measured(recording=name)) for name in (None, "monday"))
    by_offsets = [r.budget.by_cause()["recordings"][0] for r in (apart, together)]
    assert by_offsets[0] != pytest.approx(by_offsets[1], rel=0.05)
    names = {e for c in together.budget.causes for e in c.errors}
    assert names == {f"recording_offset {axis}" for axis in "xyz"}


def test_without_correlated_noise_errors_are_divided_by_their_std():
    data = measured()
    none = evaluate(build_problem(MODEL, E, data), fit(data).z)
    errors = np.ravel(none.delta_e) / STD
    np.testing.assert_allclose(none.rows.error[:-1], errors, rtol=1e-14)


@pytest.mark.slow
def test_a_second_optimiser_ends_at_the_same_place():
    data = measured(relative_std=0.03, share=0.03)
    result = fit(data)
    problem = build_problem(MODEL, E, data).with_noise(result.noise)
    z, ok = levenberg_marquardt(problem)
    assert ok
    np.testing.assert_allclose(z, result.z, atol=1e-5)


def test_the_estimated_jitter_is_that_of_the_residuals_beside_stated_offsets():
    """The stated 0.1 mm are half of what the data have."""
    jitters = [
        float(fit(measured(seed, jitter=2e-4), noise="estimated").noise.jitter)
        for seed in range(4)
    ]
    # 4 x 9 - 12 - 1 degrees of freedom each.
    assert np.sqrt(np.mean(np.square(jitters))) == pytest.approx(2.0, abs=0.35)
    result = fit(measured(0, jitter=2e-4), noise="estimated")
    assert result.uncertainty.noise_scale == float(result.noise.jitter)
    V = covariance_of(measured(0), OFFSET, jitter=STD * float(result.noise.jitter))
    data = measured(0, jitter=2e-4)
    at = evaluate(build_problem(MODEL, E, data), result.z)
    W = np.concatenate(at.response.W_ep)
    expected = np.linalg.inv(W.T @ np.linalg.solve(V, W))
    np.testing.assert_allclose(result.budget.covariance, expected, rtol=1e-3)
    # The weights stood still, so fitting again with them changes nothing.
    again = fit(data, noise="estimated", start=result.z)
    np.testing.assert_allclose(again.z, result.z, atol=0.02 * expected[0, 0] ** 0.5)


def test_without_offsets_the_estimated_noise_is_the_mean_square():
    result = fit(measured(offset=0.0), exactly_known(), noise="estimated")
    spread = result.uncertainty
    mean_square = spread.chi_squared / spread.degrees_of_freedom
    np.testing.assert_allclose(spread.noise_scale, np.sqrt(mean_square), rtol=1e-12)


def test_offsets_are_estimated_where_asked():
    asked = replace(exactly_known(), recordings="estimated")
    offsets = [
        float(fit(measured(seed, offset=2e-3, jitter=5e-5), asked).noise.offset[0, 0])
        for seed in range(4)
    ]
    # Some 11 degrees of freedom each.
    assert np.sqrt(np.mean(np.square(offsets))) == pytest.approx(2e-3, rel=0.35)


def test_creep_is_estimated_where_asked():
    shares = []
    for seed in range(4):
        data = measured(seed, offset=0.0, share=0.1, relative_std="estimated")
        share = fit(data, exactly_known()).noise.share
        assert np.ptp(share) == 0.0
        shares.append(float(share[0]))
    # Some 3 degrees of freedom each.
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(0.1, rel=0.6)


def test_what_the_data_cannot_tell_is_taken_as_stated_with_a_note():
    asked = replace(exactly_known(), recordings="estimated")
    result = fit(measured(recording="monday"), asked)
    assert float(result.noise.offset[0, 0]) == OFFSET
    assert says(result.notes, "offset of the recordings", "cannot")


def test_a_left_out_pose_is_that_of_a_fit_to_the_others():
    """The linearised prediction against a calibration without the pose."""
    data = measured(5, offset=0.0, jitter=2e-5)
    result = fit(data, exactly_known())
    for i, pose in enumerate(result.checks.left_out):
        others = fit(data[:i] + data[i + 1 :], exactly_known())
        at = evaluate(build_problem(MODEL, E, data), others.z)
        distance = np.linalg.norm(np.asarray(at.delta_e)[i], axis=1)
        assert pose.name == data[i].name
        np.testing.assert_allclose(pose.rms, np.sqrt(np.mean(distance**2)), rtol=2e-2)


def test_a_pose_with_a_wrong_load_is_named_with_either_noise():
    known = replace(exactly_known(), recordings=1e-4)
    data = measured(6, offset=1e-4)
    assert not fit(data, known).checks.reasons
    assert not fit(data, known, noise="estimated").checks.reasons
    data[2] = replace(data[2], loads=poses()[1].loads)
    for noise in ("stated", "estimated"):
        result = fit(data, known, noise=noise)
        assert says(result.checks.reasons, "from the other poses, load 2 is"), noise
        assert set(result.checks.reasons) <= set(assess(result).reasons)


def test_recordings_that_agree_and_one_that_does_not():
    """The estimate from one recording is that of a calibration of it alone."""
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    result = fit(data, known)
    estimates = {e.recording: e for e in result.checks.recordings}
    assert list(estimates) == [c.name for c in data]
    for c in data:
        alone, estimate = fit([c], known), estimates[c.name]
        np.testing.assert_allclose(estimate.value, alone.value("E"), rtol=1e-3)
        std = alone.parameters[0].standard_error
        np.testing.assert_allclose(estimate.standard_error, std, rtol=2e-2)
        # Hausman: the difference from the better of two has the smaller variance.
        both = std**2 - result.parameters[0].standard_error ** 2
        apart = (estimate.value - estimate.fit) / np.sqrt(both)
        np.testing.assert_allclose(estimate.apart, apart, rtol=5e-2, atol=5e-2)
        assert abs(estimate.apart) < 3.0
    assert "disagree" not in result.checks.agreement[0]
    assert result.checks.agreement[0] in str(result)
    data[3] = replace(data[3], loads=poses()[2].loads)
    wrong = fit(data, known)
    (sentence,) = wrong.checks.agreement
    assert "load 3 disagree" in sentence
    (reason,) = [r for r in assess(wrong).reasons if r.startswith("load 3 alone")]
    assert "standard errors from the fit's" in reason
    assert reason in str(wrong)


def test_an_error_that_all_recordings_share_cancels_in_their_difference():
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    loads = replace(known, loads=0.05)
    few, more = (fit(data[1:], widths).checks.recordings for widths in (known, loads))
    for a, b in zip(few, more, strict=True):
        assert b.standard_error > 1.1 * a.standard_error
        np.testing.assert_allclose(b.apart, a.apart, rtol=0.5, atol=0.1)


def test_a_share_of_the_motion_is_zero_or_more():
    with pytest.raises(ValueError, match=r"relative_std.*'load 0'.*-0.1"):
        poses(relative_std=-0.1)


def test_before_measuring_the_outlook_is_that_after_it():
    """The motion is that of the model then; with a recording that poses share."""
    data = measured(recording="monday", relative_std=0.03)
    result = fit(data)
    before = identify(MODEL, E, data, at=result.z, uncertain=ONLY_OFFSETS)
    (ahead,), (after,) = before.parameters, assess(result).identifiability.parameters
    np.testing.assert_allclose(ahead.standard_error, after.standard_error, rtol=2e-2)
    alone = identify(MODEL, E, data, at=result.z, uncertain=exactly_known())
    assert ahead.standard_error > 1.05 * alone.parameters[0].standard_error


def test_another_recording_tells_more_than_another_pose_of_the_same():
    """One error of the frame for both poses, or two."""
    data = measured()
    same, other = (
        [replace(c, recording=name) for c in (data[1], data[2])]
        for name in ("monday", None)
    )
    errors = [
        identify(MODEL, E, both, uncertain=ONLY_OFFSETS).parameters[0].standard_error
        for both in (same, other)
    ]
    assert errors[0] != pytest.approx(errors[1], rel=0.05)


def test_a_held_out_recording_is_asked_too():
    """It is independent of the fit, so the variances add up."""
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    result, alone = fit(data[:3], known, validation=data[3:]), fit(data[3:], known)
    (estimate,) = [e for e in result.checks.recordings if e.recording == "load 3"]
    stds = [r.parameters[0].standard_error for r in (result, alone)]
    np.testing.assert_allclose(estimate.value, alone.value("E"), rtol=1e-3)
    apart = (estimate.value - result.value("E")) / np.hypot(*stds)
    np.testing.assert_allclose(estimate.apart, apart, rtol=3e-2, atol=3e-2)
    assert abs(estimate.apart) < 3.0
    assert not any("alone gives" in reason for reason in assess(result).reasons)


def test_a_held_out_recording_that_contradicts_the_fit_reaches_the_verdict():
    """One recording is fitted: its own estimate is the fit, and no distance from it."""
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    other = replace(data[3], loads=poses()[2].loads)
    result = fit(data[2:3], known, validation=other)
    fitted, held_out = result.checks.recordings
    assert fitted.apart == 0.0
    assert abs(held_out.apart) > 5.0
    reasons = assess(result).reasons
    assert [r.split(" alone")[0] for r in reasons if " alone" in r] == ["load 3"]


def test_jitter_that_offsets_explain_as_well_is_not_estimated():
    """With one marker for each recording, no residual is free of its offset."""
    seen = Markers(MARKERS.names[2:], MARKERS.positions[2:], STD)
    data = [replace(c, markers=seen, measured=c.measured[2:]) for c in measured(2)]
    # Held out with all markers, one of them makes the program that of the other fits.
    held_out = replace(measured(2)[0], name="held out")
    result = fit(data, noise="estimated", validation=held_out)
    assert says(result.notes, "Jitter", "cannot", "offsets")
    assert float(result.noise.jitter) == 1.0
    dof = 3 * len(data) - 1
    assert result.uncertainty.degrees_of_freedom == dof
    # Jitter and offset together are of the size that was drawn.
    assert chi2.ppf(0.001, dof) < dof * result.uncertainty.noise_scale**2
    assert dof * result.uncertainty.noise_scale**2 < chi2.ppf(0.999, dof)


def test_noise_that_still_changes_at_the_end_is_not_settled(monkeypatch):
    data = measured(7, jitter=2e-5, offset=2e-5)
    result = fit(data, noise="estimated")
    assert result.noise_settled
    monkeypatch.setattr(_weighing, "MOST_ROUNDS", 1)
    result = fit(data, noise="estimated")
    assert not result.noise_settled
    assert says(result.notes, "noise did not settle")
    assert says(assess(result).reasons, "noise did not settle")


def test_a_held_out_recording_with_fewer_markers_is_asked_as_well():
    """One batch holds all poses, whatever each of them measured."""
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    tip = Markers(MARKERS.names[2:], MARKERS.positions[2:], std=STD)
    other = replace(data[3], markers=tip, measured=data[3].measured[2:])
    result = fit(data[:3], known, validation=other)
    alone = fit([other], known, validation=data[0])  # in the same batch of markers
    (held_out,) = [e for e in result.checks.recordings if e.recording == "load 3"]
    np.testing.assert_allclose(held_out.value, alone.value("E"), rtol=1e-3)
    std = alone.parameters[0].standard_error
    np.testing.assert_allclose(held_out.standard_error, std, rtol=2e-2)


def test_the_fit_without_a_pose_is_that_of_a_calibration_without_it():
    data = measured(7, jitter=2e-5, offset=2e-5)
    known = replace(exactly_known(), recordings=2e-5)
    result, fewer = fit(data, known), fit(data[:2] + data[3:], known)
    without = result.linear.without("load 2")
    np.testing.assert_allclose(
        without.standard_errors(), np.sqrt(np.diag(fewer.budget.covariance)), rtol=1e-2
    )
    moved = fewer.z - result.z
    np.testing.assert_allclose(without.step(), moved, rtol=5e-2)
    with pytest.raises(ValueError, match=r"'load 9'.*load 0"):
        result.linear.without("load 9")


@pytest.mark.parametrize("noise", ["stated", "estimated"])
def test_a_reading_counts_once(noise):
    """However often it stands in the fitted configurations: one error, one weight."""
    data = measured(3, offset=0.0)
    # The load is another one, and of the third only two markers.
    few = Markers(MARKERS.names[1:], MARKERS.positions[1:], STD)
    again = [
        replace(data[1], name="again", loads=data[2].loads),
        replace(data[2], name="partly", markers=few, measured=data[2].measured[1:]),
    ]
    once = fit(data, noise=noise)
    with pytest.warns(CalibrationWarning, match="again has the readings of load 1; "):
        twice = fit([*data, *again], noise=noise)
    for one, two in zip(once.parameters, twice.parameters, strict=True):
        assert two.value == pytest.approx(one.value, rel=1e-6)
        assert two.standard_error == pytest.approx(one.standard_error, rel=1e-6)
    assert twice.uncertainty.degrees_of_freedom == once.uncertainty.degrees_of_freedom
    assert twice.uncertainty.chi_squared == pytest.approx(once.uncertainty.chi_squared)
    assert says(assess(twice).reasons, "partly has the readings of load 2", "once")
    assert not any("count once" in reason for reason in assess(once).reasons)
    assert len(twice.checks.left_out) == len(data)


def test_a_reading_that_is_fitted_is_not_held_out():
    data = measured(3, offset=0.0)
    result = fit(data, validation=replace(data[1], name="again"))
    assert says(assess(result).reasons, "The error of again is not held out")
    assert held_out_sentences(result.configurations) == []
    assert says(str(result), "again has the readings of load 1")


def test_what_agrees_but_is_no_reading_twice():
    """Markers at rest, a number alone, some of many, references of displacements."""
    data = measured(3)
    at_rest = [replace(c, measured=MARKERS.positions) for c in data[:2]]
    one = Markers(MARKERS.names, MARKERS.positions, STD, axes="x")
    near = np.where([[True], [False], [False]], data[0].measured, data[1].measured)
    x = np.asarray(MARKERS.positions) + np.array([[1e-3], [0.0], [0.0]]) * [1, 0, 0]
    from_rest = [replace(c, displacement_from="load 0") for c in data]
    for several in (
        at_rest,
        [replace(c, markers=one, measured=x) for c in data[:2]],
        [data[0], replace(data[1], measured=near)],
        [data[0], *from_rest[1:]],
    ):
        lanes = configuration_lanes(MESH, several)
        assert read_once(several, lanes)[1] == {}
    # The reference keeps its reading, wherever it stands.
    several = [replace(data[0], name="pose"), data[0], from_rest[1]]
    lanes, repeats = read_once(several, configuration_lanes(MESH, several))
    assert repeats == {"pose": "load 0"}
    weight = np.asarray(lanes.arrays.effectors.inverse_std)
    np.testing.assert_array_equal(weight.any(axis=(1, 2)), [False, True, True])
