"""The same calibration with other constitutive laws: only the law's name changes."""

import numpy as np
import pytest
from optimisers import levenberg_marquardt

from softcal_jax.calibration import build_problem, calibrate
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import (
    Corotational,
    Fibre,
    ReducedTransverseIsotropic,
    StVenantKirchhoff,
    TransverseHyperelastic,
    TransverseIsotropic,
)
from softcal_jax.mesh import beam
from softcal_jax.robots import synthetic_measurements

FIBRE = Fibre(0.0, plane="xy")
MODULI = (700e3, 400e3)
LAWS = {
    "transverse-hyperelastic": TransverseHyperelastic(*MODULI, 0.3, 200e3, FIBRE),
    "st-venant-kirchhoff": StVenantKirchhoff(
        ReducedTransverseIsotropic(*MODULI, 0.3, FIBRE)
    ),
    "full set": Corotational(TransverseIsotropic(*MODULI, 0.3, 0.3, 200e3, FIBRE)),
}
TRUTH = {"E_t": 800e3, "E_l": 350e3, "theta": 0.4, "mu_l": 150e3}


def one_point(fields):
    """Parameters at one control point, so that the field is the same everywhere."""
    point = ControlPoints([(0.05, 0.01, 0.01)])
    modulus = {"lower": 50e3, "upper": 2e6, "unit": "Pa"}
    entries = [
        ControlPointParameters(field, point, start=start, **modulus)
        for field, start in zip(("E_t", "E_l"), MODULI, strict=True)
    ]
    entries.append(
        ControlPointParameters(
            "theta",
            point,
            start=0.1,
            lower=-np.pi / 2,
            upper=np.pi / 2,
            unit="rad",
            scale="linear",
            S=1.0,
            interpolation="director",
        )
    )
    if "mu_l" in fields:
        entries.append(ControlPointParameters("mu_l", point, start=200e3, **modulus))
    return ParameterSpace(tuple(entries), axes=[("E_l", "E_t", "theta")])


def poses():
    """Hanging and on its side, held at either end, with three markers."""
    places = {"x_min": 0.1, "x_max": 0.0}
    return tuple(
        Configuration(
            f"{held} {axis}",
            held,
            (0.0, -9.81, 0.0) if axis == "y" else (0.0, 0.0, 9.81),
            markers=Markers(
                ["centre", "corner", "middle"],
                [
                    (places[held], 0.01, 0.01),
                    (places[held], 0.02, 0.0),
                    (0.05, 0.02, 0.01),
                ],
                1e-4,
            ),
        )
        for held in places
        for axis in "yz"
    )


@pytest.mark.slow  # three calibrations that compile
@pytest.mark.parametrize(
    "name", ["transverse-hyperelastic", "st-venant-kirchhoff", "full set"]
)
def test_known_parameters_come_back(name):
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    model = build_model(mesh, LAWS[name], density=2000.0)
    fields = ["E_t", "E_l", "theta"]
    # Longitudinal shear is a constant of its own in these two.
    fields += [] if name == "st-venant-kirchhoff" else ["mu_l"]
    space = one_point(fields)
    truth = {f"{field} of CP 1": TRUTH[field] for field in fields}
    measured = synthetic_measurements(model, space, poses(), truth)
    result = calibrate(model, space, measured, noise="stated", starts=1, intervals=None)
    assert result.converged
    for parameter, value in truth.items():
        assert result.value(parameter) == pytest.approx(value, rel=1e-4)
    z, good = levenberg_marquardt(build_problem(model, space, measured))
    assert good
    np.testing.assert_allclose(z, result.z, rtol=0, atol=1e-4)
