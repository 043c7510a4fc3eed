import math

import pytest

from softcal_jax._units import readable_estimate, readable_unit

NAN = math.nan


@pytest.mark.parametrize(
    ("values", "unit", "expected"),
    [
        ([2.6e5], "Pa", (1e-3, "kPa")),
        ([2.6e5, 1.2e6], "Pa", (1e-6, "MPa")),
        ([-2.0e9], "Pa", (1e-9, "GPa")),
        ([12.0], "Pa", (1.0, "Pa")),
        ([0.0, NAN], "Pa", (1.0, "Pa")),
        ([0.02], "m", (1e3, "mm")),
        ([1070.0], "kg/m3", (1.0, "kg/m3")),
        ([0.4], "", (1.0, "")),
        ([0.5, -1.0], "rad", (180.0 / math.pi, "deg")),
        ([], "Pa", (1.0, "Pa")),
    ],
)
def test_readable_unit(values, unit, expected):
    assert readable_unit(values, unit) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("value", "error", "unit", "text"),
    [
        (286148.0, 5924.6, "Pa", "286.1 ± 5.9 kPa"),
        (286148.0, 59246.0, "Pa", "286 ± 59 kPa"),
        (286148.0, 592460.0, "Pa", "290 ± 590 kPa"),
        (0.4312, 0.0123, "", "0.431 ± 0.012"),
        (0.4312, 1e-12, "", "0.4312 ± 1.0e-12"),
        (286148.0, NAN, "Pa", "286.1 kPa"),
        (286148.0, 0.0, "Pa", "286.1 ± 0 kPa"),
        (1070.0, 0.996, "kg/m3", "1070.0 ± 1.0 kg/m3"),
        (math.radians(-33.94), math.radians(0.123), "rad", "-33.94 ± 0.12 deg"),
    ],
)
def test_readable_estimate(value, error, unit, text):
    assert readable_estimate(value, error, unit) == text
