"""Which faces of the body can meet: pairs of them, decided at rest."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax._units import readable
from softcal_jax.contact._touching import BLOCK, Touching
from softcal_jax.mesh import (
    TetMesh,
    boundary_faces,
    boundary_tets,
    face_areas,
    face_indices,
    volumes,
)

_SLIDE = 2.0, 0.25
"""Default reach of a face, over its mean size, and over the way to the other [-]."""

_MOST = 50_000
"""Pairs of faces; places of their tangents take 2.7 kB each, if quadratic."""


def face_size(mesh: TetMesh) -> float:
    """Return the mean size of the faces of a body [m]."""
    areas, _ = face_areas(mesh, boundary_faces(mesh))
    return float(np.sqrt(2.0 * areas.sum() / len(areas)))


def build_touching(
    mesh: TetMesh,
    stated: Sequence[tuple[str, str]],
    *,
    carrier: Int[HostArray, " n_nodes"],
    reach: float | None,
) -> Touching | None:
    """Find the pairs of faces that can meet; None if no surfaces are stated.

    A face can meet those of the other surface that lie across from it, as if a mirror
    stood between them: a mirror image that lies up to `reach` beside counts [m].
    `carrier` is the rigid body of each node, negative for none.

    Raises:
        ValueError: If there is no such surface, no pair, or too many of them.
    """
    if not stated:
        return None
    surface, tets = boundary_faces(mesh), boundary_tets(mesh)
    corners = mesh.points[surface[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    areas, N = face_areas(mesh, surface)
    slide = (_SLIDE[0] * face_size(mesh), _SLIDE[1]) if reach is None else (reach, 0.0)
    centre = corners.mean(axis=1)
    found, of = [], []
    for k, names in enumerate(stated):
        first, second = (face_indices(mesh.faces(name), surface) for name in names)
        for some in np.array_split(first, 1 + len(first) // 100):
            same = names[0] == names[1]
            pairs = _across(centre, normal, some, second, reach=slide, itself=same)
            found.append(pairs[_can_meet(surface, carrier, pairs)])
            of.append(np.full(len(found[-1]), k))
        if k not in np.concatenate(of):
            raise ValueError(
                f"no face of {names[0]!r} can meet one of {names[1]!r} in touching: "
                "none lies across from it at rest, shares no node with it and is not "
                "held by the same rigid body. Name other surfaces, or state a larger "
                "touching_reach."
            )
    both = np.concatenate(found)
    ends, once = np.unique(np.sort(both, axis=1), axis=0, return_index=True)
    if len(ends) > _MOST:
        raise ValueError(
            f"touching has {len(ends)} pairs of faces that can meet, expected at most "
            f"{_MOST}: name smaller surfaces, or state a touching_reach below "
            f"{readable(slide[0], 'm')}."
        )
    used, ends = np.unique(ends, return_inverse=True)
    ends = ends.reshape(-1, 2)
    n, pad = len(used), -len(used) % BLOCK
    counts = np.bincount(ends.ravel(), minlength=n)
    # Pairs of each face, one after the other.
    owner = ends.T.ravel()
    order = np.argsort(owner, kind="stable")
    place = np.arange(owner.size) - np.repeat(np.cumsum(counts) - counts, counts)
    pairs = np.full((n + pad, counts.max()), -1, np.int32)
    partners = np.repeat(np.arange(n + pad)[:, None], counts.max(), axis=1)
    pairs[owner[order], place] = np.tile(np.arange(len(ends)), 2)[order]
    partners[owner[order], place] = ends[:, ::-1].T.ravel()[order]
    padded = np.concatenate([used, np.repeat(used[:1], pad)])
    heights = 3.0 * volumes(mesh)[tets] / areas.sum(axis=1)
    return Touching(
        faces=surface[padded],
        areas=np.pad(0.5 * areas[used], ((0, pad), (0, 0))),
        limits=0.5 * heights[padded],
        partners=partners.astype(np.int32),
        pairs=pairs,
        ends=ends.astype(np.int32),
        swapped=both[once, 0] > both[once, 1],
        of=np.concatenate(of)[once].astype(np.int32),
        shape_functions=N,
        names=tuple(f"{first} on {second}" for first, second in stated),
    )


def _across(
    centre: Float[HostArray, "n_faces 3"],
    normal: Float[HostArray, "n_faces 3"],
    first: Int[HostArray, " n"],
    second: Int[HostArray, " m"],
    *,
    reach: tuple[float, float],
    itself: bool,
) -> Int[HostArray, "n_pairs 2"]:
    """List pairs of faces of which one is nearly the mirror image of the other.

    It lies up to a length, and a share of the distance, beside. Those of one surface
    must see each other, or lie on each other.
    """
    way = centre[second][None] - centre[first][:, None]
    n, m = normal[first][:, None], normal[second][None]
    far, up, down = (way**2).sum(axis=2), (n * way).sum(axis=2), (m * way).sum(axis=2)
    # Half of |way| |m - image of n|.
    beside = far * ((n - m) ** 2).sum(axis=2) + 4.0 * up * down
    beside = 0.5 * np.sqrt(np.maximum(beside, 0.0))
    chosen = beside <= reach[0] + reach[1] * np.sqrt(far)
    chosen &= first[:, None] != second[None]
    if itself:
        least = 1e-9 * np.ptp(centre)
        chosen &= (up >= -least) & (down <= least) & ((n * m).sum(axis=2) < 0.5)
    i, j = np.nonzero(chosen)
    return np.stack([first[i], second[j]], axis=1)


def _can_meet(surface, carrier, pairs):
    """Tell which pairs share no node, and are not held together by a rigid body."""
    nodes = surface[pairs]
    apart = (nodes[:, 0, :, None] != nodes[:, 1, None]).all(axis=(1, 2))
    of = carrier[nodes]
    whole = np.where((of == of[:, :, :1]).all(axis=2), of[:, :, 0], -1)
    for a, b in ((0, 1), (1, 0)):
        same = (of[:, b] == whole[:, a, None]).any(axis=1)
        apart &= ~same | (whole[:, a] < 0)
    return apart
