"""What the view of a page draws, as JSON with packed arrays, in mm.

Positions are 16-bit multiples of one step above the lower corner of a box that holds
all configurations, and values of fields 16-bit parts of the field's range: arrays of
bytes, the lowest first, in base64. The step is a 65535th of the largest side of the
box, too small a change to be seen in a picture.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from softcal_jax import plotting
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import Model
from softcal_jax.export import fibre_directions, readable_values
from softcal_jax.report._view_fields import Field, Surface

_MOST = 65535  # largest number of 16 bits; in a field, there is no value
_FIBRES = 600  # most fibres that are drawn


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
    entries = [
        {
            "drawn": pose.converged,
            "points": placed(x),
            "fibres": placed(f),
            "markers": _markers(pose),
            **robot,
            "walls": pack(surface.having(robot["walls"]).astype("u1"))
            if len(robot["walls"])
            else None,
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
    _add_actuators(data, picture)
    data["frames"] += _bodies(picture)
    for frame in picture.sensors:
        kind = "measured" if frame.is_measured else "simulated"
        place = {"at": _mm(frame.position), "axes": frame.rotation.T.tolist()}
        data["frames"].append({"kind": kind, "name": "", **place})
    for obstacle in picture.obstacles:
        place = {"at": _mm(obstacle.origin), "axes": obstacle.axes.tolist()}
        about = {"shape": obstacle.number, "name": escaped(obstacle.name)}
        data["obstacles"].append(about | place)
    for place, force in picture.loads:
        size = float(np.linalg.norm(force))
        if size > 0.0:
            arrow = {"kind": "load", "name": readable_values([size], "N", digits=3)}
            arrow |= {"tip": _mm(place), "towards": (force / size).tolist()}
            data["arrows"].append(arrow)
    return data


def _add_actuators(data: dict[str, Any], picture: plotting.RobotPicture) -> None:
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
            place, along = _mm(point), arrow.tolist()
            if actuator.kind == "motor":
                data["motors"].append({"name": name, "at": place, "axis": along})
            else:
                force = {"kind": "force", "name": name, "tip": place, "towards": along}
                data["arrows"].append(force)


def _bodies(picture: plotting.RobotPicture) -> Iterator[dict[str, Any]]:
    """Yield the frames of rigid bodies, but of none that only stands beside."""
    bodies = picture.model.mechanism.bodies
    frames = picture.x[picture.model.mesh.n_nodes :].reshape(-1, 4, 3)
    axes = (frames[:, 1:] - frames[:, :1]) / bodies.length
    for k in np.flatnonzero(bodies.has_nodes):
        frame = {"kind": "frame of a rigid body", "name": escaped(bodies.names[k])}
        yield frame | {"at": _mm(frames[k, 0]), "axes": axes[k].tolist()}


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
