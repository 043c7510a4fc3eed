"""Records of effectors: made with the arrays, in the order of the user."""

import numpy as np
import pytest

from softcal_jax.actuators import Cable, Guide
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Configuration,
    Markers,
    SupportReaction,
    build_mechanism,
    configuration_lanes,
)
from softcal_jax.configurations._effector import effector_row
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (5, 1, 1))
GUIDES = [Guide((0.0, 0.01, -0.005), "ground"), Guide((0.1, 0.01, 0.0), "plate")]
MECHANISM = build_mechanism(
    MESH, [RigidBody("plate", "x_max")], [Cable("cable", GUIDES)]
)
TURNED = Pose([0.0, 0.0, 0.01], [0.0, 0.2, 0.0])
ALL = (
    ActuatorForce("tension", "cable", 1.5, std=0.1),
    BodyFrame("sensor", "plate", TURNED, std=1e-4),
    SupportReaction("ground", "x_min", [1.0, 2.0, 3.0]),
    BodyAngle("angle", "plate", "plate", [0, 1, 0], 0.3),
    Centroid("middle", "x_max", [0.1, 0.01, 0.02]),
    ActuatorDisplacement("length", "cable", 2e-3),
)
SEEN_IN_XZ = Markers(["tip"], [[0.1, 0.0, 0.02]], std=2e-3, axes="xz")


@pytest.fixture(scope="module")
def lanes():
    """All kinds with values, one kind without, and nothing at all."""
    configurations = [
        Configuration(
            "all",
            "x_min",
            markers=SEEN_IN_XZ,
            measured=[[0.1, 7.0, 0.0]],
            effectors=ALL,
        ),
        Configuration("asked", "x_min", effectors=[ActuatorForce("pull", "cable")]),
        Configuration("none", "x_min"),
    ]
    return configuration_lanes(MESH, configurations, MECHANISM)


def test_names_units_and_widths_in_the_order_of_the_user(lanes):
    every, asked, none = lanes.effectors
    assert [(e.name, e.quantity, e.unit, len(e.measured)) for e in every] == [
        ("tip", "point", "m", 3),
        ("tension", "force", "N", 1),
        ("sensor", "point", "m", 3),
        ("sensor", "turn", "rad", 3),
        ("ground", "reaction", "N", 3),
        ("angle", "scalar", "rad", 1),
        ("middle", "point", "m", 3),
        ("length", "scalar", "m", 1),
    ]
    assert [e.name for e in asked] == ["pull"]
    assert none == ()


def test_each_finds_its_row_in_the_arrays(lanes):
    """Rows are stacked by quantity and padded to the same number in all lanes."""
    arrays = lanes.arrays.effectors
    for lane, records in enumerate(lanes.effectors):
        for record in records:
            weight = record.among(arrays.inverse_std[lane])
            np.testing.assert_allclose(1.0 / record.std, weight, rtol=1e-15)
            known = np.where(record.seen, record.measured, 0.0)
            stored = record.among(arrays.measured[lane])
            np.testing.assert_array_equal(known, np.where(record.seen, stored, 0.0))
            if record.quantity not in ("point", "turn"):
                last = record.index - arrays.measured.shape[1]
                assert arrays.observed[last].name == record.name
        used = [record.index for record in records]
        assert len(set(used)) == len(used)
        padding = np.delete(np.asarray(arrays.inverse_std[lane]), used, axis=0)
        assert not padding.any()


def test_what_was_not_measured_has_no_value(lanes):
    """A number on an axis that is not measured means nothing."""
    tip, *_ = lanes.effectors[0]
    np.testing.assert_array_equal(tip.seen, [True, False, True])
    np.testing.assert_array_equal(tip.measured, [0.1, np.nan, 0.0])
    np.testing.assert_array_equal(tip.error(np.full(3, 0.5)), [0.4, np.nan, 0.5])
    (pull,) = lanes.effectors[1]
    assert np.isnan(pull.measured).all()
    assert not pull.seen.any()


def test_points_at_rest(lanes):
    at_rest = {(e.name, e.quantity): e.at_rest for e in lanes.effectors[0]}
    np.testing.assert_allclose(at_rest["tip", "point"], [0.1, 0.0, 0.02], atol=1e-15)
    middle = [0.1, 0.01, 0.01]
    np.testing.assert_allclose(at_rest["middle", "point"], middle, atol=1e-15)
    np.testing.assert_allclose(at_rest["sensor", "point"], middle, atol=1e-15)
    assert np.isnan(at_rest["sensor", "turn"]).all()
    turn = lanes.effectors[0][3]
    np.testing.assert_allclose(turn.reference, TURNED.matrix)


def test_defaults_of_a_row_are_not_written_into_all_rows():
    rows = (effector_row("one", "scalar", "N", None, 1.0) for _ in range(2))
    row, other = (row.record for row in rows)
    with pytest.raises(ValueError, match="read-only"):
        row.reference[...] = 1.0
    row.measured[...] = row.std[...] = 1.0
    assert np.isnan(other.measured).all()
    assert np.isinf(other.std).all()
