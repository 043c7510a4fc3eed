"""Control points placed over a body: evenly, or where the data see the field."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Literal

import equinox as eqx
import numpy as np
from scipy.spatial.distance import pdist

from softcal_jax._lanes import stacked
from softcal_jax._text import SoftcalWarning, check_known, listed, parse_axes
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    Program,
    Workers,
    adjoint_rows,
    check_converged,
    effector_values,
    equilibria,
    linearise,
)
from softcal_jax.fields import ControlPoints, find_field, region_tets
from softcal_jax.mesh import TetMesh, volumes
from softcal_jax.sensitivity import adjoint_of_tets

_SEES_FORCES = ("force", "reaction", "observation")

PATCHES_PER_POINT = 8
"""Patches of tets per control point: the more, the finer the choice of places."""

TETS_PER_PATCH = 24
"""Smallest mean number of tets in a patch.

The sensitivity of a marker to a single tet next to it depends on the shape of the tet
more than on its material; over a patch of tets this averages out.
"""

ROUNDS = 5  # rounds in which patches are centred; further rounds hardly move any

INDEPENDENT = 0.05
"""Remaining sensitivity of a patch, over the largest, below which it is unseen [-].

A control point in such a patch needs data 20 times as precise as the best point does to
be as well determined. Patches on the far side of the markers from the load still move
them by a few percent, through the strain around the markers.
"""


Places = Float[HostArray, "n n_axes"]
"""Coordinates along the axes that count, over the diagonal of their box [-]."""


class LayoutWarning(SoftcalWarning):
    """More control points were asked for than the data can tell apart."""


def place_control_points(
    mesh: TetMesh,
    n: int,
    *,
    method: Literal["farthest", "sensitivity"] = "farthest",
    region: str | None = None,
    axes: str = "xyz",
    model: Model | None = None,
    configurations: Configuration | Sequence[Configuration] = (),
    fields: str | Mapping[str, float] | None = None,
    newton: NewtonSettings | None = None,
) -> ControlPoints:
    """Place control points on centroids of tets, spread out or where the data see them.

    "farthest" uses the shape alone. A single point goes to the centroid nearest to the
    middle of the region; of several, the first is the farthest from there, and each
    further one is farthest from those before (Gonzalez, Theoretical Computer Science
    38, 1985). Ties go to the place nearest to the middle, then to the smallest x, y, z.

    "sensitivity" uses the data: the sensitivities of the effectors to the fields in
    patches of tets (Eq. 9), per volume and in units of the noise, are the columns of a
    matrix. QR with column pivoting picks columns that are large and independent of
    those before: the orthogonal method for the parameters that data can estimate (Yao
    et al., Polymer Reaction Engineering 11, 2003). Deviations: a patch has one column
    per field, picked together, and points keep half the distance that "farthest" would
    leave between n points. The result is local: it holds for the present fields.

    The result are "CP 1" to "CP n" in the order in which they were found, for the tet
    group `region` or the whole body; distance counts along `axes`, like "x" for a bar,
    as in `ControlPoints`.

    "sensitivity" needs the model on this mesh, configurations with markers, which need
    not be measured, and `fields`: the field that is calibrated; or several, each with
    the size of its variation in SI units, to weigh them against each other.

    Raises:
        ValueError: If n is not between 1 and the number of different places, a name is
            unknown, or the model or the fields are missing or do not fit.
        RuntimeError: If a configuration has no equilibrium.

    Warns:
        LayoutWarning: If the data see fewer independent directions than n; further
            points are then spread evenly over what the data see.
    """
    check_known("method", ("farthest", "sensitivity"), method)
    if n < 1:
        raise ValueError(f"the number of control points must be at least 1, got {n}.")
    tets, along = _places(mesh, region, axes, n)
    if method == "farthest":
        chosen = farthest_points(along, n)
        _check_room(len(chosen), n, f"along {axes}" if axes != "xyz" else "in space")
    else:
        sizes = _field_sizes(model, mesh, fields, configurations)
        assert model is not None  # checked with the fields
        G = tet_sensitivities(model, configurations, tuple(sizes), newton=newton)
        blocks = np.stack([size * G[f][:, tets] for f, size in sizes.items()], axis=2)
        chosen = _well_seen(along, n, np.abs(volumes(mesh)[tets]), blocks)
    return ControlPoints(mesh.centroids[tets[chosen]], axes=axes)


def _places(
    mesh: TetMesh, region: str | None, axes: str, n: int
) -> tuple[Int[HostArray, " n"], Places]:
    """Return the tets of the region from the middle outwards, and their places."""
    tets = np.unique(region_tets(mesh, region))
    if n > len(tets):
        where = "the mesh has" if region is None else f"{region!r} has"
        raise ValueError(
            f"{n} control points were asked for, but {where} only {len(tets)} tets: a "
            "control point needs one of its own."
        )
    x = mesh.centroids[tets]
    middle = np.average(x, axis=0, weights=np.abs(volumes(mesh)[tets]))
    away = np.linalg.norm(x - middle, axis=1)
    # Rounded, so that places that are alike by symmetry tie.
    step = 1e-9 * max(float(away.max()), mesh.size)
    keys = np.round(np.column_stack([away, x]) / step)
    order = np.lexsort(keys.T[::-1])
    along = x[order][:, parse_axes(axes)]
    size = max(float(np.linalg.norm(np.ptp(along, axis=0))), 1e-12 * mesh.size)
    return tets[order], along / size


def farthest_points(places: Places, n: int) -> list[int]:
    """Pick n places far from each other; fewer if no different place is left."""
    if n == 1:
        return [0]
    # Place 0 is the nearest to the middle.
    gaps = _gaps(places, places[0])
    chosen: list[int] = []
    while len(chosen) < n and gaps.max() > 0.0:
        chosen.append(int(np.argmax(gaps)))
        new = _gaps(places, places[chosen[-1]])
        gaps = new if len(chosen) == 1 else np.minimum(gaps, new)
    return chosen


def _gaps(places: Places, place: Float[HostArray, " n_axes"]) -> Float[HostArray, " n"]:
    """Return distances from a place, rounded so that equal ones tie."""
    return np.round(np.linalg.norm(places - place, axis=1), 9)


def _check_room(available: int, n: int, what: str) -> None:
    if available < n:
        raise ValueError(
            f"{n} control points were asked for, but only {available} different places "
            f"were found {what}: ask for fewer, refine the mesh, or change the axes."
        )


def _field_sizes(
    model: Model | None,
    mesh: TetMesh,
    fields: str | Mapping[str, float] | None,
    configurations: Configuration | Sequence[Configuration],
) -> dict[str, float]:
    """Check the arguments of "sensitivity"; return how far each field varies [SI]."""
    if model is None or not configurations or not fields:
        raise ValueError(
            'method "sensitivity" needs model, configurations and fields: it places '
            "points where the markers of these poses see the field."
        )
    same = np.array_equal(model.mesh.points, mesh.points)
    if not (same and np.array_equal(model.mesh.tets, mesh.tets)):
        raise ValueError("the model stands on another mesh: give `model.mesh`.")
    sizes = {fields: 1.0} if isinstance(fields, str) else dict(fields)
    for field, size in sizes.items():
        if not (np.isfinite(size) and size > 0.0):
            raise ValueError(
                f"the variation of {field} must be positive, got {size:g}."
            )
    return sizes


def _well_seen(
    places: Places,
    n: int,
    shares: Float[HostArray, " n"],
    blocks: Float[HostArray, "n_e n n_fields"],
) -> list[int]:
    """Pick places of n patches that the data see well and independently."""
    most = max(n, min(PATCHES_PER_POINT * n, len(places) // TETS_PER_PATCH))
    seeds, patches = _patches(places, shares, most)
    _check_room(len(seeds), n, "among the tets")
    density = np.stack(
        [blocks[:, p].sum(axis=1) / shares[p].sum() for p in patches], axis=1
    )
    norms = np.linalg.norm(density, axis=(0, 2))
    if not norms.max() > 0.0:
        raise ValueError(
            "the markers do not see the field in any tet: check that the poses are "
            "loaded, and that the markers move."
        )
    seen = np.flatnonzero(norms > INDEPENDENT * norms.max())
    _check_room(len(seen), n, "that the markers see")
    kept = [seeds[i] for i in seen]
    visible = places[kept]
    distance = 0.5 * _separation(visible, n)
    chosen, rank = pivoted(visible, density[:, seen] / norms.max(), n, distance)
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
    places: Places, shares: Float[HostArray, " n"], most: int
) -> tuple[list[int], list[Int[HostArray, " _"]]]:
    """Form compact patches of places; return their middle places and their members.

    They are centroidal Voronoi cells by Lloyd's method (IEEE Trans. Inf. Theory 28,
    1982), since the cells of the farthest points alone, which lie at corners, are
    lopsided.
    """
    seeds, patches = farthest_points(places, most), []
    for _ in range(ROUNDS):
        owner = np.argmin([_gaps(places, places[i]) for i in seeds], axis=0)
        patches = [np.flatnonzero(owner == patch) for patch in range(len(seeds))]
        seeds = []
        for patch in patches:
            middle = np.average(places[patch], axis=0, weights=shares[patch])
            seeds.append(int(patch[np.argmin(_gaps(places[patch], middle))]))
    return seeds, patches


def _separation(places: Places, n: int) -> float:
    """Return the smallest distance between n points that are spread out.

    At half of it, there is room for n points however badly the first ones are placed: a
    ball of that radius holds at most one of the points spread out.
    """
    gaps = pdist(places[farthest_points(places, n)])
    return float(np.min(gaps, initial=np.inf)) if n > 1 else 0.0


def pivoted(
    places: Places,
    blocks: Float[HostArray, "n_e n n_fields"],
    n: int,
    min_distance: float,
) -> tuple[list[int], int]:
    """Pick blocks of columns by pivoted QR, with a distance between their patches.

    The largest block has norm one. Returns the chosen patches, and how many of them
    were independent; each further patch is the farthest from those before it.
    """
    left = blocks.copy()
    free = np.ones(blocks.shape[1], bool)
    gaps = np.full(blocks.shape[1], np.inf)
    chosen: list[int] = []
    rank = 0
    while len(chosen) < n:
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
        gaps = np.minimum(gaps, np.linalg.norm(places - places[best], axis=1))
        free &= gaps >= max(min_distance, 1e-9)
    return chosen, rank


@eqx.filter_jit
def _rows(
    model: Model,
    fields: tuple[str, ...],
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"],
) -> tuple[Float[Array, "n_fields n_e n_tets"], Bool[Array, ""]]:
    """Return the rows of a configuration, and whether they are sound."""
    lin = linearise(model, configuration, u, lambda_a)
    adjoint = adjoint_rows(lin, effector_values)
    return adjoint_of_tets(lin, fields, adjoint.state), adjoint.ok


def tet_sensitivities(
    model: Model,
    configurations: Configuration | Sequence[Configuration],
    fields: str | Sequence[str],
    *,
    newton: NewtonSettings | None = None,
) -> dict[str, Float[HostArray, "n_e n_tets"]]:
    """Compute the change of every measured coordinate per change of a field in a tet.

    This is Eq. (9) for the finest layout possible, one control point per tet, in
    adjoint form: each configuration is solved for the rows W_e = K^-T H_e^T, and one
    pass over the tets gives the forces of their fields.

    Fields are of the law, or "density", and are differentiated at their values in the
    model; `measured` of the configurations is ignored. Rows of each field are for the
    measured coordinates, in the order configuration, marker, axis; in units of the
    noise per SI unit of the field.

    Raises:
        ValueError: If a field does not exist, a configuration has no effectors or
            comes after another one, or an effector is a force.
        RuntimeError: If a configuration has no equilibrium, or a singular one.
    """
    posed = as_sequence(configurations)
    names = (fields,) if isinstance(fields, str) else tuple(fields)
    for field in names:
        find_field(model, field)
    mesh, mechanism = model.mesh, model.mechanism
    if later := [c.name for c in posed if c.after]:
        raise ValueError(
            f"{listed(later)} comes after another configuration, and sensitivities of "
            "tets do not go through that: leave `after` out."
        )
    measured = [c.measured_at_rest(mesh, mechanism) for c in posed]
    arrays, records = configuration_lanes(mesh, measured, mechanism)
    if any(e.quantity in _SEES_FORCES for of_pose in records for e in of_pose):
        raise ValueError(
            "tet_sensitivities takes effectors that follow from positions: leave out "
            "ActuatorForce, SupportReaction and Observation."
        )
    with Workers(model, len(posed)) as workers:
        solution = equilibria(workers, model, arrays, newton or NewtonSettings())
        check_converged(solution, tuple(c.name for c in posed))
        states = solution.displacement, solution.multipliers
        lanes = zip(arrays, *states, strict=True)
        by_lane, sound = stacked(workers.map(Program(_rows, model, names), lanes))
    for c, ok in zip(posed, np.asarray(sound), strict=True):
        if not ok:
            raise RuntimeError(
                f"configuration {c.name!r}: its tangent is singular at the equilibrium."
            )
    weight = np.asarray(arrays.effectors.inverse_std).ravel()
    seen = weight > 0.0
    rows = np.moveaxis(np.asarray(by_lane), 1, 0)
    rows = rows.reshape(len(names), len(weight), mesh.n_tets)[:, seen]
    return dict(zip(names, weight[seen, None] * rows, strict=True))
