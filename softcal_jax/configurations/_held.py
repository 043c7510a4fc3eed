"""Checks of how a configuration is held."""

import numpy as np

from softcal_jax._typing import Bool, HostArray, Int
from softcal_jax.bodies import KINDS
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh


def check_apart(mesh: TetMesh, mechanism: Mechanism, fixed, name: str) -> None:
    """Raise if a node is both held by a support and part of a rigid body."""
    bodies = mechanism.bodies
    both = np.flatnonzero(fixed[bodies.attached].any(axis=1))
    if both.size:
        node = bodies.attached[both[0]]
        body = bodies.names[bodies.body[both[0]]]
        raise ValueError(
            f"configuration {name!r}: its supports hold {both.size} nodes of rigid "
            f"bodies, such as node {node} of {body!r} at "
            f"{mesh.points[node].tolist()} m. Hold the body instead, with bodies="
            f'{{{body!r}: "held"}}, or keep the groups apart.'
        )


def check_held(
    mesh: TetMesh,
    mechanism: Mechanism,
    fixed: Bool[HostArray, "n_nodes 3"],
    kind: Int[HostArray, " n_b"],
    *,
    name: str,
    balanced: bool,
) -> None:
    """Raise unless all six rigid motions of the configuration `name` are blocked.

    The angle of a hinge needs something by which it is `balanced`: weight, a load, or
    an actuator other than motors. `kind` are states of bodies, indices of `KINDS`.
    """
    motors = [n for n, b in motors_of(mechanism) if kind[b] == KINDS.index("hinged")]
    if motors and balanced:
        kind = np.where(kind == KINDS.index("hinged"), KINDS.index("held"), kind)
    bodies, centre = mechanism.bodies, mesh.points.mean(axis=0)
    size = np.abs(mesh.points - centre).max()
    motions = lambda x: np.concatenate(
        [
            np.broadcast_to(np.eye(3)[:, None], (3, len(x), 3)),
            np.cross(np.eye(3)[:, None], ((x - centre) / size)[None]),
        ]
    )
    rows = [motions(mesh.points)[:, fixed]]
    for k in np.flatnonzero(kind != KINDS.index("free")):
        rows.append(motions(bodies.origin[k][None])[:, 0])
        turns = np.concatenate([np.zeros((3, 3)), bodies.axes[k].T])
        rows.append(turns if kind[k] == KINDS.index("held") else turns[:, :2])
    held = np.concatenate(rows, axis=1)
    rank = np.linalg.matrix_rank(held @ held.T) if held.size else 0
    if rank < 6:
        nodes = int(fixed.any(axis=1).sum())
        problem = (
            f"configuration {name!r} is not held: its supports ({nodes} nodes) leave "
            f"{6 - rank} of the 6 rigid motions free. Clamp a surface, add supports, "
            "or hold a rigid body."
        )
        if motors:
            problem += (
                f" Motor {motors[0]!r} is driven by its torque and only a hinge: "
                "nothing that could balance it is given."
            )
        raise ValueError(problem)


def motors_of(mechanism: Mechanism) -> list[tuple[str, int]]:
    """Return names of the motors, and indices of the bodies that they turn."""
    actuators = mechanism.actuators
    both = zip(actuators.names, actuators.motor_body, strict=True)
    return [(name, body) for name, body in both if body >= 0]
