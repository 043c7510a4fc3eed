"""Every float of a model and a lane, and every float of what is solved and read.

The reference is the equilibrium to rounding at other values. What is compared is found
by walking through the objects, so that a new field is compared, too.
"""

import dataclasses
import re
from functools import cache, partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import arrays
from scipy.linalg import expm

import softcal_jax as sc
from softcal_jax.actuators import (
    Cable,
    Chamber,
    ForceActuator,
    Guide,
    Motor,
    SurfacePressure,
)
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
from softcal_jax.configurations import (
    ActuatorDisplacement,
    ActuatorForce,
    BodyAngle,
    BodyFrame,
    Centroid,
    Configuration,
    ContactForce,
    ContactMoment,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    PointForce,
    Support,
    SupportReaction,
    SurfaceForce,
)
from softcal_jax.contact import Ball
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    effector_values,
    energy_and_force,
    gravity_load,
    internal_force,
    marker_positions,
    residual,
    solve_equilibrium,
    solved_forces,
    tet_stresses,
    traced_tet_states,
)
from softcal_jax.equilibrium._robot_state import observed_state
from softcal_jax.fields import ControlPoints
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic

TIGHT = NewtonSettings(rtol=1e-13)
RANDOM = np.random.default_rng(0)


def bored_block() -> TetMesh:
    """A block of 3 x 1 x 3 cells with a hole along y, and groups of faces."""
    full = beam(0.06, 0.02, 0.03, (3, 1, 3))
    x, _, z = full.centroids.T
    hole = (np.abs(x - 0.03) < 0.01) & (np.abs(z - 0.015) < 0.005)
    mesh = to_quadratic(TetMesh(full.points, full.tets[~hole]))
    faces = boundary_faces(mesh)
    X = mesh.points[faces]
    side = {
        f"{'xyz'[a]}_{end}": np.isclose(X[:, :, a], value).all(axis=1)
        for end, corner in (("min", X.min((0, 1))), ("max", X.max((0, 1))))
        for a, value in enumerate(corner)
    }
    side["cavity"] = ~np.any([*side.values()], axis=0)
    between = (X[:, :, 0] > 0.019) & (X[:, :, 0] < 0.041)
    side["back"] = side["y_max"] & between.all(axis=1)
    groups = {name: faces[mask] for name, mask in side.items()}
    return TetMesh(mesh.points, mesh.tets, surface_groups=groups)


MESH = bored_block()
LAW = ReducedTransverseIsotropic(
    E_t=RANDOM.uniform(4e5, 6e5, MESH.n_tets),
    E_l=RANDOM.uniform(2e5, 3e5, MESH.n_tets),
    nu=0.3,
    fibre=Fibre(theta=RANDOM.uniform(0.2, 0.5, MESH.n_tets), phi=0.1),
)
MODEL = build_model(
    MESH,
    Corotational(LAW),
    density=RANDOM.uniform(900.0, 1100.0, MESH.n_tets),
    bodies=[
        RigidBody("base", "x_min", axes=hinge_axes((0, 1, 0))),
        RigidBody("plate", "x_max", mass=0.03, centre_of_mass=(0.07, 0.012, 0.01)),
        # Thicker than the way of any point, the cushion is smooth.
        RigidBody("ball", shape=Ball(0.04), origin=(0.03, 0.01, -0.042), friction=0.5),
    ],
    contact_scale=0.02,
    actuators=[
        Motor("motor", "base"),
        Cable(
            "rope",
            [
                Guide((0.0, 0.015, 0.06), "ground"),
                (0.025, 0.005, 0.03),
                (0.055, 0.015, 0.02),
            ],
            friction=0.2,
            pulled_from="first",
        ),
        Cable("tendon", [Guide((0.0, 0.01, 0.01), "ground"), (0.05, 0.01, 0.02)]),
        Chamber("chamber", "cavity", seal=True),
        SurfacePressure("wind", "z_max"),
        ForceActuator("probe", (0.06, 0.015, 0.03), (0.0, 0.0, -1.0)),
    ],
)
MARKERS = Markers(("a", "b"), [[0.05, 0.01, 0.01], [0.055, 0.01, 0.02]])
LIFTED = np.flatnonzero(np.all(np.isclose(MESH.points, (0.04, 0.0, 0.03)), axis=1))
POSE = Configuration(
    "pose",
    [
        Support("back", "xz", (0.0, 0.0, 1e-3), stiffness=2e6),
        Support(LIFTED, "y", (0.0, 5e-4, 0.0)),
    ],
    loads=[
        SurfaceForce("z_max", (0.0, 0.05, -0.1)),
        PointForce((0.06, 0.01, 0.01), (0.0, 0.02, -0.05), name="payload"),
    ],
    markers=MARKERS,
    measured=MARKERS.positions,
    effectors=(
        BodyFrame("sensor", "base"),
        Centroid("middle", "y_min"),
        BodyAngle("angle", "base", "plate", (0, 1, 0)),
        ActuatorForce("torque", "motor"),
        ActuatorForce("pull", "tendon"),
        ActuatorDisplacement("length", "rope"),
        ActuatorDisplacement("volume", "chamber"),
        SupportReaction("reaction", "back"),
        ContactForce("push", "ball"),
        ContactMoment("moment", "ball", (1.0, 0.0, 0.0)),
    ),
    bodies={"ball": Pose((1e-3, 0.0, 4e-3), (0.1, 0.0, 0.2))},
    actuation={
        "motor": ImposedDisplacement(0.2),
        "rope": ImposedForce(0.5),
        "tendon": ImposedDisplacement(2e-3),
        "chamber": ImposedForce(2e3),
        "wind": ImposedForce(200.0),
        "probe": ImposedForce(0.05),
    },
)
LANE = arrays(MODEL, POSE)

FLOATS, REST = eqx.partition((MODEL, LANE), eqx.is_inexact_array_like)
FLOATS = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), FLOATS)


def by_path(tree) -> dict:
    """The float leaves of a tree that hold numbers, by their place."""
    is_float = lambda leaf: jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {
        jax.tree_util.keystr(path): leaf
        for path, leaf in leaves
        if np.size(leaf) and is_float(leaf)
    }


INPUTS = by_path(FLOATS)
COUPLED = {"[0].mesh.points", "[0].mechanism.points"}
"""Inputs that one alone leaves without equilibrium; `with_points` sets all."""

COUNTS = {f"['state'].contacts[0].{name}" for name in ("area", "sliding")}
DIAGNOSTICS = {
    f"['solution'].{name}"
    for name in (
        *("load_reached", "residual", "rounding"),
        *("approached", "along_path", "contacts"),
    )
}


@cache
def at_start():
    return solve_equilibrium(MODEL, LANE, settings=TIGHT).displacement


def results(floats, guess) -> dict:
    """All that has a float of an equilibrium, and is public or seen by an effector."""
    model, lane = eqx.combine(floats, REST)
    solution = solve_equilibrium(model, lane, guess=guess, settings=TIGHT)
    u, multipliers = solution.displacement, solution.multipliers
    return by_path(
        {
            "solution": solution,
            "effectors": effector_values(model, lane, u, multipliers),
            "markers": marker_positions(model, lane, solution),
            "state": observed_state(model, lane, u, multipliers),
            "tets": traced_tet_states(model, u),
            "stresses": tet_stresses(model, u),
            "energy": energy_and_force(model, u),
            "force": internal_force(model, u),
            "residual": residual(model, lane, u, multipliers),
            "multipliers of u": solved_forces(model, lane, u),
            "weight": gravity_load(model, lane.acceleration),
        }
    )


@jax.jit
def derivatives(floats, tangent, cotangent, guess):
    """Values, derivatives along a tangent, and those of what has one in reverse."""
    value, along = jax.linearize(lambda x: results(x, guess), floats)
    some = lambda t: {k: v for k, v in along(t).items() if k in cotangent}
    (reverse,) = jax.linear_transpose(some, floats)(cotangent)
    return value, along(tangent), by_path(reverse)


def is_rotation(leaf) -> bool:
    square = leaf.shape[-2:] == (3, 3)
    return square and np.allclose(leaf @ np.swapaxes(leaf, -1, -2), np.eye(3))


@cache
def direction(name: str):
    """A change of one input at random, of its own size; rotations turn.

    Zeros of what is never negative, like areas and shares, say where nothing is, and
    stay.
    """
    leaf = np.asarray(INPUTS[name])
    random = np.random.default_rng(sum(map(ord, name)))
    if is_rotation(leaf):
        turn = random.normal(size=(*leaf.shape[:-2], 1, 3))
        return np.swapaxes(np.cross(turn, np.swapaxes(leaf, -1, -2)), -1, -2)
    size = np.where(np.isfinite(leaf), np.abs(leaf), 0.0)
    if not leaf.any():
        size += 1e-2
    elif leaf.min() < -1e-9 * size.max():
        size = np.where(size > 0.0, size, size.max())
    return size * random.normal(size=leaf.shape)


def changed(name: str, h: float):
    """The inputs with one of them changed by h times its direction."""
    leaf = np.asarray(INPUTS[name])
    if is_rotation(leaf):
        new = expm(h * direction(name) @ np.swapaxes(leaf, -1, -2)) @ leaf
    else:
        new = leaf + h * direction(name)
    return put(name, new, FLOATS)


def put(name: str, leaf, tree):
    """A tree with another leaf in one place."""
    here = lambda path, old: leaf if jax.tree_util.keystr(path) == name else old
    return jax.tree_util.tree_map_with_path(here, tree)


STILL = jax.tree.map(jnp.zeros_like, FLOATS)


@cache
def cotangent():
    floats = jax.eval_shape(results, FLOATS, at_start())
    random = np.random.default_rng(2)
    return {
        name: jnp.asarray(random.normal(size=leaf.shape))
        for name, leaf in floats.items()
        if name not in COUNTS | DIAGNOSTICS
    }


def at(floats, tangent=STILL):
    return jax.device_get(derivatives(floats, tangent, cotangent(), at_start()))


@cache
def compared(name: str):
    """Slopes by one input, quotients of differences, and values that say their size.

    Quotients are extrapolated from two steps, so that their error is of fourth order.
    """
    value, slope, reverse = at(FLOATS, put(name, direction(name), STILL))
    quotients = []
    for h in (1e-4, 3e-5):
        (plus, *_), (minus, *_) = at(changed(name, h)), at(changed(name, -h))
        quotients.append({k: (plus[k] - minus[k]) / (2.0 * h) for k in plus})
    ratio = (10.0 / 3.0) ** 2
    extrapolated = {
        k: (ratio * fine - quotients[0][k]) / (ratio - 1.0)
        for k, fine in quotients[1].items()
    }
    return value, slope, reverse, extrapolated


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(INPUTS) - COUPLED))
def test_derivatives_meet_differences(name):
    value, slope, reverse, quotient = compared(name)
    assert set(slope) == set(cotangent()) | COUNTS | DIAGNOSTICS
    for key, differences in quotient.items():
        if key in DIAGNOSTICS:
            assert np.isnan(slope[key]).all(), key
            continue
        if key in COUNTS:
            forces = slope["['state'].contacts[0].force"]
            assert np.isnan(slope[key]) == bool(np.sum(forces)), key
            continue
        size = np.max(np.abs(slope[key]), initial=np.max(np.abs(differences)))
        # Of the equilibrium, 1e-13 are left, over a step of 3e-5.
        rounding = 1e-8 * np.max(np.abs(value[key]))
        assert np.all(np.isfinite(slope[key])), key
        np.testing.assert_allclose(
            slope[key], differences, rtol=0, atol=1e-6 * size + rounding, err_msg=key
        )
    forward = sum(np.vdot(ct, slope[key]) for key, ct in cotangent().items())
    pulled = np.vdot(reverse[name], direction(name))
    parts = sum(abs(np.vdot(ct, slope[key])) for key, ct in cotangent().items())
    np.testing.assert_allclose(pulled, forward, rtol=0, atol=1e-8 * parts)


PAGE = Path(__file__).parents[2] / "docs" / "guide" / "differentiate.md"
ROWS = {
    name: (code, order)
    for name, code, order in re.findall(
        r"^\| (.+?) \| `(.+)` \| (2|exact) \|$", PAGE.read_text(), re.M
    )
}
POINTS = ControlPoints({"left": (0.0, 0.01, 0.01), "right": (0.06, 0.01, 0.02)})
VALUES = jnp.array([2e5, 3e5])
# Points that move take no loads and supports that are shared out by area.
BARE = arrays(
    MODEL,
    dataclasses.replace(POSE, supports=POSE.supports[1:], loads=POSE.loads[1:]),
)
NAMES = {
    "sc": sc,
    "eqx": eqx,
    "model": MODEL,
    "mesh": MESH,
    "lane": BARE,
    "points": POINTS,
    "values": VALUES,
}
MECHANISM = MODEL.mechanism
# Where to differentiate, and the size of a step: where the ball moves, so small that no
# point of the surface comes in touch.
AT = {
    "modulus": (5e5, 5e5),
    "field, one value per tet": (MODEL.law.elasticity.fibre.theta, 0.3),
    "values at control points": (VALUES, 2e5),
    "positions of control points": (POINTS.positions, 0.02),
    "density": (MODEL.density, 1e4),
    "gravity": (BARE.gravity, 100.0),
    "nodal forces of the loads": (BARE.loads.force, 0.02),
    "factors on the loads": (BARE.loads.factor, 5.0),
    "tensions, pressures, torques, and imposed displacements of actuators": (
        BARE.actuation.value,
        0.3 * BARE.actuation.value,
    ),
    "imposed motion of nodes": (BARE.imposed, 3e-3),
    "translations of held bodies": (BARE.bodies.translation, 3e-3),
    "rotations of held bodies": (BARE.bodies.rotation, 0.1),
    "frames of bodies, as mounted": (MECHANISM.bodies.mounting_translation, 1e-4),
    "masses of bodies": (MECHANISM.bodies.mass, 1.0),
    "frame of a recording": (BARE.effectors.base.rotation, 0.3),
    "places of markers on the body": (BARE.effectors.offset, 3e-3),
    "friction of obstacles": (MECHANISM.contacts.friction, 0.1),
    "radius of an obstacle": (MECHANISM.contacts.shapes[0].radius, 1e-4),
    "shape": (MESH.points, 3e-4),
}
FOLLOWING, STATIC = eqx.partition(
    (dataclasses.replace(MODEL, moved=True), BARE), eqx.is_inexact_array_like
)


def floats_of(code: str, value):
    """The floats of the robot that a row of the table makes of a value."""
    made = eval(code, {**NAMES, "value": value})
    robot = (made, BARE) if isinstance(made, type(MODEL)) else (MODEL, made)
    is_float = lambda leaf: jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)
    floats = [jnp.asarray(x, float) for x in jax.tree.leaves(robot) if is_float(x)]
    return jax.tree.unflatten(jax.tree.structure(FOLLOWING), floats)


def read(floats):
    model, lane = eqx.combine(floats, STATIC)
    solution = solve_equilibrium(model, lane, settings=TIGHT)
    u, multipliers = solution.displacement, solution.multipliers
    return effector_values(model, lane, u, multipliers), u


@jax.jit
def read_along(floats, tangent):
    return jax.jvp(read, (floats,), (tangent,))


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_the_table_of_the_guide_has_the_order_of_accuracy(name):
    code, order = ROWS[name]
    value, size = (jnp.asarray(x, float) for x in AT[name])
    step = size * np.random.default_rng(5).normal(size=value.shape)
    floats, tangent = jax.jvp(partial(floats_of, code), (value,), (step,))
    (start, _), slope = read_along(floats, tangent)
    at = lambda h: read_along(floats_of(code, value + h * step), tangent)[0]
    largest = lambda pair: max(float(np.max(np.abs(part))) for part in pair)
    errors = []
    for h in (3e-2, 1e-2):
        both = zip(at(h), at(-h), slope, strict=True)
        errors.append([(p - m) / (2.0 * h) - d for p, m, d in both])
    scale = largest(slope)
    assert scale > 1e-6
    if order == "exact":
        assert largest(errors[0]) < 1e-9 * np.max(np.abs(start))
    else:
        found = np.log(largest(errors[0]) / largest(errors[1])) / np.log(3.0)
        np.testing.assert_allclose(found, float(order), atol=0.1)


def test_every_row_of_the_table_is_tried():
    assert set(ROWS) == set(AT)
    table = PAGE.read_text().partition("|---|---|---|\n")[2].partition("\n\n")[0]
    assert len(table.splitlines()) == len(ROWS)
