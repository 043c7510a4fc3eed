"""What a model leaves out: dents under forces at a point, and weights of bodies."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from export.handmade import make_fit, make_result
from problems import lane_of
from wording import says

from softcal_jax.actuators import Cable, ForceActuator, Guide, Motor
from softcal_jax.bodies import RigidBody, hinge_axes
from softcal_jax.configurations import (
    ActuatorDisplacement,
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    PointForce,
    configuration_lanes,
)
from softcal_jax.equilibrium import build_model, omission_sentences, omissions
from softcal_jax.identifiability import assess
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MESH = beam(0.08, 0.015, 0.015, (12, 2, 2))
TIP = (0.08, 0.0075, 0.015)
WOUND, PULLED = ImposedDisplacement(2e-3), ImposedForce(0.5)
NO_WEIGHT = {"gravity": (0.0, 0.0, 0.0)}


def cable(*path, on="mesh"):
    ground = Guide((-0.01, 0.0075, 0.015), "ground")
    return Cable("cable", [ground, *path, Guide(TIP, on)])


def said(actuator=None, *, parts=(), u=None, loads=(), **how):
    """The sentences on a configuration, with displacements `u` of nodes if solved."""
    actuators = [] if actuator is None else [actuator]
    carried = {"bodies": parts, "actuators": actuators}
    model = build_model(MESH, NeoHookean(2e5, 0.45), density=1e3, **carried)
    pose = Configuration("pose", "x_min", loads=loads, **{**NO_WEIGHT, **how})
    lanes = configuration_lanes(MESH, [pose], model.mechanism)
    lane = jax.device_get(lane_of(lanes.arrays, 0))
    if u is not None:
        u = np.concatenate([u, np.zeros((model.n_points - MESH.n_nodes, 3))])
    return omission_sentences(omissions(model, pose, lane, u, lanes.effectors[0]))


def bent(depth=0.0):
    """A bent beam, whose tip is pulled in by some more [m]."""
    x, _, z = MESH.points.T
    u = 5.0 * np.stack([x * (0.0075 - z), 0.0 * x, 0.5 * x**2], axis=1)
    u[np.linalg.norm(MESH.points - TIP, axis=1) < 1e-9] -= [depth, 0.0, 0.0]
    return u


PLATE = RigidBody("plate", "x_max", mass=0.0)


@pytest.mark.parametrize("how", [WOUND, PULLED])
def test_a_cable_that_ends_on_bare_tets_is_named_where_its_displacement_counts(how):
    read = [ActuatorDisplacement("length", "cable")]
    text = said(cable(), actuation={"cable": how}, effectors=read)
    assert says(text, "A part ... cable 'cable' ... plate", "[bodies]")
    assert bool(said(cable(), actuation={"cable": how})) == (how is WOUND)


def test_a_plate_carries_it_and_a_guide_in_between_is_none():
    on_plate = cable((0.04, 0.0075, 0.015), on="plate")
    assert said(on_plate, parts=[PLATE], actuation={"cable": WOUND}) == ()
    # A place on the mesh that the plate holds is as good.
    assert said(cable(), parts=[PLATE], actuation={"cable": WOUND}) == ()
    clamped = Cable("cable", [(0.0, 0.0075, 0.015), Guide(TIP, "plate")])
    assert said(clamped, parts=[PLATE], actuation={"cable": WOUND}) == ()


def test_a_force_actuator_at_a_point_is_named_too():
    push = ForceActuator("push", TIP, (0.0, 0.0, -1.0))
    text = said(push, actuation={"push": WOUND})
    assert says(text, "force actuator 'push'")


def test_the_share_of_the_dent_is_that_of_the_node_beyond_a_smooth_bend():
    """The bend shortens the path too."""
    wound = {"actuation": {"cable": WOUND}}
    assert said(cable(), u=bent(), **wound) == ()
    (text,) = said(cable(), u=bent(3e-3), **wound)
    (share,) = [int(word) for word in text.split() if word.isdigit()]
    path = lambda u: np.linalg.norm(TIP + u - [-0.01, 0.0075, 0.015])
    tip = np.argmin(np.linalg.norm(MESH.points - TIP, axis=1))
    smooth, dented = (path(bent(d)[tip]) for d in (0.0, 3e-3))
    assert share == round(100 * (smooth - dented) / (0.09 - dented))


def test_a_marker_in_the_dent_of_a_dead_load_is_named():
    spots = Markers(("tip", "side"), [TIP, (0.04, 0.0, 0.0075)])
    seen = {"markers": spots, "measured": spots.positions}
    push = [PointForce(TIP, (-1.0, 0.0, 0.0))]
    (text,) = said(loads=push, u=bent(3e-3), **seen)
    assert says(text, "marker 'tip'")
    assert said(loads=push, u=bent(), **seen) == ()
    assert said(u=bent(3e-3), **seen) == ()


HINGED = RigidBody("plate", "x_max", axes=hinge_axes((0, 1, 0)))


@pytest.mark.parametrize(
    ("bodies", "how", "named"),
    [
        ([replace(PLATE, mass=None)], {}, True),
        ([replace(PLATE, mass=None)], NO_WEIGHT, False),
        ([replace(PLATE, mass=None)], {"bodies": {"plate": "held"}}, False),
        ([PLATE], {}, False),
        ([RigidBody("plate", np.flatnonzero(MESH.points[:, 0] > 0.07))], {}, False),
        ([HINGED], {"actuation": {"turn": ImposedDisplacement(0.1)}}, False),
        ([HINGED], {"actuation": {"turn": ImposedForce(0.01)}}, True),
    ],
)
def test_a_body_without_mass_is_named_where_gravity_moves_it(bodies, how, named):
    turn = Motor("turn", "plate") if "actuation" in how else None
    text = said(turn, parts=bodies, **{"gravity": (0.0, 0.0, -9.81), **how})
    assert bool(text) == named
    if named:
        assert says(text, "'plate'", "mass")


def test_the_verdict_names_each_once_with_the_largest_share():
    mesh = beam(0.1, 0.02, 0.02, (2, 1, 1))
    fits = [
        replace(make_fit(mesh, name), omissions=(("of it", share), ("why {", 0.0)))
        for name, share in (("one", 0.2), ("two", 0.4), ("three", 0.3))
    ]
    result = make_result(fits=fits)
    assert ("why {", "Up to 40 % of it") == result.contact_doubts
    reasons = assess(result).reasons
    assert {"Up to 40 % of it", "why {"} <= {*reasons}
