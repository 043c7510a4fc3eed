"""Cables, walls of chambers, motors and frames of rigid bodies as a VTK file."""

from pathlib import Path

import meshio
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import actuator_geometry
from softcal_jax.equilibrium import Model, RobotState


def write_robot_vtu(path: str | Path, model: Model, state: RobotState) -> None:
    """Write what is beside the soft body for ParaView, to be shown with it.

    Points are those at rest [m]; "Warp By Vector" with `displacement` shows the state.
    Lines are the segments of cables, faces those of chambers and surface pressures,
    vertices the origins of rigid bodies, then motors and forces. Per cell: `actuator`
    and `rigid_body` (numbers from 1 in the order of the model, 0 for none), `lambda_a`
    and `delta_a` in SI. Per vertex `arrow`: the axis of a motor or the direction of a
    force; `axis_1` to `axis_3`: axes of a rigid body's frame [-].

    Args:
        path: The file, ending in .vtu.
        model: The model.
        state: What its rigid bodies and actuators do.

    Raises:
        ValueError: If the name does not end in .vtu.
    """
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"the file name must end in .vtu, got {path.name!r}.")
    actuators, rest = model.mechanism.actuators, np.asarray(model.mechanism.points)
    x = rest + state.displacement
    before = actuator_geometry(actuators, rest)
    after = actuator_geometry(actuators, x)
    origins, axes = _origins(model, rest), _axes(model, x)
    n_b, n_s, n_p = len(origins), len(after.segments), len(after.points)
    used, faces = np.unique(after.faces, return_inverse=True)
    faces = faces.reshape(after.faces.shape)
    points = np.concatenate(
        [origins, before.points, before.segments.reshape(-1, 3), rest[used]]
    )
    moved = np.concatenate(
        [
            np.array([b.translation for b in state.bodies]).reshape(-1, 3),
            after.points - before.points,
            (after.segments - before.segments).reshape(-1, 3),
            state.displacement[used],
        ]
    )
    vertices = np.arange(n_b + n_p)[:, None]
    lines = n_b + n_p + np.arange(2 * n_s).reshape(-1, 2)
    walls = n_b + n_p + 2 * n_s + faces
    n_fn = after.faces.shape[-1]
    triangle = "triangle" if n_fn == 3 else "triangle6"
    none = np.full(n_b, -1)
    owners = [
        np.concatenate([none, after.point_owner]),
        after.segment_owner,
        after.face_owner,
    ]
    cells = [("vertex", vertices), ("line", lines), (triangle, walls)]
    there = [i for i, (_, nodes) in enumerate(cells) if len(nodes)]
    bodies = [np.zeros(len(owner)) for owner in owners]
    bodies[0][:n_b] = 1 + np.arange(n_b)
    forces = np.array([0.0, *(a.force for a in state.actuators)])
    moves = np.array([0.0, *(a.displacement or 0.0 for a in state.actuators)])
    each = lambda values: [values[owners[i] + 1] for i in there]
    rows = lambda *parts: _padded(len(points), *parts)
    meshio.Mesh(
        points,
        [cells[i] for i in there],
        point_data={
            "displacement": moved,
            "arrow": rows(np.zeros((n_b, 3)), after.arrows),
            **{f"axis_{k + 1}": rows(axes[:, k]) for k in range(3)},
        },
        cell_data={
            "actuator": [owners[i] + 1.0 for i in there],
            "rigid_body": [bodies[i] for i in there],
            "lambda_a": each(forces),
            "delta_a": each(moves),
        },
    ).write(path)


def _origins(
    model: Model, x: Float[HostArray, "n_points 3"]
) -> Float[HostArray, "n_b 3"]:
    """Origins of the frames of the rigid bodies [m]."""
    return x[model.mesh.n_nodes :: 4]


def _axes(
    model: Model, x: Float[HostArray, "n_points 3"]
) -> Float[HostArray, "n_b 3 3"]:
    """Their axes, by rows [-]."""
    nodes = x[model.mesh.n_nodes :].reshape(-1, 4, 3)
    return (nodes[:, 1:] - nodes[:, :1]) / model.mechanism.bodies.length


def _padded(n: int, *parts: Float[HostArray, "_ 3"]) -> Float[HostArray, "n 3"]:
    """Vectors of the first points, and zero for the rest."""
    first = np.concatenate(parts)
    return np.concatenate([first, np.zeros((n - len(first), 3))])
