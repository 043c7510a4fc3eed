from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from export.handmade import AT_REST, make_simulation, small_model
from wording import says

from softcal_jax.calibration import ConfigurationResult
from softcal_jax.calibration._configuration_result import configuration_results
from softcal_jax.calibration._notes import _rounding_notes
from softcal_jax.configurations import Configuration, Markers, configuration_lanes
from softcal_jax.sensitivity import Response


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
