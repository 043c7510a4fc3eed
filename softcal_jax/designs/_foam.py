"""The foam of a printer: its table, its file, and the moduli that it can have."""

import csv
import os
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import numpy as np
from scipy.spatial import KDTree

from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax._typing import Float, HostArray
from softcal_jax.fields import Region
from softcal_jax.readings import read_table

_T_STEPS, _S_STEPS = 96, 64
"""Samples along the density, and between two levels, from which searches begin."""

Numbers = Float[HostArray, " n"]
Pairs = Float[HostArray, "n 2"]

Infill = Literal["Polyfoam", "Phasor"]
"""Foams of the slicer IceSL, by its names."""


class FoundFoam(NamedTuple):
    """The foams whose moduli are nearest to those asked for.

    Attributes:
        density: Relative density [-].
        anisotropy: As in `FoamTable` [-].
        E_soft: Modulus along the soft axis, or in the soft plane [Pa].
        E_stiff: Modulus along the stiff axis, or in the stiff plane [Pa].
        error: The larger |ln(found / asked)| of both moduli [-].
    """

    density: Numbers
    anisotropy: Numbers
    E_soft: Numbers
    E_stiff: Numbers
    error: Numbers


class FoamTable(Module):
    """Moduli of a foam by its density and the setting that makes it anisotropic.

    Samples with the same anisotropy are a level. Along a level ln E is a monotone cubic
    of ln density: a straight line where E is a power of the density. Between two levels
    ln density and ln E are linear, for Polyfoam in ln shrink and for Phasor in its
    isotropy; what lies outside of this patch is not reached by the foam.

    Attributes:
        infill: The foam. Polyfoam has a soft axis and a stiff plane across it; Phasor
            has a stiff axis and a soft plane.
        density: Share of solid [-], in (0, 1].
        anisotropy: `kgon_x_shrink` of Polyfoam, in (0, 1], or `phasor_infill_iso` of
            Phasor, in [0, 1]; 1 is isotropic [-].
        E_soft: Young's modulus along the soft axis, or in the soft plane [Pa].
        E_stiff: Young's modulus along the stiff axis, or in the stiff plane [Pa].
        source: Where the numbers come from.

    Raises:
        ValueError: If the infill is unknown, a value is out of its range, E_soft
            exceeds E_stiff, or a level has fewer than two densities.
    """

    infill: Infill = eqx.field(static=True)
    density: Numbers = eqx.field(converter=np.asarray)
    anisotropy: Numbers = eqx.field(converter=np.asarray)
    E_soft: Numbers = eqx.field(converter=np.asarray)
    E_stiff: Numbers = eqx.field(converter=np.asarray)
    source: str = eqx.field(static=True, default="a table of the user")

    def __check_init__(self):
        check_known("infill", get_args(Infill), self.infill)
        density, shrink, soft = self.density, self.anisotropy, self.E_soft
        above, low = (shrink > 0.0, "(0") if self.is_log else (shrink >= 0.0, "[0")
        share = "in (0, 1]: the share of solid, 0.2 for 20 %"
        at_least = self.E_stiff, self.E_stiff >= soft, "finite and at least E_soft [Pa]"
        for name, values, fine, expected in (
            ("density", density, (density > 0.0) & (density <= 1.0), share),
            (self.setting, shrink, above & (shrink <= 1.0), f"in {low}, 1]"),
            ("E_soft", soft, soft > 0.0, "positive [Pa]"),
            ("E_stiff", *at_least),
        ):
            bad = np.flatnonzero(~(fine & np.isfinite(values)))
            if bad.size:
                raise ValueError(
                    f"foam table, sample {bad[0] + 1}: {name} must be {expected}, got "
                    f"{values[bad[0]]:g}."
                )
        for level in np.unique(shrink):
            densities = density[shrink == level]
            if len(np.unique(densities)) < max(len(densities), 2):
                raise ValueError(
                    f"foam table: at {self.setting} {level:g} it has the densities "
                    f"{', '.join(f'{d:g}' for d in densities)}; expected two or more, "
                    "each once, since moduli are interpolated between them."
                )

    @property
    def setting(self) -> str:
        """What the anisotropy is called for this infill."""
        return "shrink" if self.is_log else "iso"

    @property
    def axis(self) -> Literal["soft", "stiff"]:
        """Which modulus holds along the single axis; the other holds across it."""
        return "soft" if self.is_log else "stiff"

    @property
    def is_log(self) -> bool:
        """Whether the setting is interpolated by its logarithm."""
        return self.infill == "Polyfoam"

    def moduli(self, density: Numbers, anisotropy: Numbers) -> Pairs:
        """Interpolate E_soft and E_stiff [Pa].

        Outside the table, curves of the density are extended; the nearest level counts.
        """
        patch, values = _Patch(self), np.log(anisotropy) if self.is_log else anisotropy
        s = np.interp(values, patch.levels, np.arange(len(patch.levels)))
        low, high = (patch.at(np.full_like(s, t), s)[:, 0] for t in (0.0, 1.0))
        t = (np.log(density) - low) / (high - low)
        return np.exp(patch.at(t, s)[:, 1:])

    def outline(self) -> Pairs:
        """Return ln E_soft and ln E_stiff along the edge of what the table reaches."""
        patch = _Patch(self)
        t = np.linspace(0.0, 1.0, _T_STEPS + 1)
        s = np.linspace(0.0, patch.last, _S_STEPS * int(patch.last) + 1)
        level = np.full_like
        sides = [
            (t, level(t, 0.0)),
            (level(s, 1.0), s),
            (t[::-1], level(t, patch.last)),
            (level(s, 0.0), s[::-1]),
        ]
        return np.concatenate([patch.at(*side)[:-1, 1:] for side in sides])

    def find(self, E_soft: Numbers, E_stiff: Numbers) -> FoundFoam:
        """Find the foams whose moduli [Pa] are nearest, in the logarithms of both.

        The nearest of many samples starts a Gauss-Newton search within the table, so
        that every value has an answer; its `error` says how far that is off.
        """
        # Each pair once: fields have few values per tet. Complex numbers sort as pairs.
        pairs, index = np.unique(E_soft + 1j * E_stiff, return_inverse=True)
        asked = np.log(np.stack([pairs.real, pairs.imag], axis=1))
        anisotropy, nearest = _Patch(self).nearest(asked)
        error = np.abs(nearest[:, 1:] - asked).max(axis=1)
        density, *moduli = np.exp(nearest).T
        values = (density, anisotropy, *moduli, error)
        return FoundFoam(*(each[index] for each in values))


TPU = 12e6
"""Young's modulus of the printed solid of the published tables [Pa]."""

# As in the authors' published scenes: the relative density, and Ex, Ey and Ez over E of
# the solid, with x the soft axis; for the isotropic foam the mean modulus.
_STRETCHED = np.array(
    [
        (0.0918, 0.00719095, 0.0677105, 0.0618133),
        (0.1798, 0.00823011, 0.1462979, 0.1372145),
        (0.2639, 0.00943911, 0.2214149, 0.2104164),
        (0.3422, 0.01094113, 0.2942527, 0.2842800),
    ]
)
_ISOTROPIC = np.array(
    [(0.0901, 0.0247), (0.1534, 0.0436), (0.2323, 0.0738), (0.3297, 0.1244)]
)


def published_foam(solid_modulus: float = TPU) -> FoamTable:
    """Return the published table of Polyfoam: a soft axis, or isotropic.

    F. Vanneste et al., "Anisotropic soft robots based on 3D printed meso-structured
    materials", IEEE RA-L 5 (2020), doi 10.1109/LRA.2020.2969926. E_stiff is the
    mean of both moduli across the soft axis, which differ by 3 to 9 %. The table names
    no shrink of its anisotropic foam: it is taken to be 0.2, as in a published script
    of the robot that was printed of it. Between this and the isotropic foam there are
    no published values, so moduli there are only interpolated; and relative density is
    taken for the infill percentage.

    Moduli of a foam are proportional to that of the solid [Pa], by default that of the
    published TPU.

    Raises:
        ValueError: If the modulus is not positive and finite.
    """
    if not (np.isfinite(solid_modulus) and solid_modulus > 0.0):
        raise ValueError(
            "the modulus of the solid must be positive and finite [Pa], got "
            f"{solid_modulus:g}; 12 MPa is that of the published TPU."
        )
    density, soft, *stiff = _STRETCHED.T
    dense, isotropic = _ISOTROPIC.T
    shrink = np.repeat([0.2, 1.0], [len(_STRETCHED), len(_ISOTROPIC)])
    return FoamTable(
        "Polyfoam",
        np.concatenate([density, dense]),
        shrink,
        solid_modulus * np.concatenate([soft, isotropic]),
        solid_modulus * np.concatenate([np.mean(stiff, axis=0), isotropic]),
        "homogenised Polyfoam of TPU, Vanneste et al., IEEE RA-L 2020",
    )


class _Patch:
    """A foam table as a map from two coordinates to ln density and ln moduli.

    The coordinate s counts the levels of equal anisotropy: 0 at the first level, 0.5
    halfway to the second. The coordinate t runs from the smallest density of the level
    (0) to its largest (1).
    """

    def __init__(self, table: FoamTable):
        """Fit a curve to each level."""
        # Imported here, so that other commands do not wait for it.
        from scipy.interpolate import PchipInterpolator

        self.is_log, values = table.is_log, np.unique(table.anisotropy)
        self.levels = np.log(values) if self.is_log else values
        self.last = len(values) - 1.0  # the largest s
        self.ends, self.curves = [], []
        moduli = np.stack([table.E_soft, table.E_stiff], axis=1)
        for value in values:
            samples = np.flatnonzero(table.anisotropy == value)
            samples = samples[np.argsort(table.density[samples])]
            x = np.log(table.density[samples])
            self.ends.append((x[0], x[-1]))
            self.curves.append(PchipInterpolator(x, np.log(moduli[samples])))

    def at(self, t: Numbers, s: Numbers) -> Float[HostArray, "n 3"]:
        """Return ln density, ln E_soft and ln E_stiff."""
        mixed, s = np.zeros((len(t), 3)), np.clip(s, 0.0, self.last)
        levels = zip(self.ends, self.curves, strict=True)
        for level, ((low, high), curve) in enumerate(levels):
            weight = np.maximum(1.0 - np.abs(s - level), 0.0)
            near = np.flatnonzero(weight)
            x = low + t[near] * (high - low)
            mixed[near] += weight[near, None] * np.column_stack([x, curve(x)])
        return mixed

    def nearest(self, asked: Pairs) -> tuple[Numbers, Float[HostArray, "n 3"]]:
        """Return anisotropy and `at` where ln E_soft and ln E_stiff are nearest."""
        t = np.linspace(0.0, 1.0, _T_STEPS + 1)
        s = np.linspace(0.0, self.last, _S_STEPS * int(self.last) + 1)
        grid = np.stack(np.meshgrid(t, s, indexing="ij"), axis=-1).reshape(-1, 2)
        tree = KDTree(self.at(*grid.T)[:, 1:])
        x = _refined(self, asked, grid[tree.query(asked)[1]])
        levels = np.interp(x[:, 1], np.arange(len(self.levels)), self.levels)
        return np.exp(levels) if self.is_log else levels, self.at(*x.T)


def _refined(patch: _Patch, asked: Pairs, x: Pairs) -> Pairs:
    """Move points (t, s) until their moduli are nearest, by Gauss-Newton in the box."""
    x, active = x.copy(), np.arange(len(x))
    for _ in range(20):
        moved = _moved(patch, asked[active], x[active])
        gone = np.abs(moved - x[active]).max(axis=1)
        x[active] = moved
        # After so small a step, a quadratic iteration is at rounding.
        active = active[gone > 1e-9]
        if not active.size:
            break
    return x


def _moved(patch: _Patch, asked: Pairs, x: Pairs) -> Pairs:
    """Take the longest part of each Gauss-Newton step that brings the moduli nearer."""
    upper, log_moduli = np.array([1.0, patch.last]), patch.at(*x.T)[:, 1:]
    # Differences towards the inside, so that they never leave the patch.
    h = np.where(x < 0.5 * upper, 1e-6, -1e-6)
    beside = [patch.at(*(x + h * axis).T)[:, 1:] - log_moduli for axis in np.eye(2)]
    J, r = np.stack(beside, axis=-1) / h[:, None], log_moduli - asked
    slope = np.einsum("nij,ni->nj", J, r)
    # A coordinate that the slope presses against its bound takes no part in the step.
    free = ((x > 0.0) | (slope < 0.0)) & ((x < upper) | (slope > 0.0))
    step = -np.einsum("nij,nj->ni", np.linalg.pinv(J * free[:, None]), r)
    moved = x.copy()
    for length in (0.01, 0.1, 0.5, 1.0):
        trial = np.clip(x + length * step, 0.0, upper)
        off = patch.at(*trial.T)[:, 1:] - asked
        better = (off**2).sum(axis=1) < (r**2).sum(axis=1)
        moved[better] = trial[better]
    return moved


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


_UNITS = {"kPa": 1e3, "Pa": 1.0, "MPa": 1e6}


def foam_table(infill: Infill, path: str | os.PathLike[str] | None = None) -> FoamTable:
    """Return the foam table in a file, or the published one of the infill.

    Raises:
        ValueError: If none is published, or the file is no such table.
    """
    if path is not None:
        return read_foam_table(path, infill)
    if infill == "Phasor":
        raise ValueError(
            "no moduli of Phasor are published: give a table of your own, from test "
            "prints, with the columns density, iso, E_soft_kPa and E_stiff_kPa "
            "(table=, --table)."
        )
    return published_foam()


def read_foam_table(path: str | os.PathLike[str], infill: Infill) -> FoamTable:
    """Read a foam table of the user, from own tests or homogenisation.

    The file has one line per sample and the columns `density` (share of solid, 0.2 for
    20 %), `shrink` for Polyfoam or `iso` for Phasor (from 0 to 1, where 1 is
    isotropic), `E_soft_kPa` and `E_stiff_kPa` (or `_Pa`, `_MPa`). At each shrink or iso
    there must be two densities or more. `write_foam_table` writes one to start from.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such table; the text says what is wrong where.
    """
    path = Path(path)
    table = read_table(path, "density")
    known = (unit for unit in _UNITS if f"E_soft_{unit}" in table.header)
    unit = next(known, "kPa")
    setting = "iso" if infill == "Phasor" else "shrink"
    columns = ["density", setting, f"E_soft_{unit}", f"E_stiff_{unit}"]
    density, anisotropy, soft, stiff = table.numbers(columns).T
    moduli = _UNITS[unit] * soft, _UNITS[unit] * stiff
    try:
        return FoamTable(infill, density, anisotropy, *moduli, source=path.name)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_foam_table(path: Path, table: FoamTable) -> None:
    """Write a foam table as `read_foam_table` reads it, in kPa."""
    moduli = 1e-3 * table.E_soft, 1e-3 * table.E_stiff
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["density", table.setting, "E_soft_kPa", "E_stiff_kPa"])
        for row in zip(table.density, table.anisotropy, *moduli, strict=True):
            writer.writerow([f"{value:.9g}" for value in row])
