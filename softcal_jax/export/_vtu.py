"""Deformed bodies, and what moves them, as VTK files for ParaView."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import ActuatorGeometry, actuator_geometry
from softcal_jax.equilibrium import Model, RobotState, tet_states
from softcal_jax.export._tet_fields import (
    fibre_directions,
    principal_stretches,
    symmetric_part,
    tet_fields,
)
from softcal_jax.mesh import volumes

if TYPE_CHECKING:
    import pyvista

_SYMMETRIC = {"XX": (0, 0), "YY": (1, 1), "ZZ": (2, 2)}
_SYMMETRIC |= {"XY": (0, 1), "YZ": (1, 2), "XZ": (0, 2)}
"""Entries of a symmetric tensor in the order of VTK."""


def write_vtu(
    path: str | Path,
    model: Model,
    displacement: Float[ArrayLike, "n_nodes 3"],
    *,
    standard_errors: Mapping[str, Float[HostArray, " n_tets"]] | None = None,
) -> None:
    """Write a deformed body for ParaView; quadratic tets stay quadratic.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the deformed
    shape. Per tet: `cauchy_stress`, the mean over the tet, in the order XX, YY, ZZ, XY,
    YZ, XZ, of a law whose moments do not balance its symmetric part [Pa];
    `principal_stretches`, the largest first, mean over the quadrature points [-];
    `strain_energy_density` [J/m3], `density` [kg/m3] and every field of the law under
    its own name, in SI; `fibre_direction` at rest, and `fibre_direction_2` of a second
    family [-]; `E_standard_error` and so on of fields that were calibrated. Per point
    `rigid_body`, if there are any: the index of its rigid body plus 1, 0 for soft
    points.

    Args:
        path: The file, ending in .vtu.
        model: The model.
        displacement: Nodal displacement [m].
        standard_errors: Standard errors of fields in each tet, by the name of the
            field, see `field_standard_errors`.

    Raises:
        ValueError: If the name does not end in .vtu, or the shape is wrong.
    """
    import pyvista

    path = _ending_in(".vtu", path)
    mesh = model.mesh
    u = np.asarray(displacement, float)
    if u.shape != mesh.points.shape:
        raise ValueError(
            f"displacement must have the shape {mesh.points.shape}, one row per node, "
            f"got {u.shape}."
        )
    states = tet_states(model, jnp.asarray(u))
    kinds = pyvista.CellType.TETRA, pyvista.CellType.QUADRATIC_TETRA
    grid = pyvista.UnstructuredGrid({kinds[mesh.order - 1]: mesh.tets}, mesh.points)
    grid.point_data["displacement"] = u
    bodies = model.mechanism.bodies
    if bodies.n_bodies:
        owner = np.zeros(mesh.n_nodes)
        owner[bodies.attached] = bodies.body + 1.0
        grid.point_data["rigid_body"] = owner
    cauchy = symmetric_part(states.cauchy)
    stress = np.stack([cauchy[:, i, j] for i, j in _SYMMETRIC.values()], axis=1)
    _add(grid, "cauchy_stress", stress, tuple(_SYMMETRIC))
    _add(grid, "principal_stretches", principal_stretches(states), ("1", "2", "3"))
    grid.cell_data["strain_energy_density"] = states.energy / volumes(mesh)
    for name, values in tet_fields(model, standard_errors or {}).items():
        grid.cell_data[name] = values
    for name, values in fibre_directions(model).items():
        grid.cell_data[name] = values
    _save(path, grid)


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

    path = _ending_in(".vtu", path)
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
    _save(path, grid)


def write_pvd(path: str | Path, files: Sequence[Sequence[str]]) -> None:
    """Write the list of the .vtu files of configurations, which ParaView opens at once.

    Each configuration is a time, 0, 1, 2 and so on, and its files are parts. (VTK has
    no writer for this format; see "ParaView file formats" in its documentation.)

    Args:
        path: The file, ending in .pvd.
        files: The files of each configuration, relative to the folder of `path`.

    Raises:
        ValueError: If the name does not end in .pvd.
    """
    path = _ending_in(".pvd", path)
    version = {"type": "Collection", "version": "0.1", "byte_order": "LittleEndian"}
    root = ElementTree.Element("VTKFile", version)
    collection = ElementTree.SubElement(root, "Collection")
    for time, parts in enumerate(files):
        for part, file in enumerate(parts):
            entry = {"timestep": str(time), "part": str(part), "file": file}
            ElementTree.SubElement(collection, "DataSet", entry)
    tree = ElementTree.ElementTree(root)
    ElementTree.indent(tree)
    tree.write(path, encoding="utf-8", xml_declaration=True)


def _save(path: Path, grid: "pyvista.UnstructuredGrid") -> None:
    """Write a grid."""
    grid.save(path)
    if not path.exists():  # VTK removes what it could not finish, and only prints it
        raise OSError(f"{path} could not be written: is the disk full?")


def _ending_in(suffix: str, path: str | Path) -> Path:
    path = Path(path)
    if path.suffix != suffix:
        raise ValueError(f"the file name must end in {suffix}, got {path.name!r}.")
    return path


def _add(
    grid: "pyvista.UnstructuredGrid",
    name: str,
    values: Float[HostArray, "n_tets k"],
    components: tuple[str, ...],
) -> None:
    """Add values per tet whose components have names."""
    grid.cell_data[name] = values
    array = grid.GetCellData().GetArray(name)
    for k, component in enumerate(components):
        array.SetComponentName(k, component)
