"""The set of moduli that a foam has, as half-planes."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from wording import saying

from softcal_jax.designs import FoamTable, foam_region, isotropic_range, published_foam
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.mesh import beam

FOAM = published_foam()


def grid(region, n=200):
    """Logarithms of (E_l, E_t) over a box around the region, and which are in it."""
    low, high = np.log([5e4, 1e5]), np.log([2e6, 5e6])
    axes = [np.linspace(a, b, n) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return points, (points @ np.asarray(region.A).T <= np.asarray(region.b)).all(axis=1)


def test_the_foam_reaches_its_region_and_little_else():
    """Inside to rounding; outside it is off, but for a thousandth at the edge."""
    points, inside = grid(foam_region(FOAM, "E_l", "E_t"))
    error = FOAM.find(*np.exp(points).T).error
    assert error[inside].max() < 1e-9
    assert np.mean(error[~inside] < 1e-9) < 0.002
    assert 0.1 < inside.mean() < 0.5


def test_what_lies_between_a_modulus_and_its_mean_is_reached_too():
    """In the core of an angle the moduli fade to their geometric mean."""
    points, inside = grid(foam_region(FOAM, "E_l", "E_t", fading=True))
    for share in (0.0, 0.5):
        middle = points.mean(axis=1, keepdims=True)
        faded = middle + share * (points - middle)
        assert FOAM.find(*np.exp(faded[inside]).T).error.max() < 1e-9


def test_a_stiff_axis_swaps_the_fields():
    soft, stiff = FOAM.E_soft, FOAM.E_stiff
    phasor = FoamTable("Phasor", FOAM.density, FOAM.anisotropy, soft, stiff)
    assert foam_region(phasor, "E_l", "E_t").fields == ("E_t", "E_l")
    assert foam_region(FOAM, "E_l", "E_t").fields == ("E_l", "E_t")


def test_a_hollow_set_loses_what_lies_beyond_its_hollow():
    """Three levels, of which the middle one is bent inwards."""
    density = np.tile([0.1, 0.2, 0.4], 3)
    shrink = np.repeat([0.2, 0.5, 1.0], 3)
    soft = 1e6 * density * np.repeat([0.1, 0.4, 1.0], 3)
    stiff = 1e6 * density * np.repeat([8.0, 1.2, 1.0], 3)
    hollow = FoamTable("Polyfoam", density, shrink, soft, stiff)
    points, inside = grid(foam_region(hollow, "E_l", "E_t"))
    error = hollow.find(*np.exp(points).T).error
    assert inside.any()
    assert error[inside].max() < 1e-6
    assert np.sum(~inside & (error < 1e-9)) > 0.05 * inside.sum()


def test_the_isotropic_foam_is_that_of_the_table():
    moduli = FOAM.E_soft[FOAM.anisotropy == 1.0]
    assert isotropic_range(FOAM) == pytest.approx((moduli.min(), moduli.max()))


def test_one_level_is_no_region():
    level = FOAM.anisotropy == 0.2
    moduli = FOAM.E_soft[level], FOAM.E_stiff[level]
    one = FoamTable("Polyfoam", FOAM.density[level], FOAM.anisotropy[level], *moduli)
    with pytest.raises(ValueError, match=saying("one shrink", "add samples")):
        foam_region(one, "E_l", "E_t")
    with pytest.raises(ValueError, match=saying("no isotropic", "samples", "shrink 1")):
        isotropic_range(one)


def fields(**options):
    points = ControlPoints({"a": (0.0, 0.5, 0.5), "b": (4.0, 0.5, 0.5)})
    known: dict[str, Any] = {"scale": "log", "interpolation": "log"} | options
    return [
        ControlPointParameters(field, points, 3e5, 5e4, 5e6, **known)
        for field in ("E_l", "E_t")
    ]


def test_no_tet_between_control_points_leaves_the_region():
    """Random values are drawn into it at the control points; the mesh follows."""
    region = foam_region(FOAM, "E_l", "E_t")
    entries = fields()
    space = ParameterSpace(entries, regions=[region])
    mesh, random = beam(4.0, 1.0, 1.0, (8, 1, 1)), np.random.default_rng(0)
    A, b = map(np.asarray, space.rows())
    assert A.shape == (2 * len(region.b), 4)
    for _ in range(20):
        asked = space.to_scaled(jnp.exp(random.uniform(np.log(5e4), np.log(5e6), 4)))
        z = np.asarray(space.admissible(asked))
        assert np.all(A @ z <= b + 1e-12)
        values = dict(zip(space.names, jnp.exp(z), strict=True))
        E_l, E_t = (entry.evaluate(mesh, values) for entry in entries)
        assert FOAM.find(np.asarray(E_l), np.asarray(E_t)).error.max() < 1e-9


@pytest.mark.parametrize("option", [{"interpolation": "linear"}, {"scale": "linear"}])
def test_other_interpolations_could_leave_it(option):
    region = foam_region(FOAM, "E_l", "E_t")
    message = saying('scale="log"', 'interpolation="log"', "Polyfoam")
    with pytest.raises(ValueError, match=message):
        ParameterSpace(fields(**option), regions=[region])
