"""Effectors of every kind, and how they follow the parameters."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import LENGTH, SIDE, TIGHT, arrays, positions, solved, strip
from scipy.spatial.transform import Rotation

from softcal_jax.actuators import Cable, Guide, Motor
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
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
)
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh

MIDDLE = SIDE / 2
MESH = strip(6)
MODEL = build_model(
    MESH,
    NeoHookean(3e5, 0.3),
    density=1000.0,
    bodies=(
        RigidBody("plate", "at 3", mass=0.01),
        RigidBody("tip", "at 6", axes=hinge_axes((0.0, 1.0, 0.0))),
    ),
    actuators=(
        Cable("cable", (Guide((0.0, 0.0, 0.05), "ground"), (0.1, 0.0, SIDE))),
        Motor("motor", "tip"),
    ),
)
POINT = np.array([LENGTH / 2, MIDDLE, 0.03])  # on the plate, beside the mesh
REFERENCE = Pose((0.0, 1e-3, -2e-3), (0.05, -0.1, 0.2))
AXIS = np.array([0.0, 3.0, 1.0])
MARKERS = Markers(("end", "post"), [[0.11, 0.0, SIDE], [0.03, MIDDLE, 0.025]])
EFFECTORS = (
    BodyFrame("frame", "plate", REFERENCE, POINT),
    Centroid("middle", "at 2"),
    ActuatorDisplacement("delta cable", "cable"),
    ActuatorDisplacement("delta motor", "motor"),
    BodyAngle("angle", "tip", "plate", AXIS),
    ActuatorForce("lambda cable", "cable"),
    ActuatorForce("lambda motor", "motor"),
    SupportReaction("clamp", "x_min"),
    SupportReaction("tip", "at 6"),
)
# Points: two markers, frame, centroid; a turn; three scalars; two forces; reactions.
TURN, SCALARS, REACTION = 4, slice(5, 8), 10


def watched(cable, effectors=EFFECTORS):
    return Configuration(
        "watched",
        "x_min",
        (1.0, 2.0, -9.0),
        markers=MARKERS,
        effectors=effectors,
        actuation={"cable": cable, "motor": ImposedDisplacement(0.1)},
    )


BY_FORCE, BY_DISPLACEMENT = ImposedForce(0.2), ImposedDisplacement(2e-3)


def test_values_of_all_kinds():
    """Each from the positions of the nodes alone, by SciPy's rotations."""
    solution, values, _ = solved(MODEL, watched(BY_DISPLACEMENT), TIGHT)
    x, X = positions(MODEL, solution), MODEL.mechanism.points
    plate, tip = MESH.nodes("at 3"), MESH.nodes("at 6")

    def turn(nodes):
        now, rest = (p[nodes] - p[nodes].mean(axis=0) for p in (x, X))
        return Rotation.align_vectors(now, rest)[0]

    R, R_tip = turn(plate), turn(tip)
    within = lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-8)
    there = R.apply(POINT - X[plate].mean(axis=0)) + x[plate].mean(axis=0)
    within(values[2], there)
    within(values[3], x[MESH.nodes("at 2")].mean(axis=0))
    reference = Rotation.from_rotvec(REFERENCE.rotation_vector)
    within(values[TURN], (R * reference.inv()).as_rotvec())
    within(values[SCALARS, 0][:2], [2e-3, 0.1])
    relative = R.inv() * R_tip
    axis = AXIS / np.linalg.norm(AXIS)
    # Twist about the axis of the swing-twist decomposition is not what an encoder of
    # this axis shows unless the turn is about it; a direction across the axis is.
    across = np.eye(3)[0] - axis * axis[0]
    across /= np.linalg.norm(across)
    seen = relative.apply(across)
    angle = np.arctan2(seen @ np.cross(axis, across), seen @ across)
    within(values[7, 0], angle)
    np.testing.assert_allclose(values[8, 0], solution.multipliers[0], rtol=1e-9)


@pytest.mark.parametrize("cable", [BY_FORCE, BY_DISPLACEMENT])
def test_reactions_balance_all_loads(cable):
    """Clamp and hinge together carry all weight and the pull of the cable."""
    masses = jnp.array([0.01, 0.03])  # of the plate, and of what is held at the tip
    heavy = eqx.tree_at(lambda m: m.mechanism.bodies.mass, MODEL, masses)
    solution, values, _ = solved(heavy, watched(cable), TIGHT)
    weight = (1000.0 * LENGTH * SIDE**2 + 0.04) * np.array([1.0, 2.0, -9.0])
    x = positions(MODEL, solution)
    X = MESH.points
    pair = np.isclose(X[:, 0], 0.1) & (X[:, 1] == 0.0) & np.isclose(X[:, 2], SIDE)
    along = np.array([0.0, 0.0, 0.05]) - x[: MESH.n_nodes][pair][0]
    pull = values[8, 0] * along / np.linalg.norm(along)
    total = values[REACTION] + values[REACTION + 1]
    np.testing.assert_allclose(total, -weight - pull, rtol=0, atol=1e-9)


def bad(message, *effectors, mesh: TetMesh = MESH):
    configuration = Configuration("bad", "x_min", effectors=effectors)
    model = eqx.tree_at(lambda m: m.mesh, MODEL, mesh)
    with pytest.raises(ValueError, match=message):
        arrays(model, configuration)


def test_bad_effectors(unchecked):
    bad("body .*'plat'.* mean 'plate'", BodyFrame("f", "plat"))
    bad("actuator .*'cabel'", ActuatorForce("f", "cabel"))
    bad("effector 'c' .*another", *[Centroid("c", "at 2")] * 2)
    bad(r"std .*'c' .*\[m\], got 0", Centroid("c", "at 2", std=0.0))
    nan, inf = (np.array([value, 0.0, 0.0]) for value in (np.nan, np.inf))
    bad(r"'d' .* nan, .*finite .*\[m\]", ActuatorDisplacement("d", "cable", np.nan))
    bad(r"'t' .*\], .*finite number \[N\]", ActuatorForce("t", "cable", np.ones(3)))
    bad("'c' .* 0.1, .*three finite", Centroid("c", "at 2", 0.1))
    bad("axis .*'a' .*all zero", BodyAngle("a", "tip", "plate", (0.0, 0.0, 0.0)))
    bad(r"'c' .*\[nan +0. +0.\], .*three finite", Centroid("c", "at 2", nan))
    bad("'r' .* 3 of the 4 .*'tip'", SupportReaction("r", MESH.nodes("at 6")[1:]))
    bad("'r': .*group 'at 9'", SupportReaction("r", "at 9"))
    bad("'r' .*inf .*three finite", SupportReaction("r", "x_min", inf))
