"""Material in the voxels of a slicer, the settings for it, and what they miss."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._text import check_known
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.designs import FoamTable, FoundFoam
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace
from softcal_jax.materials import AbstractLaw, split_law, youngs_moduli
from softcal_jax.mesh import Grid, TetMesh, fill

N_VOXELS = 64  # voxels along each axis of a texture; IceSL takes no other number

PrintPlane = Literal["xy", "xz", "yz"]

_BEDS: dict[PrintPlane, list[list[float]]] = {
    "xy": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "xz": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "yz": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
}
"""Rotations that lay the print plane on the bed: rows are bed x, y and z.

Both axes of the plane keep their order, so angles count the same way on the bed.
"""

_SPECK = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
"""A tet around the origin [-]."""


class Design(NamedTuple):
    """A field of moduli that is printed.

    Attributes:
        model: The model at rest, with its parameters set.
        space: Its parameters: fields with control points are evaluated at the voxels.
        z: Scaled values of the parameters [-].
        title: First line of the script.
    """

    model: Model
    space: ParameterSpace | None = None
    z: Float[Array, " n_p"] | None = None
    title: str = "robot"


class PrintedPart(NamedTuple):
    """A body, or a region of it, as it lies on the bed, in the corner of the axes [m].

    The mesh has linear tets if all edges are straight; `tets` are their indices in the
    model. `rotation` and then `shift` [m] lead from the frame of the model to the bed.
    """

    mesh: TetMesh
    tets: Int[HostArray, " n_part"]
    rotation: Float[HostArray, "3 3"]
    shift: Float[HostArray, "3"]


def part_on_bed(mesh: TetMesh, *, plane: PrintPlane, region: str | None) -> PrintedPart:
    """Lay a body, or one tet group of it, on the bed."""
    check_known("print plane", _BEDS, plane)
    tets = np.arange(mesh.n_tets)
    if region is not None:
        tets = np.asarray(mesh.tets_of(region))
    nodes = mesh.tets[tets]
    rotation = np.array(_BEDS[plane], float)
    used, index = np.unique(nodes, return_inverse=True)
    points = mesh.points[used] @ rotation.T
    shift = -points.min(axis=0)
    X, cells = points + shift, index.reshape(nodes.shape)
    # If every mid node is the middle of its edge, the corners are enough.
    middle = X[cells][:, np.array(TET_EDGES)].mean(axis=2)[:, : nodes.shape[1] - 4]
    if np.allclose(X[cells[:, 4:]], middle, rtol=0.0, atol=1e-9 * mesh.size):
        corners, index = np.unique(cells[:, :4], return_inverse=True)
        X, cells = X[corners], index.reshape(-1, 4)
    return PrintedPart(TetMesh(X, cells), tets, rotation, shift)


class Samples(NamedTuple):
    """The voxels that a part fills, wholly or in part, and the material in them.

    A place, in the frame of the model, is the centre of its voxel, or another point of
    it if the centre lies outside of the part [m]. Moduli are across and along the fibre
    [Pa]. The fibre is a unit vector on the bed, or None for an isotropic law.
    """

    grid: Grid
    voxels: Int[HostArray, "n 3"]
    places: Float[HostArray, "n 3"]
    E_t: Float[HostArray, " n"]
    E_l: Float[HostArray, " n"]
    fibre: Float[HostArray, "n 3"] | None


def sample(design: Design, part: PrintedPart) -> Samples:
    """Take moduli and fibre of a model at the centres of the voxels that a part fills.

    Fields with control points are evaluated there; others have the value of the tet.
    """
    grid = Grid.around(part.mesh.points, N_VOXELS)
    filled = fill(part.mesh, grid)
    places = (filled.places - part.shift) @ part.rotation
    law = _law_at(design, places, part.tets[filled.tets])
    E_t, E_l, fibre = _axis_moduli(law, len(places))
    if fibre is not None:
        fibre = fibre @ part.rotation.T
    return Samples(grid, filled.voxels, places, E_t, E_l, fibre)


def _law_at(
    design: Design, places: Float[HostArray, "n 3"], tets: Int[HostArray, " n"]
) -> AbstractLaw:
    """Return the law with one value per place, as if each were a tet of its own."""
    model, mesh, n = design.model, design.model.mesh, len(places)
    groups = {name: np.asarray(group) for name, group in mesh.tet_groups.items()}
    # Also one place of each group, as parameters name groups, which must not be empty.
    extra = np.array([group[0] for group in groups.values()], int)
    tets = np.concatenate([tets, extra])
    places = np.concatenate([places, mesh.centroids[extra]])
    corners = places[:, None] + 1e-6 * mesh.size * _SPECK
    specks = TetMesh(
        corners.reshape(-1, 3),
        np.arange(4 * len(places)).reshape(-1, 4),
        tet_groups={
            name: np.flatnonzero(np.isin(tets, group)) for name, group in groups.items()
        },
    )

    law, density = _rows_of(model.law, tets), model.density
    if jnp.ndim(density):
        density = jnp.asarray(np.asarray(density)[tets])
    sampled = eqx.tree_at(
        lambda m: (m.mesh, m.law, m.density), model, (specks, law, density)
    )
    if design.space is not None and design.z is not None:
        sampled = design.space.model_at(sampled, design.z)
    return _rows_of(sampled.law, slice(n))


def _rows_of(law: AbstractLaw, rows: Any) -> AbstractLaw:
    """Take some tets of a law, on the host, where no number of them compiles a program.

    Values that are the same in all tets stay.
    """
    of_tets, shared = split_law(law)
    chosen = lambda leaf: jnp.asarray(np.asarray(leaf)[rows] if np.ndim(leaf) else leaf)
    return eqx.combine(jax.tree.map(chosen, of_tets), shared)


def _axis_moduli(
    law: AbstractLaw, n: int
) -> tuple[
    Float[HostArray, " n"], Float[HostArray, " n"], Float[HostArray, "n 3"] | None
]:
    """Return E_t and E_l [Pa] and the fibre of a law with one value per place."""
    each = lambda value: np.broadcast_to(np.asarray(value, float), (n,))
    moduli, fibres = [each(value) for _, value in youngs_moduli(law)], law.fibres()
    if len(moduli) == 2 and len(fibres) == 1:
        fibre = np.asarray(fibres[0].direction(), float)
        along = np.broadcast_to(fibre.reshape(3, -1).T, (n, 3))
        return moduli[1], moduli[0], along
    if len(moduli) == 1 and not fibres:
        return moduli[0], moduli[0], None
    raise ValueError(
        f"the law {type(law).__name__} has neither Young's moduli E_t and E_l about a "
        "fibre nor one E, so no foam can be chosen for it: calibrate a transversely "
        "isotropic law, like Corotational(ReducedTransverseIsotropic(...))."
    )


def print_plane(model: Model) -> PrintPlane:
    """Return the plane in which the fibre's angle is counted; "xy" without a fibre."""
    base = getattr(model.law, "elasticity", model.law)
    fibre = getattr(base, "fibre", None)
    return "xy" if fibre is None or fibre.frame is not None else fibre.plane


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
