"""Change between neighbouring control points: who they are, and what it counts."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_design import LENGTH, MIDDLE, MODEL

from softcal_jax.designs import Change
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace

THREE = ControlPoints(
    {
        name: (x * LENGTH, MIDDLE, MIDDLE)
        for name, x in zip("abc", (0, 0.5, 1), strict=True)
    }
)
TURN = {"interpolation": "director", "scale": "linear", "S": 0.5, "unit": "rad"}
QUARTER = np.pi / 2


def fields(**fixed):
    return ParameterSpace(
        [
            ControlPointParameters(
                "E_t", THREE, 4e5, 1e5, 5e6, interpolation="log", fixed=fixed
            ),
            ControlPointParameters("theta", THREE, 0.1, -QUARTER, QUARTER, **TURN),
        ]
    )


def test_neighbours_share_tets():
    """Along a beam, each control point with the next."""
    entry = fields().entries[0]
    assert entry.neighbours(MODEL.mesh) == [("a", "b"), ("b", "c")]


def test_differences_count_in_their_unit():
    """Logarithms of ratios, and angles the short way round: 85 to -85 degrees is 10."""
    space, change = fields(), Change(0.2, np.deg2rad(20.0))
    likeness = change.likeness(MODEL, space)
    p = [4e5, 8e5, 2e5, *np.deg2rad([85.0, -85.0, -75.0])]
    z = space.to_scaled(jnp.asarray(p))
    found, slopes = map(np.asarray, likeness.rows(z))
    ratios = np.log([0.5, 4.0]) / 0.2
    np.testing.assert_allclose(found, [*ratios, -0.5, -0.5], atol=1e-12)
    step = 1e-3 * np.random.default_rng(0).standard_normal(6)
    moved, _ = likeness.rows(z + step)
    np.testing.assert_allclose(moved, found + slopes @ step, atol=1e-12)


def test_a_known_neighbour_counts():
    space = fields(b=4e5)
    likeness = Change(moduli=0.1).likeness(MODEL, space)
    z = space.to_scaled(jnp.asarray([8e5, 2e5, 0.0, 0.0, 0.0]))
    found, _ = likeness.rows(z)
    np.testing.assert_allclose(found, np.log([2.0, 2.0]) / 0.1)


@pytest.mark.parametrize("change", [Change(moduli=0.1), Change(angle=0.1)])
def test_only_what_has_a_change_counts(change):
    assert len(change.likeness(MODEL, fields()).std) == 2
