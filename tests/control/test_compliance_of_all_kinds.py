"""Responses of a robot with all kinds of actuators but those of the arm.

A chamber, a force on a point and one on a surface, and a pressure that follows an open
side, which has no potential: the full tangent. Seen by markers, a frame, an angle, a
mean, displacements and forces of actuators, and the reaction of the clamp.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import central_difference, lane_of

from softcal_jax.actuators import (
    Chamber,
    ForceActuator,
    SurfaceForceActuator,
    SurfacePressure,
)
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    SupportReaction,
    configuration_arrays,
)
from softcal_jax.control import actuator_compliance, actuator_readings, with_inputs
from softcal_jax.equilibrium import NewtonSettings, build_model, solve_equilibrium
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh, beam, boundary_faces
from softcal_jax.sensitivity import parameter_compliance

# As tight as the rounding of the chamber's volume allows: it grows by 3 % of itself.
TIGHT = NewtonSettings(rtol=1e-10)
LENGTH, SIDE = 0.05, 0.03
NAMES = ("chamber", "point", "surface", "follower")
EFFECTORS = (
    Centroid("middle", "plate"),
    BodyFrame("frame", "tip"),
    BodyAngle("bend", "tip", "plate", (0.0, -1.0, 0.0)),
    *(ActuatorDisplacement(f"delta {name}", name) for name in NAMES[:3]),
    *(ActuatorForce(f"lambda {name}", name) for name in NAMES),
    SupportReaction("clamp", "x_min"),
)
FORCES = {"chamber": 4e3, "point": 0.3, "surface": -0.2, "follower": 5e2}


def hollow_block() -> TetMesh:
    """Cells of 1 cm, two of them left out in the middle of the body: "cavity".

    Nodes of the last cross-sections are "plate" and "tip".
    """
    full = beam(LENGTH, SIDE, SIDE, (5, 3, 3))
    centre = full.points[full.tets].mean(axis=1)
    core = np.all(np.abs(centre[:, 1:] - SIDE / 2) < 0.005, axis=1)
    dropped = core & (centre[:, 0] > 0.01) & (centre[:, 0] < 0.03)
    X = full.points
    mesh = TetMesh(X, full.tets[~dropped])
    faces = boundary_faces(mesh)
    on_side = np.isclose(X, 0.0) | np.isclose(X, [LENGTH, SIDE, SIDE])
    sides = np.all(on_side[faces], axis=1)
    at = lambda x: np.flatnonzero(np.isclose(X[:, 0], x))
    return TetMesh(
        X,
        mesh.tets,
        node_groups={"x_min": at(0.0), "plate": at(0.04), "tip": at(LENGTH)},
        surface_groups={
            "cavity": faces[~np.any(sides, axis=1)],
            "top": faces[sides[:, 2] & (X[faces][:, 0, 2] > 0.0)],
            "side": faces[sides[:, 1] & (X[faces][:, 0, 1] > 0.0)],
        },
    )


@cache
def block():
    return build_model(
        hollow_block(),
        NeoHookean(1e5, 0.3),
        density=1000.0,
        bodies=[RigidBody("tip", "tip", mass=0.01), RigidBody("plate", "plate")],
        actuators=[
            Chamber("chamber", "cavity"),
            ForceActuator("point", (0.03, 0.0, SIDE), (0.0, 1.0, 2.0)),
            SurfaceForceActuator("surface", "side", (1.0, 0.0, 1.0)),
            SurfacePressure("follower", "top"),
        ],
    )


def solved(model, lane, value):
    lane = with_inputs(lane, value)
    solution = solve_equilibrium(model, lane, settings=TIGHT)
    return solution, read(model, lane, solution)


read = eqx.filter_jit(actuator_readings)


def arrays(actuation):
    points = [[0.02, SIDE, 0.01], [0.03, SIDE / 2, SIDE + 0.005]]
    configuration = Configuration(
        "block",
        "x_min",
        markers=Markers(("skin", "post"), points),
        effectors=EFFECTORS,
        actuation=actuation,
    )
    lanes = configuration_arrays(block().mesh, [configuration], block().mechanism)
    return lane_of(lanes)


@cache
def reference():
    """All forces imposed."""
    lane = arrays({name: ImposedForce(force) for name, force in FORCES.items()})
    solution, state = solved(block(), lane, lane.actuation.value)
    assert solution.converged
    return lane, solution, state


compliance = eqx.filter_jit(actuator_compliance)
DRIVES = {
    "forces": (),
    "displacements": NAMES[:3],
    "volume": ("chamber",),
    "both forces' displacements": ("point", "surface"),
}


def driven_by(drive):
    """The same state, some displacements imposed in place of forces."""
    _, _, state = reference()
    forces = {name: ImposedForce(force) for name, force in FORCES.items()}
    displacements = {
        name: ImposedDisplacement(float(state.displacements[NAMES.index(name)]))
        for name in DRIVES[drive]
    }
    lane = arrays(forces | displacements)
    solution, state = solved(block(), lane, lane.actuation.value)
    assert solution.converged
    return lane, solution, state, compliance(block(), lane, solution)


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_displacements_imposed_give_back_the_forces(drive):
    _, solution, state, _ = driven_by(drive)
    _, free, before = reference()
    np.testing.assert_allclose(state.forces, before.forces, rtol=1e-7)
    np.testing.assert_allclose(
        solution.displacement, free.displacement, rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(state.effectors, before.effectors, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("drive", DRIVES)
def test_responses_of_all_kinds_meet_differences_at_second_order(drive):
    lane, _, state, response = driven_by(drive)
    exact = [
        np.asarray(part)
        for part in (
            response.W_ea.reshape(*state.effectors.shape, -1),
            response.by_force,
            response.by_displacement,
        )
    ]
    value, errors = np.asarray(lane.actuation.value), []
    for h in (0.1, 0.05):
        columns = []
        for step in np.diag(value):
            (one, ahead), (other, behind) = (
                solved(block(), lane, jnp.asarray(value + sign * h * step))
                for sign in (1, -1)
            )
            assert bool(one.converged & other.converged)
            changes = jax.tree.map(lambda a, b: np.asarray(a - b), ahead, behind)
            columns.append(jax.tree.leaves(changes))
        slopes = [
            np.stack(part, axis=-1) / (2 * h) for part in zip(*columns, strict=True)
        ]
        # By the share of each input: all columns in the units of their rows.
        errors.append([s - e * value for s, e in zip(slopes, exact, strict=True)])
    for coarse, fine, ours in zip(*errors, exact, strict=True):
        in_rows = lambda e: np.abs(e).reshape(len(e), -1, value.size).max(axis=1)
        size = in_rows(ours * value).max(axis=1, keepdims=True)
        # Only the following pressure has no displacement that could change.
        still = np.flatnonzero(size == 0.0)
        assert still.tolist() == ([3] if ours is exact[2] else [])
        size[still] = 1.0
        one, other = (np.max(in_rows(e) / size, axis=0) for e in (coarse, fine))
        # Half the step leaves a quarter of the error, and next to none where all that
        # is compared is imposed.
        nonlinear = one > 1e-10
        ratio = one[nonlinear] / other[nonlinear]
        np.testing.assert_allclose(ratio, 4.0, rtol=0.05)
        assert np.all(nonlinear) or ours is not exact[0]


def test_W_aa_is_the_same_however_it_is_driven():
    """Symmetric but for the following pressure, which has no displacement."""
    of_forces = driven_by("forces")[-1].W_aa
    assert np.linalg.eigvalsh(of_forces[:3, :3]).min() > 0.0
    for drive in list(DRIVES)[1:]:
        W = driven_by(drive)[-1].W_aa
        np.testing.assert_allclose(W[:3, :3], of_forces[:3, :3], rtol=1e-6)


SPACE = ParameterSpace(
    (
        Parameter("E", "E", 1e5, 1e4, 1e6),
        Parameter("rho", "density", 1e3, 1e2, 1e4),
    )
)


@pytest.mark.parametrize("drive", DRIVES)
def test_parameters_move_all_effectors_as_W_ep_says(drive):
    """With pressures imposed, and with volumes; by differences of second order."""
    lane, solution, state, _ = driven_by(drive)
    z = SPACE.start()
    of = eqx.filter_jit(parameter_compliance)
    W = np.asarray(of(block(), lane, solution.displacement, SPACE, z).W_ep)
    W = W.reshape(*state.effectors.shape, -1)

    def effectors(z):
        return solved(SPACE.model_at(block(), z), lane, lane.actuation.value)[
            1
        ].effectors

    error = []
    for h in (0.04, 0.02):
        along = [central_difference(effectors, z, dz, h) for dz in jnp.eye(2)]
        error.append(np.abs(np.stack(along, axis=-1) - W).max(axis=(0, 1)))
    # What is imposed of each actuator follows no parameter; the other rows do.
    rows = np.abs(W).max(axis=(1, 2))
    assert np.sum(rows > 1e-9) == len(rows) - len(NAMES)
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    np.testing.assert_allclose(error[0] / error[1], 4.0, rtol=0.05)
