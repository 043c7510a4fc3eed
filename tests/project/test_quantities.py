"""Quantities with units, and what a reader is told about the others."""

import math

import pint
import pytest
from wording import saying

from softcal_jax._units import UNITS
from softcal_jax.project import _quantities
from softcal_jax.project._quantities import parse_in_si, parse_vector


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("200 kPa", "Pa", 200e3),
        ("2e5Pa", "Pa", 2e5),
        ("0.2 N/mm^2", "Pa", 2e5),
        ("0.2 N/mm²", "Pa", 2e5),
        ("1 kgf", "N", 9.80665),
        ("-3 mm", "m", -3e-3),
        (" 1 inch ", "m", 0.0254),
        ("5 µm", "m", 5e-6),
        ("1070 kg/m^3", "kg/m3", 1070.0),
        ("1070 kg/m3", "kg/m3", 1070.0),
        ("1.07 g/cm**3", "kg/m3", 1070.0),
        ("9.81 m/s2", "m/s2", 9.81),
        ("9.81 m*s^-2", "m/s2", 9.81),
        ("-inf mm", "m", -math.inf),
        ("180 deg", "rad", math.pi),
        ("-90°", "rad", -math.pi / 2),
        ("0.5 rad", "rad", 0.5),
    ],
)
def test_scalar(text, unit, value):
    assert parse_in_si(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        (
            200000,
            "Pa",
            '200000 has no unit ... pressure ... "200 kPa"',
        ),
        (
            "0.5",
            "N",
            '0.5 has no unit ... force ... "0.51 N"',
        ),
        (
            "200 kpa",
            "Pa",
            '"200 kpa": unknown unit "kpa" ... pressure ... "200 kPa" ... mean "kPa"',
        ),
        (
            "200 kP",
            "Pa",
            '"200 kP": "kP" is not a pressure ... "200 kPa" ... mean "kPa"',
        ),
        (
            "3 furlongz",
            "m",
            '"3 furlongz": unknown unit "furlongz" ... length ... "100 mm"',
        ),
        (
            "3 mm",
            "N",
            '"3 mm": "mm" is not a force ... "0.51 N"',
        ),
        (
            "3 m//s",
            "m",
            '"3 m//s": ... unit "m//s" ... length ... "100 mm"',
        ),
        (
            20,
            "rad",
            '20 has no unit ... angle ... "20 deg"',
        ),
        (
            "20 %",
            "rad",
            '"20 %": "%" is not an angle ... "20 deg"',
        ),
        (
            True,
            "m",
            'got True ... length ... "100 mm"',
        ),
        ("long", "m", 'got "long" ... length ... "100 mm"'),
        ("nan mm", "m", 'got "nan mm" ... length ... "100 mm"'),
    ],
)
def test_bad_scalar(value, unit, message):
    with pytest.raises(ValueError, match=saying(message)):
        parse_in_si(value, unit)


@pytest.mark.parametrize(
    "value",
    [
        "(0, -15, 36.5) mm",
        "[0, -15, 3.65e1]mm",
        ["0 m", "-1.5 cm", "36.5 mm"],
    ],
)
def test_vector(value):
    assert parse_vector(value, "m") == pytest.approx((0.0, -0.015, 0.0365), rel=1e-14)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("(0, 15) mm", "got 2 numbers ... three numbers"),
        ("0, 15, 36 mm", 'got "0, 15, 36 mm" ... three numbers'),
        (
            "(0, 15, 36)",
            '"(0, 15, 36)" has no unit ... three numbers',
        ),
        ("(0, x, 36) mm", '"(0, x, 36) mm": "x" is not a number'),
        ("(0, 15, 36) N", '"(0, 15, 36) N": "N" is not a length'),
        ([0, 15, 36], "0 has no unit ... length"),
        (36, 'got 36 ... three numbers ... "(0, 0, -1) mm"'),
    ],
)
def test_bad_vector(value, message):
    with pytest.raises(ValueError, match=saying(message)):
        parse_vector(value, "m")


def test_common_units_are_those_of_pint():
    """The table that spares pint's definitions holds what these would give."""
    registry = pint.get_application_registry()
    read = lambda unit: registry.parse_units(_quantities._by_pint(unit))
    for si, units in UNITS.items():
        for unit, factor in units.items():
            assert _quantities._spelt(unit) == unit  # so that it is found there
            exact = registry.Quantity(1.0, read(unit)).to(read(si)).magnitude
            # pint multiplies its prefixes, each with a rounding error.
            assert factor == pytest.approx(exact, rel=1e-15), unit


def test_a_quantity_of_any_dimension():
    assert _quantities.recognised("(0, 15, -2) m") == ((0.0, 15.0, -2.0), "m")
    assert _quantities.recognised("2 ml") == ((2e-6,), "m3")
    values, _ = _quantities.recognised("3 psi")
    assert values == pytest.approx((20684.27,))
    for text in ("tip", "3 %", "350", "load 5 N", "x_min", "4 parsnips"):
        assert _quantities.recognised(text) is None
