"""A beam whose end plate is held far round: bent to a large part of a circle.

In pure bending a straight beam becomes an arc of constant length, whatever its law.
"""

from functools import cache
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import NO_GRAVITY, TIGHT, arrays, solve
from problems import nearest_node

from softcal_jax.actuators import AbstractActuator, Kind, Motor
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import BodyFrame, Configuration, ImposedForce, Support
from softcal_jax.equilibrium import (
    RESULTS,
    LoadPath,
    NewtonSettings,
    build_model,
    linearise,
    trace_equilibria,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

LENGTH, SIDE, E = 0.1, 0.01, 5e5
MIDDLE = (0.5 * LENGTH, 0.5 * SIDE, 0.5 * SIDE)
MIDDLE_OF_END = (LENGTH, 0.5 * SIDE, 0.5 * SIDE)


@cache
def robot(width=SIDE, height=SIDE):
    mesh = beam(LENGTH, width, height, (10, 1, 1), order=2)
    plate = RigidBody("plate", "x_max", origin=(LENGTH, 0.5 * width, 0.5 * height))
    law = Corotational(Isotropic(E, 0.3))
    return build_model(mesh, law, density=0.0, bodies=[plate])


def arc(angle, length=LENGTH):
    return length * np.array([np.sin(angle), 0.0, 1.0 - np.cos(angle)]) / angle


def bent(turn, model=None):
    """The plate held where a share of a whole circle ends."""
    angle = 2.0 * np.pi * turn
    pose = Pose(arc(angle) - [LENGTH, 0.0, 0.0], (0.0, -angle, 0.0))
    plate = BodyFrame("plate", "plate")
    held = Configuration(
        "bent", "x_min", NO_GRAVITY, bodies={"plate": pose}, effectors=[plate]
    )
    return arrays(robot() if model is None else model, held)


def from_rest(
    turn,
    settings=NewtonSettings(),  # noqa: B008 (it is immutable)
    model=None,
):
    model = robot() if model is None else model
    return solve(model, bent(turn, model), None, settings)[0]


@jax.jit
def frame_origin(model, lane, load):
    """Where the frame of the first body is held at a share of the load."""
    rest = jnp.zeros((model.n_points, 3))
    there = linearise(model, lane, rest).posed.at_load(load).held_at(rest)
    return model.positions(there)[model.mesh.n_nodes]


CENTRE = [0.0, 0.5 * SIDE, 0.5 * SIDE]
BASE = RigidBody("base", "x_min", origin=CENTRE)


@pytest.mark.parametrize(
    ("bases", "how"),
    [
        ((), {"supports": "x_min"}),
        ((), {"supports": Support("x_min", stiffness=1e9)}),
        ((BASE,), {"bodies": {"base": "held"}}),
    ],
)
def test_the_path_is_an_arc_from_where_the_beam_is_held(bases, how):
    """By a clamp, by springs, or by another body."""
    bodies = [RigidBody("plate", "x_max", origin=MIDDLE_OF_END), *bases]
    model = build_model(robot().mesh, robot().law, density=0.0, bodies=bodies)
    angle = 1.5 * np.pi
    pose = Pose(arc(angle) - [LENGTH, 0.0, 0.0], (0.0, -angle, 0.0))
    held = {"plate": pose, **how.get("bodies", {})}
    how = {"gravity": NO_GRAVITY, **how, "bodies": held}
    lane = arrays(model, Configuration("held", **how))
    for load in (0.3, 0.8, 1.0):
        plate = frame_origin(model, lane, jnp.asarray(load))
        np.testing.assert_allclose(plate, arc(load * angle) + CENTRE, atol=1e-9)


@pytest.mark.parametrize(("turn", "off"), [(0.25, 0.01), (0.75, 0.01), (0.9, 0.02)])
def test_the_beam_becomes_an_arc(turn, off):
    """Close to a whole ring, which may swing; see below."""
    solution = from_rest(turn)
    assert bool(solution.converged), RESULTS[solution.result]
    assert int(solution.n_negative) == 0
    # On a straight line to three quarters of a circle there was no solution.
    assert int(solution.steps) < 80
    angle = 2.0 * np.pi * turn
    # No load step turns the plate by more than a radian, which crushes tets.
    assert int(solution.load_steps) >= int(angle)
    node = nearest_node(robot().mesh, MIDDLE)
    position = (
        np.asarray(solution.displacement[node])
        + MIDDLE
        - np.array([0.0, 0.5 * SIDE, 0.5 * SIDE])
    )
    # Ten cells of quadratic tets, and a section that curves across, too.
    expected = arc(0.5 * angle, 0.5 * LENGTH)
    np.testing.assert_allclose(position, expected, rtol=0, atol=off * LENGTH)


class Couple(AbstractActuator):
    """A torque about the third axis of a free body, which is fixed in space."""

    body: str
    kind: ClassVar[Kind] = Kind("couple", "N m", "rad")

    def cliques(self, rest, owner):
        return Motor(self.label, self.body).cliques(rest, owner)


def test_a_couple_rolls_the_beam_up():
    """In one load step, as what turns with the plate is foreseen along its tangents.

    One side stays in its plane: a couple that does not follow pushes a square rod over.
    """
    mesh = robot().mesh
    axes = np.roll(np.eye(3), 1, axis=0)  # the third is y
    plate = RigidBody("plate", "x_max", origin=MIDDLE_OF_END, axes=axes)
    couple, law = Couple("couple", "plate"), Corotational(Isotropic(E, 0.0))
    model = build_model(mesh, law, density=0.0, bodies=[plate], actuators=[couple])
    x, y, _ = mesh.points.T
    side = Support(np.flatnonzero((y < 1e-9) & (x < LENGTH - 1e-9)), "y")
    angle, EI = np.pi, E * SIDE**4 / 12.0
    once = {"couple": ImposedForce(-EI * angle / LENGTH)}
    pose = Configuration("once", [Support("x_min"), side], NO_GRAVITY, actuation=once)
    solution = solve(model, arrays(model, pose), None, NewtonSettings())[0]
    assert bool(solution.converged), RESULTS[solution.result]
    assert int(solution.load_steps) == 1
    assert int(solution.steps) < 20
    end = np.array([LENGTH, 0.0, 0.0]) + solution.displacement[mesh.n_nodes]
    np.testing.assert_allclose(end, arc(angle), rtol=0, atol=0.02 * LENGTH)


def test_a_flat_strip_closes_to_a_ring():
    """It stands in its plane, since it hardly bends across its width."""
    model = robot(2.0 * SIDE, 0.5 * SIDE)
    solution = from_rest(1.0, model=model)
    assert bool(solution.converged), RESULTS[solution.result]
    assert int(solution.n_negative) == 0
    assert int(solution.steps) < 100
    points = model.mesh.points
    line = np.isclose(points[:, 1:], [SIDE, 0.25 * SIDE]).all(axis=1).nonzero()[0]
    assert line.size == 21
    angle = 2.0 * np.pi * points[line, 0] / LENGTH
    radius = LENGTH / (2.0 * np.pi)
    ring = radius * np.stack([np.sin(angle), 0.0 * angle, 1.0 - np.cos(angle)], axis=1)
    curve = points[line] + np.asarray(solution.displacement)[line]
    curve = curve - [0.0, SIDE, 0.25 * SIDE]
    # As the arcs above; the mesh, no mirror image of itself, pushes it aside by less.
    np.testing.assert_allclose(curve, ring, rtol=0, atol=0.01 * LENGTH)
    np.testing.assert_allclose(curve[:, 1], 0.0, atol=0.001 * LENGTH)


def test_a_ring_of_a_square_rod_rests_where_its_mesh_has_it():
    """It swings about the tangent at its ends with hardly any energy.

    Every section rolls as the ring turns, and a square bends in all directions alike;
    tets do not quite. The state found is stable, and the same from beside it.
    """
    solution = from_rest(1.0)
    assert bool(solution.converged)
    assert int(solution.n_negative) == 0
    u = np.asarray(solution.displacement)
    aside = u + np.outer(np.sin(np.linspace(0.0, 40.0, len(u))), [0.0, 1e-4, 0.0])
    again, _ = solve(robot(), bent(1.0), jnp.asarray(aside), NewtonSettings())
    np.testing.assert_allclose(again.displacement, u, rtol=0, atol=1e-9)


def test_the_end_does_not_depend_on_the_path():
    """The same state as by small turns, each from the one before."""
    u = jnp.zeros((robot().n_points, 3))
    for turn in np.linspace(0.05, 0.75, 15):
        solution, _ = solve(robot(), bent(float(turn)), u, TIGHT)
        assert bool(solution.converged)
        u = solution.displacement
    at_once = from_rest(0.75, TIGHT)
    np.testing.assert_allclose(at_once.displacement, u, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_path_leads_there_too():
    """States along the load of a held body, each an arc of the same length."""
    path = trace_equilibria(robot(), bent(0.25), LoadPath(first=0.25))
    assert bool(path.result == RESULTS.converged), RESULTS[path.result]
    solution = from_rest(0.25)
    np.testing.assert_allclose(
        path.displacement[-1], solution.displacement, rtol=0, atol=1e-7
    )
    node = nearest_node(robot().mesh, MIDDLE)
    half = path.load[1:, None] * 0.25 * np.pi
    x, _, z = np.stack([arc(float(a), 0.5 * LENGTH) for a in half[:, 0]]).T
    motion = path.displacement[1:, node]
    np.testing.assert_allclose(motion[:, 0] + MIDDLE[0], x, atol=0.01 * LENGTH)
    np.testing.assert_allclose(motion[:, 2], z, atol=0.01 * LENGTH)
    np.testing.assert_array_equal(path.n_negative, 0)
