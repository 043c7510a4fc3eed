"""Deformed bodies, their fields in each tet, and what moves them, for ParaView."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jax.numpy as jnp
import meshio
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import ActuatorGeometry, actuator_geometry
from softcal_jax.equilibrium import Model, RobotState, TetStates, tet_states
from softcal_jax.fields import constants_of, find_field
from softcal_jax.mesh import boundary_tets, volumes

STANDARD_ERROR = "_standard_error"
"""End of the name of a standard error; the name of its field stands before it."""

_SYMMETRIC = {"XX": (0, 0), "YY": (1, 1), "ZZ": (2, 2)}
_SYMMETRIC |= {"XY": (0, 1), "YZ": (1, 2), "XZ": (0, 2)}
"""Entries of a symmetric tensor in the order of VTK."""

_COMPONENTS = {"cauchy_stress": tuple(_SYMMETRIC), "principal_stretches": "123"}
"""Names of the components of values per tet."""


def write_vtu(
    path: str | Path,
    model: Model,
    displacement: Float[ArrayLike, "n_nodes 3"],
    *,
    standard_errors: Mapping[str, Float[HostArray, " n_tets"]] | None = None,
    state: RobotState | None = None,
) -> None:
    """Write a body, moved by `displacement` [m], for ParaView; tets keep their order.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the deformed
    shape. Per tet: `cauchy_stress`, the symmetric part of its mean over the tet, in the
    order XX, YY, ZZ, XY, YZ, XZ [Pa];
    `principal_stretches`, the largest first, mean over the quadrature points [-];
    `strain_energy_density` [J/m3], `density` [kg/m3] and every field of the law under
    its own name, in SI; `fibre_direction` at rest, and `fibre_direction_2` of a second
    family [-]; `E_standard_error` and so on of fields that were calibrated, see
    `field_standard_errors`; of the `state` of a robot that may touch something,
    `contact_pressure`: the mean over a face by its area at rest, the largest of the
    faces of the tet, 0 where nothing touches [Pa]. Per point `rigid_body`, if there are
    any: the index of its rigid body plus 1, 0 for soft points.

    Raises:
        ValueError: If the shape is wrong.
    """
    mesh = model.mesh
    u = np.asarray(displacement, float)
    if u.shape != mesh.points.shape:
        raise ValueError(
            f"displacement must have the shape {mesh.points.shape}, one row per node, "
            f"got {u.shape}."
        )
    states = tet_states(model, jnp.asarray(u))
    at_points = {"displacement": u}
    bodies = model.mechanism.bodies
    if bodies.n_bodies:
        owner = at_points["rigid_body"] = np.zeros(mesh.n_nodes)
        owner[bodies.attached] = bodies.body + 1.0
    cauchy = _symmetric_part(states)
    of_tets = {
        "cauchy_stress": np.stack(
            [cauchy[:, *ij] for ij in _SYMMETRIC.values()], axis=1
        ),
        "principal_stretches": principal_stretches(states),
        "strain_energy_density": np.asarray(states.energy) / volumes(mesh),
        **tet_fields(model, standard_errors or {}),
        **fibre_directions(model),
    }
    if state is not None and model.mechanism.contacts.can_touch:
        most = of_tets["contact_pressure"] = np.zeros(mesh.n_tets)
        np.maximum.at(most, boundary_tets(mesh), state.surface_pressure(model))
    kind = ("tetra", "tetra10")[mesh.order - 1]
    _save(path, mesh.points, [(kind, mesh.tets)], at_points, of_tets)


def write_robot_vtu(path: str | Path, model: Model, state: RobotState) -> None:
    """Write actuators and frames of rigid bodies for ParaView, beside the soft body.

    Points are at rest [m]; "Warp By Vector" with `displacement` shows the state. Lines
    are segments of cables, faces those of chambers and surface pressures, vertices the
    origins of rigid bodies, then motors and forces. Per cell: `actuator` and
    `rigid_body` (index in the model plus 1, 0 for none), `lambda_a` and `delta_a` in
    SI. Per vertex: `arrow`, the axis of a motor or direction of a force, and `axis_1`
    to `axis_3`, the axes of a rigid body's frame [-]; with obstacles `contact_force`
    [N] and `contact_moment` [N m], what the robot does to them.
    """
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
    if mechanism.contacts.n_obstacles:
        felt = {contact.name: contact for contact in state.contacts}
        for what in ("force", "moment"):  # zero where nothing touches a body
            of = (felt.get(name) for name in mechanism.bodies.names)
            sizes = [getattr(contact, what, np.zeros(3)) for contact in of]
            vectors[f"contact_{what}"] = np.array(sizes)

    # Kind and points of the cells, and the index of the actuator of each, -1 for none.
    vertex_owner = np.concatenate([np.full(n_b, -1), after.point_owner])
    kind = "triangle" if n_fn == 3 else "triangle6"
    faces = n_v + 2 * n_l + faces.reshape(-1, n_fn)
    blocks = (
        ("vertex", np.arange(n_v)[:, None], vertex_owner),
        ("line", n_v + np.arange(2 * n_l).reshape(-1, 2), after.segment_owner),
        (kind, faces, after.face_owner),
    )
    blocks = [block for block in blocks if len(block[1])]
    owner = 1 + np.concatenate([owners for *_, owners in blocks])
    # Entry 0 is for cells that no actuator owns.
    forces = np.array([0.0, *(a.force for a in state.actuators)])
    moves = np.array([0.0, *(a.displacement or 0.0 for a in state.actuators)])
    at_points = {"displacement": points(moved, after) - at_rest}
    for name, values in vectors.items():  # zero at all points but the vertices
        at_points[name] = np.pad(values, ((0, n - len(values)), (0, 0)))
    body = np.zeros(len(owner))
    body[:n_b] = 1.0 + np.arange(n_b)
    of_cells = {"actuator": owner.astype(float), "rigid_body": body}
    of_cells |= {"lambda_a": forces[owner], "delta_a": moves[owner]}
    cells = [(kind, cells) for kind, cells, _ in blocks]
    _save(path, at_rest, cells, at_points, of_cells)


def read_displacement(path: str | Path, model: Model) -> Float[HostArray, "n_points 3"]:
    """Read the displacement of all nodes of a model from a file of `write_vtu` [m].

    That of the frames of rigid bodies is read from the file of `write_robot_vtu` beside
    it, which ends in `_robot.vtu`.

    Raises:
        ValueError: If a file cannot be read, or is that of another mesh.
    """
    path, bodies = Path(path), model.mechanism.bodies
    rest, n_b = np.asarray(model.mechanism.points), bodies.n_bodies
    robot = path.with_name(f"{path.stem}_robot.vtu")
    try:
        body = meshio.vtu.read(path)
        u = np.asarray(body.point_data["displacement"])
        if n_b:
            seen = meshio.vtu.read(robot)
            moved = np.asarray(seen.point_data["displacement"])
            at = (seen.points + moved)[:n_b, None]
            axes = [np.asarray(seen.point_data[f"axis_{k}"])[:n_b] for k in (1, 2, 3)]
            ends = at + bodies.length * np.stack(axes, axis=1)
            frames = np.concatenate([at, ends], axis=1).reshape(-1, 3)
            u = np.concatenate([u, frames - rest[model.mesh.n_nodes :]])
    except Exception as error:  # libraries raise any; `meshio.read` even exits
        raise ValueError(f"{path} cannot be read: {error}") from error
    if u.shape != rest.shape or not np.array_equal(body.points, model.mesh.points):
        raise ValueError(f"{path} is of another mesh than the model")
    return u


def write_pvd(path: str | Path, files: Sequence[Sequence[str]]) -> None:
    """Write the list of the .vtu files of configurations, which ParaView opens at once.

    Each configuration is a time, 0, 1, 2 and so on, and its files, relative to the
    folder of `path`, are parts. (VTK has no writer for this format; see "ParaView file
    formats" in its documentation.)
    """
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


def _save(
    path: str | Path,
    points: Float[HostArray, "n_points 3"],
    blocks: Sequence[tuple[str, HostArray]],
    at_points: dict[str, Any],
    of_cells: Mapping[str, HostArray],
) -> None:
    """Write cells in blocks of one kind each, which VTK would abort on a full disk."""
    ends = np.cumsum([len(cells) for _, cells in blocks])[:-1]
    split: dict[str, Any] = {k: np.split(of, ends) for k, of in of_cells.items()}
    mesh = meshio.Mesh(points, list(blocks), at_points, split)
    mesh.write(path, file_format="vtu")
    tree = ElementTree.parse(path)  # meshio names no components
    for array in tree.iter("DataArray"):
        for k, name in enumerate(_COMPONENTS.get(array.get("Name", ""), ())):
            array.set(f"ComponentName{k}", name)
    tree.write(path, encoding="utf-8", xml_declaration=True)


def tet_fields(
    model: Model, standard_errors: Mapping[str, Float[HostArray, " n_tets"]]
) -> dict[str, HostArray]:
    """Return density and fields of the law, one value or vector per tet, in SI.

    Fields that have standard errors in each tet, see `field_standard_errors`, are
    followed by these, as `E_standard_error`.
    """
    errors = {find_field(model, name).path: e for name, e in standard_errors.items()}
    cells = {}
    for name, path, leaf, _ in _named(model):
        values = np.asarray(leaf, float)
        if values.ndim == 0:
            values = np.full(model.n_tets, values)
        # VTK knows no tensors per tet.
        cells[name] = values if values.ndim == 1 else values.reshape(len(values), -1)
        if path in errors:
            cells[name + STANDARD_ERROR] = errors[path]
    return cells


def field_units(model: Model) -> dict[str, str]:
    """Return the SI units of `tet_fields` by name, where the law declares one."""
    return {name: of["unit"] for name, _, _, of in _named(model) if "unit" in of}


def _named(model: Model) -> Iterator[tuple[str, str, Any, Mapping[str, Any]]]:
    """Yield name, path in the model, values and declaration of density and fields."""
    *of_law, density = constants_of(model)
    constants = [density, *of_law]
    shorts = [path.rpartition(".")[2] for path, *_ in constants]
    for short, field in zip(shorts, constants, strict=True):
        # A law with two elasticities has two E: use the whole path as the name then.
        path = field[0] if short == "density" else field[0].removeprefix("law.")
        yield short if shorts.count(short) == 1 else path, *field


def principal_stretches(states: TetStates) -> Float[HostArray, "n_tets 3"]:
    """Compute the principal stretches, the singular values of F, largest first [-]."""
    return np.linalg.svd(states.F, compute_uv=False).mean(axis=1)


def _symmetric_part(states: TetStates) -> Float[HostArray, "n_tets 3 3"]:
    """Return the symmetric part of the stress, which not every law keeps symmetric."""
    cauchy = np.asarray(states.cauchy)
    return 0.5 * (cauchy + np.swapaxes(cauchy, 1, 2))


def von_mises_stress(states: TetStates) -> Float[HostArray, " n_tets"]:
    """Compute the von Mises stress of the mean Cauchy stress of each tet [Pa].

    It is sqrt(3/2 s : s) with the deviatoric part s, so without the pressure, which
    is uneven over the tets of a nearly incompressible law.
    """
    cauchy = _symmetric_part(states)
    s = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0
    return np.sqrt(1.5 * np.sum(s * s, axis=(1, 2)))


def fibre_directions(model: Model) -> dict[str, Float[HostArray, "n_tets 3"]]:
    """Return the directions of the fibres at rest, by family [-]."""
    return {
        f"fibre_direction{f'_{k}' if k > 1 else ''}": fibre.of_tets(model.n_tets)
        for k, fibre in enumerate(model.law.fibres(), start=1)
    }
