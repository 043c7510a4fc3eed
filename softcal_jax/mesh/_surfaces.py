"""Selection of surfaces by a point: all that it reaches, a face, a cavity's wall."""

import re
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softcal_jax._module import key, keys
from softcal_jax._typing import Bool, Float, HostArray, Int, Vector
from softcal_jax._units import readable
from softcal_jax.mesh._location import nearest_on_triangles
from softcal_jax.mesh._selection import place
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import (
    area_normals,
    boundary_faces,
    face_indices,
    sides_of,
)

SHARP = np.deg2rad(40.0)
"""Turn of the normal at an edge that ends a face [rad]; a round wall turns by less."""

CAD_FACE = re.compile(r"face \d+")
"""Names of the surface groups that are the faces of a CAD model."""

_ROUNDING = 1e-6
"""Distance at which a point lies on several faces, over the size of the mesh [-]."""

_RAYS = 12
_NARROW = 0.2
"""Rays that look for the wall of a channel, and their length over the mesh size [-]."""

_ENCLOSED = 0.5
"""Share of all directions in which the wall of a cavity is seen, at least [-]."""


@keys(
    point=key("m", 'where it begins: "(0, 5, 0) mm"'),
    angle=key("rad", size="any"),
    stop_at=key(),
)
def select_reachable(
    mesh: TetMesh,
    point: Vector,
    *,
    angle: float | None = None,
    stop_at: Sequence[str] = (),
) -> Int[HostArray, "n n_fn"]:
    """Select the boundary faces that a walk over the surface reaches from a point [m].

    The point lies on the surface. The walk does not cross edges at which the surface
    turns by more than `angle` [rad], if given, nor enter the surface groups `stop_at`.

    Raises:
        ValueError: If the point is not on the surface, where parts of it meet, or in a
            group of `stop_at`; if a group is unknown, or the angle is out of range.
    """
    if angle is not None and not 0.0 < angle <= np.pi:
        raise ValueError(
            f"angle must lie between 0 and 180 degrees, got {np.rad2deg(angle):g}."
        )
    surface = _FaceGraph(mesh)
    barred = surface.of_groups(stop_at)
    p = np.asarray(point, float)
    if barred[surface.at(p)].any():
        names = ", ".join(map(repr, stop_at))
        raise ValueError(
            f"the point {place(p)} lies on a surface that is not to be entered "
            f"({names}); give a point beside it."
        )
    return surface.part_at(p, surface.parts(angle, barred))


def select_face(mesh: TetMesh, point: Vector) -> Int[HostArray, "n n_fn"]:
    """Select the face of the body that a point [m] lies on, not on its border.

    On a mesh from a CAD model it is the face of the model ("face 7"); on any other mesh
    all that is reached across edges where the surface turns by less than 40 degrees.

    Raises:
        ValueError: If the point is not on the surface, or on the border of faces.
    """
    surface = _FaceGraph(mesh)
    return surface.part_at(np.asarray(point, float), surface.body_faces())


@keys(point=key("m", 'a point in the cavity: "(20, 0, 0) mm"'), stop_at=key())
def select_cavity(
    mesh: TetMesh, point: Vector, *, stop_at: Sequence[str] = ()
) -> Int[HostArray, "n n_fn"]:
    """Select the wall of the cavity around a point [m], as a chamber needs it.

    Its openings lie in the surface groups `stop_at`: the wall ends where one of them
    begins.

    Raises:
        ValueError: If the point lies in the body, a group is unknown, or no cavity
            surrounds the point that is closed or has its openings in `stop_at`.
    """
    p = np.asarray(point, float)
    surface = _FaceGraph(mesh)
    if seen_from(surface.corners, p).sum() > _ROUNDING:
        raise ValueError(
            f"the point {place(p)} lies in the body or on its surface; expected one in "
            "the empty inside of the cavity."
        )
    barred = surface.of_groups(stop_at)
    labels = surface.parts(None, barred)
    start = np.argmin(np.where(barred, np.inf, surface.distances(p)))
    chosen = labels == labels[start]
    share = -seen_from(surface.corners[chosen], p).sum()
    if share < _ENCLOSED:
        known = ", ".join(map(repr, mesh.surface_groups)) or "none yet"
        raise ValueError(
            f"no cavity surrounds the point {place(p)}: what is reached from there "
            f"closes {max(0, round(100 * share))} % of the view. If the cavity is open,"
            " name the surface that its opening lies in (stop_at), where the wall ends."
            f" Surface groups: {known}."
        )
    return surface.faces[chosen]


_MOST_CUT = 60
"""Faces of the body that are tried as openings: a scan has thousands of facets."""


class Cavity(NamedTuple):
    """The wall of a cavity, the faces of the body that it opens in, its volume [m3]."""

    wall: Int[HostArray, "n n_fn"]
    openings: tuple[Int[HostArray, "_ n_fn"], ...]
    volume: float


def find_cavities(mesh: TetMesh) -> list[Cavity]:
    """Find what is cut off from the surface of the body, and has a void on its inside.

    A closed cavity is; the wall of an open one is once a face of the body (see
    `select_face`) in which it opens is taken away, or two of them. These are sought
    among the `_MOST_CUT` largest.
    """
    surface = _FaceGraph(mesh)
    of_face = np.unique(surface.body_faces(), return_inverse=True)[1].ravel()
    pairs = np.unique(of_face[surface.sides // 3], axis=0)
    n, whole = int(of_face.max()) + 1, 0
    sizes = np.linalg.norm(area_normals(surface.corners), axis=1)
    areas = np.bincount(of_face, sizes)
    large = np.argsort(-areas, kind="stable")[:_MOST_CUT].tolist()
    beside = [{*pairs[(pairs == k).any(axis=1)].flat} & {*large} for k in range(n)]
    both = sorted({two for near in beside for two in combinations(sorted(near), 2)})
    found: dict[frozenset[int], Cavity] = {}
    for cut in ((), *((k,) for k in sorted(large)), *both):
        ends = pairs[~np.isin(pairs, cut).any(axis=1)].T
        joined = coo_array((np.ones(len(ends[0])), tuple(ends)), (n, n))
        count, labels = connected_components(joined, directed=False)
        whole = whole or count
        if cut and count == whole + len(cut):  # nothing is cut off
            continue
        for label in {*labels.tolist()} - {*labels[[*cut]].tolist()}:
            wall = frozenset(np.flatnonzero(labels == label).tolist())
            if any(wall <= other for other in found):
                continue
            chosen = np.isin(of_face, [*wall])
            volume = surface.void(chosen)
            if volume > (_ROUNDING * mesh.size) * mesh.size**2:
                openings = tuple(surface.faces[of_face == k] for k in cut)
                found = {w: cavity for w, cavity in found.items() if not w < wall}
                found[wall] = Cavity(surface.faces[chosen], openings, volume)
    return [*found.values()]


def distances_along(
    corners: Float[HostArray, "n_faces 3 3"],
    point: Float[HostArray, "3"],
    rays: Float[HostArray, "3 n_rays"],
) -> Float[HostArray, "n_faces n_rays"]:
    """Compute how far from a point rays meet the outer side of triangles, else inf [m].

    Rays are unit vectors in columns.
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    normals = area_normals(corners - point)
    tiny = 1e-9 * np.ptp(corners, axis=(0, 1)).max() ** 2
    # A ray meets a triangle if it passes all three sides on their inner side.
    passed = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)]) @ rays
    away = np.sum(a * normals, axis=1)[:, None] / np.minimum(normals @ rays, -tiny)
    return np.where((passed.max(axis=0) > tiny) | (away < 0.0), np.inf, away)


def ring_around(
    mesh: TetMesh, point: Float[HostArray, "3"]
) -> tuple[Int[HostArray, " n"], Float[HostArray, " n"]] | None:
    """Find the ring of wall around a point in a channel, or None if it has gaps.

    The channel goes across the normals of the wall that is seen from the point. Rays
    across it meet the wall within a fifth of the size of the mesh, in faces whose
    corners are the ring. The weights [-] of these nodes are as equal as can be while
    linear fields are exact at the point.
    """
    faces = boundary_faces(mesh)[:, :3]
    corners = mesh.points[faces]
    seen = -seen_from(corners, point)
    # The rim of a channel and a face beside it, seen edge-on, do not count.
    faces, corners, seen = (x[seen > _ROUNDING] for x in (faces, corners, seen))
    if not len(faces):
        return None
    normals = area_normals(corners - point)
    weights = seen / np.sum(normals**2, axis=1)
    across = np.linalg.eigh((normals.T * weights) @ normals)[1][:, 1:]
    turn = np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)
    away = distances_along(corners, point, across @ [np.cos(turn), np.sin(turn)])
    if away.min(axis=0).max() > _NARROW * mesh.size:
        return None
    nodes = np.unique(faces[away.argmin(axis=0)])
    linear = np.vstack([np.ones(len(nodes)), (mesh.points[nodes] - point).T])
    equal = np.full(len(nodes), 1.0 / len(nodes))
    return nodes, equal + np.linalg.lstsq(linear, np.eye(4)[0] - linear @ equal)[0]


def surface_parts(mesh: TetMesh) -> list[Int[HostArray, "_ n_fn"]]:
    """Divide the surface at edges at which it turns by more than 40 degrees."""
    surface = _FaceGraph(mesh)
    labels = surface.parts(SHARP)
    return [surface.faces[labels == part] for part in range(labels.max() + 1)]


def matching_faces(
    mesh: TetMesh, surfaces: Sequence[Int[HostArray, "_ 3"]]
) -> list[Int[HostArray, "_ n_fn"]]:
    """Find the boundary faces with the corners of triangles, surface by surface."""
    surface = _FaceGraph(mesh)
    rows = surface.rows(np.concatenate(surfaces))
    ends = np.cumsum([len(triangles) for triangles in surfaces])[:-1]
    return [surface.faces[part[part >= 0]] for part in np.split(rows, ends)]


def seen_from(
    corners: Float[HostArray, "n_faces 3 3"], point: Float[HostArray, "3"]
) -> Float[HostArray, " n_faces"]:
    """Compute the share of all directions in which each triangle is seen [-].

    Shares are negative if the outer side is seen; their sum is 1 within the surface,
    and 0 elsewhere. Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    dot = lambda u, v: np.sum(u * v, axis=1)
    triple = dot(a, np.cross(b, c))
    rest = la * lb * lc + dot(a, b) * lc + dot(a, c) * lb + dot(b, c) * la
    return np.arctan2(triple, rest) / (2.0 * np.pi)


class _FaceGraph:
    """The boundary of a mesh: its faces, which of them meet, and how they turn."""

    def __init__(self, mesh: TetMesh):
        self.mesh, self.faces = mesh, boundary_faces(mesh)
        self.corners = mesh.points[self.faces[:, :3]]
        normals = area_normals(self.corners)
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        # Along an edge of more than two faces, parts only touch.
        self.sides = sides_of(self.faces[:, :3]).pairs

    def rows(self, faces: Int[HostArray, "n n_fn"]) -> Int[HostArray, " _"]:
        """Find the indices of faces on the boundary; -1 for those that are not."""
        return face_indices(faces[:, :3], self.faces[:, :3])

    def of_groups(self, names: Iterable[str]) -> Bool[HostArray, " n_faces"]:
        """Mark the faces of surface groups."""
        marked = np.zeros(len(self.faces), bool)
        for name in names:
            rows = self.rows(self.mesh.faces(name))
            marked[rows[rows >= 0]] = True
        return marked

    def parts(
        self, angle: float | None, barred: Bool[HostArray, " n_faces"] | None = None
    ) -> Int[HostArray, " n_faces"]:
        """Number the connected parts of the surface; a barred face is its own part."""
        left, right = self.sides.T // 3
        joined = np.ones(len(left), bool)
        if barred is not None:
            joined = ~barred[left] & ~barred[right]
        if angle is not None:
            turn = np.sum(self.normals[left] * self.normals[right], axis=1)
            joined &= turn >= np.cos(angle)
        n = len(self.faces)
        pairs = (np.ones(joined.sum()), (left[joined], right[joined]))
        labels = connected_components(coo_array(pairs, (n, n)), directed=False)[1]
        return labels.astype(int)

    def body_faces(self) -> Int[HostArray, " n_faces"]:
        """Number the faces of the CAD model, or what is between sharp edges."""
        labels = self.parts(SHARP)
        for k, name in enumerate(filter(CAD_FACE.fullmatch, self.mesh.surface_groups)):
            labels[self.of_groups([name])] = -1 - k
        return labels

    def void(self, chosen: Bool[HostArray, " n_faces"]) -> float:
        """Compute the volume that a part of the surface and its lids enclose [m3]."""
        rim = self.sides[np.logical_xor(*chosen[self.sides.T // 3]), 0]
        nodes = self.faces[:, :3].ravel()[rim] if rim.size else self.faces[chosen]
        # From a rim, a flat lid adds nothing to the volume on the inner side.
        middle = self.mesh.points[nodes].reshape(-1, 3).mean(axis=0)
        return -float(np.linalg.det(self.corners[chosen] - middle).sum()) / 6.0

    def distances(self, point: Float[HostArray, "3"]) -> Float[HostArray, " n_faces"]:
        """Compute the distance of each face from a point [m]."""
        b = nearest_on_triangles(self.corners, point)
        feet = np.einsum("fc,fci->fi", b, self.corners)
        return np.linalg.norm(feet - point, axis=1)

    def at(self, point: Float[HostArray, "3"]) -> Int[HostArray, " _"]:
        """Find the faces that a point lies on; several if it lies on an edge."""
        away = self.distances(point)
        nearest = np.argmin(away)
        edges = self.corners[nearest] - np.roll(self.corners[nearest], 1, axis=0)
        # Flat faces are off a round surface, but by less than this.
        allowed = 0.5 * np.linalg.norm(edges, axis=1).max()
        if away[nearest] > allowed:
            lower, upper = self.mesh.points.min(axis=0), self.mesh.points.max(axis=0)
            raise ValueError(
                f"the point {place(point)} is {readable(float(away[nearest]), 'm')} "
                f"away from the surface of the body, which spans {place(lower)} to "
                f"{place(upper)}; expected a point on it. Check its length unit."
            )
        return np.flatnonzero(away <= away[nearest] + _ROUNDING * self.mesh.size)

    def part_at(
        self, point: Float[HostArray, "3"], labels: Int[HostArray, " n_faces"]
    ) -> Int[HostArray, "n n_fn"]:
        """Return the faces of the part that a point lies on."""
        parts = np.unique(labels[self.at(point)])
        if len(parts) > 1:
            raise ValueError(
                f"the point {place(point)} lies where {len(parts)} surfaces meet; move "
                "it off their border, onto the one that is meant."
            )
        return self.faces[labels == parts[0]]
