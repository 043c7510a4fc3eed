"""Cliques: the small sets of nodes over whose contributions an actuator sums.

A cable segment, a face of a chamber, the frame of a motor: each is one clique, and the
generic code differentiates, scales and adds them.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax

from softcal_jax._typing import Array, Float, Int


class AbstractCliques(eqx.Module):
    """All cliques of one type, and the forces on their nodes.

    The arrays hold all cliques along their first axis; the methods see one of them,
    under the `vmap` of `each_clique`.

    Attributes:
        nodes: Nodes of the cliques. None stands twice in a clique, except as padding:
            a repeated node on which the clique exerts no force.
        owner: Number of the actuator that each belongs to.
        curved: Whether the force changes with the position of the nodes.
    """

    nodes: eqx.AbstractVar[Int[Array, "*cliques m"]]
    owner: eqx.AbstractVar[Int[Array, "*cliques"]]
    curved: ClassVar[bool]

    @abstractmethod
    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""

    def curvature(self, x: Float[Array, "m 3"]) -> Float[Array, "3*m 3*m"]:
        """Derivative of the force by the positions, node by node, for lambda_a = 1."""
        return jax.jacfwd(self.row)(x).reshape(x.size, x.size)


class AbstractPotentialCliques(AbstractCliques):
    """Cliques whose force is the gradient of their part of delta_a."""

    @abstractmethod
    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        """What one clique adds to delta_a, up to a constant."""

    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""
        return jax.grad(self.contribution)(x)


def each_clique(
    method: Callable[[Any, Array], Array],
    cliques: AbstractCliques,
    x: Float[Array, "n_all 3"],
) -> Float[Array, "n_cliques ..."]:
    """A method of every clique at its own nodes' positions."""
    return jax.vmap(method)(cliques, x[cliques.nodes])
