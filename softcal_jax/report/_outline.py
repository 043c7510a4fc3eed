"""What a project describes, in aligned lines: before anything is solved."""

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from softcal_jax._text_table import aligned
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import actuator_geometry, enclosed_volumes
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    AbstractLoad,
    Configuration,
    ConfigurationLanes,
    Support,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model
from softcal_jax.export import readable_values
from softcal_jax.fields import ControlPointParameters, ControlPoints, Parameter
from softcal_jax.mesh import TetMesh, locate, node_indices, volumes
from softcal_jax.project import (
    Project,
    ProjectError,
    QuantityAsRead,
    guesses_left,
)
from softcal_jax.report._outline_measured import measured_rows

ROLES = {"calibration": "fitted", "validation": "held out", "candidate": "candidate"}
"""Roles of configurations in words."""

_MOST_ALIKE = 4
"""Most quantities of one table and unit, like positions, that are listed one by one."""

Rows = Sequence[Sequence[str]]


def roles_of(project: Project) -> dict[str, str]:
    """Return the role of each configuration and candidate in words, by its name."""
    groups = (project.calibration, project.validation, project.candidates)
    return {
        c.name: word
        for word, group in zip(ROLES.values(), groups, strict=True)
        for c in group
    }


def control_point_sets(project: Project) -> dict[str, ControlPoints]:
    """Return the sets of control points of the parameters, by fields they carry."""
    sets: dict[str, ControlPoints] = {}
    fields: dict[tuple, list[str]] = {}
    for entry in () if project.space is None else project.space.entries:
        if isinstance(entry, ControlPointParameters):
            points = entry.control_points
            key = (points.names, np.asarray(points.positions).tobytes())
            fields.setdefault(key, []).append(entry.field)
            sets[str(key)] = points
    return {", ".join(names): sets[str(key)] for key, names in fields.items() if names}


def outline(
    project: Project, quantities: Sequence[QuantityAsRead] = ()
) -> Iterator[str]:
    """Describe a project that was read, without solving or compiling anything.

    Args:
        project: The project.
        quantities: Its quantities as they were typed.

    Yields:
        Lines of text: guesses of `softcal new` that are left, mesh, unknowns and
        weight, bodies, actuators, markers and control points with their distances from
        the mesh, configurations, what is measured, parameters, quantities as read, and
        which commands the project suffices for.
    """
    posed = (*project.configurations, *project.candidates)
    guesses = guesses_left(project.path)
    rows = [(f"line {own.line}", own.text, own.remark) for own in guesses]
    yield from _section("Guesses, to be changed or confirmed", rows)
    lanes = configuration_lanes(project.model.mesh, posed, project.model.mechanism)
    weight = project.model.mass * STANDARD_GRAVITY
    yield from _section("Model", _model(project.model, posed, lanes, weight))
    yield from _section("Rigid bodies", _bodies(project.model))
    yield from _section("Actuators", _actuators(project.model))
    yield from _section("Markers", _markers(project.model.mesh, posed))
    for fields, points in control_point_sets(project).items():
        rows = _control_points(project.model.mesh, points)
        yield from _section(f"Control points of {fields}", rows)
    roles = roles_of(project)
    rows = [_configuration(project.model, c, roles[c.name], weight) for c in posed]
    head = ("name", "role", "gravity", "held", "loads", "actuators and bodies")
    yield from _section("Configurations", [head, *rows])
    yield from _section("Measured", measured_rows(posed, lanes))
    rows = _registrations(project)
    yield from _section("Camera frames, registered to the mesh", rows)
    yield from _section("Parameters", _parameters(project.parameters))
    yield from _section("Quantities as read, in SI and mm", _as_read(quantities))
    yield from _section("Commands", _commands(project))


def _section(title: str, rows: Rows) -> Iterator[str]:
    """Align the columns of rows below a title; nothing without rows."""
    if any(any(row) for row in rows):
        yield from ("", title, *aligned(rows))


def _model(
    model: Model,
    posed: Sequence[Configuration],
    lanes: ConfigurationLanes,
    weight: float,
) -> Rows:
    mesh = model.mesh
    kind = "quadratic" if mesh.order == 2 else "linear"
    size = " x ".join(f"{1e3 * x:.4g}" for x in np.ptp(mesh.points, axis=0))
    volume = readable_values([float(volumes(mesh).sum())], "m3")
    density = np.unique(np.asarray(model.density))
    listed = " to ".join(f"{d:.4g}" for d in dict.fromkeys([density[0], density[-1]]))
    mass = readable_values([weight], "N")
    free: dict[int, list[str]] = {}
    for c, n in zip(posed, _free_coordinates(model, posed, lanes), strict=True):
        free.setdefault(n, []).append(c.name)
    several = len(free) > 1
    counted = "; ".join(
        f"{n} free" + (f" in {', '.join(names)}" if several else "")
        for n, names in free.items()
    )
    lock = (
        ("note", "linear tets lock in bending: their moduli are those of this mesh")
        if mesh.order == 1
        else ("", "")
    )
    rows = [
        ("mesh", f"{mesh.n_nodes} nodes, {mesh.n_tets} {kind} tets; {size} mm"),
        ("volume", volume),
        ("weight", f"{mass} ({1e3 * weight / STANDARD_GRAVITY:.4g} g)"),
        ("density", f"{listed} kg/m3"),
        ("unknowns", f"{3 * mesh.n_nodes} coordinates of nodes, {counted}"),
        lock,
    ]
    return [row for row in rows if row[0]]


def _free_coordinates(
    model: Model, posed: Sequence[Configuration], lanes: ConfigurationLanes
) -> list[int]:
    """Count what the balance finds: coordinates of nodes, six or one of each body."""
    bodies, actuators = model.mechanism.bodies, model.mechanism.actuators
    fixed = np.asarray(lanes.arrays.fixed)[:, : model.mesh.n_nodes].copy()
    fixed[:, bodies.attached] = True
    kinds = np.asarray(lanes.arrays.bodies.kind)
    driven = np.asarray(lanes.arrays.actuation.by_displacement)
    counts = []
    for k in range(len(posed)):
        n = int((~fixed[k]).sum())
        for body in np.flatnonzero(bodies.owner == np.arange(bodies.n_bodies)):
            if body in actuators.motor_body:
                n += int(not driven[k, actuators.motor_body.index(body)])
            else:
                n += (6, 1, 0)[int(kinds[k, body])]
        counts.append(n)
    return counts


def _bodies(model: Model) -> Rows:
    bodies = model.mechanism.bodies
    rows = [("name", "nodes", "origin [mm]", "own mass", "tied to")]
    for k, name in enumerate(bodies.names):
        owner = int(bodies.owner[k])
        mass = float(np.asarray(bodies.mass)[k])
        rows.append(
            (
                name,
                str(int((bodies.body == k).sum())),
                _in_mm(bodies.origin[k]),
                f"{1e3 * mass:.4g} g" if mass else "",
                "" if owner == k else bodies.names[owner],
            )
        )
    return rows if bodies.n_bodies else []


def _actuators(model: Model) -> Rows:
    actuators, x = model.mechanism.actuators, model.mechanism.points
    geometry = actuator_geometry(actuators, x)
    lengths = np.linalg.norm(geometry.segments[:, 1] - geometry.segments[:, 0], axis=1)
    volumes_of = enclosed_volumes(actuators.groups, x)
    rows = [("name", "kind", "at rest")]
    for a, (name, kind) in enumerate(
        zip(actuators.names, actuators.kinds, strict=True)
    ):
        size, own = "", lengths[geometry.segment_owner == a]
        if own.size:
            size = f"{_length(own.sum())} long"
        elif a in volumes_of:
            size = readable_values([volumes_of[a]], "m3")
        rows.append((name, kind.noun, size))
    return rows if actuators.names else []


def _markers(mesh: TetMesh, posed: Sequence[Configuration]) -> Rows:
    """List markers once, with how far they stand off the mesh."""
    found: dict[tuple, tuple[str, ...]] = {}
    for c in posed:
        if c.markers is None:
            continue
        at = locate(mesh, c.markers.positions, max_distance=math.inf)
        for i, name in enumerate(c.markers.names):
            off = float(at.distance[i])
            where = f"{readable_values([off], 'm', digits=3)} off" if off else "in it"
            place = c.markers.positions[i]
            axes = "" if c.markers.axes == "xyz" else f"only {c.markers.axes}"
            found.setdefault((name, *place), (name, _in_mm(place), where, axes))
    return [("name", "at rest [mm]", "mesh", ""), *found.values()] if found else []


def _control_points(mesh: TetMesh, points: ControlPoints) -> Rows:
    positions = np.asarray(points.positions)
    at = locate(mesh, positions, max_distance=math.inf)
    rows = [("", "name", "place [mm]", "mesh")]
    for i, name in enumerate(points.names):
        off = float(at.distance[i])
        where = f"{readable_values([off], 'm', digits=3)} off" if off else "in it"
        rows.append((str(i + 1), name, _in_mm(positions[i]), where))
    return rows


def _configuration(
    model: Model, c: Configuration, role: str, weight: float
) -> tuple[str, ...]:
    return (
        c.name,
        role,
        _sized(c.gravity, "m/s2") if np.any(c.gravity) else "none",
        ", ".join(_support(s, model.mesh) for s in c.supports),
        ", ".join(_load(load, model.mesh, weight) for load in c.loads),
        ", ".join([*_actuation(model, c), *_states(c)]),
    )


def _support(support: Support, mesh: TetMesh) -> str:
    n = len(node_indices(mesh, support.where, "a support"))
    text = f"{support.name} ({n} nodes"
    text += "" if support.axes == "xyz" else f", only {support.axes}"
    text += "" if support.stiffness is None else ", elastic"
    if np.any(support.displacement):
        text += f", moved {readable_values(support.displacement, 'm')}"
    return f"{text})"


def _load(load: AbstractLoad, mesh: TetMesh, weight: float) -> str:
    force = load.nodal_forces(mesh).sum(axis=0)
    where = getattr(load, "where", None)
    if isinstance(where, str):
        on = f" on {where}"
    else:
        point = getattr(load, "point", None)
        on = "" if point is None else f" at {_in_mm(np.asarray(point))} mm"
    share = float(np.linalg.norm(force)) / weight if weight else math.inf
    times = f" = {share:.3g} x weight" if math.isfinite(share) else ""
    return f"{_sized(force, 'N')}{on}{times}"


def _actuation(model: Model, c: Configuration) -> Iterator[str]:
    actuators = model.mechanism.actuators
    for name, asked in c.actuation.items():
        kind = actuators.kinds[actuators.names.index(name)]
        imposed = type(asked).__name__ == "ImposedDisplacement"
        unit = kind.displacement_unit if imposed else kind.force_unit
        released = ", releasing" if asked.releasing else ""
        yield f"{name} {readable_values([asked.value], unit or '')}{released}"


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


def _registrations(project: Project) -> Rows:
    rows = [("configuration", "rms left at the markers")]
    for name, found in project.registrations.items():
        rows.append((name, f"{1e3 * found.rms:.2f} mm"))
    return rows if project.registrations else []


def _parameters(parameters: Sequence[Parameter]) -> Rows:
    rows: list[tuple[str, ...]] = [
        ("name", "start", "lower", "upper", "scale", "prior")
    ]
    for q in parameters:
        values = [float(v) for v in (q.start, q.lower, q.upper)]
        prior = "none"
        if q.prior_std is not None:
            std = float(q.prior_std)
            log = q.scale == "log"
            prior = f"+- {100 * std:.3g} %" if log else f"+- {_read(std, q.unit)}"
        scale = f"{q.scale}, periodic" if q.periodic else q.scale
        rows.append((q.name, *(_read(v, q.unit) for v in values), scale, prior))
    return rows if parameters else [("none: nothing to calibrate",)]


def _as_read(quantities: Sequence[QuantityAsRead]) -> Rows:
    """List quantities, those of a long table in one line."""
    rows: list[tuple[str, str, str]] = []
    alike = lambda q: (q.table, q.typed.split()[-1], len(q.values))
    for (table, unit, _), group in groupby(quantities, alike):
        own = list(group)
        if len(own) <= _MOST_ALIKE:
            rows += [(q.key, f'"{q.typed}"', q.read) for q in own]
            continue
        first = own[0]
        text = f'{len(own)} texts in {unit}, like "{first.typed}"'
        rows.append((table, text, first.read))
    return rows


def _commands(project: Project) -> Rows:
    """Say which commands the project suffices for."""
    rows = []
    for command, check in (
        ("simulate", project.check_simulation),
        ("identify", project.check_identify),
        ("calibrate", project.check_calibration),
    ):
        try:
            check()
            rows.append((f"softcal {command}", "has all it needs"))
        except ProjectError as error:
            text = str(error).removeprefix(f"{project.path}: ")
            first, *others = [line.strip() for line in text.splitlines()]
            # Several problems stand below their number.
            rows.append((f"softcal {command}", f"would refuse: {first}"))
            rows += [("", other) for other in others]
    bodies = project.model.mechanism.bodies.names
    if bodies:
        plain = f"not for SOFA, CalculiX or Abaqus: rigid bodies ({', '.join(bodies)})"
        rows.append(("softcal export", plain))
    return rows


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


def _in_mm(place: HostArray) -> str:
    return f"({', '.join(f'{1e3 * x + 0.0:.5g}' for x in place)})"


def _length(value: float) -> str:
    return readable_values([float(value)], "m")


def _read(value: float, unit: str) -> str:
    return readable_values([value], unit).rstrip()
