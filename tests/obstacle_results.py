"""A beam beside obstacles, and states of it put together by hand, without a solve."""

import numpy as np

from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.configurations import Configuration
from softcal_jax.contact import Ball, ContactState, HalfSpace
from softcal_jax.equilibrium import BodyPlace, RobotState, build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

FORCE = np.array([3e-3, 0.0, 4e-3])
"""Force of the robot on the probe: 5 mN [N]."""

PRESSED = Pose((1e-3, 0.0, -2e-3), (0.0, 0.0, 0.5 * np.pi))


def beside_obstacles(law=None):
    """A beam of 10 cm with a probe above its end, and a table that it does not touch.

    The origin of the table's frame is far away in its plane.
    """
    bodies = [
        RigidBody("probe", shape=Ball(0.01), origin=(0.09, 0.01, 0.04), friction=0.5),
        RigidBody("table", shape=HalfSpace(), origin=(2.0, 1.0, -0.03)),
    ]
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    law = law or NeoHookean(2e5, 0.4)
    return build_model(mesh, law, density=1000.0, bodies=bodies)


def pressed(model, *, present=("probe", "table"), depth=1e-5, sliding=0.0, name="a"):
    """A result in which the probe has moved by `PRESSED`."""
    bodies, n_nodes = model.mechanism.bodies, model.mesh.n_nodes
    u = np.zeros((model.n_points, 3))
    u[:n_nodes, 2] = -0.01 * (model.mesh.points[:, 0] / 0.1) ** 2
    u[n_nodes : n_nodes + 4] = PRESSED.translation
    turned = bodies.axes[0] @ PRESSED.matrix.T - bodies.axes[0]
    u[n_nodes + 1 : n_nodes + 4] += bodies.length * turned
    none = np.zeros(len(model.mechanism.contacts.faces))
    felt = {
        "probe": ContactState(
            "probe", FORCE, np.array([0.0, 2e-5, 0.0]), 3e-6, depth, sliding, none
        ),
        "table": ContactState("table", np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0, none),
    }
    places = (
        BodyPlace(
            body,
            "held" if body in present else "absent",
            bodies.origin[k] + u[n_nodes + 4 * k],
            u[n_nodes + 4 * k],
            PRESSED.rotation_vector if k == 0 else np.zeros(3),
        )
        for k, body in enumerate(bodies.names)
    )
    contacts = tuple(felt[body] for body in present)
    states = {body: "absent" for body in felt if body not in present}
    moved = {"probe": PRESSED} if "probe" in present else {}
    return ConfigurationResult(
        name=name,
        role="simulation",
        converged=True,
        outcome="converged",
        effectors=(),
        displacement=u[:n_nodes],
        newton_steps=5,
        load_steps=1,
        residual=1e-9,
        rounding=1e-12,
        at_rounding=False,
        min_det_F=0.9,
        robot=RobotState(tuple(places), (), (), contacts, u),
        posed=Configuration(name, "x_min", bodies=states | moved),
    )
