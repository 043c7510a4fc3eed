"""A robot as its model shows it: its size, and parts that seem held or inflated."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._files import check_file
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import Chamber, enclosed_volumes
from softcal_jax.configurations import build_mechanism
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad, read_stl
from softcal_jax.mesh import (
    MeshWarning,
    Plane,
    TetMesh,
    locate,
    node_indices,
    read_mesh,
    select_faces,
    select_nodes,
    sides_of,
    volumes,
)

HELD_WORDS = ("clamp", "base", "fix", "support", "held", "mount", "anchor", "ground")
CHAMBER_WORDS = ("chamber", "cavity", "inflat", "pressur", "lumen", "air")
"""Parts of names by which groups that are held, and chambers, are recognised."""

_FLAT = 1e-4
_END = 0.02
"""How deep a flat end and a round one are, as shares of the size of the mesh [-]."""


class Body(NamedTuple):
    """The linear mesh of a robot, and how a project file says to read it.

    The unit is None if the file states it; the size of tets is None for a mesh file.
    """

    mesh: TetMesh
    unit: str | None
    unit_guessed: bool
    size: str | None
    drop_unused: bool


class Held(NamedTuple):
    """The part that is proposed to be held, and the mean of its nodes [m].

    `definition` is its group in a project file, by lines; empty if the mesh has it.
    """

    group: str
    definition: tuple[str, ...]
    centre: Float[HostArray, "3"]


def read_body(path: Path, *, size: float | None, length_unit: str | None) -> Body:
    """Read a mesh, or fill a CAD model with tets, by default 20 along its diagonal."""
    suffix = path.suffix.lower()
    guessed = length_unit is None and suffix not in (".step", ".stp")  # these state it
    unit = _guess_unit(path) if guessed else length_unit
    if suffix not in CAD_FORMATS:
        mesh, drop = _read(path, str(unit))
        return Body(mesh, unit, guessed, None, drop)
    options = {"length_unit": unit, "order": 1}
    if size is None:
        # This mesh is thrown away.
        with warnings.catch_warnings(action="ignore", category=MeshWarning):
            first = mesh_cad(path, **options)
        # Enough for bending, and solved in seconds.
        size = float(f"{first.size / 20.0:.1g}")
    typed = f"{1e3 * size:.6g} mm"
    return Body(mesh_cad(path, size=size, **options), unit, guessed, typed, False)


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


def _named_like(
    words: Sequence[str], groups: Iterable[str], mesh: TetMesh
) -> list[str]:
    """List the groups, but for tet groups, whose names contain one of some words."""
    has_word = lambda name: any(word in name.lower() for word in words)
    return [name for name in groups if name not in mesh.tet_groups and has_word(name)]


def propose_held(mesh: TetMesh, moving: Float[HostArray, "n 3"] | None) -> Held:
    """Propose what is held: a group by its name, or an end of the longest side.

    Of both ends it is the lower one, or that which is farther from points that were
    seen to move [m].
    """
    named = _named_like(HELD_WORDS, (*mesh.surface_groups, *mesh.node_groups), mesh)
    if named:
        nodes = node_indices(mesh, named[0], "a support")
        return Held(named[0], (), mesh.points[nodes].mean(axis=0))
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


def find_chambers(mesh: TetMesh, held: Held) -> dict[str, bool]:
    """Find the surfaces that are called like chambers, and are walls of a cavity.

    Returns whether each has a rim that a lid has to close, by the name of its group.
    """
    chambers = {}
    for name in _named_like(CHAMBER_WORDS, mesh.surface_groups, mesh):
        faces = mesh.surface_groups[name]
        is_open = bool(np.any(sides_of(faces[:, :3]).counts == 1))
        chamber = Chamber(name, name, seal=is_open)
        try:
            made = build_mechanism(mesh, [], [chamber])
        except ValueError:  # a wall of the outside, whatever it is called
            continue
        (volume,) = enclosed_volumes(made.actuators.groups, made.points).values()
        # A flat wall of the outside encloses nothing, with either sign of rounding.
        if name != held.group and volume > 1e-6 * float(volumes(mesh).sum()):
            chambers[name] = is_open
    return chambers


def far_end(mesh: TetMesh, held: Held) -> Float[HostArray, "3"]:
    """Return the middle of the end away from what is held, on or in the mesh [m]."""
    away = mesh.points - held.centre
    axis = int(np.argmax(np.abs(away).max(axis=0)))
    along = away[:, axis] * np.sign(away[np.argmax(np.abs(away[:, axis])), axis])
    end = mesh.points[along >= along.max() - _FLAT * mesh.size]
    return locate(mesh, end.mean(axis=0)[None], max_distance=np.inf).foot[0]
