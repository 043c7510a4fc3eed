"""The surface of a body as a page draws it, and the fields that colour it."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax import export
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable_unit
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import Model, tet_states
from softcal_jax.mesh import Tessellation, TetMesh, boundary_tets, tessellate
from softcal_jax.plotting import rigid_faces

TetValues = Mapping[str, Float[HostArray, " n_tets"]]
"""Values of fields in each tet, or their standard errors, by the name of the field."""

_SHARP = np.cos(np.radians(30.0))  # an edge is sharp where two normals differ more


class Surface(NamedTuple):
    """Triangles of the boundary, face by face, and the edges of its faces."""

    cut: Tessellation
    per_face: int  # triangles that a face is cut into
    faces: Int[HostArray, "n_faces n_fn"]  # their nodes
    tets: Int[HostArray, " n_faces"]  # the tet of each face
    rigid: Bool[HostArray, " n_faces"]  # all its nodes belong to one rigid body
    edges: Int[HostArray, "n_edges 2"]  # points at the ends of parts, sharp ones first
    n_sharp: int  # edges that are sharp at rest

    def having(self, corners: Int[HostArray, "n 3"]) -> Bool[HostArray, " n_faces"]:
        """Say which faces have one of these triples of corners, in any order."""
        triples = np.sort(self.faces[:, :3], axis=1)
        wanted = {tuple(row) for row in np.sort(corners, axis=1).tolist()}
        return np.array([tuple(row) in wanted for row in triples.tolist()], bool)


def surface_of(model: Model, parts: int) -> Surface:
    """Cut the boundary into triangles, and edges of quadratic faces into `parts`."""
    tets = boundary_tets(model.mesh)
    cut = tessellate(model.mesh, parts=parts)
    per_face = len(cut.triangles) // len(tets)
    faces = cut.faces[::per_face]
    rigid = rigid_faces(model, faces)
    edges, sharp = _edges(model.mesh, cut, per_face)
    edges = np.concatenate([edges[sharp], edges[~sharp]])
    return Surface(cut, per_face, faces, tets, rigid, edges, int(sharp.sum()))


def _edges(
    mesh: TetMesh, cut: Tessellation, per_face: int
) -> tuple[Int[HostArray, "n_edges 2"], Bool[HostArray, " n_edges"]]:
    """Find the sides of triangles on edges of faces, and which are sharp at rest."""
    corners = cut.interpolate(mesh.points)[cut.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    sides = np.sort(cut.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(cut.triangles)), 3)
    order = np.lexsort(sides.T)
    sides, owner = sides[order], owner[order]
    first = np.flatnonzero(np.any(np.diff(sides, axis=0, prepend=-1) != 0, axis=1))
    count = np.diff(first, append=len(sides))
    paired = count == 2
    a, b = owner[first], owner[first + paired]
    within = paired & (a // per_face == b // per_face)
    # Where other than two triangles meet, bodies touch: a line worth seeing.
    sharp = ~paired | (np.einsum("ij,ij->i", normals[a], normals[b]) < _SHARP)
    return sides[first[~within]], sharp[~within]


_AS_THEY_ARE = ("rad", "m")  # units of errors that are not shown in % of the value

_ERROR = "standard error of "


class Field(NamedTuple):
    """A field, in the unit in which it is shown, of points, faces or the markers alone.

    `values` has an entry per configuration, None without an equilibrium and nan where
    there is no value; a field that is the same in all of them has a single entry.
    """

    label: str
    unit: str
    place: Literal["point", "face", "marker"]
    values: tuple[Float[HostArray, " n"] | None, ...]
    note: str = ""


_STATE = {"largest principal stretch": "", "von Mises stress": "Pa"}  # units


def state_fields(model: Model, pose: ConfigurationResult) -> TetValues:
    """Compute stretch and stress of the tets; nothing without an equilibrium."""
    if not pose.converged:
        return {}
    states = tet_states(model, jnp.asarray(pose.displacement))
    values = export.principal_stretches(states)[:, 0], export.von_mises_stress(states)
    return dict(zip(_STATE, values, strict=True))


def view_fields(
    model: Model,
    shown: Sequence[ConfigurationResult],
    states: Sequence[TetValues],
    surface: Surface,
    errors: TetValues | None,
) -> list[Field]:
    """Collect the fields: of the state of the body, of its law, and at markers.

    Fields of the law are shown if they vary over the body or were calibrated, and so
    have standard errors. A field without any value on the surface is left out.
    """
    size = lambda u: 1e3 * np.linalg.norm(surface.cut.interpolate(u), axis=1)
    moved = [size(pose.displacement) if pose.converged else None for pose in shown]
    fields = [Field("displacement [mm]", "mm", "point", tuple(moved))]
    fields += _law_fields(model, surface, errors)
    for name, unit in _STATE.items():
        values = [state[name][surface.tets] if state else None for state in states]
        fields.append(_of_faces(name, unit, values, surface))
    label = "distance at markers [mm]"
    note = "Discs at the measured markers; there are no values in between."
    fields.append(Field(label, "mm", "marker", tuple(map(_distances, shown)), note))
    has_values = lambda v: v is not None and np.isfinite(v).any()
    return [field for field in fields if any(map(has_values, field.values))]


def calibrated_field(fields: Sequence[Field]) -> int:
    """Return the index of the first field that was calibrated and varies, or else 0.

    The standard error of a field follows it.
    """
    for k, (field, after) in enumerate(itertools.pairwise(fields)):
        values = field.values[0]
        if after.label.startswith(_ERROR) and values is not None:
            if np.nanmin(values) < 0.999 * np.nanmax(values):
                return k
    return 0


def _distances(pose: ConfigurationResult):
    """Compute how far simulated points are from measured ones [mm]."""
    if not pose.converged or pose.role == "simulation":
        return None
    return np.array([1e3 * point.distance(point.simulated) for point in pose.points])


def _law_fields(
    model: Model, surface: Surface, errors: TetValues | None
) -> list[Field]:
    units, per_tet = export.field_units(model), export.tet_fields(model, errors or {})
    fields = []
    for name, values in per_tet.items():
        if name not in units or values.ndim > 1:
            continue
        error = per_tet.get(name + export.STANDARD_ERROR)
        if error is None and np.ptp(values) <= 1e-9 * np.abs(values).max():
            continue
        unit = units[name]
        fields.append(_of_faces(name, unit, [values[surface.tets]], surface))
        if error is not None:
            if unit not in _AS_THEY_ARE:
                size = np.where(values == 0.0, np.nan, np.abs(values))
                unit, error = "%", 100.0 * error / size
            title = f"{_ERROR}{name}"
            fields.append(_of_faces(title, unit, [error[surface.tets]], surface))
    return fields


def _of_faces(
    name: str,
    unit: str,
    values: Sequence[Float[HostArray, " n_faces"] | None],
    surface: Surface,
) -> Field:
    """Convert values of faces to a readable unit; rigid faces get no value."""
    present = np.concatenate([np.zeros(0), *(v for v in values if v is not None)])
    finite = np.abs(present[np.isfinite(present)])
    factor, shown = readable_unit([float(finite.max(initial=0.0))], unit)
    converted = tuple(
        None if v is None else np.where(surface.rigid, np.nan, factor * v)
        for v in values
    )
    note = ["Each face has the value of its tet."]
    if unit == "rad":
        note.append("Angles that differ by 180 deg are one axis.")
    if not np.isfinite(present).all():
        note.append("Grey: no value.")
    return Field(f"{name} [{shown or '-'}]", shown, "face", converted, " ".join(note))
