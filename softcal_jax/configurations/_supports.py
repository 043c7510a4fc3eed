"""Where and how the body is held."""

import equinox as eqx
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.configurations._axes import parse_axes
from softcal_jax.mesh import TetMesh, node_indices


class Support(eqx.Module):
    """Nodes held, or moved by a given displacement, along some axes.

    Attributes:
        where: Name of a node or surface group, or node indices.
        axes: The held axes: "xyz" clamps, "z" lets the nodes slide in x and y.
        displacement: Imposed displacement of the held axes [m].
    """

    where: str | Int[HostArray, " n"]
    axes: str = "xyz"
    displacement: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __check_init__(self):
        parse_axes(self.axes)
        if np.shape(self.displacement) != (3,) or not np.all(
            np.isfinite(self.displacement)
        ):
            raise ValueError(
                "displacement must be three finite numbers [m], "
                f"got {self.displacement!r}."
            )

    def apply(
        self,
        mesh: TetMesh,
        fixed: Bool[HostArray, "n_nodes 3"],
        imposed: Float[HostArray, "n_nodes 3"],
    ) -> None:
        """Write the support into the masks of a configuration.

        Raises:
            ValueError: If the group or a node is unknown, or a node is given two
                displacements.
        """
        nodes = node_indices(mesh, self.where, "a support")
        for axis in parse_axes(self.axes):
            clash = fixed[nodes, axis] & (
                imposed[nodes, axis] != self.displacement[axis]
            )
            if np.any(clash):
                raise ValueError(
                    f"node {nodes[clash][0]} is held twice along "
                    f"{'xyz'[axis]} with different displacements."
                )
            fixed[nodes, axis] = True
            imposed[nodes, axis] = self.displacement[axis]
