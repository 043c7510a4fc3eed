"""What a project or a mesh describes, before anything is solved."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import jax
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.actuators import actuator_geometry, enclosed_volumes
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    AbstractLoad,
    Configuration,
    ConfigurationLanes,
    EffectorRecord,
    Support,
    Unstated,
    beyond,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model, omission_sentences, omissions
from softcal_jax.fields import ControlPointParameters, ControlPoints, Parameter
from softcal_jax.mesh import TetMesh, face_shares, locate, node_indices, volumes
from softcal_jax.project import Project, ProjectError, QuantityAsRead, guesses_left
from softcal_jax.results._poses import imposed
from softcal_jax.results._tree import Section, Table, Value

ROLES = {"calibration": "fitted", "validation": "held out", "candidate": "candidate"}
ROLES |= {"design": "design", "prediction": "predicted", "command": "commanded"}
"""Roles of configurations in words."""

_MOST_ALIKE = 4  # quantities of one table and unit that are listed one by one
_QUANTITIES = {"point": "position", "turn": "orientation", "scalar": "value"}
"""Words for the quantities of effectors that are not shown by their own name."""


def roles_of(project: Project) -> dict[str, str]:
    """Return the role of each configuration and candidate in words, by its name."""
    groups = {
        "calibration": project.calibration,
        "validation": project.validation,
        "candidate": project.candidates,
        "design": project.asked.goals,
    }
    return {c.name: ROLES[role] for role, of in groups.items() for c in of}


def control_point_sets(project: Project) -> dict[str, ControlPoints]:
    """Return the sets of control points, by the names of the fields that use them."""
    sets: dict[tuple, tuple[ControlPoints, list[str]]] = {}
    for entry in () if project.space is None else project.space.entries:
        if isinstance(entry, ControlPointParameters):
            points = entry.control_points
            key = (points.names, np.asarray(points.positions).tobytes())
            sets.setdefault(key, (points, []))[1].append(entry.field)
    return {", ".join(fields): points for points, fields in sets.values()}


def project_sections(
    project: Project, quantities: Sequence[QuantityAsRead] = ()
) -> Iterator[Section]:
    """Describe a project that was read, without solving or compiling anything.

    Args:
        project: The project.
        quantities: Its quantities as they were typed.

    Yields:
        Sections, not all of which say anything: first the guesses of `softcal new` that
        nobody has confirmed, last the commands for which the project is complete.
    """
    model, mesh = project.model, project.model.mesh
    posed = (*project.configurations, *project.candidates)
    lanes = configuration_lanes(mesh, posed, model.mechanism)
    states = jax.device_get([lane_of(lanes.arrays, i) for i in range(len(posed))])
    each = zip(posed, states, strict=True)
    left_out = omission_sentences(
        o for c, lane in each for o in omissions(model, c, lane)
    )
    roles = roles_of(project)
    beyond_fit = [
        (c.name, beyond(project.calibration, c))
        for c in (*project.validation, *project.asked.goals)
        if project.calibration
    ]
    guesses = guesses_left(project.path)
    rows = [(f"line {guess.line}", guess.text, guess.remark) for guess in guesses]
    names, places, axes = _markers(posed)
    tables = [
        Table.of("Guesses to change or confirm", " |  | ", rows),
        Table.of("Left out of the model", "", [(text,) for text in left_out]),
        Table.of("Model", " | ", _model(model)),
        Table.of(
            "Rigid bodies",
            "name | nodes | origin [m] | own mass [kg] | tied to",
            _bodies(model),
        ),
        Table.of(
            "Obstacles", "name | shape | coefficient of friction", _obstacles(model)
        ),
        _actuators(model),
        _placed("Markers", names, places, mesh, axes),
    ]
    for fields, points in control_point_sets(project).items():
        numbered = [f"{i} {name}".rstrip() for i, name in enumerate(points.names, 1)]
        at = np.asarray(points.positions)
        tables.append(_placed(f"Control points of {fields}", numbered, at, mesh))
    tables += [
        Table.of(
            "Configurations",
            "name | role | gravity | held | loads | actuators and bodies",
            [_configuration(model, c, roles[c.name]) for c in posed],
        ),
        Table.of("Beyond what is fitted", " | ", [row for row in beyond_fit if row[1]]),
        Table.of(
            "Measured",
            "configuration | what | value | standard deviation",
            _measured(posed, lanes),
        ),
        Table.of(
            "Camera frames, registered to the mesh",
            "configuration | rms residual at the markers [distance]",
            [(name, fit.rms) for name, fit in project.registrations.items()],
        ),
        _parameters(project.parameters),
        Table.of("Quantities as read, in SI and mm", " |  | ", _as_read(quantities)),
        Table.of("Commands", " | ", _commands(project)),
    ]
    for table in tables:
        key = table.title.lower().replace(" ", "-")
        yield Section(key, table.title, tables=(table,))


def _model(model: Model) -> Iterator[tuple[str, str]]:
    mesh = model.mesh
    size = readable_values(np.ptp(mesh.points, axis=0).tolist(), "m")
    yield "mesh", f"{mesh.words}; {size}"
    yield "volume", readable_values([float(volumes(mesh).sum())], "m3")
    weight = readable_values([model.mass * STANDARD_GRAVITY], "N")
    yield "weight", f"{weight} ({readable_values([model.mass], 'kg')})"
    density = np.unique(np.asarray(model.density))
    ends = dict.fromkeys([density[0], density[-1]])
    yield "density", f"{' to '.join(f'{d:.4g}' for d in ends)} kg/m3"
    yield "unknowns", f"{3 * mesh.n_nodes} nodal coordinates"
    if mesh.order == 1:
        yield "note", "linear tets lock in bending: moduli hold only for this mesh"


def _bodies(model: Model) -> Iterator[tuple[Any, ...]]:
    bodies = model.mechanism.bodies
    for k, name in enumerate(bodies.names):
        owner, mass = int(bodies.owner[k]), float(np.asarray(bodies.mass)[k])
        tied = "" if owner == k else bodies.names[owner]
        nodes = str(int((bodies.body == k).sum()))
        yield name, nodes, np.asarray(bodies.origin[k]), mass or "", tied


def _obstacles(model: Model) -> Iterator[tuple[str, ...]]:
    contacts = model.mechanism.contacts
    shapes = (type(shape).__name__ for shape in contacts.shapes)
    friction = (f"{value:g}" if value else "-" for value in contacts.friction)
    yield from zip(contacts.names, shapes, friction, strict=True)
    for name in contacts.touched[contacts.n_obstacles :]:
        yield name, "surfaces of the body", "-"


def _actuators(model: Model) -> Table:
    actuators, x = model.mechanism.actuators, model.mechanism.points
    geometry = actuator_geometry(actuators, x)
    lengths = np.linalg.norm(geometry.segments[:, 1] - geometry.segments[:, 0], axis=1)
    volumes_of = enclosed_volumes(actuators.groups, x)
    kinds = zip(actuators.names, actuators.kinds, strict=True)
    rows = []
    for a, (name, kind) in enumerate(kinds):
        size, segments = Value(volumes_of.get(a, ""), "m3"), geometry.segment_owner == a
        if np.any(segments):
            size = Value(float(lengths[segments].sum()), "m")
        rows.append((name, kind.noun, size))
    return Table.of("Actuators", "name | kind | at rest", rows)


def _placed(
    title: str,
    names: Sequence[str],
    positions: Float[HostArray, "n 3"],
    mesh: TetMesh,
    notes: Sequence[str] = (),
) -> Table:
    """List points at rest, and how far they are off the mesh."""
    off = locate(mesh, positions, max_distance=math.inf).distance
    rows = [
        (name, place, Value(float(distance) or "inside", digits=3), note)
        for name, place, distance, note in zip(
            names, positions, off, notes or [""] * len(names), strict=True
        )
    ]
    heads = "name | at rest [m] | off the mesh [m] | "
    return Table.of(title, heads, rows, digits=5)


def _markers(
    posed: Sequence[Configuration],
) -> tuple[list[str], Float[HostArray, "n 3"], list[str]]:
    """List the markers of all configurations, equal ones once."""
    rows = {}
    for markers in [c.markers for c in posed if c.markers is not None]:
        axes = "" if markers.axes == "xyz" else f"only {markers.axes}"
        for name, place in zip(markers.names, markers.positions, strict=True):
            rows[name, *np.asarray(place).tolist(), axes] = None
    places = np.array([row[1:4] for row in rows]).reshape(-1, 3)
    return [row[0] for row in rows], places, [row[4] for row in rows]


def _configuration(model: Model, c: Configuration, role: str) -> tuple[str, ...]:
    weight = model.mass * STANDARD_GRAVITY
    commands = (
        f"{name} {readable_values([of.value], unit)}{', releasing' * of.releasing}"
        for name, of, unit in imposed(model, c)
    )
    return (
        c.name,
        role,
        _sized(c.gravity, "m/s2") if np.any(c.gravity) else "none",
        ", ".join(_support(s, model.mesh) for s in c.supports),
        ", ".join(_load(load, model.mesh, weight) for load in c.loads),
        ", ".join([*commands, *_states(c)]),
    )


def _support(support: Support, mesh: TetMesh) -> str:
    n = len(node_indices(mesh, support.where, "a support"))
    text = f"{support.name} ({n} nodes"
    text += "" if support.axes == "xyz" else f", only {support.axes}"
    text += "" if support.stiffness is None else ", elastic"
    if np.any(support.displacement):
        text += f", displaced by {readable_values(support.displacement, 'm')}"
    return f"{text})"


def _load(load: AbstractLoad, mesh: TetMesh, weight: float) -> str:
    force = load.nodal_forces(mesh).sum(axis=0)
    where, point = getattr(load, "where", None), getattr(load, "point", None)
    on = f" on {where}" if isinstance(where, str) else ""
    if not on and point is not None:
        on = f" at {readable_values(np.asarray(point).tolist(), 'm')}"
    times = f" = {np.linalg.norm(force) / weight:.3g} x weight" if weight else ""
    return f"{_sized(force, 'N')}{on}{times}"


def _states(c: Configuration) -> Iterator[str]:
    for name, state in c.bodies.items():
        kind = state if isinstance(state, str) else getattr(state, "kind", "held")
        pose = getattr(state, "pose", state)
        moved = [
            readable_values(list(np.asarray(getattr(pose, key))), unit)
            for key, unit in (("translation", "m"), ("rotation_vector", "rad"))
            if np.any(getattr(pose, key, 0.0))
        ]
        yield f"{name} {kind}" + (f" at {' and '.join(moved)}" if moved else "")


def _measured(
    posed: Sequence[Configuration], lanes: ConfigurationLanes
) -> list[tuple[str, ...]]:
    """List what is measured: for each configuration its markers, then each effector."""
    records = dict(zip([c.name for c in posed], lanes.effectors, strict=True))
    rows: list[tuple[str, ...]] = []
    for c in posed:
        before = {r.name: r for r in records.get(c.displacement_from or "", ())}
        effectors = {e.name: e for e in c.effectors}
        n = 0 if c.markers is None else len(c.markers.names)
        lines = []
        if c.markers is not None:
            noise = _noise(c.markers.std, "m") + _share(c)
            what = f"{n} marker{'s' if n > 1 else ''}"
            if c.markers.axes != "xyz":
                what += f" along {c.markers.axes}"
            lines.append((what, _motion(records[c.name][:n], before), noise))
        for record in records[c.name][n:]:
            effector: Any = effectors[record.name]
            std = effector.std_angle if record.is_turn else effector.std
            noise = _noise(std, record.unit) if record.seen.any() else ""
            if noise and record.quantity == "point":
                noise += _share(c)
            quantity = _QUANTITIES.get(record.quantity, record.quantity)
            what = f"{record.name}, {quantity}"
            lines.append((what, _value_seen(record, before), noise))
        lines = lines or [("nothing", "", "")]
        # The name stands once, on the first of its lines.
        rows += [("" if i else c.name, *row) for i, row in enumerate(lines)]
    return rows


def _noise(std: Any, unit: str) -> str:
    """Write a standard deviation, or the smallest and the largest of several."""
    ends = dict.fromkeys([float(np.min(std)), float(np.max(std))])
    size = " to ".join(readable_values([end], unit) for end in ends)
    return f"not stated: {size} as a weight" if isinstance(std, Unstated) else size


def _share(c: Configuration) -> str:
    """Write the part of the noise that is a share of the motion, if there is one."""
    if c.relative_std == "estimated":
        return " and an estimated share of the motion"
    share = readable(c.relative_std, "percent")
    return f" and {share} of the motion" if c.relative_std else ""


def _motion(
    markers: Sequence[EffectorRecord], before: Mapping[str, EffectorRecord]
) -> str:
    """Say how far markers moved since `before`, or from rest without it."""
    moved = []
    for record in (m for m in markers if m.seen.any()):
        earlier = before.get(record.name)
        start = record.at_rest if earlier is None else earlier.measured
        moved.append(np.linalg.norm((record.measured - start)[record.seen]))
    if not moved:
        return "not measured"
    since = "since the reference" if before else "from rest"
    ends = [round(end, 9) for end in (min(moved), max(moved))]  # not to rounding
    shown = (readable_values([end], "m", digits=3, beside=ends) for end in ends)
    return f"moved by {' to '.join(dict.fromkeys(shown))} {since}"


def _value_seen(record: EffectorRecord, before: Mapping[str, EffectorRecord]) -> str:
    if record.quantity == "point" or not record.seen.any():
        return _motion([record], before)
    if record.is_turn:
        turn = math.acos(np.clip(0.5 * (np.trace(record.reference) - 1.0), -1.0, 1.0))
        return f"turned {readable_values([turn], 'rad', digits=3)} from rest"
    return readable_values(list(record.measured), record.unit)


def _parameters(parameters: Sequence[Parameter]) -> Table:
    rows = []
    for q in parameters:
        prior = "none"
        if q.prior_std is not None:
            share = q.scale == "log"
            size = readable_values([float(q.prior_std)], "percent" if share else q.unit)
            prior = f"+- {size.rstrip()}"
        scale = f"{q.scale}, periodic" if q.periodic else q.scale
        ends = (Value(float(end), q.unit) for end in (q.start, q.lower, q.upper))
        rows.append((q.name, *ends, scale, prior))
    heads = "name | start | lower | upper | scale | prior"
    return Table.of("Parameters", heads, rows)


def _as_read(quantities: Sequence[QuantityAsRead]) -> Iterator[tuple[str, ...]]:
    """List quantities, those of a long table in one line."""
    alike = lambda q: (q.table, q.typed.split()[-1], len(q.values))
    for (table, unit, _), group in groupby(quantities, alike):
        members = list(group)
        if len(members) > _MOST_ALIKE:
            text = f'{len(members)} texts in {unit}, like "{members[0].typed}"'
            yield table, text, members[0].read
        else:
            yield from ((q.key, f'"{q.typed}"', q.read) for q in members)


def _commands(project: Project) -> Iterator[tuple[str, str]]:
    """Say for which commands the project has all that is needed."""
    for command, check in (
        ("simulate", project.check_simulation),
        ("identify", project.check_identify),
        ("calibrate", project.check_calibration),
        *([("design", project.check_design)] if project.asked.goals else []),
    ):
        try:
            check()
            yield f"softcal {command}", "ready to run"
        except ProjectError as error:
            text = str(error).removeprefix(f"{project.path}: ")
            first, *others = [line.strip() for line in text.splitlines()]
            # Where there are several, the first line only counts them.
            yield f"softcal {command}", f"would refuse: {first}"
            yield from (("", other) for other in others)
    mechanism = project.model.mechanism
    touched, bodies = mechanism.contacts.touched, mechanism.bodies.names
    if touched or bodies:
        programs = "SOFA, MuJoCo, CalculiX or Abaqus"
        what = "contact" if touched else "rigid bodies"
        plain = f"not for {programs}: {what} ({', '.join(touched or bodies)})"
        yield "softcal export", plain


def mesh_sections(mesh: TetMesh) -> Iterator[Section]:
    """Describe a mesh and its groups; surfaces have a point on them.

    Points are written as a project file has them.
    """
    corners = mesh.points[mesh.tets[:, :4]]
    edges = np.linalg.norm(corners[:, [1, 2, 3]] - corners[:, :1], axis=2)
    mean = readable_values([float(edges.mean())], "m", digits=3)
    volume = readable_values([float(volumes(mesh).sum())], "m3")
    text = f"{mesh.words}, mean edge length {mean}, volume {volume}"
    rows = []
    for name, faces in mesh.surface_groups.items():
        centres = mesh.points[faces[:, :3]].mean(axis=1)
        areas = face_shares(mesh, faces).sum(axis=1)
        mean = np.average(centres, axis=0, weights=areas)
        point = centres[np.argmin(np.linalg.norm(centres - mean, axis=1))]
        place = readable_values(point.tolist(), "m")
        area = Value(float(areas.sum()), "m2")
        rows.append((name, area, f'a point on it: "{place}"'))
    for name, tets in mesh.tet_groups.items():
        volume = Value(float(volumes(mesh)[tets].sum()), "m3")
        rows.append((name, volume, f"{len(tets)} tets"))
    for name, nodes in mesh.node_groups.items():
        if name not in mesh.surface_groups and name not in mesh.tet_groups:
            rows.append((name, f"{len(nodes)} nodes", ""))
    yield Section("mesh", "", (text,), (Table.of("Groups", " |  | ", rows),))


def _sized(vector: Any, unit: str) -> str:
    """Format a vector as its size and direction: "1 N along -z"."""
    vector = np.asarray(vector, float)
    size = float(np.linalg.norm(vector))
    text = readable_values([size], unit)
    if not size:
        return text
    along: Float[HostArray, 3] = vector / size
    axis = int(np.argmax(np.abs(along)))
    if abs(along[axis]) > 1.0 - 1e-9:
        return f"{text} along {'-' if along[axis] < 0 else '+'}{'xyz'[axis]}"
    return f"{text} along ({', '.join(f'{v:.3g}' for v in along + 0.0)})"
