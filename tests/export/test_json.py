import json
from importlib.metadata import version

import numpy as np
import pytest
from export.handmade import (
    make_fit,
    make_result,
    make_simulation_result,
    nowhere_before,
    small_model,
    with_points,
)
from wording import says

from softcal_jax.calibration import LeftOut, ParameterInterval, ResidualChecks
from softcal_jax.equilibrium import RESULTS
from softcal_jax.inference import LackOfFit, RecordingEstimate, Uncertainty
from softcal_jax.results import result_dict
from softcal_jax.unknowns import Attachments, CorrelatedNoise


@pytest.fixture(scope="module")
def data():
    return result_dict(make_result(), name="beam", timing_s={"import": 2.5})


def test_result_is_strict_json_with_all_its_keys(data):
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert sorted(data) == sorted(
        [
            "format",
            "name",
            "converged",
            "source",
            "parameters",
            "intervals",
            "configurations",
            "history",
            "solver",
            "settings",
            "uncertainty",
            "budget",
            "noise",
            "checks",
            "assessment",
            "identifiability",
            "starts",
            "mistakes",
            "notes",
            "versions",
            "timing_s",
        ]
    )
    assert (data["name"], data["converged"]) == ("beam", True)
    assert data["timing_s"] == {"steps": 1.5, "import": 2.5}


def test_intervals_are_in_si_and_a_missing_end_is_null():
    E = ParameterInterval("E", 0.95, 2.1e5, np.nan, "likelihood", "not found", "Pa")
    data = result_dict(make_result(intervals=(E,)))
    (entry,) = data["intervals"]
    assert entry == data["parameters"][0]["interval"]
    assert data["parameters"][1]["interval"] is None
    assert entry == {
        "name": "E",
        "level": 0.95,
        "lower": 2.1e5,
        "upper": None,
        "lower_end": "likelihood",
        "upper_end": "not found",
        "unit": "Pa",
        "kind": "profile",
        "why": "",
    }


def test_parameters_are_in_si_and_a_missing_error_is_null(data):
    E, nu = data["parameters"]
    assert E == {
        "name": "E",
        "value": 2.4e5,
        "standard_error": pytest.approx(6e3, rel=1e-12),
        "start": 2e5,
        "lower": 1e5,
        "upper": 1e6,
        "unit": "Pa",
        "at_bound": False,
        "interval": None,
        "given": [],
    }
    assert nu["standard_error"] is None
    assert nu["at_bound"] is True


def test_noise_and_checks_are_null_where_there_are_none(data):
    assert data["noise"] is data["checks"] is None


def test_noise_and_checks_are_in_millimetres():
    noise = CorrelatedNoise(
        recording=np.array([0, 0]),
        offset=np.full((2, 3), 5e-4),
        motion=np.zeros((2, 1, 3)),
        share=np.array([0.0, 0.02]),
        jitter=np.array(1.5),
        attached=Attachments(
            np.full((2, 1), -1), np.tile(np.eye(3), (2, 1, 1, 1)), np.zeros(0)
        ),
    )
    predicted = LeftOut("held out", 1e-3, 2e-4, 1e-2, 1e-3, np.nan)
    test = LackOfFit(4.0, 7, 9, 1e-3, 0.8, np.array([0.75, 0.25]))
    single = RecordingEstimate("monday", "E", 2e5, 1e4, 2.4e5, -4.0, "Pa", 1e-4)
    names = ("beam", "held out")
    checks = ResidualChecks(names, test, (predicted,), (single,))
    data = result_dict(make_result(noise=noise, checks=checks))
    json.dumps(data, allow_nan=False)
    offsets = [[0.5, 0.5, 0.5]] * 2
    assert data["noise"] == {"jitter": 1.5, "share": [0, 0.02], "offset_mm": offsets}
    assert data["checks"]["lack_of_fit"]["shares"] == [0.75, 0.25]
    (row,) = data["checks"]["left_out"]
    assert (row["rms_mm"], row["expected_mm"], row["by_scatter"]) == (1.0, 0.2, None)
    (row,) = data["checks"]["recordings"]
    assert (row["recording"], row["apart"]) == ("monday", -4.0)
    off, far, alone = data["checks"]["reasons"]
    assert says(off, "the largest in beam ... check its load")
    assert says(far, "held out is 1.00 mm off, 10 % ... 0.2 mm")
    assert says(alone, "monday ... E = 200 kPa, 4.0 standard ... fit's 240 kPa")
    assert data["checks"]["level"] is data["checks"]["probability"] is None
    (agreement,) = data["checks"]["agreement"]
    assert says(agreement, "E ... [kPa]: monday 200 +- 10 (4.0 ... monday disagrees")


def test_markers_are_in_millimetres(data):
    fit, held_out = data["configurations"]
    assert (fit["name"], fit["role"]) == ("droop", "calibration")
    assert (held_out["name"], held_out["role"]) == ("held out", "validation")
    # An error of 1 mm after and 4 mm before, on a motion of 20 mm; rounding only.
    np.testing.assert_allclose(fit["rms_before_mm"], 4.0, rtol=1e-12)
    np.testing.assert_allclose(fit["rms_after_mm"], 1.0, rtol=1e-12)
    np.testing.assert_allclose(fit["motion_mm"], 20.0, rtol=1e-12)
    np.testing.assert_allclose(fit["rms_after_percent_of_motion"], 5.0, rtol=1e-12)
    left = fit["markers"][0]
    assert left["name"] == "left"
    close = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(left["measured_mm"], [100.0, 20.0, 0.0], **close)
    np.testing.assert_allclose(left["simulated_before_mm"], [104.0, 20.0, 0.0], **close)
    np.testing.assert_allclose(left["simulated_mm"], [101.0, 20.0, 0.0], **close)
    np.testing.assert_allclose(left["residual_mm"], [1.0, 0.0, 0.0], **close)


def test_a_coordinate_that_was_not_measured_is_null_and_counts_for_nothing():
    # The lost axis holds a number that nobody measured, or none.
    for y in (7.0, np.nan):
        fit = make_fit(small_model().mesh, axes="xz", y=y)
        entry = result_dict(make_result(fits=[fit]))["configurations"][0]
        marker = entry["markers"][0]
        assert marker["measured_mm"][1] is None
        assert marker["residual_mm"][1] is None
        assert marker["simulated_mm"][1] is not None
        assert marker["measured_mm"][0] is not None
        np.testing.assert_allclose(fit.motion, 0.02, rtol=1e-12)
        np.testing.assert_allclose(entry["motion_mm"], 20.0, rtol=1e-12)


def test_markers_that_did_not_move_have_no_percentage():
    fit = with_points(make_fit(small_model().mesh), at_rest=lambda p: p.measured)
    entry = result_dict(make_result(fits=[fit]))["configurations"][0]
    assert entry["motion_mm"] == 0.0
    assert entry["rms_after_percent_of_motion"] is None


def test_no_equilibrium_at_the_start_is_null():
    fit = nowhere_before(make_fit(small_model().mesh))
    entry = result_dict(make_result(fits=[fit]))["configurations"][0]
    assert entry["rms_before_mm"] is None
    assert entry["markers"][0]["simulated_before_mm"] == [None, None, None]
    np.testing.assert_allclose(entry["rms_after_mm"], 1.0, rtol=1e-12)


def test_history_keeps_every_step_and_the_start_has_no_step(data):
    history = data["history"]
    assert [entry["step"] for entry in history] == [0, 1, 2, 3, 4]
    assert history[0]["lambda_p"] == [None, None]
    assert history[2]["lambda_p"] == [-0.1, 0.05]
    assert history[1]["rms_mm"] == 2.0
    assert history[1]["values"] == {"E": 2.1e5, "nu": 0.4 + 0.01}
    assert history[1]["newton_steps"] == [4, 5]


def test_what_it_was_computed_with(data):
    assert data["solver"]["name"] == make_result().model.solver.name
    assert data["solver"]["law"] == "NeoHookean"
    assert data["solver"]["formulation"] == "displacement"
    assert data["solver"]["element_order"] == 1
    assert data["solver"]["n_tets"] == 30
    assert data["versions"]["jax"] == version("jax")
    package = data["solver"]["name"].split("(")[1].rstrip(")")
    assert data["versions"][package] == version(package)
    assert data["settings"]["calibration"]["tol"] == 1e-6
    assert data["settings"]["newton"]["rtol"] == 1e-8
    assert data["settings"]["noise"] == "estimated"


def test_uncertainty(data):
    uncertainty = data["uncertainty"]
    assert uncertainty["covariance"] == [[4e-4, None], [None, None]]
    assert uncertainty["correlation"] == [[1.0, None], [None, None]]
    assert uncertainty["degrees_of_freedom"] == 10
    assert uncertainty["noise_scale"] == 1.5


def test_an_exact_fit_has_no_correlation_and_no_warning():
    exact = Uncertainty(np.zeros((2, 2)), "estimated", 0.0, 10, 0.0, np.zeros(2, bool))
    data = result_dict(make_result(uncertainty=exact))
    assert data["uncertainty"]["covariance"] == [[0.0, 0.0], [0.0, 0.0]]
    assert data["uncertainty"]["correlation"] == [[None, None], [None, None]]


def test_not_converged_is_said():
    assert result_dict(make_result(converged=False))["converged"] is False


def test_simulation_lists_lanes_that_failed_with_the_reason():
    result = make_simulation_result(small_model(order=2))
    data = result_dict(result, name="poses")
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert (data["name"], data["converged"]) == ("poses", False)
    good, bad = data["configurations"]
    assert good["outcome"] == "converged"
    assert good["newton_steps"] == 4
    assert (good["residual"], good["rounding"]) == (1e-9, 1e-12)
    assert good["at_rounding"] is False
    # The tip goes down by 20 mm and back by 4 mm.
    np.testing.assert_allclose(
        good["largest_displacement_mm"], np.hypot(20.0, 4.0), rtol=1e-12
    )
    assert [marker["name"] for marker in good["markers"]] == ["left", "right"]
    np.testing.assert_allclose(
        good["markers"][0]["simulated_mm"], [96.0, 20.0, 0.0], atol=1e-9
    )
    assert bad["outcome"] == RESULTS[RESULTS.inverted]
    assert bad["largest_displacement_mm"] is None
    assert bad["min_det_F"] == -0.1
    assert bad["markers"] == []


def test_a_failed_lane_has_no_marker_positions():
    data = result_dict(make_simulation_result(small_model(), (False, True)))
    assert data["configurations"][0]["markers"][0]["simulated_mm"] is None
    assert data["configurations"][0]["markers"][0]["at_rest_mm"] is not None


def test_standard_errors_by_cause(data):
    """Of E 2 % by the noise and 1.5 % by the clamp, 2.5 % together."""
    budget = data["budget"]
    E, nu = budget["parameters"]
    assert list(E["by_cause"]) == ["noise", "clamp"]
    assert E["by_cause"] == pytest.approx({"noise": 4.8e3, "clamp": 3.6e3}, rel=1e-12)
    assert E["standard_error"] == pytest.approx(6e3, rel=1e-12)
    assert says(E["sentence"], "noise 2 %, clamp 1.5 %")
    assert nu["by_cause"] == {"noise": None, "clamp": None}
    assert nu["sentence"] == "no standard error"
    (error,) = budget["errors"]
    assert (error["cause"], error["name"]) == ("clamp", "clamp")
    assert error["deviations"] == [pytest.approx(3.6e3, rel=1e-12), None]
    assert budget["covariance"][0][0] == pytest.approx(6e3**2, rel=1e-12)
