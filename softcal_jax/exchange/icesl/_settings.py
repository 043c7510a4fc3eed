"""Settings of the slicer for the material in each voxel, and what they cannot give."""

from typing import Literal, NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.designs import FoamTable, FoundFoam
from softcal_jax.exchange.icesl._fields import N_VOXELS, Samples

RTOL = 0.01  # largest relative error of a modulus that counts as reached [-]
_STEPS = 255  # steps of a texture, which has 8 bits

_FLAT = np.deg2rad(0.5 * 360.0 / _STEPS)
"""Angle between fibre and print plane that a texture could not show [rad]."""


class Convention(NamedTuple):
    """Which axis an angle of the slicer marks, its offset [rad], and its sense."""

    marks: Literal["soft", "stiff"]
    offset: float = 0.0
    clockwise: bool = False


class SlicerSetting(NamedTuple):
    """A constant in its unit, or a texture by voxel in steps of 1/255 of `full`."""

    name: str
    full: float
    constant: float | None = None
    texture: Int[HostArray, "n n n"] | None = None

    def values(self, voxels: Int[HostArray, "m 3"]) -> Float[HostArray, " m"]:
        """Return what the slicer is given in some voxels [-], as a share of `full`."""
        if self.texture is None:
            assert self.constant is not None
            return np.full(len(voxels), self.constant / self.full)
        return self.texture[tuple(voxels.T)] / _STEPS


class Chosen(NamedTuple):
    """The foam for each sample as the table has it, and what the slicer is given.

    Samples that the foam misses are `beyond` the table, `tilted` or `across`, see
    `IceslResult`. `rounding` is the largest relative error of a modulus by the 8 bits
    of a texture, where the foam reaches what was asked for [-]. `seams` are pairs of
    neighbouring voxels between which the angle jumps by half a turn, though the axis
    does not: IceSL interpolates there the wrong way round.
    """

    settings: tuple[SlicerSetting, ...]
    foam: FoundFoam
    beyond: Bool[HostArray, " n"]
    tilted: Bool[HostArray, " n"]
    across: Bool[HostArray, " n"]
    rounding: float
    seams: int

    @property
    def unreachable(self) -> Bool[HostArray, " n"]:
        """Samples that will not have the material that was asked for."""
        return self.beyond | self.tilted | self.across


def choose(samples: Samples, table: FoamTable, convention: Convention) -> Chosen:
    """Choose density, anisotropy and angles for each sample."""
    stiff_fibre = samples.E_l > samples.E_t
    low = np.minimum(samples.E_t, samples.E_l)
    high = np.maximum(samples.E_t, samples.E_l)
    foam = table.find(low, high)
    isotropic = np.log(high / low) < RTOL

    fibre = samples.fibre
    if fibre is None:
        fibre = np.tile([1.0, 0.0, 0.0], (len(low), 1))
    fibre = np.where(fibre[:, 2:] < 0.0, -fibre, fibre)
    azimuth = np.arctan2(fibre[:, 1], fibre[:, 0])
    elevation = np.arcsin(np.clip(fibre[:, 2], 0.0, 1.0))
    # The foam's single axis is the fibre if it is of the same kind. Otherwise the foam
    # is turned: in the print plane it has the same moduli along and across the fibre.
    turned = stiff_fibre != (table.axis == "stiff")
    leaves = table.infill == "Phasor" and convention.marks == table.axis
    tilted = ~isotropic & (elevation > _FLAT) & (turned | (not leaves))
    marked = azimuth + np.where(turned, 0.5 * np.pi, 0.0)
    if convention.marks != table.axis:
        marked = marked + 0.5 * np.pi
    # Marked counter-clockwise from the bed's x so far.
    angle = (-marked if convention.clockwise else marked) + convention.offset

    angle, seams = _unwound(angle, samples.voxels)
    polyfoam, turn = table.infill == "Polyfoam", 2.0 * np.pi
    shares = {"infill_percentage": (100.0, foam.density)}
    if polyfoam:
        shares["infill_angle"] = (360.0, angle / turn)
        shares["kgon_x_shrink"] = (1.0, foam.anisotropy)
    else:
        inclination = np.where(turned | (not leaves), 0.0, elevation)
        shares["phasor_infill_theta"] = (360.0, angle / turn)
        shares["phasor_infill_phi"] = (360.0, inclination / turn)
        shares["phasor_infill_iso"] = (100.0, foam.anisotropy)
    sample_of, settings = _nearest_samples(samples), []
    for name, (full, values) in shares.items():
        if np.ptp(values) < 1e-4:  # far below a step
            middle = 0.5 * (values.min() + values.max())
            setting = SlicerSetting(name, full, constant=float(full * middle))
        else:
            steps = np.rint(_STEPS * np.clip(values, 0.0, 1.0)).astype(np.int64)
            setting = SlicerSetting(name, full, texture=steps[sample_of])
        settings.append(setting)
    beyond, across = foam.error > RTOL, turned & ~isotropic
    rounding = _rounding(samples, table, foam, settings, ~beyond)
    return Chosen(tuple(settings), foam, beyond, tilted, across, rounding, seams)


def _rounding(
    samples: Samples,
    table: FoamTable,
    foam: FoundFoam,
    settings: list[SlicerSetting],
    reached: Bool[HostArray, " n"],
) -> float:
    """Find the largest relative error of the moduli that the textures stand for."""
    if not reached.any():
        return 0.0
    density, anisotropy = (settings[k].values(samples.voxels)[reached] for k in (0, -1))
    # A zero would be no foam: the lowest density of a table may be below one step.
    density = np.maximum(density, 0.5 / _STEPS)
    if table.infill == "Polyfoam":
        anisotropy = np.maximum(anisotropy, 0.5 / _STEPS)
    given = table.moduli(density, anisotropy)
    exact = np.stack([foam.E_soft, foam.E_stiff], axis=1)[reached]
    return float(np.abs(given / exact - 1.0).max())


def _nearest_samples(samples: Samples) -> Int[HostArray, "n n n"]:
    """Return the sample of each voxel; outside of the part that of the nearest one.

    IceSL interpolates between voxels, so that a voxel beyond the surface counts too.
    """
    # Imported here, so that other commands do not wait for it.
    from scipy.ndimage import distance_transform_edt

    index = np.full((N_VOXELS,) * 3, -1)
    index[tuple(samples.voxels.T)] = np.arange(len(samples.voxels))
    options = {"return_distances": False, "return_indices": True}
    nearest = distance_transform_edt(index < 0, samples.grid.size, **options)
    return index[tuple(np.asarray(nearest))]


def _unwound(
    angle: Float[HostArray, " n"], voxels: Int[HostArray, "n 3"]
) -> tuple[Float[HostArray, " n"], int]:
    """Choose angles of axes, which are the same again after half a turn [rad].

    Those in [cut, cut + 180 degrees) are taken, with the cut where seams, see `Chosen`,
    are fewest; also returns the number of seams.
    """
    half = np.mod(angle, np.pi)
    degrees = np.full((N_VOXELS,) * 3, -1)
    degrees[tuple(voxels.T)] = np.minimum(np.rad2deg(half), 179.0).astype(int)
    straddling = _straddling(degrees)
    cut = np.deg2rad(np.argmin(straddling))
    return cut + np.mod(half - cut, np.pi), int(straddling.min())


def _straddling(degrees: Int[HostArray, "n n n"]) -> Int[HostArray, "180"]:
    """Count the pairs of neighbours between which lies a cut at 0, 1, ..., 179 degrees.

    Angles are of axes, in whole degrees from 0 to 179; -1 where no voxel is.
    """
    change = np.zeros(360, int)
    for axis in range(3):
        before, after = (np.delete(degrees, end, axis=axis).ravel() for end in (-1, 0))
        known = (before >= 0) & (after >= 0)
        before, after = before[known], after[known]
        turn = np.mod(after - before + 90, 180) - 90  # the shorter way
        first = np.where(turn >= 0, before, after)
        np.add.at(change, first + 1, 1)
        np.add.at(change, first + np.abs(turn) + 1, -1)
    return np.cumsum(change).reshape(2, 180).sum(axis=0)
