"""Size and shape of the tets of a mesh."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._typing import HostArray, Int
from softcal_jax.elements import TET_EDGES
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import volumes


class Spread(NamedTuple):
    """Smallest, middle and largest value."""

    min: float
    median: float
    max: float


def _spread(values: HostArray) -> Spread:
    return Spread(float(values.min()), float(np.median(values)), float(values.max()))


class QualityReport(eqx.Module):
    """Size and shape of the tets; `print` shows it as a table.

    Attributes:
        n_nodes: Number of nodes.
        n_tets: Number of tets.
        order: 1 for linear tets, 2 for quadratic ones.
        volume: Volume of the body [m^3].
        edge_length: Between corners [m].
        tet_volume: Volume of a tet [m^3].
        mean_ratio: 12 (3 V)^(2/3) over the sum of squared edges [-]: 1 for the regular
            tet, 0 for a flat one, negative for an inverted one.
        min_dihedral: Smallest angle between two faces of a tet [rad]; 1.231 (70.5
            degrees) for the regular tet.
        worst_tets: The tets with the smallest mean ratio, worst first.
    """

    n_nodes: int
    n_tets: int
    order: int
    volume: float
    edge_length: Spread
    tet_volume: Spread
    mean_ratio: Spread
    min_dihedral: Spread
    worst_tets: Int[HostArray, " n_worst"]

    def __str__(self) -> str:
        degrees = Spread(*np.rad2deg(self.min_dihedral).tolist())
        rows = [
            ("edge length [mm]", Spread(*(1e3 * v for v in self.edge_length))),
            ("tet volume [mm^3]", Spread(*(1e9 * v for v in self.tet_volume))),
            ("mean ratio, 1 is best [-]", self.mean_ratio),
            ("min dihedral angle [deg]", degrees),
        ]
        kind = "linear" if self.order == 1 else "quadratic"
        lines = [
            f"{self.n_nodes} nodes, {self.n_tets} {kind} tets, "
            f"volume {1e9 * self.volume:.6g} mm^3",
            f"{'':<26}{'min':>12}{'median':>12}{'max':>12}",
        ]
        lines += [
            f"{name:<26}{s.min:>12.4g}{s.median:>12.4g}{s.max:>12.4g}"
            for name, s in rows
        ]
        lines.append("worst tets: " + ", ".join(map(str, self.worst_tets.tolist())))
        return "\n".join(lines)


def quality_report(mesh: TetMesh, *, n_worst: int = 5) -> QualityReport:
    """Measure the tets; measures of shape use the corners only.

    Args:
        mesh: The mesh, which `check_mesh` may refuse.
        n_worst: How many of the worst tets to list.

    Raises:
        ValueError: If `n_worst` is negative.
    """
    if n_worst < 0:
        raise ValueError(f"n_worst must not be negative, got {n_worst}.")
    corners = mesh.points[mesh.tets[:, :4]]
    pairs = np.array(TET_EDGES)
    squared = ((corners[:, pairs[:, 0]] - corners[:, pairs[:, 1]]) ** 2).sum(axis=-1)
    signed = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    root = np.sign(signed) * np.abs(3.0 * signed) ** (2.0 / 3.0)
    # Tets whose corners all coincide count as flat.
    total = np.maximum(squared.sum(axis=1), np.finfo(float).tiny)
    mean_ratio = 12.0 * root / total
    volume = volumes(mesh)
    edges = np.sort(mesh.tets[:, pairs].reshape(-1, 2), axis=1)
    _, once = np.unique(edges, axis=0, return_index=True)
    return QualityReport(
        n_nodes=mesh.n_nodes,
        n_tets=mesh.n_tets,
        order=mesh.order,
        volume=float(volume.sum()),
        edge_length=_spread(np.sqrt(squared.ravel()[once])),
        tet_volume=_spread(volume),
        mean_ratio=_spread(mean_ratio),
        min_dihedral=_spread(_dihedral_angles(corners).min(axis=1)),
        worst_tets=np.argsort(mean_ratio, kind="stable")[:n_worst].astype(np.int32),
    )


def _dihedral_angles(corners: HostArray) -> HostArray:
    """Compute the angles between faces at the edges, in the order of `TET_EDGES`."""
    angles = []
    for i, j in TET_EDGES:
        k, l = sorted({0, 1, 2, 3} - {i, j})
        edge = corners[:, j] - corners[:, i]
        a = np.cross(edge, corners[:, k] - corners[:, i])
        b = np.cross(edge, corners[:, l] - corners[:, i])
        # atan2 keeps small angles exact, where arccos loses half the digits.
        sine = np.linalg.norm(np.cross(a, b), axis=1)
        angles.append(np.arctan2(sine, (a * b).sum(axis=1)))
    return np.stack(angles, axis=1)
