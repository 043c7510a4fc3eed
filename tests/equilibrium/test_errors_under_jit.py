"""Mistakes in a compiled function: each is named when it is traced, in two lines."""

from operator import attrgetter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softcal_jax as sc
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    NodalForces,
    PointForce,
    Support,
    SurfaceForce,
    SurfaceTraction,
)
from softcal_jax.contact import Ball
from softcal_jax.equilibrium import NewtonSettings, build_model, effector_values

pytestmark = pytest.mark.usefixtures("unchecked")

LAW = sc.NeoHookean(E=250e3, nu=0.3)
MESH = sc.beam(0.1, 0.03, 0.03, cells=(3, 1, 1), order=1)
BLOCK = sc.beam(0.1, 0.03, 0.03, cells=(1, 1, 1), order=1)
CABLE = sc.Cable("cable", [sc.Guide((0.0, 0.015, 0.05), "ground"), (0.09, 0.015, 0.02)])
PLAIN, ROPED, OTHER = (
    build_model(mesh, LAW, density=1e3, actuators=actuators)
    for mesh, actuators in ((MESH, []), (MESH, [CABLE]), (BLOCK, []))
)
PLATED = build_model(MESH, LAW, density=1e3, bodies=[RigidBody("plate", "x_max")])
LANE, PULLED, HELD = (
    sc.lanes(model, Configuration("pose", "x_min"))[0]
    for model in (PLAIN, ROPED, PLATED)
)
T = jnp.asarray(0.3)


def solve(model, lane, **more):
    return sc.solve_equilibrium(model, lane, **more).displacement


def shaped(leaf, shape, model=PLAIN, lane=LANE):
    """Solve with another shape in one place of the lane."""
    new = lambda t: eqx.tree_at(attrgetter(leaf), lane, t * jnp.ones(shape))
    return lambda t: solve(model, new(t))


def posed(model=PLAIN, supports="x_min", **of):
    """Solve a pose that is made of a traced number."""
    return lambda t: solve(
        model, Configuration("pose", supports, **{k: f(t) for k, f in of.items()})
    )


def clamped(**of):
    return lambda t: solve(
        PLAIN,
        Configuration("p", [Support("x_min", **{k: f(t) for k, f in of.items()})]),
    )


def told(model, what, n=PLAIN.n_points):
    return lambda t: effector_values(model, what, t * jnp.ones((n, 3)))


CASES = {
    "E": (lambda t: solve(sc.set_field(PLAIN, "E", t * jnp.ones(5)), LANE), "E .*18"),
    "law": (
        lambda t: solve(eqx.tree_at(lambda m: m.law.E, PLAIN, t * jnp.ones(5)), LANE),
        r"law\.E .*\(5,\).*18",
    ),
    "density": (
        lambda t: solve(eqx.tree_at(lambda m: m.density, PLAIN, t * jnp.ones(5)), LANE),
        r"density .*\(18,\).*\(5,\)",
    ),
    "gravity of two": (shaped("gravity", 2), r"gravity .*\(2,\).*\(3,\).*lanes"),
    "gravity of none": (shaped("gravity", ()), r"gravity .*\(\).*\(3,\).*lanes"),
    "loads": (shaped("loads.force", (16, 3)), r"loads.force .*\(1, 16, 3\).*lanes"),
    "imposed": (shaped("imposed", 3), r"imposed .*\(3,\).*\(16, 3\).*lanes"),
    "actuation": (
        shaped("actuation.value", 2, ROPED, PULLED),
        r"actuation.value .*\(2,\).*\(1,\).*lanes",
    ),
    "body": (
        shaped("bodies.translation", 3, PLATED, HELD),
        r"bodies.translation .*\(3,\).*\(1, 3\).*lanes",
    ),
    "guess": (
        lambda t: solve(PLAIN, LANE, guess=t * jnp.ones((3, 3))),
        r"guess .*\(3, 3\).*\(16, 3\)",
    ),
    "batch": (
        lambda t: solve(PLAIN, sc.lanes(PLAIN, [Configuration("pose", "x_min")])),
        r"batch of 1 .*vmap",
    ),
    "lane of another mesh": (
        lambda t: solve(OTHER, LANE),
        r"16 nodes.*lanes\(model, poses\)",
    ),
    "lane without the body": (lambda t: solve(PLATED, LANE), "16 nodes.* 20.*lanes"),
    "lane without the actuator": (
        lambda t: solve(ROPED, LANE),
        r"actuators \[\].*\['cable'\].*lanes",
    ),
    "model without the actuator": (
        lambda t: solve(PLAIN, PULLED),
        r"actuators \['cable'\].*\[\].*lanes",
    ),
    "effectors of another mesh": (told(OTHER, LANE, 8), r"imposed .*\(16, 3\).*lanes"),
    "effectors of another u": (told(PLAIN, LANE, 8), r"u .*\(8, 3\).*\(16, 3\)"),
    "rtol": (lambda t: NewtonSettings(rtol=t), "NewtonSettings is traced.*outside"),
    "max_steps": (
        lambda t: NewtonSettings(max_steps=t.astype(int)),
        "NewtonSettings is traced.*outside",
    ),
    "gravity": (posed(gravity=lambda t: (0.0, 0.0, t)), r"gravity of .*lane\.gravity"),
    "all gravity": (posed(gravity=lambda t: t * jnp.ones(3)), r"lane\.gravity"),
    "force": (
        posed(loads=lambda t: PointForce((0.1, 0.0, 0.0), (0.0, 0.0, t))),
        r"force is traced.*lane\.loads\.force",
    ),
    "surface force": (
        posed(loads=lambda t: SurfaceForce("x_max", (0.0, 0.0, t))),
        r"force is traced.*lane\.loads\.force",
    ),
    "traction": (
        posed(loads=lambda t: SurfaceTraction("x_max", (0.0, 0.0, t))),
        r"traction is traced.*lane\.loads\.force",
    ),
    "nodal forces": (
        posed(loads=lambda t: NodalForces(np.array([1]), t * jnp.ones((1, 3)))),
        r"forces is traced.*lane\.loads\.force",
    ),
    "displacement": (
        clamped(displacement=lambda t: (0.0, 0.0, t)),
        r"displacement is traced.*lane\.imposed",
    ),
    "stiffness": (
        clamped(stiffness=lambda t: t),
        r"stiffness is traced.*lane\.springs\.stiffness",
    ),
    "tension": (
        posed(ROPED, actuation=lambda t: {"cable": ImposedForce(t)}),
        r"'cable' is traced.*lane\.actuation\.value",
    ),
    "shortening": (
        posed(ROPED, actuation=lambda t: {"cable": ImposedDisplacement(t)}),
        r"'cable' is traced.*lane\.actuation\.value",
    ),
    "pose": (lambda t: Pose((0.0, 0.0, t)), "traced.*lane or of the model"),
    "marker": (
        lambda t: sc.Markers(["a"], t * jnp.ones((1, 3))),
        "traced.*lane or of the model",
    ),
    "mass": (lambda t: RigidBody("a", "x_min", mass=t), r"mass .*bodies\.mass"),
    "friction": (
        lambda t: RigidBody("a", shape=Ball(0.1), friction=t),
        r"friction .*contacts\.friction",
    ),
    "radius": (lambda t: Ball(t), r"radius .*radius of one of .*contacts\.shapes"),
    "density of a model": (
        lambda t: build_model(MESH, LAW, density=t),
        "model is traced.*set_field",
    ),
    "modulus of a model": (
        lambda t: build_model(MESH, sc.NeoHookean(E=t, nu=0.3), density=1.0),
        "model is traced.*set_field",
    ),
    "points": (
        lambda t: sc.TetMesh(t * jnp.asarray(MESH.points), MESH.tets),
        "points is traced.*with_points",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_mistake_is_named_in_two_lines(name):
    call, words = CASES[name]

    def compiled(t):
        call(t)
        return t

    with pytest.raises(ValueError, match=words) as error:
        jax.jit(compiled)(T)
    said = str(error.value).split("\n----")[0].strip()
    assert said.count("\n") < 2
    assert len(said) < 300
