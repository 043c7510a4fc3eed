import jax.numpy as jnp
import numpy as np
from export.handmade import AT_REST, make_simulation, small_model

from softcal_jax.calibration import ConfigurationFit
from softcal_jax.calibration._fits import configuration_fits
from softcal_jax.configurations import Configuration, Markers


def one_fit(before, y) -> ConfigurationFit:
    """Markers seen in x and z, 20 mm down; y holds what nobody measured."""
    measured = AT_REST - np.array([0.0, 0.0, 0.02])
    measured[:, 1] = y
    markers = Markers(("left", "right"), AT_REST, axes="xz")
    configuration = Configuration("droop", "x_min", markers=markers, measured=measured)
    model = small_model()
    _, solution = make_simulation(model, (True,))
    after = jnp.asarray(AT_REST)[None]
    fits = configuration_fits(
        model, [configuration], "validation", before, after, solution
    )
    return fits[0]


def test_only_measured_coordinates_count():
    for y in (np.nan, 7.0):
        fit = one_fit(jnp.asarray(AT_REST)[None], y)
        np.testing.assert_array_equal(fit.seen, [[True, False, True]] * 2)
        np.testing.assert_allclose(fit.motion, 0.02, rtol=1e-12)
        np.testing.assert_allclose(fit.rms_after, 0.02, rtol=1e-12)


def test_no_equilibrium_at_the_start_has_no_distance():
    fit = one_fit(jnp.full((1, 2, 3), jnp.nan), 0.0)
    assert np.isnan(fit.rms_before)
    np.testing.assert_allclose(fit.rms_after, 0.02, rtol=1e-12)
