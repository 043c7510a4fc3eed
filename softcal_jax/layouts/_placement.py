"""Control points placed over a body: evenly, or where the data see the field."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import ControlPoints
from softcal_jax.layouts._tet_sensitivities import tet_sensitivities
from softcal_jax.mesh import TetMesh

METHODS = ("farthest", "sensitivity")

PATCHES_PER_POINT = 8
"""Patches of tets per control point: they decide how finely a place is chosen."""

TETS_PER_PATCH = 24
"""Tets in a patch, on average and at least.

Next to a marker, single tets push it to all sides, by their shape and not by what they
are made of; a few cells together hardly do.
"""

ROUNDS = 5
"""Rounds in which patches are centred; later ones hardly move any."""

INDEPENDENT = 0.05
"""What is left of a patch's sensitivity, over the largest, below which it is unseen.

A control point there would need data 20 times as good as the best one to be as well
determined; and patches beyond a marker on the way of a load still move it by a few
percent, through the strain around it.
"""


class LayoutWarning(UserWarning):
    """More control points were asked for than the data can tell apart."""


class _Places(NamedTuple):
    """Where control points may stand: tets, those near the middle first.

    Attributes:
        tets: Numbers of the tets.
        x: Their centroids [m].
        along: Their centroids, on the axes that count for the distance [m].
        size: Diagonal of what they span along these axes [m].
    """

    tets: Int[HostArray, " n"]
    x: Float[HostArray, "n 3"]
    along: Float[HostArray, "n n_axes"]
    size: float


def place_control_points(
    mesh: TetMesh,
    n: int,
    *,
    method: Literal["farthest", "sensitivity"] = "farthest",
    region: str | None = None,
    power: float = 2.0,
    nearest: int | None = None,
    axes: str = "xyz",
    model: Model | None = None,
    configurations: Configuration | Sequence[Configuration] = (),
    fields: str | Mapping[str, float] | None = None,
    min_distance: float | None = None,
    newton: NewtonSettings | None = None,
) -> ControlPoints:
    """Control points on centroids of tets, spread out or where the data see them.

    "farthest" looks at the shape alone. A single point stands on the centroid nearest
    to the middle of the region; of several, the first is the farthest from there, and
    each further one is farthest from those before (Gonzalez, Theoretical Computer
    Science 38, 1985), so a layout holds all smaller ones of two points and more. Of
    equally far places the one nearest to the middle is taken, then that with the
    smallest x, y, z, whatever the numbering of the tets.

    "sensitivity" looks at the data: the sensitivities of the effectors to the fields
    in patches of tets (Eq. 9), per volume and in units of the noise, are the columns of
    a matrix, from which a QR with column pivoting takes those that are large and
    independent of those before: the orthogonal method for the parameters that data can
    estimate (Yao et al., Polymer Reaction Engineering 11, 2003), known for the dual
    task of placing sensors too (Manohar et al., IEEE Control Systems 38, 2018).
    Deviations: a patch brings one column per field, together; and points keep a
    distance. It is local: it looks at the fields as they are in the model.

    Args:
        mesh: The mesh [m].
        n: How many control points.
        method: "farthest" or "sensitivity".
        region: Tet group that they are for; the whole body by default.
        power: Exponent of the weighting, see `ControlPoints` [-].
        nearest: How many control points a tet listens to; all by default.
        axes: Axes along which distance is counted, like "x" for a bar.
        model: For "sensitivity": the body on this mesh.
        configurations: For "sensitivity": poses with markers; need not be measured.
        fields: For "sensitivity": the field that is calibrated; or several, each with
            the size of its variation in SI units, to weigh them against each other.
        min_distance: For "sensitivity": smallest distance of two points along `axes`
            [m]; by default half of what "farthest" would leave between as many.
        newton: For "sensitivity": settings of the equilibrium.

    Returns:
        The control points, "CP 1" to "CP n" in the order in which they were found.

    Raises:
        ValueError: If n is not between 1 and the number of different places, a name is
            unknown, the model or the fields are missing or do not fit, or n points do
            not find room.
        RuntimeError: If a configuration has no equilibrium.

    Warns:
        LayoutWarning: If the data see fewer independent directions than n; further
            points are then spread evenly over what the data see.
    """
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    if n < 1:
        raise ValueError(f"the number of control points must be at least 1, got {n}.")
    # Checks the options that it takes before anything is computed.
    ControlPoints([(0.0, 0.0, 0.0)], power=power, axes=axes)
    places = _places(mesh, region, axes, n)
    if method == "farthest":
        chosen = farthest_points(places, n)
        _check_room(len(chosen), n, f"along {axes}" if axes != "xyz" else "in space")
    else:
        sizes = _field_sizes(model, mesh, fields, configurations)
        assert model is not None  # checked with the fields
        G = tet_sensitivities(model, configurations, tuple(sizes), newton=newton)
        blocks = np.stack([size * G[f] for f, size in sizes.items()], axis=2)
        chosen = _well_seen(places, n, mesh, blocks, min_distance)
    return ControlPoints(places.x[chosen], power=power, nearest=nearest, axes=axes)


def _places(mesh: TetMesh, region: str | None, axes: str, n: int) -> _Places:
    """Centroids of the region's tets, those near the middle first."""
    tets = np.arange(mesh.n_tets)
    if region is not None:
        tets = np.unique(np.asarray(mesh.tets_of(region)))
    if n > len(tets):
        where = "the mesh has" if region is None else f"{region!r} has"
        raise ValueError(
            f"{n} control points were asked for, but {where} only {len(tets)} tets: a "
            "control point needs one of its own."
        )
    x = mesh.points[mesh.tets[tets, :4]].mean(axis=1)
    volumes = tet_volumes(mesh)[tets]
    away = np.linalg.norm(x - np.average(x, axis=0, weights=volumes), axis=1)
    # Rounded, so that places that are alike by symmetry tie.
    step = 1e-9 * max(float(away.max()), mesh.size)
    keys = np.round(np.column_stack([away, x]) / step)
    order = np.lexsort(keys.T[::-1])
    columns = ["xyz".index(axis) for axis in axes]
    along = x[order][:, columns]
    size = float(np.linalg.norm(np.ptp(along, axis=0)))
    return _Places(tets[order], x[order], along, max(size, 1e-12 * mesh.size))


def tet_volumes(mesh: TetMesh) -> Float[HostArray, " n_tets"]:
    """Volumes of the tets by their corners [m3]."""
    corners = mesh.points[mesh.tets[:, :4]]
    return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0


def farthest_points(places: _Places, n: int) -> list[int]:
    """Places that are far from each other; fewer than n if no other one is left."""
    if n == 1:
        return [0]
    # Place 0 is the nearest to the middle.
    gaps = _gaps(places, 0)
    chosen: list[int] = []
    while len(chosen) < n and gaps.max() > 0.0:
        chosen.append(int(np.argmax(gaps)))
        new = _gaps(places, chosen[-1])
        gaps = new if len(chosen) == 1 else np.minimum(gaps, new)
    return chosen


def _gaps(places: _Places, i: int) -> Float[HostArray, " n"]:
    """Distances from a place, in units of the size, rounded so that equal ones tie."""
    gaps = np.linalg.norm(places.along - places.along[i], axis=1)
    return np.round(gaps / places.size, 9)


def _check_room(found: int, n: int, what: str) -> None:
    if found < n:
        raise ValueError(
            f"{n} control points were asked for, but only {found} different places "
            f"were found {what}: ask for fewer, refine the mesh, or change the axes."
        )


def _field_sizes(
    model: Model | None,
    mesh: TetMesh,
    fields: str | Mapping[str, float] | None,
    configurations: Configuration | Sequence[Configuration],
) -> dict[str, float]:
    """How far each field varies [its SI unit], once all that is needed is there."""
    one = isinstance(configurations, Configuration)
    given = {
        "model": model is not None,
        "configurations": one or len(configurations) > 0,
        "fields": bool(fields),
    }
    missing = [name for name, there in given.items() if not there]
    if missing or model is None or not fields:
        raise ValueError(
            f'method "sensitivity" needs {" and ".join(missing)}: it places points '
            "where the markers of these poses see the field."
        )
    if not (
        np.array_equal(model.mesh.points, mesh.points)
        and np.array_equal(model.mesh.tets, mesh.tets)
    ):
        raise ValueError("the model stands on another mesh: give `model.mesh`.")
    sizes = {fields: 1.0} if isinstance(fields, str) else dict(fields)
    for field, size in sizes.items():
        if not (np.isfinite(size) and size > 0.0):
            raise ValueError(
                f"the variation of {field} must be positive, got {size:g}."
            )
    return sizes


def _well_seen(
    places: _Places,
    n: int,
    mesh: TetMesh,
    blocks: Float[HostArray, "n_e n_tets n_fields"],
    min_distance: float | None,
) -> list[int]:
    """Places of n patches that the data see well and independently."""
    volumes = tet_volumes(mesh)[places.tets]
    most = max(n, min(PATCHES_PER_POINT * n, len(places.tets) // TETS_PER_PATCH))
    seeds, patches = _patches(places, volumes, most)
    _check_room(len(seeds), n, "among the tets")
    columns = []
    for own in patches:
        total = blocks[:, places.tets[own]].sum(axis=1)
        columns.append(total / volumes[own].sum())
    density = np.stack(columns, axis=1)
    norms = np.linalg.norm(density, axis=(0, 2))
    if not norms.max() > 0.0:
        raise ValueError(
            "the markers do not see the field in any tet: check that the poses are "
            "loaded, and that the markers move."
        )
    seen = np.flatnonzero(norms > INDEPENDENT * norms.max())
    _check_room(len(seen), n, "that the markers see")
    kept = [seeds[i] for i in seen]
    there = _Places(places.tets[kept], places.x[kept], places.along[kept], places.size)
    distance = min_distance
    if distance is None:
        distance = 0.5 * _separation(there, n)
    chosen, rank = pivoted(there, density[:, seen] / norms.max(), n, distance)
    if len(chosen) < n:
        raise ValueError(
            f"only {len(chosen)} of {n} control points find room {distance:.3g} m "
            "apart where the markers see the field: lower min_distance or n."
        )
    if rank < n:
        warnings.warn(
            f"the markers tell only {rank} of {n} control points apart; the others are "
            "spread over what they see. Add configurations or markers, or ask for "
            f"{rank}.",
            LayoutWarning,
            stacklevel=3,
        )
    return [kept[i] for i in chosen]


def _patches(
    places: _Places, volumes: Float[HostArray, " n"], most: int
) -> tuple[list[int], list[Int[HostArray, " _"]]]:
    """Compact patches of places: the middle one of each, and its members.

    Centroidal Voronoi cells by Lloyd's rounds (IEEE Trans. Inf. Theory 28, 1982): the
    farthest points alone stand at corners, and their cells lean to one side.
    """
    seeds, patches = farthest_points(places, most), []
    for _ in range(ROUNDS):
        owner = np.argmin(np.stack([_gaps(places, i) for i in seeds]), axis=0)
        patches = [np.flatnonzero(owner == patch) for patch in range(len(seeds))]
        seeds = []
        for own in patches:
            middle = np.average(places.along[own], axis=0, weights=volumes[own])
            away = np.linalg.norm(places.along[own] - middle, axis=1) / places.size
            seeds.append(int(own[np.argmin(np.round(away, 9))]))
    return seeds, patches


def _separation(places: _Places, n: int) -> float:
    """Smallest distance between n points that are spread out [m].

    Balls of half of it, around however badly placed points, leave room for n: each
    holds at most one of the n.
    """
    spread = places.along[farthest_points(places, n)]
    gaps = np.linalg.norm(spread[:, None] - spread[None], axis=2)
    return float(np.min(gaps + np.diag(np.full(len(gaps), np.inf)))) if n > 1 else 0.0


def pivoted(
    places: _Places,
    blocks: Float[HostArray, "n_e n_patches n_fields"],
    n: int,
    min_distance: float,
) -> tuple[list[int], int]:
    """QR with column pivoting, by blocks of columns and with a distance between them.

    Args:
        places: Where the patches are.
        blocks: Their sensitivities; the largest block has norm one [-].
        n: How many are wanted.
        min_distance: Smallest distance between two [m].

    Returns:
        The chosen patches, fewer where no room is left, and how many of them were
        independent; the others are farthest from those before.
    """
    left = blocks.copy()
    free = np.ones(blocks.shape[1], bool)
    gaps = np.full(blocks.shape[1], np.inf)
    chosen: list[int] = []
    rank = 0
    while len(chosen) < n and free.any():
        # Rounded, so that patches that are alike by symmetry tie.
        norms = np.round(np.linalg.norm(left, axis=(0, 2)), 9)
        independent = np.where(free, norms, -1.0)
        best = int(np.argmax(independent))
        if independent[best] > INDEPENDENT and rank == len(chosen):
            rank += 1
        else:
            best = int(np.argmax(np.where(free, gaps, -1.0)))
        chosen.append(best)
        U, singular, _ = np.linalg.svd(left[:, best], full_matrices=False)
        Q = U[:, singular > INDEPENDENT]
        left = left - np.einsum("eq,fq,fpk->epk", Q, Q, left, optimize=True)
        new = np.linalg.norm(places.along - places.along[best], axis=1)
        gaps = np.minimum(gaps, new)
        free &= gaps >= max(min_distance, 1e-9 * places.size)
    return chosen, rank
