"""Actuators in equilibrium: forces and displacements imposed, slack cables, motors.

One arm on a motor, with a plate at its tip, two cables and a force.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import (
    LENGTH,
    NO_GRAVITY,
    SIDE,
    TIGHT,
    arrays,
    both_ways_at,
    positions,
    solve,
    solved,
    strip,
    values_of,
)
from problems import assert_second_order

from softcal_jax.actuators import Cable, ForceActuator, Guide, Motor
from softcal_jax.bodies import RigidBody, hinge_axes
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyFrame,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
)
from softcal_jax.equilibrium import EquilibriumSolution, build_model, linearise
from softcal_jax.materials import NeoHookean

DENSITY, G = 1000.0, 9.81
MESH = strip(6)
MIDDLE = SIDE / 2
ROOT_AXIS = np.array([0.0, -0.03, MIDDLE])  # of the motor's hinge, behind the beam
BODIES = (
    RigidBody("root", "at 0", origin=ROOT_AXIS, axes=hinge_axes((0.0, 1.0, 0.0))),
    RigidBody("tip", "at 6"),
)
ACTUATORS = (
    Cable(
        "top",
        (
            Guide((-0.01, MIDDLE, 0.04), "ground"),
            (LENGTH / 2, MIDDLE, SIDE),
            Guide((LENGTH, MIDDLE, SIDE), "tip"),
        ),
    ),
    Cable("side", (Guide((0.0, 0.05, 0.0), "ground"), (LENGTH * 2 / 3, SIDE, 0.005))),
    ForceActuator("push", (LENGTH / 2, MIDDLE, 0.0), (0.0, 1.0, 2.0)),
    Motor("motor", "root"),
)
NAMES = tuple(actuator.name for actuator in ACTUATORS)
MODEL = build_model(
    MESH, NeoHookean(3e5, 0.3), density=DENSITY, bodies=BODIES, actuators=ACTUATORS
)
# Rows of the effectors: the frame's point and turn, then delta_a, then lambda_a.
EFFECTORS = (
    BodyFrame("tip", "tip"),
    *(ActuatorDisplacement(f"delta {name}", name) for name in NAMES),
    *(ActuatorForce(f"lambda {name}", name) for name in NAMES),
)
# Hanging down far enough that the arm is stable with the torque imposed, too.
ANGLE = 0.6
FORCES = {
    "top": ImposedForce(0.2),
    "side": ImposedForce(0.1),
    "push": ImposedForce(-0.1),
    "motor": ImposedDisplacement(ANGLE),
}


def driven(gravity=(0.0, 0.0, -G), **actuation) -> Configuration:
    return Configuration(
        "driven", gravity=gravity, actuation=actuation, effectors=EFFECTORS
    )


def read(values):
    """delta_a and lambda_a by name."""
    first, second = values[2:6, 0], values[6:10, 0]
    return dict(zip(NAMES, first, strict=True)), dict(zip(NAMES, second, strict=True))


def same_state(one, other):
    # Both solved to 1e-12 of the forces; the softest mode is 1e3 times softer.
    np.testing.assert_allclose(
        one.displacement, other.displacement, rtol=0, atol=1e-9 * LENGTH
    )


@pytest.fixture(scope="module")
def by_force():
    return solved(MODEL, driven(**FORCES), TIGHT)


@pytest.mark.parametrize(
    "names", [("top",), ("push",), ("top", "side"), ("top", "side", "push")]
)
def test_displacement_imposed_gives_back_the_force(by_force, names):
    """delta_a of an imposed lambda_a, imposed in turn, has that lambda_a."""
    reference, values, _ = by_force
    delta, _ = read(values)
    asked = FORCES | {name: ImposedDisplacement(delta[name]) for name in names}
    solution, again, _ = solved(MODEL, driven(**asked), TIGHT)
    same_state(solution, reference)
    # Stable on the steps that leave delta_a alone, and found so.
    assert int(solution.n_negative) == 0
    for k, name in enumerate(NAMES[:3]):
        expected = FORCES[name].value if name in names else 0.0
        np.testing.assert_allclose(solution.multipliers[k], expected, atol=1e-8)
        np.testing.assert_allclose(read(again)[1][name], FORCES[name].value, rtol=1e-7)
        np.testing.assert_allclose(read(again)[0][name], delta[name], atol=1e-11)


def test_torque_that_holds_an_angle_gives_it_back(by_force):
    reference, values, _ = by_force
    torque = read(values)[1]["motor"]
    asked = driven(**FORCES | {"motor": ImposedForce(torque)})
    near = solved(MODEL, driven(**FORCES | {"motor": ImposedDisplacement(0.5)}))[0]
    solution, again, _ = solved(MODEL, asked, TIGHT, near.displacement)
    same_state(solution, reference)
    np.testing.assert_allclose(read(again)[0]["motor"], ANGLE, rtol=1e-9)
    np.testing.assert_allclose(read(again)[1]["motor"], torque, rtol=1e-14)


@pytest.mark.parametrize("angle", [0.6, 1.1, 1.5, 1.9])
def test_torque_turns_the_arm_from_rest(angle):
    """Far, and past the edge on which it stands: at rest no torque balances it."""
    asked = driven(motor=ImposedDisplacement(angle))
    reference, values, _ = solved(MODEL, asked, TIGHT)
    torque = ImposedForce(read(values)[1]["motor"])
    solution, again, _ = solved(MODEL, driven(motor=torque), TIGHT)
    same_state(solution, reference)
    np.testing.assert_allclose(read(again)[0]["motor"], angle, rtol=1e-7)
    assert int(solution.n_negative) == 0


def test_torque_of_a_motor_balances_weight_and_force():
    """Moments of all loads about the hinge, on the arm as it has bent."""
    asked = {"motor": ImposedDisplacement(0.3), "push": ImposedForce(0.2)}
    solution, values, _ = solved(MODEL, driven(**asked), TIGHT)
    x, X = positions(MODEL, solution), MESH.points
    volumes = np.abs(np.linalg.det(X[MESH.tets][:, 1:] - X[MESH.tets][:, :1])) / 6.0
    weights = DENSITY * volumes[:, None] * np.array([0.0, 0.0, -G])
    node = np.flatnonzero(np.isclose(X, (LENGTH / 2, MIDDLE, 0.0)).all(axis=1))
    assert node.size == 0  # on an edge of the section: the mean of its two corners
    corners = np.isclose(X[:, 0], LENGTH / 2) & np.isclose(X[:, 2], 0.0)
    point = x[: MESH.n_nodes][corners].mean(axis=0)
    force = 0.2 * np.array([0.0, 1.0, 2.0]) / 5**0.5
    moment = np.cross(x[MESH.tets].mean(axis=1) - ROOT_AXIS, weights).sum(axis=0)
    moment += np.cross(point - ROOT_AXIS, force)
    torque = read(values)[1]["motor"]
    np.testing.assert_allclose(torque, -moment[1], rtol=1e-8)
    assert abs(torque) > 1e-3


def test_angle_of_a_motor_has_its_error_of_zero():
    """A motor at 0.2 rad that stands 0.1 rad off is one at 0.3 rad.

    Its encoder does not know, and shows what was asked for.
    """
    off = eqx.tree_at(
        lambda m: m.mechanism.motor_zero, MODEL, jnp.array([0.0, 0.0, 0.0, 0.1])
    )
    one, values, _ = solved(off, driven(motor=ImposedDisplacement(0.2)), TIGHT)
    other, _, _ = solved(MODEL, driven(motor=ImposedDisplacement(0.3)), TIGHT)
    same_state(one, other)
    np.testing.assert_allclose(read(values)[0]["motor"], 0.2, rtol=1e-14)


def test_a_slack_cable_has_no_force():
    """Let out by more than the arm's weight pulls, it changes nothing."""
    free, values, _ = solved(MODEL, driven(), TIGHT)
    needed = read(values)[0]["top"]
    assert needed < -1e-4  # the weight pulls it longer
    slack = ImposedDisplacement(1.5 * needed)
    solution, values, _ = solved(MODEL, driven(top=slack), TIGHT)
    same_state(solution, free)
    assert read(values)[1]["top"] == 0.0
    np.testing.assert_array_equal(solution.multipliers, 0.0)
    # Let out by less, it carries; and more of it the less it is let out.
    tensions = []
    for share in (0.9, 0.5, 0.0):
        taut = ImposedDisplacement(share * needed)
        _, values, _ = solved(MODEL, driven(top=taut), TIGHT)
        tensions.append(read(values)[1]["top"])
        np.testing.assert_allclose(read(values)[0]["top"], share * needed, atol=1e-11)
    assert 0.0 < tensions[0] < tensions[1] < tensions[2]


@pytest.mark.parametrize("load", [1e-7, 1.0])
def test_a_cable_becomes_taut_under_another_load(load):
    """At once under a load so small that one Newton step is all it takes."""
    asked = {"top": ImposedDisplacement(0.0), "push": ImposedForce(-load)}
    solution, values, _ = solved(MODEL, driven(gravity=NO_GRAVITY, **asked))
    assert read(values)[1]["top"] > 1e-2 * load
    np.testing.assert_allclose(read(values)[0]["top"], 0.0, atol=1e-9 * load)
    assert bool(solution.converged)
    # And slack again where the load lifts the arm.
    asked = asked | {"push": ImposedForce(load)}
    _, values, _ = solved(MODEL, driven(gravity=NO_GRAVITY, **asked))
    assert read(values)[1]["top"] == 0.0
    assert read(values)[0]["top"] > 0.0


@jax.jit
def compliance(model, lane, u):
    lin = linearise(model, lane, u)
    force, gap = jnp.zeros((1, model.n_dof)), jnp.zeros((1, lin.system.active.size))
    return lin.system.solve(model.solver, force, gap).W_aa


class Inputs(NamedTuple):
    """What is varied."""

    value: jax.Array
    motor_zero: jax.Array


def _inputs(both):
    return Inputs(both[1].actuation.value, both[0].mechanism.motor_zero)


def sensors(inputs, both):
    model, lane, guess = both
    return values_of(model, lane, guess, _inputs, inputs)


forward_and_reverse = both_ways_at(sensors)


class Start(NamedTuple):
    """An equilibrium: which actuators have forces, its inputs, and where it is."""

    kind: str
    both: tuple
    inputs: Inputs
    solution: EquilibriumSolution

    def derivatives(self, tangent, cotangent=None):
        if cotangent is None:
            cotangent = np.zeros(self.both[1].effectors.measured.shape)
        return jax.tree.map(
            np.asarray,
            forward_and_reverse(
                self.solution, self.inputs, tangent, cotangent, self.both
            ),
        )


OTHERS = [pytest.param(n, marks=pytest.mark.slow) for n in ("displacements", "torque")]
"""More programs of the same kind."""


@pytest.fixture(scope="module", params=["forces", *OTHERS])
def start(request, by_force):
    delta, lambda_a = read(by_force[1])
    asked = (
        FORCES
        | {
            "forces": {},
            "displacements": {
                n: ImposedDisplacement(delta[n]) for n in ("top", "push")
            },
            "torque": {"motor": ImposedForce(lambda_a["motor"])},
        }[request.param]
    )
    lane = arrays(MODEL, driven(**asked))
    # From next to the solution: a hinge turns far under small changes of its torque.
    both = (MODEL, lane, by_force[0].displacement)
    inputs = jax.tree.map(np.asarray, _inputs(both[:2]))
    return Start(request.param, both, inputs, solve(*both, TIGHT)[0])


def direction(start, a):
    """A step of one actuator: a third of its force or angle, or what that moves."""
    lengths = start.both[1].actuation.by_displacement[a] & (a < 3)
    size = 1e-4 if lengths else 0.3 * start.inputs.value[a]
    return Inputs(size * np.eye(4)[a], np.zeros(4))


@pytest.mark.parametrize("a", range(4), ids=NAMES)
def test_derivatives_meet_differences_at_second_order(start, a):
    tangent = direction(start, a)
    jvp, _ = start.derivatives(tangent)
    assert np.max(np.abs(jvp)) > 1e-4
    function = lambda inputs: np.asarray(sensors(inputs, start.both))
    assert_second_order(function, start.inputs, tangent, jvp, (0.2, 0.1))


def test_derivative_by_the_error_of_zero_is_that_by_the_angle(start):
    """But for the encoder of the motor, which shows the angle without it."""
    of_zero = Inputs(np.zeros(4), np.eye(4)[3])
    of_angle = Inputs(np.eye(4)[3], np.zeros(4))
    one = np.array(start.derivatives(of_zero)[0])
    torque = start.kind == "torque"
    np.testing.assert_allclose(one[5, 0], -1.0 * torque, atol=1e-15)
    one[5, 0] += 1.0
    if torque:  # no angle is imposed
        np.testing.assert_array_equal(one, 0.0)
    else:
        assert np.max(np.abs(one)) > 1e-2
        np.testing.assert_allclose(one, start.derivatives(of_angle)[0], rtol=1e-12)


def test_forward_equals_reverse(start):
    value = sum(direction(start, a).value for a in range(4))
    tangent = Inputs(value, np.array([0.0, 0.0, 0.0, 0.1]))
    shape = start.both[1].effectors.measured.shape
    cotangent = np.random.default_rng(5).normal(size=shape)
    forward, reverse = start.derivatives(tangent, cotangent)
    products = [np.vdot(a, b) for a, b in zip(reverse, tangent, strict=True)]
    # Both solve with the same factor; rounding times its condition remains.
    np.testing.assert_allclose(sum(products), np.vdot(cotangent, forward), rtol=1e-9)


def test_actuator_compliance_is_positive_definite_and_what_it_says(start, by_force):
    """W_aa = d delta_a / d lambda_a with forces imposed, and its inverse otherwise."""
    kind = start.kind
    solution, _, lane = by_force
    W = np.asarray(compliance(MODEL, lane, solution.displacement))[:3, :3]
    # The matrix is solved for by columns: rounding times its condition.
    np.testing.assert_allclose(W, W.T, rtol=0, atol=1e-9 * np.abs(W).max())
    assert np.linalg.eigvalsh(W).min() > 1e-4 * np.linalg.eigvalsh(W).max()
    columns = [Inputs(np.eye(4)[a], np.zeros(4)) for a in range(3)]
    slopes = np.stack([start.derivatives(one)[0] for one in columns], axis=-1)
    by_delta, by_lambda = slopes[2:5, 0], slopes[6:9, 0]
    if kind == "forces":
        np.testing.assert_allclose(by_delta, W, rtol=0, atol=1e-9 * np.abs(W).max())
        np.testing.assert_allclose(by_lambda, np.eye(3), atol=1e-12)
    if kind == "displacements":
        S = W[np.ix_([0, 2], [0, 2])]
        stiffness = by_lambda[np.ix_([0, 2], [0, 2])]
        np.testing.assert_allclose(stiffness @ S, np.eye(2), atol=1e-8)
        np.testing.assert_allclose(
            by_delta[np.ix_([0, 2], [0, 2])], np.eye(2), atol=1e-8
        )
