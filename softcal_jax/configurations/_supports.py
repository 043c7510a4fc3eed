"""Supports: where and how the body is held."""

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.configurations._values import parse_axes, three_numbers
from softcal_jax.mesh import TetMesh, node_indices, surface_shares


class Support(Module):
    """Nodes held, or moved by a given displacement, along some axes.

    Attributes:
        where: Name of a node or surface group, or node indices.
        axes: The held axes: "xyz" clamps, "z" lets the nodes slide in x and y.
        displacement: Imposed displacement of the held axes [m].
        stiffness: Stiffness of an elastic support on a surface group, like a rubber
            clamp: force per area and displacement [N/m3]. Rigid by default.
    """

    where: str | Int[HostArray, " n"]
    axes: str = "xyz"
    displacement: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stiffness: float | None = None

    @property
    def name(self) -> str:
        """Name of its group; "support" where it has none."""
        return self.where if isinstance(self.where, str) else "support"

    def __check_init__(self):
        parse_axes(self.axes)
        three_numbers("displacement", "m", self.displacement)
        if self.stiffness is None:
            return
        if not (np.isfinite(self.stiffness) and self.stiffness > 0.0):
            raise ValueError(
                f"stiffness of the support {self.name!r} must be positive and finite "
                f"[N/m3], got {self.stiffness!r}; leave it out for a rigid support."
            )
        if not isinstance(self.where, str):
            raise ValueError(
                "a support with a stiffness needs the name of a surface group, whose "
                "area it acts on; got node indices."
            )

    def apply(
        self,
        mesh: TetMesh,
        fixed: Bool[HostArray, "n_nodes 3"],
        imposed: Float[HostArray, "n_nodes 3"],
    ) -> None:
        """Write the support into the masks of a configuration."""
        nodes = node_indices(mesh, self.where, "a support")
        for axis in parse_axes(self.axes):
            other = imposed[nodes, axis] != self.displacement[axis]
            clash = fixed[nodes, axis] & other
            if np.any(clash):
                raise ValueError(
                    f"node {nodes[clash][0]} is held twice along "
                    f"{'xyz'[axis]} with different displacements."
                )
            fixed[nodes, axis] = True
            imposed[nodes, axis] = self.displacement[axis]

    def areas(self, mesh: TetMesh) -> Float[HostArray, "n_nodes 3"]:
        """Compute the area of each node of an elastic support, along its axes [m2]."""
        areas = np.zeros((mesh.n_nodes, 3))
        shares = surface_shares(mesh, mesh.faces(str(self.where)))
        areas[:, parse_axes(self.axes)] = shares[:, None]
        return areas
