"""What a user may get wrong about bodies and actuators, and what is answered."""

import functools

import numpy as np
import pytest

from softcal_jax.actuators import Cable, Guide, Motor, SurfacePressure
from softcal_jax.bodies import BodyState, Pose, RigidBody, body_arrays, hinge_axes
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    build_mechanism,
    configuration_arrays,
)
from softcal_jax.mesh import beam

MESH = beam(0.1, 0.02, 0.02, (4, 1, 1))
ROOT, TIP = RigidBody("root", "x_min"), RigidBody("tip", "x_max")
MIDDLE = np.flatnonzero(np.isclose(MESH.points[:, 0], 0.05))
FLAP = RigidBody("flap", MIDDLE, tied_to="tip")
ACTUATORS = (
    Cable("cable", (Guide((0.0, 0.0, 0.1), "ground"), (0.08, 0.01, 0.01))),
    Motor("motor", "root"),
    SurfacePressure("pressure", "z_max"),
)


@functools.cache
def mechanism():
    return build_mechanism(MESH, (ROOT, TIP, FLAP), ACTUATORS)


def refused(message, *, supports=(), **asked):
    configuration = Configuration("one", supports, **asked)
    with pytest.raises(ValueError, match=message):
        configuration_arrays(MESH, [configuration], mechanism())


def test_good_input():
    configuration = Configuration(
        "one", actuation={"cable": ImposedForce(1.0)}, bodies={"tip": "held"}
    )
    arrays = configuration_arrays(MESH, [configuration], mechanism())
    # Of the motor nothing is asked: it stands at zero.
    np.testing.assert_array_equal(arrays.actuation.by_displacement, [[0, 1, 0]])
    np.testing.assert_array_equal(arrays.actuation.value, [[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("actuation", "message"),
    [
        ({"cabel": ImposedForce(1.0)}, "actuator .*'one'.*'cabel'"),
        ({"cable": ImposedForce(-1.0)}, "value -1 N.*only pulls"),
        ({"cable": ImposedForce(np.nan)}, "'cable' has the value nan N"),
        ({"cable": ImposedDisplacement(np.inf)}, "value inf m.*finite"),
        ({"motor": ImposedDisplacement(45.0)}, "value 45 rad.*np.deg2rad"),
        (
            {"pressure": ImposedDisplacement(1.0)},
            r"'pressure' .*no displacement.*ImposedForce\(...\) \[Pa\]",
        ),
    ],
)
def test_bad_actuation(actuation, message):
    refused(message, actuation=actuation)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ({"tipp": "held"}, "body .*'one'.*'tipp'"),
        ({"flap": "held"}, "'flap' is tied to 'tip'"),
        ({"root": Pose()}, "'root' is turned by motor 'motor'"),
    ],
)
def test_bad_states_of_bodies(bodies, message):
    refused(message, bodies=bodies)


def test_hinge_of_a_torque_needs_a_balance():
    """Weight, a load or another actuator; without any it turns and turns."""
    torque = {"motor": ImposedForce(1e-3)}
    nothing = (0.0, 0.0, 0.0)
    message = "1 of the 6 .*'motor' .*torque"
    refused(message, actuation=torque, gravity=nothing)
    pulled = torque | {"cable": ImposedForce(1.0)}
    for c in (
        Configuration("weight", actuation=torque),
        Configuration("cable", actuation=pulled, gravity=nothing),
        Configuration("clamp", "x_max", actuation=torque, gravity=nothing),
    ):
        bare = build_mechanism(MESH, (ROOT,), ACTUATORS)
        configuration_arrays(MESH, [c], bare)


def test_support_on_a_body():
    refused("4 nodes of rigid bodies, .*'tip'", supports="x_max")


def test_bad_poses():
    with pytest.raises(ValueError, match=r"90 rad,.*np\.deg2rad"):
        Pose(rotation_vector=(0.0, 0.0, 90.0))
    with pytest.raises(ValueError, match=r"mirrors space, got \[\[ 1"):
        Pose.from_matrix(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    with pytest.raises(ValueError, match=r"3 x 3 matrix.*got \[\[2"):
        Pose.from_matrix(2.0 * np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match=r"'fixed'.*'absent', .*'hinged', 'sliding'"):
        BodyState("fixed")
    with pytest.raises(ValueError, match=r"is free .*\[0.0, 0.1, 0.0\] m.* Hold"):
        BodyState("free", Pose((0.0, 0.1, 0.0)))
    with pytest.raises(ValueError, match=r"is hinged .*\[0.5, 0.0, 0.0\] rad.* Hold"):
        BodyState("hinged", Pose(rotation_vector=(0.5, 0.0, 0.0)))


def test_bad_bodies(unchecked):
    with pytest.raises(ValueError, match=r"mass .*'a' .*not negative.* -1"):
        RigidBody("a", "x_min", mass=-1.0)
    with pytest.raises(ValueError, match=r"origin .*'a' .*\[m\].* nan"):
        RigidBody("a", "x_min", origin=(0.0, np.nan, 0.0))
    with pytest.raises(ValueError, match=r"right-handed.*`hinge_axes`"):
        RigidBody("a", "x_min", axes=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ValueError, match=r"'a' .*tied to itself"):
        RigidBody("a", "x_min", tied_to="a")
    with pytest.raises(ValueError, match=r"a hinge .*all zero"):
        hinge_axes((0.0, 0.0, 0.0))


def test_axes_of_a_hinge():
    for axis in ([0.0, 0.0, 2.0], [1.0, -2.0, 0.5], [-1.0, 0.0, 0.0]):
        axes = hinge_axes(axis)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(axes[2], axis / np.linalg.norm(axis), atol=1e-15)
        np.testing.assert_allclose(np.linalg.det(axes), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ((ROOT, ROOT), "'root' .*another name"),
        ((ROOT, RigidBody("b", "y_min")), "'root' and 'b' share 2 nodes"),
        ((RigidBody("b", "nowhere"),), "'b': .*group 'nowhere'"),
        ((RigidBody("b", np.array([0, 1])),), "'b' holds 2 nodes .*Support"),
        ((RigidBody("b", "x_min", tied_to="tip"),), "tied_to of body 'b' 'tip'"),
        (
            (
                ROOT,
                RigidBody("b", "x_max", tied_to="root"),
                RigidBody("c", MIDDLE, tied_to="b"),
            ),
            "'c' is tied to 'b', .* 'root'",
        ),
    ],
)
def test_bodies_that_do_not_fit(bodies, message):
    with pytest.raises(ValueError, match=message):
        body_arrays(MESH, bodies)


@pytest.mark.parametrize(
    ("motors", "message"),
    [
        (("root", "root"), "'m1' turns 'root'.* motor 'm0'"),
        (("flap",), "'flap', .*let it turn 'tip'"),
        (("hip",), "'hip'.* mean 'tip'"),
    ],
)
def test_bad_motors(motors, message):
    actuators = [Motor(f"m{k}", body) for k, body in enumerate(motors)]
    with pytest.raises(ValueError, match=message):
        build_mechanism(MESH, (ROOT, TIP, FLAP), actuators)
