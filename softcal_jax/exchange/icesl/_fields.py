"""Moduli and fibre of a body in the voxels of a slicer, on its print bed."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._names import check_known
from softcal_jax._typing import Array, Float, HostArray, Int
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
