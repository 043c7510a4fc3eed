"""What the mesh of a robot shows: its size, what seems held, chambers and channels."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._files import check_file
from softcal_jax._text import listed
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad, read_stl
from softcal_jax.mesh import (
    CAD_FACE,
    MeshWarning,
    Plane,
    TetMesh,
    boundary_faces,
    distances_along,
    face_indices,
    find_cavities,
    locate,
    node_indices,
    place,
    read_mesh,
    ring_around,
    seen_from,
    select_faces,
    select_nodes,
    volumes,
)

HELD_WORDS = ("clamp", "base", "fix", "support", "held", "mount", "anchor", "ground")
"""Parts of names by which groups that are held are recognised."""

MOST_TETS, COST = 30_000, 1.6
"""Tets that are proposed at most, and by which power of them the time grows [-]."""

_FLAT = 1e-4
_END = 0.02
"""How deep a flat end and a round one are, as shares of the size of the mesh [-]."""


class Body(NamedTuple):
    """The linear mesh of a robot, and how a project file says to read it.

    The unit is None if the file states it; the size of tets is None for a mesh file,
    and `why` says what it is chosen by.
    """

    mesh: TetMesh
    unit: str | None
    unit_guessed: bool
    size: str | None
    drop_unused: bool
    why: str = "halve it to see what changes"


class Held(NamedTuple):
    """The part that is proposed to be held, and the mean of its nodes [m].

    `definition` is its group in a project file, by lines; empty if the mesh has it.
    """

    group: str
    definition: tuple[str, ...]
    centre: Float[HostArray, "3"]


def read_body(path: Path, *, size: float | None, length_unit: str | None) -> Body:
    """Read a mesh, or fill a CAD model with tets.

    By default 20 along its longest side, and two across its thinnest wall.
    """
    suffix = path.suffix.lower()
    guessed = length_unit is None and suffix not in (".step", ".stp")  # these state it
    unit = _guess_unit(path) if guessed else length_unit
    if suffix not in CAD_FORMATS:
        mesh, drop = _read(path, str(unit))
        return Body(mesh, unit, guessed, None, drop)
    options = {"length_unit": unit, "order": 1}
    typed = lambda metres: f"{float(f'{1e3 * metres:.2g}'):g} mm"
    if size is not None:
        mesh = mesh_cad(path, size=size, **options)
        return Body(mesh, unit, guessed, f"{1e3 * size:.6g} mm", False)
    # This mesh is thrown away.
    with warnings.catch_warnings(action="ignore", category=MeshWarning):
        first = mesh_cad(path, **options)
    wall, where = thinnest_wall(first)
    bending, two_across = first.size / 20.0, 0.5 * wall
    usual = first.size / 30.0  # what the first mesh was made with
    least = usual * (first.n_tets / MOST_TETS) ** (1.0 / 3.0)
    size = float(f"{min(bending, max(two_across, least)):.2g}")
    mesh = mesh_cad(path, size=size, **options)
    body = Body(mesh, unit, guessed, typed(size), False)
    if two_across >= bending:
        return body
    longer = float(f"{(mesh.n_tets / first.n_tets) ** COST:.2g}")
    return body._replace(
        why=f"{typed(two_across)}: two across the thinnest wall, {typed(wall)}{where}"
        f"\n# A fit with its {mesh.n_tets} tets takes {longer:g} times as long as "
        f"with the {first.n_tets} of {typed(usual)}."
    )


def _guess_unit(path: Path) -> str:
    """Guess whether the coordinates of a mesh or STL file are in "mm" or "m".

    Programs nearly always write one of the two. A robot is hardly more than 2 m across,
    and hardly less than 2 mm.
    """
    if path.suffix.lower() == ".stl":
        check_file(path, "CAD model")
        points = read_stl(path).points
    else:
        # What is warned of is repeated when it is read.
        with warnings.catch_warnings(action="ignore", category=MeshWarning):
            points = read_mesh(path, length_unit="m", unused="drop").points
    return "mm" if np.ptp(points, axis=0).max() > 2.0 else "m"


def _read(path: Path, unit: str) -> tuple[TetMesh, bool]:
    """Read a mesh file, and say whether it has nodes that no cell uses."""
    try:
        return read_mesh(path, length_unit=unit, order=1), False
    except ValueError as refused:
        try:
            return read_mesh(path, length_unit=unit, order=1, unused="drop"), True
        except ValueError:
            raise refused from None


def propose_held(mesh: TetMesh, moving: Float[HostArray, "n 3"] | None) -> Held:
    """Propose what is held: a group by its name, or an end of the longest side.

    Of both ends it is the lower one, or that which is farther from points that were
    seen to move [m].
    """
    for name in (*mesh.surface_groups, *mesh.node_groups):
        has_word = any(word in name.lower() for word in HELD_WORDS)
        if has_word and name not in mesh.tet_groups:
            nodes = node_indices(mesh, name, "a support")
            return Held(name, (), mesh.points[nodes].mean(axis=0))
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    extent, point = high - low, 0.5 * (low + high)
    # Among nearly equal sides the upright one.
    axis = 2 if extent[2] > 0.9 * extent.max() else int(np.argmax(extent))
    upper = moving is not None and moving.mean(axis=0)[axis] < point[axis]
    point[axis] = high[axis] if upper else low[axis]
    plane = Plane(point=point, normal=np.eye(3)[axis], tolerance=_FLAT * mesh.size)
    of = ('of = "faces"',)
    try:
        nodes = np.unique(select_faces(mesh, plane))
    except ValueError:  # no face lies in it: the end is round
        plane, of = replace(plane, tolerance=_END * mesh.size), ()
        nodes = np.unique(select_nodes(mesh, plane))
    definition = (
        f'plane = {{ point = {in_mm(point)}, normal = "{"xyz"[axis]}" }}',
        *of,
        f'tolerance = "{1e3 * plane.tolerance:.3g} mm"',
    )
    return Held("held", definition, mesh.points[nodes].mean(axis=0))


def in_mm(place: Float[HostArray, "3"]) -> str:
    """Write a place as a project file does."""
    return '"(' + ", ".join(f"{round(1e3 * x, 4) + 0.0:.10g}" for x in place) + ') mm"'


def far_end(mesh: TetMesh, held: Held) -> Float[HostArray, "3"]:
    """Return the middle of the end away from what is held, on or in the mesh [m]."""
    away = mesh.points - held.centre
    axis = int(np.argmax(np.abs(away).max(axis=0)))
    along = away[:, axis] * np.sign(away[np.argmax(np.abs(away[:, axis])), axis])
    end = mesh.points[along >= along.max() - _FLAT * mesh.size]
    return locate(mesh, end.mean(axis=0)[None], max_distance=np.inf).foot[0]


_SMALL, _SEEN = (1e-6, 0.01, 0.1), 0.5
"""Volume of a hole that is no chamber, over that of the body, by its openings; and the
share of all directions in which the wall of a chamber is seen [-]."""

_LONG, _NARROW, _ROUND = 8.0, 0.25, 0.1
"""Of a channel: least length over its diameter, largest diameter over the narrowest
side of the body, and how far its wall may lie off a cylinder, over its radius [-]."""

_GUIDES = 9  # points on the axis of a channel

_RAYS, _THINNER = 400, 0.01
"""Rays through the body, and the share of its surface whose wall may be thinner [-]."""


class Actuated(NamedTuple):
    """A cavity that is proposed as a chamber, or as the channel of a cable.

    `why` says what led to it. The surface `group` of a chamber has a `definition`, by
    lines of a project file, unless the mesh has it. Guides lie on the axis of a channel
    [m].
    """

    name: str
    why: str
    group: str = ""
    definition: tuple[str, ...] = ()
    is_open: bool = False
    guides: Float[HostArray, "n 3"] = np.zeros((0, 3))


def find_actuated(mesh: TetMesh) -> tuple[Actuated, ...]:
    """Find cavities to inflate, and long round holes for cables.

    Where groups of the mesh are walls of cavities, only these are inflated.
    """
    made: list[Actuated] = []
    body, cavities = float(volumes(mesh).sum()), find_cavities(mesh)
    groups = [_group(mesh, cavity.wall) for cavity in cavities]
    for (wall, openings, volume), group in zip(cavities, groups, strict=True):
        guides, (point, seen) = _axis(mesh, wall), _inside(mesh.points[wall[:, :3]])
        noun, faces = "cable" if len(guides) else "air", _cad_faces(mesh, wall)
        number = 1 + sum(noun in one.name for one in made)
        name = f"{noun}_{number}" if number > 1 else noun
        why = f"{'an open' if openings else 'a closed'} cavity{faces}"
        if len(guides):
            made.append(Actuated(name, f"a long round hole{faces}", guides=guides))
        elif group:
            made.append(Actuated(name, f"{group}, {why}", group, (), bool(openings)))
        elif not any(groups) and volume > _SMALL[len(openings)] * body and seen > _SEEN:
            lines = _definition(mesh, name, why, openings, point)
            made.append(Actuated(name, why, f"{name}_wall", lines, bool(openings)))
    return tuple(made)


def _group(mesh: TetMesh, wall: Int[HostArray, "n n_fn"]) -> str:
    """Return the group of the mesh that is a wall, and not of a CAD model, or ""."""
    groups = mesh.surface_groups.items()
    same = lambda faces: (
        len(faces) == len(wall) and (face_indices(faces, wall) >= 0).all()
    )
    known = (name for name, faces in groups if same(faces))
    return next((name for name in known if not CAD_FACE.fullmatch(name)), "")


def _definition(
    mesh: TetMesh,
    name: str,
    why: str,
    openings: Sequence[Int[HostArray, "_ n_fn"]],
    point: Float[HostArray, "3"],
) -> tuple[str, ...]:
    """Define a wall by a point in the cavity, and by points on what it opens in."""
    stop, lines = "", ()
    if openings:
        corners = [mesh.points[faces[:, :3]] for faces in openings]
        largest = [c[np.argmax(np.linalg.norm(_normals(c), axis=1))] for c in corners]
        points = ", ".join(f'"{place(corner.mean(axis=0))}"' for corner in largest)
        stop = f', stop_at = "{name}_opening"'
        rim = _cad_faces(mesh, np.concatenate(openings))
        head = f"[groups.{name}_opening] # CHANGE: where {name} opens{rim}"
        lines = head, f"face = {{ points = [{points}] }}", ""
    head = f"[groups.{name}_wall] # CHANGE: the wall of {why}"
    return *lines, head, f'inside = {{ point = "{place(point)}"{stop} }}'


def _cad_faces(mesh: TetMesh, faces: Int[HostArray, "n n_fn"]) -> str:
    """Name the faces of the CAD model in a surface, if it is from one: " (face 3)"."""
    inside = lambda name: (face_indices(mesh.surface_groups[name], faces) >= 0).all()
    names = filter(inside, filter(CAD_FACE.fullmatch, mesh.surface_groups))
    numbers = [name.split()[1] for name in names]
    return f" (face{'s' * (len(numbers) > 1)} {listed(numbers, 8)})" if numbers else ""


def _normals(corners: Float[HostArray, "n 3 3"]) -> Float[HostArray, "n 3"]:
    """Compute the outward normals of triangles, as long as twice their area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.cross(b - a, c - a)


def _across(
    corners: Float[HostArray, "n 3 3"], most: int
) -> Iterator[tuple[int, float, Float[HostArray, "3"]]]:
    """Take rays along normals, from the middles of triangles at even steps of area.

    Yields the triangle, how far away the ray meets the outer side of another [m], and
    a point halfway; rays that meet none are left out.
    """
    normals = _normals(corners)
    area = np.cumsum(np.linalg.norm(normals, axis=1))
    for k in np.searchsorted(area, (np.arange(most) + 0.5) / most * area[-1]):
        start, ray = corners[k].mean(axis=0), normals[k] / np.linalg.norm(normals[k])
        others = np.delete(corners, k, axis=0)
        width = distances_along(others, start, ray[:, None]).min()
        if np.isfinite(width):
            yield int(k), float(width), start + 0.5 * width * ray


def _inside(
    corners: Float[HostArray, "n 3 3"],
) -> tuple[Float[HostArray, "3"], float]:
    """Find a point halfway across a cavity, and the share of all around that is wall.

    That share is largest there, and of several such points the cavity is widest.
    """
    best = 0.0, 0.0, np.zeros(3)
    for _, width, middle in _across(corners, 40):
        seen = -round(float(seen_from(corners, middle).sum()), 2)
        best = max(best, (seen, width, middle), key=lambda one: one[:2])
    return best[2], best[0]


def _axis(mesh: TetMesh, wall: Int[HostArray, "n n_fn"]) -> Float[HostArray, "_ 3"]:
    """Return points on the axis of a long round hole [m]; none if it is something else.

    The axis is across the normals of its wall, amid a circle through its nodes.
    """
    normals, none = _normals(mesh.points[wall[:, :3]]), np.zeros((0, 3))
    size = np.linalg.norm(normals, axis=1)
    axis, *across = np.linalg.eigh((normals.T / size) @ normals)[1].T
    nodes = mesh.points[np.unique(wall[np.abs(normals @ axis) < 0.3 * size])]
    if not len(nodes):
        return none
    x, along = nodes @ np.array(across).T, nodes @ axis
    # The middle is at a + b along, to first order in what the axis is off.
    columns = 2.0 * x, 2.0 * x * along[:, None], np.vander(along, 3)
    a, b = np.linalg.lstsq(np.hstack(columns), (x**2).sum(axis=1))[0][:4].reshape(2, 2)
    away = np.linalg.norm(x - a - along[:, None] * b, axis=1)
    radius, length = away.mean(), np.ptp(along)
    narrow = 2.0 * radius < _NARROW * np.ptp(mesh.points, axis=0).min()
    if not narrow or length < 2.0 * _LONG * radius or np.ptp(away) > _ROUND * radius:
        return none
    # Off its ends, where no ring of wall would carry them.
    places = np.linspace(along.min() + radius, along.max() - radius, _GUIDES)
    points = places[:, None] * axis + (a + places[:, None] * b) @ np.array(across)
    return points if all(ring_around(mesh, point) for point in points) else none


def thinnest_wall(mesh: TetMesh) -> tuple[float, str]:
    """Return the thickness of the thinnest wall [m], and the CAD face that it is at."""
    faces = boundary_faces(mesh)
    rays = sorted(_across(mesh.points[faces[:, [0, 2, 1]]], _RAYS), key=lambda r: r[1])
    k, width, _ = rays[int(_THINNER * len(rays))]
    cad = filter(CAD_FACE.fullmatch, mesh.surface_groups)
    of = [n for n in cad if (face_indices(faces[[k]], mesh.faces(n)) >= 0).any()]
    return width, "".join(f" at {name}" for name in of)
