"""Tables of a project file for the robot: mesh, groups, fibres, bodies, actuators."""

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, StrictInt, create_model, model_validator

from softcal_jax import actuators, mesh as meshes
from softcal_jax._files import check_file
from softcal_jax._module import key, keys
from softcal_jax._typing import Float, HostArray, Int, Vector
from softcal_jax._units import METRES
from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.configurations import (
    ImposedDisplacement,
    ImposedForce,
    Mechanism,
    actuation_arrays,
)
from softcal_jax.contact import SHAPES, AbstractShape, read_surface
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad
from softcal_jax.materials import frames_along, frames_around
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._table import (
    Choice,
    File,
    Maker,
    Table,
    TableOr,
    by_keys,
    known_name,
    of_type,
    only,
    table_of,
    under,
    wrong_key,
)

LengthUnit = Literal["m", "cm", "mm", "um", "inch"]


class MeshTable(Maker):
    """A mesh: of a mesh file, of a CAD model, or of a box."""

    element: Literal["quadratic", "linear"] = "quadratic"

    def build(self, folder: Path) -> TetMesh:
        """Make the mesh; what is costly to make is kept in `folder`."""
        kept = {"kept_in": folder} if self.makes is mesh_cad else {}
        return super().build(order=2 if self.element == "quadratic" else 1, **kept)

    def tet_data(self, name: str) -> Float[HostArray, "n_tets _"]:
        """Read an array of a mesh file with values for each tet."""
        if self.makes is not meshes.read_mesh:
            raise ValueError(
                f"there is no mesh file to read {name!r} from. Take "
                'type = "along", "hoop" or "helix", or a mesh of a file.'
            )
        return meshes.read_tet_data(vars(self)["file"], name)


class BeamTable(Table):
    """A box of tets, long along x; its sides are the groups "x_min" to "z_max"."""

    size: typed.Extent = Field(description='length, width, height: "(100, 30, 30) mm"')
    cells: tuple[StrictInt, StrictInt, StrictInt] = Field(
        description="cells along x, y and z: [14, 4, 4]"
    )
    origin: typed.Position = (0.0, 0.0, 0.0)
    pattern: Literal["mirrored", "centred"] = "mirrored"


@keys(beam=key())
def _box(beam: BeamTable, order: int) -> TetMesh:
    return meshes.beam(*beam.size, order=order, **beam.model_dump(exclude={"size"}))


MESH_FILE = table_of(
    meshes.read_mesh,
    base=MeshTable,
    path=File,
    length_unit=LengthUnit,
    unused=Literal["error", "drop"],
    parts=Literal["one", "linked"],
)
CAD_MODEL = table_of(mesh_cad, base=MeshTable, path=File, length_unit=LengthUnit)
BOX = table_of(_box, base=MeshTable)


def _mesh_kind(value: Any, _: Any) -> type[BaseModel]:
    """Choose a table of a mesh; a CAD model is known by its file extension."""
    file = value.get("file") if isinstance(value, dict) else None
    if file is None:
        return by_keys(value, (MESH_FILE, CAD_MODEL, BOX))
    is_cad = Path(str(file)).suffix.lower() in CAD_FORMATS
    return CAD_MODEL if is_cad else MESH_FILE


AnyMesh = Annotated[MeshTable, Choice(_mesh_kind)]


_Points = Annotated[tuple[typed.Position, ...], Field(min_length=1)]


@keys(points=key(words='a point on each face: ["(0, 5, 0) mm"]'))
def _faces_at(mesh: TetMesh, points: _Points) -> Int[HostArray, "n n_fn"]:
    faces = [meshes.select_face(mesh, point) for point in points]
    return np.unique(np.concatenate(faces), axis=0)


_PLACES = meshes.REGIONS | {
    "face": _faces_at,
    "reachable": meshes.select_reachable,
    "inside": meshes.select_cavity,
}
_KEYS: dict[str, Any] = {
    key: (table_of(makes, "tolerance") | None, None) for key, makes in _PLACES.items()
}


class GroupTable(create_model("Group", __base__=Table, **_KEYS)):
    """A named part of the mesh: nodes, faces or tets in a region, or a surface."""

    of: Literal["nodes", "faces", "tets"] = "nodes"
    tolerance: typed.Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "GroupTable":
        given = [key for key in _PLACES if key in self.model_fields_set]
        if len(given) != 1:
            raise ValueError(
                f"expected exactly one of {', '.join(_PLACES)}; got "
                f"{' and '.join(given) or 'none'}."
            )
        spare = sorted({"of", "tolerance"} & self.model_fields_set)
        if spare and given[0] not in meshes.REGIONS:
            raise ValueError(
                f"{given[0]} finds faces: leave {' and '.join(spare)} out."
            )
        return self

    def add(self, mesh: TetMesh, name: str) -> TetMesh:
        """Add the group to the mesh; raise if nothing is there or the name is taken."""
        key, place = next((k, part) for k, part in self if isinstance(part, Maker))
        if key not in meshes.REGIONS:
            return mesh.with_surface_group(name, place.build(mesh))
        # A millionth of the mesh: far below a cell, far above the rounding of a file.
        rounding = 1e-6 * mesh.size if self.tolerance is None else self.tolerance
        region = place.build(tolerance=rounding)
        if self.of == "nodes":
            return mesh.with_node_group(name, meshes.select_nodes(mesh, region))
        if self.of == "faces":
            return mesh.with_surface_group(name, meshes.select_faces(mesh, region))
        tets = np.flatnonzero(region(mesh.centroids))
        if not tets.size:
            raise ValueError("no tet has its centre there; check the length unit.")
        return mesh.with_tet_group(name, tets)


TetData = Callable[[str], Float[HostArray, "n_tets _"]]
"""Returns an array of the mesh file by its name."""

Frames = Float[HostArray, "n 3 3"]
"""Local axes of some tets, see `Fibre`."""


@keys(axis=key("", 'where fibres point: "z" or [0, 0, 1]'))
def _along(mesh: TetMesh, tets: HostArray, data: TetData, axis: Vector) -> Frames:
    return frames_along(np.broadcast_to(np.asarray(axis), (len(tets), 3)))


@keys(
    axis=key("", 'direction of the axis: "z" or [0, 0, 1]'),
    through=key("m", "a point of the axis"),
    kind=key(key="type"),
)
def _around(
    mesh: TetMesh,
    tets: HostArray,
    data: TetData,
    axis: Vector,
    through: Vector = (0.0, 0.0, 0.0),
    kind: str = "helix",
) -> Frames:
    """Build local axes for hoops, or for a helix at the angle `theta` from the axis."""
    frames = frames_around(mesh.centroids[tets], axis, through)
    return frames[:, [2, 1, 0]] if kind == "hoop" else frames


@keys(array=key(words='name of a cell array of the mesh file: "fibre"'))
def _cells(mesh: TetMesh, tets: HostArray, data: TetData, array: str) -> Frames:
    vectors = data(array)
    if vectors.shape[1:] != (3,):
        raise ValueError(
            f"the cell array {array!r} has the shape {vectors.shape}; "
            "expected a vector of three components for each tet."
        )
    return frames_along(vectors[tets])


DIRECTIONS = {"along": _along, "hoop": _around, "helix": _around, "cells": _cells}
"""What makes local axes of some tets, from the mesh and its file."""

AnyDirections = Annotated[Maker, of_type(DIRECTIONS)]


SURFACE_FORMATS = ".stl", ".ply", ".obj", ".vtp"


@keys(
    file=key(words='a closed surface: "object.stl"'),
    length_unit=key(words='the length unit of the file: "mm"'),
)
def _surface(file: File, length_unit: LengthUnit) -> AbstractShape:
    check_file(file, "surface file")
    if file.suffix.lower() not in SURFACE_FORMATS:
        raise ValueError(
            f"surface file {file} has the extension {file.suffix!r}; "
            f"expected one of {', '.join(SURFACE_FORMATS)}."
        )
    return read_surface(file, length_unit=METRES[length_unit])


AnyShape = Annotated[Maker, of_type(SHAPES | {"surface": _surface})]


class BodyTable(table_of(RigidBody, "name", "shape")):
    """Nodes that move as one, or an obstacle with a shape, which may have no nodes."""

    hinge: typed.Direction | None = None
    shape: AnyShape | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyTable":
        if not any(self.model_dump(include={"group", "shape"}).values()):
            raise wrong_key(
                "group",
                'missing. Expected a group of the mesh: "x_max", or several; or, for '
                'an obstacle, its shape: { type = "plane" }.',
            )
        if {"hinge", "axes"} <= self.model_fields_set:
            raise ValueError(
                "got hinge and axes; the hinge is the third of the axes: give one."
            )
        return self

    def build(self, name: str) -> RigidBody:
        with under("shape"):
            shape = None if self.shape is None else self.shape.build()
        axes = {} if self.hinge is None else {"axes": hinge_axes(self.hinge)}
        return super().build(name, shape=shape, **axes)


StateName = Literal["held", "hinged", "sliding", "free", "absent"]


class BodyStateTable(table_of(Pose)):
    state: StateName = "held"
    start: Annotated[Maker, only(Pose)] = table_of(Pose)()

    def build(self) -> BodyState:
        return BodyState(self.state, super().build(), self.start.build())


State = TableOr[BodyStateTable, StateName]


def build_states(
    table: Mapping[str, Any], mechanism: Mechanism
) -> dict[str, BodyState | Pose | str]:
    states: dict[str, BodyState | Pose | str] = {}
    for body, state in table.items():
        with under(body):
            known_name("rigid body", body, mechanism.bodies.names, "[bodies]")
            states[body] = state.build() if isinstance(state, Maker) else state
    return states


_actuator = lambda kind: table_of(kind, "name", type=str)
AnyActuator = Annotated[Maker, of_type(actuators.ACTUATORS, _actuator)]


def imposed_on(
    tables: Mapping[str, Maker], name: str, value: Any
) -> ImposedForce | ImposedDisplacement:
    """Parse what is imposed on an actuator; the unit tells force from displacement."""
    known_name("actuator", name, tables, "[actuators]")
    kind: actuators.Kind = tables[name].makes.kind
    releasing, given = False, value
    if isinstance(value, dict):  # a cable with friction: which way it last moved
        unknown = set(value) - {"value", "releasing"}
        if unknown or not isinstance(value.get("releasing", False), bool):
            raise ValueError(
                f"got {typed.shown(value)}; expected a table like "
                '{ value = "2 N", releasing = true }.'
            )
        releasing, given = value.get("releasing", False), value.get("value")
    units = kind.force_unit, kind.displacement_unit
    for impose, unit in zip((ImposedForce, ImposedDisplacement), units, strict=True):
        with contextlib.suppress(ValueError):  # of the other dimension, or neither
            if unit is not None:
                return impose(typed.parse_in_si(given, unit), releasing)
    raise ValueError(
        f"got {typed.shown(given)}; expected of a {kind.noun} {kind.imposed}."
    )


def build_actuation(
    asked: Mapping[str, Any],
    tables: Mapping[str, Maker],
    mechanism: Mechanism,
    name: str,
) -> dict[str, ImposedForce | ImposedDisplacement]:
    imposed: dict[str, ImposedForce | ImposedDisplacement] = {}
    for actuator, value in asked.items():
        with under(actuator):
            imposed[actuator] = imposed_on(tables, actuator, value)
            actuation_arrays(mechanism, {actuator: imposed[actuator]}, name)
    return imposed
