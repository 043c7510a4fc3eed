"""A robot as its model shows it: its size, and parts that seem held or inflated."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._files import check_file
from softcal_jax._typing import Float, HostArray
from softcal_jax.exchange.cad import CAD_FORMATS, mesh_cad, read_stl
from softcal_jax.exchange.proposal._cavities import thinnest_wall
from softcal_jax.mesh import (
    MeshWarning,
    Plane,
    TetMesh,
    locate,
    node_indices,
    read_mesh,
    select_faces,
    select_nodes,
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
    why: str = ""


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
    mesh, why = mesh_cad(path, size=size, **options), "halve it to see what changes"
    if two_across < bending:
        longer = float(f"{(mesh.n_tets / first.n_tets) ** COST:.2g}")
        why = (
            f"{typed(two_across)}: two across the thinnest wall, {typed(wall)}{where}"
            f"\n# A fit with its {mesh.n_tets} tets takes {longer:g} times as long as "
            f"with the {first.n_tets} of {typed(usual)}."
        )
    return Body(mesh, unit, guessed, typed(size), False, why)


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


def named_like(words: Sequence[str], groups: Iterable[str], mesh: TetMesh) -> list[str]:
    """List the groups, but for tet groups, whose names contain one of some words."""
    has_word = lambda name: any(word in name.lower() for word in words)
    return [name for name in groups if name not in mesh.tet_groups and has_word(name)]


def propose_held(mesh: TetMesh, moving: Float[HostArray, "n 3"] | None) -> Held:
    """Propose what is held: a group by its name, or an end of the longest side.

    Of both ends it is the lower one, or that which is farther from points that were
    seen to move [m].
    """
    named = named_like(HELD_WORDS, (*mesh.surface_groups, *mesh.node_groups), mesh)
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


def far_end(mesh: TetMesh, held: Held) -> Float[HostArray, "3"]:
    """Return the middle of the end away from what is held, on or in the mesh [m]."""
    away = mesh.points - held.centre
    axis = int(np.argmax(np.abs(away).max(axis=0)))
    along = away[:, axis] * np.sign(away[np.argmax(np.abs(away[:, axis])), axis])
    end = mesh.points[along >= along.max() - _FLAT * mesh.size]
    return locate(mesh, end.mean(axis=0)[None], max_distance=np.inf).foot[0]
