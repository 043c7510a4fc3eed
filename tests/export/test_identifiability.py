"""Verdicts and rankings as JSON: every number of the result, and null for the rest."""

import json

import numpy as np
import pytest
from export.handmade import axis_space, make_ranking, make_result, replaced

from softcal_jax.identifiability import assess, identifiability
from softcal_jax.inference import independent
from softcal_jax.results import result_dict


def half_blind():
    """Of a modulus and an angle, only the modulus is seen; to 1 % per coordinate."""
    W = np.array([[100.0, 0.0], [100.0, 0.0]])
    space = axis_space()
    return identifiability(independent(W, tuple(space.names)), space, space.start())


def test_verdict_as_strict_json():
    data = result_dict(half_blind())["identifiability"]
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert list(data) == [
        "verdict",
        "n_data",
        "precision",
        "parameters",
        "informed",
        "directions",
        "covariance",
        "correlation",
        "conditioning",
    ]
    assert (data["verdict"], data["n_data"]) == ("not identifiable", 2)
    E_t, theta = data["parameters"]
    # Two coordinates of 100 per unit of ln E: 0.01 / sqrt(2), of 500 kPa.
    assert E_t["data_only"] == pytest.approx(500e3 * 0.01 / np.sqrt(2.0), rel=1e-12)
    assert (E_t["unit"], E_t["verdict"]) == ("Pa", "identifiable")
    # Bounds are no measurement: nothing is known of the angle.
    assert theta["standard_error"] is theta["ratio"] is theta["prior"] is None
    assert (E_t["asked"], theta["asked"]) == (pytest.approx(50e3), pytest.approx(0.1))
    assert E_t["ratio"] == pytest.approx(0.1 / np.sqrt(2.0))
    assert (theta["name"], theta["unit"]) == ("theta", "rad")
    assert theta["data_only"] is None
    assert theta["relative"] is None
    seen, blind = data["directions"]
    assert (seen["words"], blind["words"]) == ("E_t", "theta")
    assert blind["components"] == [0.0, 1.0]
    assert blind["ratio"] is None
    assert (data["precision"], data["informed"]) == (0.1, 1)
    assert data["conditioning"]["condition_weighted"] is None


@pytest.mark.parametrize(
    ("estimated", "used"), [(1.5, 1.5), (np.nan, 1.0), (0.0, 1.0), (1e-6, 1.0)]
)
def test_in_the_result_of_a_calibration(estimated, used):
    """With the noise of the fit, where it left any to estimate."""
    result = make_result()
    result = replaced(
        result, uncertainty=replaced(result.uncertainty, noise_scale=estimated)
    )
    outlook = assess(result).identifiability
    data = result_dict(result)["identifiability"]
    assert data == result_dict(outlook)["identifiability"]
    assert [p["name"] for p in data["parameters"]] == ["E", "nu"]
    # Six coordinates of 100 per unit of ln E, at E = 240 kPa.
    assert data["parameters"][0]["data_only"] == pytest.approx(
        240e3 * used * 0.01 / np.sqrt(6.0), rel=1e-12
    )


def test_outlook():
    data = result_dict(
        half_blind(), known=make_ranking(), name="beam", timing_s={"a": 1.0}
    )
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    made = ["source", "settings", "versions"]
    of_data = ["identifiability", "budget", "ranking", "timing_s"]
    assert list(data) == ["format", "name", *made, *of_data]
    assert (data["source"], data["settings"]) == (None, {})
    assert (data["name"], data["timing_s"]) == ("beam", {"a": 1.0})
    ranking = data["ranking"]
    assert ranking["reached"] == "Fewest that reach 10 %: turned."
    (best,) = ranking["candidates"]
    assert (best["name"], best["parameter"], best["unit"]) == ("turned", "theta", "rad")
    assert best["errors"] == [0.5, 0.1]
    assert ranking["unranked"] == [{"name": "crushed", "reason": "inverted"}]


def test_outlook_without_one_or_the_other():
    assert result_dict(half_blind())["ranking"] is None
    assert result_dict(make_ranking())["identifiability"] is None
