"""The moduli that a foam can have, as half-planes of their logarithms."""

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.designs._foam import FoamTable
from softcal_jax.fields import Region

Polygon = Float[HostArray, "_ 2"]

SMOOTH = 1e-3
"""How far vertices of the region are left out that hardly show, in ln E [-]."""

DIRECTIONS = 180  # of the lines that cut off what a hollow leaves outside


def foam_region(
    table: FoamTable, E_l: str, E_t: str, *, fading: bool = False
) -> Region:
    """Return the moduli along and across a fibre that a foam can have, as a region.

    `E_l` and `E_t` are the names of their fields. The fibre is the single axis of the
    foam, the soft one of Polyfoam and the stiff one of Phasor. Where the set is hollow,
    a convex part of it is taken, so that moduli between those of two control points are
    reached, too. If the contrast of the moduli is `fading` in cores, it has only such
    moduli of which the foam also has the geometric mean, as an isotropic one.

    Raises:
        ValueError: If the table has the moduli of one level only, or no isotropic foam
            to fade to.
    """
    if len(np.unique(table.anisotropy)) < 2:
        raise ValueError(
            f"the foam table has one {table.setting}, so that its moduli lie on a "
            "curve: add samples with another one."
        )
    edge = _convex_part(table.outline())
    if fading:
        mean = np.full(2, 0.5)
        low, high = np.log(isotropic_range(table))
        edge = _cut(_cut(edge, mean, high), -mean, -low)
    normals, b = _half_planes(edge)
    fields = (E_l, E_t) if table.axis == "soft" else (E_t, E_l)
    return Region(fields, normals, b, edge.mean(axis=0), name=table.infill)


def isotropic_range(table: FoamTable) -> tuple[float, float]:
    """Return the smallest and the largest modulus of an isotropic foam [Pa].

    Raises:
        ValueError: If the table has none.
    """
    ln_soft, ln_stiff = table.outline().T
    same = np.isclose(ln_soft, ln_stiff, rtol=0.0, atol=SMOOTH)
    if same.sum() < 2:
        raise ValueError(
            f"the table of {table.infill} has no isotropic foam, which is needed for "
            f"one E, and in the core of an angle: add samples with {table.setting} 1."
        )
    low, high = np.exp([ln_soft[same].min(), ln_soft[same].max()])
    return float(low), float(high)


def _convex_part(outline: Polygon) -> Polygon:
    """Return the vertices of a large convex part of a polygon, counter-clockwise.

    Its convex hull, cut at the deepest hollow along the line that leaves most of it,
    until no hollow is left.
    """
    # Here, so that commands which do not need it do not wait for it.
    from scipy.spatial import ConvexHull

    part, size = outline[ConvexHull(outline).vertices], np.ptp(outline, axis=0).max()
    while True:
        A, b = _half_planes(part)
        depth = np.min(b - outline @ A.T, axis=1)
        deepest = int(depth.argmax())
        if depth[deepest] <= 1e-9 * size:
            return _smoothed(part)
        angles = 2.0 * np.pi * np.arange(2 * DIRECTIONS) / (2 * DIRECTIONS)
        normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        cuts = [_cut(part, n, float(n @ outline[deepest])) for n in normals]
        part = max(cuts, key=_area)


def _area(polygon: Polygon) -> float:
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _half_planes(polygon: Polygon) -> tuple[Polygon, Float[HostArray, " _"]]:
    """Return unit normals A and b of a convex polygon A x <= b."""
    x, y = (np.roll(polygon, -1, axis=0) - polygon).T
    normals = np.stack([y, -x], axis=1) / np.hypot(x, y)[:, None]
    return normals, np.sum(normals * polygon, axis=1)


def _cut(polygon: Polygon, normal: Float[HostArray, "2"], offset: float) -> Polygon:
    """Return the part of a convex polygon where normal @ x <= offset."""
    over = polygon @ normal - offset
    kept: list[Float[HostArray, 2]] = []
    for i, j in zip(range(len(polygon)), [*range(1, len(polygon)), 0], strict=True):
        if over[i] <= 0.0:
            kept.append(polygon[i])
        if over[i] * over[j] < 0.0:
            share = over[i] / (over[i] - over[j])
            kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
    return np.array(kept).reshape(-1, 2)


def _smoothed(polygon: Polygon) -> Polygon:
    """Leave out vertices that stand out by less than `SMOOTH`, each once."""
    kept = [polygon[0]]
    for i in range(1, len(polygon)):
        after = polygon[(i + 1) % len(polygon)]
        chord = after - kept[-1]
        x, y = polygon[i] - kept[-1]
        if abs(chord[0] * y - chord[1] * x) > SMOOTH * np.linalg.norm(chord):
            kept.append(polygon[i])
    return np.array(kept)
