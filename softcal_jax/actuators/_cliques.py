"""Cliques: small sets of nodes whose contributions add up to an actuator.

A cable segment, a face of a chamber, the frame of a motor: each is one clique, and
generic code differentiates, scales and adds them. Three kinds differ in how force and
displacement are related: a force alone (`AbstractCliques`), a force beside a
displacement (`AbstractFrictionalCliques`), or a force that is the gradient of the
displacement (`AbstractPotentialCliques`).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.actuators._geometry import ActuatorGeometry


class AbstractCliques(eqx.Module):
    """All cliques of one type, and the forces on their nodes.

    Arrays hold all cliques along their first axis; methods see a single clique, under
    the `vmap` of `each_clique`.

    Attributes:
        nodes: Nodes of the cliques. A node only repeats within a clique as padding, on
            which the clique exerts no force.
        owner: Index of the actuator that each belongs to.
        curved: Whether the force depends on the positions of the nodes.
    """

    nodes: eqx.AbstractVar[Int[Array, "*cliques m"]]
    owner: eqx.AbstractVar[Int[Array, "*cliques"]]
    curved: ClassVar[bool]

    @abstractmethod
    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""

    @abstractmethod
    def picture(self, x: Float[HostArray, "n_all 3"]) -> ActuatorGeometry:
        """Collect what to draw of all cliques, on the host.

        Args:
            x: Positions of the mesh's nodes and the frame nodes [m].
        """

    def curvature(self, x: Float[Array, "m 3"]) -> Float[Array, "3*m 3*m"]:
        """Differentiate the force by the positions, node by node, for lambda_a = 1."""
        return jax.jacfwd(self.row)(x).reshape(x.size, x.size)


class AbstractDisplacedCliques(AbstractCliques):
    """Cliques with a displacement, whatever their force."""

    @abstractmethod
    def contribution(self, x: Float[Array, "m 3"]) -> Float[Array, ""]:
        """Compute what one clique adds to delta_a, up to a constant."""

    def displacement_row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Differentiate `contribution` by the positions `x` of one clique's nodes."""
        return jax.grad(self.contribution)(x)


class AbstractPotentialCliques(AbstractDisplacedCliques):
    """Cliques whose force is the gradient of their part of delta_a."""

    def row(self, x: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """Force on the nodes of one clique at the positions `x`, for lambda_a = 1."""
        return self.displacement_row(x)


class AbstractFrictionalCliques(AbstractDisplacedCliques):
    """Cliques whose force differs from the gradient by friction.

    Attributes:
        friction: Coefficient of friction [-].
        sense: 1 if the actuator pulls, -1 if it is released.
    """

    friction: eqx.AbstractVar[Float[Array, "*cliques"]]
    sense: eqx.AbstractVar[Float[Array, "*cliques"]]

    def moving(
        self, releasing: Bool[Array | HostArray, " n_a"]
    ) -> "AbstractFrictionalCliques":
        """Return the cliques with their sense of motion set."""
        sense = jnp.where(jnp.asarray(releasing)[self.owner], -1.0, 1.0)
        return eqx.tree_at(lambda cliques: cliques.sense, self, sense)


def each_clique(
    method: Callable[[Any, Array], Array],
    cliques: AbstractCliques,
    x: Float[Array, "n_all 3"],
) -> Float[Array, "n_cliques ..."]:
    """Call a method of every clique with the positions of its own nodes."""
    return jax.vmap(method)(cliques, x[cliques.nodes])
