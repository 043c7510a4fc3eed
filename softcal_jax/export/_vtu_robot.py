"""Cables, walls of chambers, motors and frames of rigid bodies as a VTK file."""

from pathlib import Path

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import ActuatorGeometry, actuator_geometry
from softcal_jax.equilibrium import Model, RobotState
from softcal_jax.export._vtu import save_vtu, vtu_path


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
    import pyvista
    from pyvista import CellType

    path = vtu_path(path)
    mechanism, first = model.mechanism, model.mesh.n_nodes
    rest = np.asarray(mechanism.points)
    moved = rest + state.displacement
    after = actuator_geometry(mechanism.actuators, moved)
    used, faces = np.unique(after.faces, return_inverse=True)

    def points(x: Float[HostArray, "n_all 3"], shown: ActuatorGeometry):
        """Stack origins of frames, motors and forces, cables, then nodes of faces."""
        return np.concatenate(
            [x[first::4], shown.points, shown.segments.reshape(-1, 3), x[used]]
        )

    at_rest = points(rest, actuator_geometry(mechanism.actuators, rest))
    n, n_b = len(at_rest), mechanism.bodies.n_bodies
    n_v, n_l, n_fn = n_b + len(after.points), len(after.segments), after.faces.shape[-1]
    frames = moved[first:].reshape(-1, 4, 3)
    axes = (frames[:, 1:] - frames[:, :1]) / mechanism.bodies.length
    vectors = {f"axis_{k + 1}": axes[:, k] for k in range(3)}
    vectors["arrow"] = np.concatenate([np.zeros((n_b, 3)), after.arrows])

    # Kind and points of the cells, and the index of the actuator of each, -1 for none.
    vertex_owner = np.concatenate([np.full(n_b, -1), after.point_owner])
    kind = CellType.TRIANGLE if n_fn == 3 else CellType.QUADRATIC_TRIANGLE
    faces = n_v + 2 * n_l + faces.reshape(-1, n_fn)
    blocks = (
        (CellType.VERTEX, np.arange(n_v)[:, None], vertex_owner),
        (CellType.LINE, n_v + np.arange(2 * n_l).reshape(-1, 2), after.segment_owner),
        (kind, faces, after.face_owner),
    )
    there = [block for block in blocks if len(block[1])]
    owner = 1 + np.concatenate([own for *_, own in there])
    # Entry 0 is for cells that no actuator owns.
    forces = np.array([0.0, *(a.force for a in state.actuators)])
    moves = np.array([0.0, *(a.displacement or 0.0 for a in state.actuators)])
    grid = pyvista.UnstructuredGrid({kind: cells for kind, cells, _ in there}, at_rest)
    grid.point_data["displacement"] = points(moved, after) - at_rest
    for name, values in vectors.items():  # zero at all points but the vertices
        grid.point_data[name] = np.pad(values, ((0, n - len(values)), (0, 0)))
    grid.cell_data["actuator"] = owner.astype(float)
    body = np.zeros(len(owner))
    body[:n_b] = 1.0 + np.arange(n_b)
    grid.cell_data["rigid_body"] = body
    grid.cell_data["lambda_a"] = forces[owner]
    grid.cell_data["delta_a"] = moves[owner]
    save_vtu(path, grid)
