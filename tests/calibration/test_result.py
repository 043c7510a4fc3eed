from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import (
    AT_REST,
    make_fit,
    make_result,
    make_simulation,
    small_model,
)
from matplotlib.figure import Figure
from wording import says

from softcal_jax.calibration import ConfigurationResult, ResidualChecks
from softcal_jax.calibration._configuration_result import configuration_results
from softcal_jax.calibration._notes import _rounding_notes
from softcal_jax.configurations import Configuration, Markers, configuration_lanes
from softcal_jax.identifiability import assess
from softcal_jax.inference import LackOfFit, Uncertainty
from softcal_jax.plotting import draw_errors, motion_words
from softcal_jax.results import held_out_sentences
from softcal_jax.results._html import chart_html
from softcal_jax.results._poses import error_charts
from softcal_jax.sensitivity import Response
from softcal_jax.sweeps._calibration import HELD_OUT, _figures


def one_fit(before, y) -> ConfigurationResult:
    """Markers seen in x and z, 20 mm down; y holds what nobody measured."""
    measured = AT_REST - np.array([0.0, 0.0, 0.02])
    measured[:, 1] = y
    markers = Markers(("left", "right"), AT_REST, axes="xz")
    configuration = Configuration("droop", "x_min", markers=markers, measured=measured)
    model = small_model()
    _, solution = make_simulation(model, (True,))
    after = jnp.asarray(AT_REST)[None]
    (fit,) = configuration_results(
        model,
        [configuration],
        configuration_lanes(model.mesh, [configuration]),
        n_fitted=0,
        before=before,
        response=Response(
            equilibrium=solution,
            effectors=after,
            W_ep=jnp.zeros((1, 6, 1)),
            displacement=None,
            ok=jnp.ones(1, bool),
        ),
        noise=None,
    )
    return fit


def test_only_measured_coordinates_count():
    for y in (np.nan, 7.0):
        fit = one_fit(jnp.asarray(AT_REST)[None], y)
        seen = [point.seen for point in fit.points]
        np.testing.assert_array_equal(seen, [[True, False, True]] * 2)
        np.testing.assert_allclose(fit.motion, 0.02, rtol=1e-12)
        np.testing.assert_allclose(fit.rms_after, 0.02, rtol=1e-12)


def test_no_equilibrium_at_the_start_has_no_distance():
    fit = one_fit(jnp.full((1, 2, 3), jnp.nan), 0.0)
    assert np.isnan(fit.rms_before)
    np.testing.assert_allclose(fit.rms_after, 0.02, rtol=1e-12)


def test_a_pose_in_balance_up_to_rounding_alone_is_noted():
    """Where there is a load: without any, rounding is all there is."""
    fit = one_fit(jnp.asarray(AT_REST)[None], 0.0)
    stopped = replace(fit, residual=3e-6, rounding=5e-6, at_rounding=True)
    idle = replace(fit, residual=0.1, rounding=1.0, at_rounding=True)
    (note,) = _rounding_notes([fit, stopped, idle])
    assert says(note, "droop", "rounding", "5.0e-06", "rtol", "3.0e-06")


def unmeasured(record):
    """The record of an effector that is followed there, but not measured."""
    return replace(record, measured=np.nan * record.std, std=np.inf * record.std)


def test_a_point_that_is_not_measured_counts_nowhere():
    """Of two markers, both 2 mm off, one was measured: not 2 mm / sqrt(2)."""
    model = small_model()
    whole = make_fit(model.mesh, "held out", "validation", (0.002, 0.0, 0.0))
    whole = replace(whole, W_ep=np.ones((2, 3, 2)))
    measured, followed = whole.points
    fit = replace(whole, effectors=(measured, unmeasured(followed)))
    np.testing.assert_allclose(fit.rms_after, 2e-3)
    np.testing.assert_allclose([fit.rms_before, fit.motion], [8e-3, 20e-3])
    np.testing.assert_allclose(fit.error_after, [[2e-3, 0.0, 0.0], [np.nan] * 3])
    assert followed.distance(followed.simulated) == fit.rms_after
    assert np.isnan(unmeasured(followed).distance(followed.simulated))
    # Over several poses each point counts once, wherever it was measured.
    far = make_fit(model.mesh, "far", "validation", (0.005, 0.0, 0.0))
    rms = np.sqrt((2.0**2 + 2 * 5.0**2) / 3)
    (sentence,) = held_out_sentences([fit, far])
    assert says(sentence, f"{rms:.2f} mm rms over 2 markers", f"{rms / 0.2:.1f} %")
    results = [make_result(model=model, fits=fits) for fits in ([fit], [whole])]
    assert make_result(fits=[fit, far]).missed == pytest.approx(rms / 20.0)
    figure = _figures(make_result(fits=[fit, far]))[HELD_OUT]
    assert figure == pytest.approx(1e-3 * rms)
    stds = [assess(result).predictions[0].std for result in results]
    assert stds[0] == pytest.approx(stds[1])


def test_a_pose_without_measured_points_has_no_distance():
    """Nor has it a dot in a chart, or a nan in a sentence."""
    model = small_model()
    fit = make_fit(model.mesh)
    bare = replace(fit, effectors=tuple(map(unmeasured, fit.effectors)), name="bare")
    assert np.isnan(
        [bare.rms_after, bare.rms_before, bare.motion, bare.turn_after]
    ).all()
    assert not bare.misfit("estimated", 1.0)
    assert motion_words(bare) == "no markers"
    held_out = replace(bare, role="validation")
    assert held_out_sentences([held_out]) == []
    result = make_result(model=model, fits=[fit, held_out])
    assert result.missed == 0.0
    assert assess(result).predictions == assess(make_result(fits=[fit])).predictions
    axes = draw_errors(Figure().subplots(), result.configurations)
    assert [word.get_text() for word in axes.get_yticklabels()] == [fit.name]
    (chart,) = error_charts(result.configurations)
    assert "nan" not in chart_html(chart)
    assert "nan" not in str(result)


@pytest.mark.parametrize(
    ("level", "probability", "beyond"),
    [(0.5, 0.99, False), (2.0, 1e-4, True), (np.nan, np.nan, True)],
    ids=["within the noise", "above it", "no noise is stated"],
)
def test_a_shared_error_within_the_stated_noise_is_not_beyond_it(
    level, probability, beyond
):
    """Poses whose markers share an error contradict the model, but not the noise."""
    shared = LackOfFit(9.0, 8, 9, 2e-3, 1.0, np.ones(1))
    checks = ResidualChecks(("droop",), shared, (), (), level, probability)
    free = Uncertainty(4e-4 * np.eye(2), "estimated", 1.5, 10, 22.5, np.zeros(2, bool))
    result = make_result(checks=checks, uncertainty=free)
    assert result.contradicted
    assert result.beyond_noise == beyond
