"""Several meshes as one, without common nodes."""

from collections.abc import Mapping

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.mesh._tet_mesh import TetMesh


def merge(parts: Mapping[str, TetMesh]) -> TetMesh:
    """Combine meshes into one; parts that touch are not joined.

    Nodes and tets come part by part, in the order of the mapping, and keep their order
    within a part. The tet group "lower" is all of the part "lower", and its groups
    become "lower/end 1", "lower/top" and so on, so laws can differ between parts.
    `check_mesh` refuses the result as disconnected: check the parts.

    Args:
        parts: Meshes of the same order by the names of the parts.

    Returns:
        The mesh of all parts.

    Raises:
        ValueError: If no part is given, a name is empty or holds a "/", or the parts
            are linear and quadratic ones.

    Example:
        Two sheets, one above the other::

            merge({"lower": tripod(y=-0.06), "upper": tripod(y=0.06)})
    """
    if not parts:
        raise ValueError("merge needs at least one part.")
    for name in parts:
        if not name or "/" in name:
            raise ValueError(
                f"a part cannot have the name {name!r}: it becomes the first half of "
                'names like "lower/end 1", so it needs letters and no "/".'
            )
    orders = {name: mesh.order for name, mesh in parts.items()}
    if len(set(orders.values())) > 1:
        listed = ", ".join(f"{name!r} {order}" for name, order in orders.items())
        raise ValueError(
            f"the parts must have the same order, got {listed}; use to_quadratic or "
            "to_linear."
        )
    meshes = list(parts.values())
    node_shift = np.cumsum([0, *(mesh.n_nodes for mesh in meshes)])
    tet_shift = np.cumsum([0, *(mesh.n_tets for mesh in meshes)])
    tets = [mesh.tets + start for mesh, start in zip(meshes, node_shift, strict=False)]
    whole = {
        name: np.arange(tet_shift[k], tet_shift[k + 1]) for k, name in enumerate(parts)
    }
    return TetMesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate(tets),
        _prefixed(parts, node_shift, "node_groups"),
        _prefixed(parts, node_shift, "surface_groups"),
        whole | _prefixed(parts, tet_shift, "tet_groups"),
    )


def _prefixed(
    parts: Mapping[str, TetMesh], shift: HostArray, kind: str
) -> dict[str, HostArray]:
    """Collect the groups of one kind of all parts, with new names and indices."""
    return {
        f"{part}/{name}": members + start
        for (part, mesh), start in zip(parts.items(), shift, strict=False)
        for name, members in getattr(mesh, kind).items()
    }
