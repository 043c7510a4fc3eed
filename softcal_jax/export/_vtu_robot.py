"""Cables, walls of chambers, motors and frames of rigid bodies as a VTK file."""

from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.actuators import actuator_geometry
from softcal_jax.equilibrium import Model, RobotState


def write_robot_vtu(path: str | Path, model: Model, state: RobotState) -> None:
    """Write actuators and frames of rigid bodies for ParaView, beside the soft body.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the state. Lines
    are segments of cables, faces those of chambers and surface pressures, vertices the
    origins of rigid bodies, then motors and forces. Per cell: `actuator` and
    `rigid_body` (index in the model plus 1, 0 for none), `lambda_a` and `delta_a` in
    SI. Per vertex: `arrow`, the axis of a motor or direction of a force, and `axis_1`
    to `axis_3`, the axes of a rigid body's frame [-].

    Args:
        path: The file, ending in .vtu.
        model: The model.
        state: State of its rigid bodies and actuators.

    Raises:
        ValueError: If the name does not end in .vtu.
    """
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"the file name must end in .vtu, got {path.name!r}.")
    pieces, x = _pieces(model, state), _moved(model, state)
    axes = _axes(model, x)
    n_b, n = len(axes), len(pieces.points)
    vectors = {"arrow": np.concatenate([np.zeros((n_b, 3)), pieces.arrows])}
    vectors |= {f"axis_{k + 1}": axes[:, k] for k in range(3)}
    bodies = [np.zeros(len(owner)) for owner in pieces.owners]
    bodies[0][:n_b] = 1 + np.arange(n_b)
    # Entry 0 is for cells that no actuator owns, whose owner is -1.
    forces = np.array([0.0, *(a.force for a in state.actuators)])
    moves = np.array([0.0, *(a.displacement or 0.0 for a in state.actuators)])
    there = [i for i, (_, nodes) in enumerate(pieces.cells) if len(nodes)]
    each = lambda values: [values[pieces.owners[i] + 1] for i in there]
    meshio.Mesh(
        pieces.points,
        [pieces.cells[i] for i in there],
        point_data={
            "displacement": pieces.displacement,
            **{name: _padded(rows, n) for name, rows in vectors.items()},
        },
        cell_data={
            "actuator": [pieces.owners[i] + 1.0 for i in there],
            "rigid_body": [bodies[i] for i in there],
            "lambda_a": each(forces),
            "delta_a": each(moves),
        },
    ).write(path)


class _Pieces(NamedTuple):
    """Points and cells: vertices, then lines, then faces.

    Attributes:
        points: Points at rest, first origins of rigid bodies, motors and forces [m].
        displacement: Their displacement [m].
        arrows: Axes of motors and directions of forces [-].
        cells: Kind and points of the cells.
        owners: Index of the actuator of each cell, -1 for none.
    """

    points: Float[HostArray, "n 3"]
    displacement: Float[HostArray, "n 3"]
    arrows: Float[HostArray, "n_arrows 3"]
    cells: list[tuple[str, Int[HostArray, "_ _"]]]
    owners: list[Int[HostArray, " _"]]


def _pieces(model: Model, state: RobotState) -> _Pieces:
    actuators, rest = model.mechanism.actuators, np.asarray(model.mechanism.points)
    before = actuator_geometry(actuators, rest)
    after = actuator_geometry(actuators, _moved(model, state))
    origins = _origins(model, rest)
    n_v, n_s = len(origins) + len(after.points), len(after.segments)
    used, faces = np.unique(after.faces, return_inverse=True)
    n_fn = after.faces.shape[-1]
    points = [origins, before.points, before.segments.reshape(-1, 3), rest[used]]
    displacement = [
        _origins(model, state.displacement),
        after.points - before.points,
        (after.segments - before.segments).reshape(-1, 3),
        state.displacement[used],
    ]
    cells = [
        ("vertex", np.arange(n_v)[:, None]),
        ("line", n_v + np.arange(2 * n_s).reshape(-1, 2)),
        (
            "triangle" if n_fn == 3 else "triangle6",
            n_v + 2 * n_s + faces.reshape(-1, n_fn),
        ),
    ]
    none = np.full(len(origins), -1)
    vertex_owner = np.concatenate([none, after.point_owner])
    return _Pieces(
        points=np.concatenate(points),
        displacement=np.concatenate(displacement),
        arrows=after.arrows,
        cells=cells,
        owners=[vertex_owner, after.segment_owner, after.face_owner],
    )


def _moved(model: Model, state: RobotState) -> Float[HostArray, "n_points 3"]:
    """Compute the positions of all nodes [m]."""
    return np.asarray(model.mechanism.points) + state.displacement


def _origins(
    model: Model, x: Float[HostArray, "n_points 3"]
) -> Float[HostArray, "n_b 3"]:
    """Select the rows of the origins of the rigid bodies' frames [m]."""
    return x[model.mesh.n_nodes :: 4]


def _axes(
    model: Model, x: Float[HostArray, "n_points 3"]
) -> Float[HostArray, "n_b 3 3"]:
    """Compute the axes of the rigid bodies' frames, as rows [-]."""
    nodes = x[model.mesh.n_nodes :].reshape(-1, 4, 3)
    return (nodes[:, 1:] - nodes[:, :1]) / model.mechanism.bodies.length


def _padded(first: Float[HostArray, "_ 3"], n: int) -> Float[HostArray, "n 3"]:
    """Pad the vectors of the first points with zeros for the rest."""
    return np.concatenate([first, np.zeros((n - len(first), 3))])
