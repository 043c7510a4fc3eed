"""The linear system at a known equilibrium, and what is out of balance there."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import tangent_values
from softcal_jax.equilibrium._balance import (
    actuator_loads,
    bordered_system,
    deform,
    estimated_forces,
    taut,
    unbalanced,
)
from softcal_jax.equilibrium._linear_solver import LinearSolution
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import Sparsity, mask_supports, product


def residual(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"] | None = None,
) -> Float[Array, "n_points 3"]:
    """Out-of-balance force f - f_ext - F_a^T lambda_a on all nodes [N]; Eq. (1).

    Zero on free coordinates at equilibrium; on held ones it is the reaction, the force
    of the support on the body. Summed over a rigid body it is zero, or what holds it.

    Args:
        model: The model.
        configuration: One configuration.
        u: Displacement [m].
        lambda_a: Forces of the actuators whose displacement is imposed; found from the
            balance by default, which holds at equilibrium.
    """
    posed, at = Posed.of(model, configuration), deform(model, u)
    if lambda_a is None:
        lambda_a = estimated_forces(posed, at)
    return unbalanced(posed, at, lambda_a)[0]


def solved_forces(
    model: Model, configuration: ConfigurationArrays, u: Float[Array, "n_points 3"]
) -> Float[Array, " n_a"]:
    """Forces of actuators whose displacement is imposed, at an equilibrium."""
    return estimated_forces(Posed.of(model, configuration), deform(model, u))


class Linearisation(NamedTuple):
    """The bordered system at an equilibrium.

    Attributes:
        posed: The configuration at full load.
        system: The matrix.
        full: Tangent over all nodes, the actuators' forces included.
        pattern: Its pattern.
    """

    posed: Posed
    system: actuation.System
    full: Float[Array, " nnz"]
    pattern: Sparsity

    def free(self, u, forces):
        """Forces on the free unknowns, 0 on the others [N]."""
        return self.posed.on_free(u, forces)

    def stiffness(self, du):
        """Change of the forces on all nodes in a small displacement [N]."""
        return product(self.pattern, self.full, du.ravel()).reshape(du.shape)


def linearise(
    model: Model, configuration: ConfigurationArrays, u: Float[Array, "n_points 3"]
) -> Linearisation:
    """Tangent and actuator rows at an equilibrium displacement."""
    posed, at = Posed.of(model, configuration), deform(model, u)
    lambda_a = jnp.zeros_like(at.delta_a)
    if actuation.with_multiplier(model).size > 0:
        lambda_a = estimated_forces(posed, at)
    g, rows = unbalanced(posed, at, lambda_a)
    full = actuation.add_curvature(
        posed.model, tangent_values(model, u), u, actuator_loads(posed, lambda_a)
    )
    reduced = posed.reduce(u, full, g)
    masked, _ = mask_supports(model.solver.sparsity, reduced, posed.fixed())
    system, _ = bordered_system(
        posed, u, values=masked, forces=rows, active=taut(posed, at)
    )
    return Linearisation(posed, system, full, model.pattern)


def factor_solve(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    rhs: Float[Array, "n_rhs n_points 3"],
    *,
    transpose: bool = False,
) -> LinearSolution:
    """Solve K(u) dx = rhs on the free unknowns, one factorization for all rows.

    Where displacements of actuators are imposed, they stay: the inverse is that of the
    bordered system, W_ep - W_ea W_aa^-1 W_ap in place of W_ep.

    Args:
        model: The model.
        configuration: Its supports decide which rows are held.
        u: Equilibrium displacement, where K is taken [m].
        rhs: Right-hand sides; entries on held nodes are ignored [N].
        transpose: Solve with K^T, which is K only for a conservative model.

    Returns:
        Displacements of all nodes, zero on held ones [m].
    """
    lin = linearise(model, configuration, u)
    forces = jax.vmap(lambda f: lin.free(u, f))(rhs)
    gap = jnp.zeros((rhs.shape[0], lin.system.active.size))
    solved = lin.system.solve(model, forces, gap, transpose=transpose)
    x = jax.vmap(lambda d: lin.posed.scatter(u, d))(solved.x)
    return LinearSolution(x, solved.n_negative, solved.ok)
