"""What the view of a page draws, as JSON with packed arrays, in mm.

It is the surface of the body, fields that colour it, and what stands beside it.
Positions are 16-bit multiples of one step above the lower corner of a box that holds
all configurations, and values of fields 16-bit parts of the field's range: arrays of
bytes, the lowest first, in base64. The step is a 65535th of the largest side of the
box, too small a change to be seen in a picture.
"""

import base64
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax import plotting
from softcal_jax._text import escaped
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable_unit, readable_values
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import Model, tet_states
from softcal_jax.mesh import (
    Tessellation,
    TetMesh,
    boundary_tets,
    face_indices,
    tessellate,
)
from softcal_jax.results._vtu import (
    STANDARD_ERROR,
    fibre_directions,
    field_units,
    principal_stretches,
    tet_fields,
    von_mises_stress,
)

TetValues = Mapping[str, Float[HostArray, " n_tets"]]
"""Values of fields in each tet, or their standard errors, by the name of the field."""

_MOST = 65535  # largest number of 16 bits; in a field, there is no value
_FIBRES = 600  # most fibres that are drawn
_SHARP = np.cos(np.radians(30.0))  # an edge is sharp where two normals differ more
_AS_THEY_ARE = ("rad", "m")  # units of errors that are not shown in % of the value
_ERROR = "standard error of "


class Surface(NamedTuple):
    """Triangles of the boundary, face by face, and the edges of its faces."""

    cut: Tessellation
    per_face: int  # triangles that a face is cut into
    faces: Int[HostArray, "n_faces n_fn"]  # their nodes
    tets: Int[HostArray, " n_faces"]  # the tet of each face
    rigid: Bool[HostArray, " n_faces"]  # all its nodes belong to one rigid body
    edges: Int[HostArray, "n_edges 2"]  # points at the ends of parts, sharp ones first
    n_sharp: int  # edges that are sharp at rest


def surface_of(model: Model, parts: int) -> Surface:
    """Cut the boundary into triangles, and edges of quadratic faces into `parts`."""
    tets = boundary_tets(model.mesh)
    cut = tessellate(model.mesh, parts=parts)
    per_face = len(cut.triangles) // len(tets)
    faces = cut.faces[::per_face]
    rigid = plotting.rigid_faces(model, faces)
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
    values = principal_stretches(states)[:, 0], von_mises_stress(states)
    return dict(zip(_STATE, values, strict=True))


def view_fields(
    model: Model,
    shown: Sequence[ConfigurationResult],
    states: Sequence[TetValues],
    surface: Surface,
    errors: TetValues | None,
) -> list[Field]:
    """Collect the fields: of the state of the body, its law, contact, and at markers.

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
    touched = [_pressure(model, pose) for pose in shown]
    if any(values is not None and values.any() for values in touched):
        note = "Each face has its mean."
        fields.append(_of_faces("contact pressure", "Pa", touched, surface, note))
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


def _pressure(model: Model, pose: ConfigurationResult):
    """Compute the pressure of contact on the faces [Pa], with an equilibrium."""
    if not pose.converged or pose.robot is None:
        return None
    return pose.robot.surface_pressure(model)


def _distances(pose: ConfigurationResult):
    """Compute how far simulated points are from measured ones [mm]."""
    if not pose.converged or pose.role == "simulation":
        return None
    return np.array([1e3 * point.distance(point.simulated) for point in pose.points])


def _law_fields(
    model: Model, surface: Surface, errors: TetValues | None
) -> list[Field]:
    units, per_tet = field_units(model), tet_fields(model, errors or {})
    fields = []
    for name, values in per_tet.items():
        if name not in units or values.ndim > 1:
            continue
        error = per_tet.get(name + STANDARD_ERROR)
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
    of_each: str = "Each face has the value of its tet.",
) -> Field:
    """Convert values of faces to a readable unit; rigid faces get no value."""
    present = np.concatenate([np.zeros(0), *(v for v in values if v is not None)])
    finite = np.abs(present[np.isfinite(present)])
    factor, shown = readable_unit([float(finite.max(initial=0.0))], unit)
    converted = tuple(
        None if v is None else np.where(surface.rigid, np.nan, factor * v)
        for v in values
    )
    note = [of_each]
    if unit == "rad":
        note.append("Angles that differ by 180 deg are one axis.")
    if not np.isfinite(present).all():
        note.append("Grey: no value.")
    return Field(f"{name} [{shown or '-'}]", shown, "face", converted, " ".join(note))


def pack(values: HostArray) -> str:
    """Write the bytes of an array as text."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def view_data(
    model: Model,
    shown: Sequence[ConfigurationResult],
    surface: Surface,
    fields: Sequence[Field],
) -> dict[str, Any]:
    """Collect what the view draws; at rest where there is no equilibrium."""
    import matplotlib

    rest = 1e3 * surface.cut.interpolate(model.mesh.points)
    # Without an equilibrium, what a solver left of a displacement means nothing.
    moved = [
        pose.displacement if pose.converged else np.zeros_like(pose.displacement)
        for pose in shown
    ]
    points = [rest + 1e3 * surface.cut.interpolate(u) for u in moved]
    fibres = [_fibres(model, surface, u) for u in moved]
    robots = [robot_data(model, pose) for pose in shown]
    n_obstacles = model.mechanism.contacts.n_obstacles
    obstacles = [plotting.obstacle_surface(model, k) for k in range(n_obstacles)]
    everything = np.concatenate([rest, *points, *(f.reshape(-1, 3) for f in fibres)])
    low, step = everything.min(axis=0), float(np.ptp(everything, axis=0).max()) / _MOST
    placed = lambda x: pack(np.rint((x - low) / step).astype("<u2"))
    # The map of the pictures, which is even in grey too.
    colours = matplotlib.colormaps[plotting.DISPLACEMENT_MAP](np.linspace(0, 1, 256))
    index = "<u2" if len(rest) <= _MOST else "<u4"
    # How far obstacles reach from the corner of the box.
    sizes = [1e3 * np.linalg.norm(s.points, axis=1).max() for s in obstacles]
    reach = [
        float(np.linalg.norm(obstacle["at"] - low) + sizes[obstacle["shape"]])
        for robot in robots
        for obstacle in robot["obstacles"]
    ]

    def covered(walls: Int[HostArray, "n 3"]) -> str | None:
        if not len(walls):
            return None
        return pack((face_indices(surface.faces[:, :3], walls) >= 0).astype("u1"))

    entries = [
        {
            "drawn": pose.converged,
            "points": placed(x),
            "fibres": placed(f),
            "markers": _markers(pose),
            **robot,
            "walls": covered(robot["walls"]),
        }
        for pose, x, f, robot in zip(shown, points, fibres, robots, strict=True)
    ]
    return {
        "low": low.tolist(),
        "step": step,
        "wide": index == "<u4",
        "triangles": pack(surface.cut.triangles.astype(index)),
        "perFace": surface.per_face,
        "rigid": pack(surface.rigid.astype("u1")),
        "anyRigid": bool(surface.rigid.any()),
        "edges": pack(surface.edges.astype(index)),
        "sharp": surface.n_sharp,
        "rest": placed(rest),
        "map": pack(np.rint(255.0 * colours[:, :3]).astype("u1")),
        "view": _first_view(model, shown, robots),
        "fields": [_field(field) for field in fields],
        "configurations": entries,
        "shapes": [_shape(surface) for surface in obstacles],
        # More than the diagonal of the box, and far enough for what stands beside.
        "farthest": 1.8 * _MOST * step + max(reach, default=0.0),
    }


def _field(field: Field) -> dict[str, Any]:
    finite = np.concatenate([v[np.isfinite(v)] for v in field.values if v is not None])
    low, high = float(finite.min()), float(finite.max())
    if field.place != "face":  # the scale of distances begins at zero
        low = 0.0
    if high - low <= 1e-6 * max(abs(low), abs(high)):
        high = low  # a single value; the rest is rounding

    def packed(values: Float[HostArray, " n"]) -> str:
        share = (values - low) / (high - low or 1.0)
        whole = np.rint(np.nan_to_num(share) * (_MOST - 1)).clip(0, _MOST - 1)
        return pack(np.where(np.isfinite(values), whole, _MOST).astype("<u2"))

    return {
        "label": field.label,
        "unit": field.unit,
        "place": field.place,
        "note": field.note,
        "range": [low, high],
        "values": [None if v is None else packed(v) for v in field.values],
        "largest": [
            None if v is None or np.isnan(v).all() else float(np.nanmax(v))
            for v in field.values
        ],
    }


def _markers(pose: ConfigurationResult) -> list[dict[str, Any]]:
    """List measured and simulated points, as the pictures show them [mm]."""
    known = lambda x: _mm(x) if np.isfinite(x).all() else None
    rows = zip(pose.points, *plotting.marker_places(pose), strict=True)
    return [
        {"name": escaped(point.name), "measured": known(a), "simulated": known(b)}
        for point, a, b in rows
    ]


def _fibres(
    model: Model, surface: Surface, u: Float[HostArray, "n_nodes 3"]
) -> Float[HostArray, "n_fibres 2 3"]:
    """Find the ends of fibres in tets at the surface, which move with the tets [mm]."""
    mesh, families = model.mesh, fibre_directions(model).values()
    tets = np.unique(surface.tets)
    count = min(_FIBRES // max(len(families), 1), len(tets))
    tets = tets[np.unique(np.linspace(0, len(tets) - 1, count).round().astype(int))]
    corners = mesh.tets[tets, :4]
    X = mesh.points[corners]
    length = 0.6 * np.cbrt(np.abs(np.linalg.det(X[:, 1:] - X[:, :1])))
    lines = []
    for directions in families:
        half = 0.5 * length[:, None] * directions[tets]
        # Barycentric coordinates of the ends: they stay with the material.
        shift = np.linalg.solve(np.swapaxes(X[:, 1:] - X[:, :1], 1, 2), half[..., None])
        shift = np.concatenate([-shift.sum(axis=1), shift[..., 0]], axis=1)
        x = X + u[corners]
        ends = [0.25 + sign * shift for sign in (-1.0, 1.0)]
        lines.append(np.stack([np.einsum("ta,tai->ti", w, x) for w in ends], axis=1))
    return 1e3 * np.concatenate([np.zeros((0, 2, 3)), *lines])


def _first_view(
    model: Model,
    shown: Sequence[ConfigurationResult],
    robots: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Choose the view of all configurations by the one that moves most."""
    drawn = [pose for pose in shown if pose.converged]
    X = model.mesh.points
    most = max(drawn, key=lambda pose: pose.largest_displacement, default=None)
    u = np.zeros_like(X) if most is None else most.displacement
    everything = np.concatenate([X, *(X + pose.displacement for pose in drawn)])
    posed = next((pose.posed for pose in shown if pose.posed is not None), None)
    gravity = () if posed is None else posed.gravity
    view = plotting.choose_view(X, u, everything, gravity)
    axes = {k: getattr(view, k).tolist() for k in ("right", "up", "towards")}
    more = []  # points that must be in the view
    for robot in robots:
        more += [end for c in robot["cables"] for s in c["segments"] for end in s]
        more += [part["tip"] for part in robot["arrows"]]
        more += [part["at"] for part in (*robot["motors"], *robot["frames"])]
    return {**axes, "more": more}


def robot_data(model: Model, result: ConfigurationResult) -> dict[str, Any]:
    """Collect what is drawn beside the soft body.

    Returns:
        `cables` (`name`, `slack`, `segments`), `walls`: corners of the faces under
        pressure, `wallNames` (`name`, `at`), `arrows` (`kind`, `name`, `tip`,
        `towards`), `motors` (`name`, `at`, `axis`), `frames` (`kind`, `name`, `at`,
        `axes`), `obstacles` (`shape`, `name`, `at`, `axes`), and `gravity`: its
        direction or None. Without an equilibrium there is only gravity.
    """
    empty = "cables wallNames arrows motors frames obstacles"
    data: dict[str, Any] = {key: [] for key in empty.split()}
    data["walls"] = np.zeros((0, 3), int)
    gravity = (0.0, 0.0, 0.0) if result.posed is None else result.posed.gravity
    size = np.linalg.norm(gravity)
    data["gravity"] = (np.array(gravity) / size).tolist() if size > 0.0 else None
    if not result.converged:
        return data
    picture = plotting.robot_picture(model, result)
    for actuator in picture.actuators:
        name, faces = escaped(actuator.name), actuator.faces
        if len(actuator.segments):
            ends = [[_mm(end) for end in segment] for segment in actuator.segments]
            cable = {"name": name, "slack": actuator.slack, "segments": ends}
            data["cables"].append(cable)
        if len(faces):
            data["walls"] = np.concatenate([data["walls"], faces])
            middle = _mm(picture.x[faces].mean(axis=(0, 1)))
            data["wallNames"].append({"name": name, "at": middle})
        for point, arrow in zip(actuator.points, actuator.arrows, strict=True):
            if actuator.kind == "motor":
                motor = {"name": name, "at": _mm(point), "axis": arrow.tolist()}
                data["motors"].append(motor)
            else:
                data["arrows"].append(_arrow("force", name, point, arrow))
    for place, force in picture.loads:
        size = float(np.linalg.norm(force))
        if size > 0.0:
            name = readable_values([size], "N", digits=3)
            data["arrows"].append(_arrow("load", name, place, force / size))
    data["frames"] = [*_frames(picture)]
    data["obstacles"] = [
        {"shape": o.number, "name": escaped(o.name), **_placed(o.origin, o.axes)}
        for o in picture.obstacles
    ]
    return data


def _arrow(kind: str, name: str, tip: HostArray, towards: HostArray) -> dict[str, Any]:
    return {"kind": kind, "name": name, "tip": _mm(tip), "towards": towards.tolist()}


def _placed(origin: HostArray, axes: HostArray) -> dict[str, Any]:
    return {"at": _mm(origin), "axes": axes.tolist()}


def _frames(picture: plotting.RobotPicture) -> Iterator[dict[str, Any]]:
    """Yield frames of sensors and rigid bodies, but of none that only stands beside."""
    bodies = picture.model.mechanism.bodies
    frames = picture.x[picture.model.mesh.n_nodes :].reshape(-1, 4, 3)
    axes = (frames[:, 1:] - frames[:, :1]) / bodies.length
    for k in np.flatnonzero(bodies.has_nodes):
        of = {"kind": "frame of a rigid body", "name": escaped(bodies.names[k])}
        yield of | _placed(frames[k, 0], axes[k])
    for frame in picture.sensors:
        kind = "measured" if frame.is_measured else "simulated"
        yield {"kind": kind, "name": "", **_placed(frame.position, frame.rotation.T)}


def _shape(surface: Any) -> dict[str, str]:
    """Pack triangles, points [mm] and normals of the surface of an obstacle."""
    surface = surface.compute_normals(
        cell_normals=False, split_vertices=True, consistent_normals=True
    )
    normals = surface.point_data["Normals"]
    points = 1e3 * np.asarray(surface.points)
    return {
        "triangles": pack(surface.regular_faces.astype("<u4")),
        "points": pack(points.astype("<f4")),
        "normals": pack(np.asarray(normals).astype("<f4")),
    }


def _mm(x: Float[HostArray, "3"]) -> list[float]:
    return np.round(1e3 * x, 4).tolist()
