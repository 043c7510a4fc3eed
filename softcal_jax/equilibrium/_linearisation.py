"""The linear system at a known equilibrium, and what is out of balance there."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import internal_force, tangent_values
from softcal_jax.equilibrium._linear_solver import LinearSolution
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings
from softcal_jax.equilibrium._problem import (
    EquilibriumProblem,
    Point,
    external_force,
    mask_supports,
    product,
)
from softcal_jax.equilibrium._sparsity import Sparsity
from softcal_jax.equilibrium._unknowns import Unknowns


def residual(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"] | None = None,
) -> Float[Array, "n_points 3"]:
    """Out-of-balance force f - f_ext - H_a^T lambda_a on all nodes [N]; Eq. (1).

    Zero on free coordinates at equilibrium; on held ones it is the reaction, the force
    of the support on the body. Summed over a rigid body it is zero, or what holds it.

    Args:
        model: The model.
        configuration: One configuration.
        u: Displacement [m].
        lambda_a: Forces of the actuators whose displacement is imposed; found from the
            balance by default, which holds at equilibrium.
    """
    at, problem = _at(model, configuration, u)
    one = jnp.ones((), u.dtype)
    if lambda_a is None:
        lambda_a = problem.estimated_forces(at, one)
    return problem.unbalanced(at, lambda_a, one)[0]


def _at(model: Model, configuration: ConfigurationArrays, u):
    """A point without its energy, which costs as much as its force and is not asked."""
    f_ext = external_force(model, configuration)
    problem = EquilibriumProblem(model, configuration, f_ext, NewtonSettings().rtol)
    unknown = jnp.full((), jnp.nan, u.dtype)
    delta_a = actuation.displacements(model, u)
    force = internal_force(model, u)
    return Point(u, unknown, unknown, force, delta_a, unknown), problem


def solved_forces(
    model: Model, configuration: ConfigurationArrays, u: Float[Array, "n_points 3"]
) -> Float[Array, " n_a"]:
    """Forces of actuators whose displacement is imposed, at an equilibrium."""
    at, problem = _at(model, configuration, u)
    return problem.estimated_forces(at, jnp.ones((), u.dtype))


class Linearisation(NamedTuple):
    """The bordered system at an equilibrium.

    Attributes:
        unknowns: The unknowns at full load.
        system: The matrix.
        full: Tangent over all nodes, the actuators' forces included.
        pattern: Its pattern.
    """

    unknowns: Unknowns
    system: actuation.System
    full: Float[Array, " nnz"]
    pattern: Sparsity

    def free(self, u, forces):
        """Forces on the free unknowns, 0 on the others [N]."""
        gathered = self.unknowns.gather(u, forces)
        return jnp.where(self.unknowns.fixed(), 0.0, gathered)

    def stiffness(self, du):
        """Change of the forces on all nodes in a small displacement [N]."""
        return product(self.pattern, self.full, du.ravel()).reshape(du.shape)


def linearise(
    model: Model, configuration: ConfigurationArrays, u: Float[Array, "n_points 3"]
) -> Linearisation:
    """Tangent and actuator rows at an equilibrium displacement."""
    one = jnp.ones((), u.dtype)
    at, problem = _at(model, configuration, u)
    lambda_a = jnp.zeros_like(at.delta_a)
    if problem.has_multipliers:
        lambda_a = problem.estimated_forces(at, one)
    g, rows = problem.unbalanced(at, lambda_a, one)
    full = actuation.add_curvature(
        model, tangent_values(model, u), u, problem.all_forces(lambda_a, one)
    )
    unknowns = problem.unknowns(one)
    reduced = unknowns.reduce(u, full, g)
    masked, _ = mask_supports(model.solver.sparsity, reduced, unknowns.fixed())
    which = problem.with_multiplier
    H_a = problem.rows_on_unknowns(u, one, rows[which])
    system = actuation.System(masked, H_a, problem.taut(at, one)[which])
    return Linearisation(unknowns, system, full, model.pattern)


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
    x = jax.vmap(lambda d: lin.unknowns.scatter(u, d))(solved.x)
    return LinearSolution(x, solved.n_negative, solved.ok)
