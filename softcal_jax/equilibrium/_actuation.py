"""Actuators in equilibrium: their forces, and imposed displacements.

The forces on the nodes are F_a^T lambda_a. Where delta_a is imposed, lambda_a is an
unknown of the bordered system

    [ K  -F_a^T ] [ dx        ]   [ -g                   ]
    [ H_a   0   ] [ dlambda_a ] = [ delta_a imposed - delta_a ]

with H_a = d delta_a / dx. Eliminating dx leaves the compliance W_aa = H_a K^-1 F_a^T,
which needs no second factorization. Where the actuators have a potential,
-sum_a lambda_a delta_a (Eq. 1 of the paper), F_a equals H_a.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.actuators import (
    actuator_rows,
    curvature_entries,
    displacement_rows,
)
from softcal_jax.configurations import ActuationArrays
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._sparsity import element_entries


def positions(model: Model, u: Float[Array, "n_points 3"]):
    """Return the positions of all nodes [m]."""
    return jnp.asarray(model.mechanism.points) + u


def displacements(model: Model, u: Float[Array, "n_points 3"]) -> Float[Array, " n_a"]:
    """Return the displacements delta_a of the actuators."""
    return model.mechanism.displacements(positions(model, u))


def force_rows(
    model: Model, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_a n_points 3"]:
    """Return F_a by rows: forces of each actuator on all nodes for lambda_a = 1."""
    return actuator_rows(model.mechanism.actuators, positions(model, u))


def own_displacement_rows(
    model: Model, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_m n_points 3"] | None:
    """Return H_a by rows for the actuators `with_multiplier`; None if it equals F_a."""
    actuators = model.mechanism.actuators
    if not any(actuators.has_friction):
        return None
    return displacement_rows(actuators, positions(model, u))[with_multiplier(model)]


def with_multiplier(model: Model) -> Int[HostArray, " n_m"]:
    """Return the indices of the actuators whose lambda_a may be an unknown.

    Motors are left out: an imposed angle holds the body itself.
    """
    actuators = model.mechanism.actuators
    motor = np.array(actuators.motor_body) >= 0
    return np.flatnonzero(actuators.has_displacement & ~motor)


def by_multiplier(model: Model, actuation: ActuationArrays) -> Bool[Array, " n_a"]:
    """Flag the actuators with an imposed displacement, whose lambda_a is unknown."""
    may_be = np.isin(np.arange(model.mechanism.n_actuators), with_multiplier(model))
    return jnp.asarray(actuation.by_displacement) & may_be


def among_all(
    model: Model, values: Float[Array, "*batch n_m"]
) -> Float[Array, "*batch n_a"]:
    """Expand values of the actuators `with_multiplier` to all, 0 elsewhere."""
    none = jnp.zeros((*values.shape[:-1], model.mechanism.n_actuators), values.dtype)
    return none.at[..., with_multiplier(model)].set(values, unique_indices=True)


def add_curvature(
    model: Model,
    values: Float[Array, " nnz"],
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"],
) -> Float[Array, " nnz"]:
    """Add the derivative of the actuators' forces, -d(F_a^T lambda_a)/dx, to a tangent.

    Args:
        model: The model.
        values: Tangent of the mesh over all nodes.
        u: Displacement [m].
        lambda_a: Forces of the actuators.
    """
    actuators = model.mechanism.actuators
    found = curvature_entries(actuators, positions(model, u), lambda_a)
    for matrices, at in zip(found, model.curvature_at, strict=True):
        p, q = element_entries(matrices.shape[1] // 3, model.pattern.symmetric)
        values = values.at[at].add(-matrices[:, p, q].T)
    return values


class Bordered(NamedTuple):
    """Solution of bordered systems that share their matrix.

    Attributes:
        x: Steps of the unknowns, one row per right-hand side [m].
        lambda_a: Changes of the forces of the actuators `with_multiplier`, 0 where the
            force is imposed.
        W_aa: Compliance of these actuators.
        n_negative: Number of negative eigenvalues of the tangent restricted to steps
            that keep the imposed displacements; -1 if the solver does not count them.
        ok: Whether the solutions exist.
    """

    x: Float[Array, "n_rhs n_dof"]
    lambda_a: Float[Array, "n_rhs n_m"]
    W_aa: Float[Array, "n_m n_m"]
    n_negative: Array
    ok: Bool[Array, ""]


class System(NamedTuple):
    """The matrix of a bordered system.

    Attributes:
        values: Tangent of the unknowns, supports masked.
        F_a: Forces of the actuators `with_multiplier` on the unknowns, by rows, zero on
            held ones.
        active: Which of these actuators have an imposed displacement that acts.
        H_own: H_a of these actuators; None if it equals F_a.
    """

    values: Float[Array, " nnz_reduced"]
    F_a: Float[Array, "n_m n_dof"]
    active: Bool[Array, " n_m"]
    H_own: Float[Array, "n_m n_dof"] | None = None

    @property
    def H_a(self) -> Float[Array, "n_m n_dof"]:
        """Derivatives of these actuators' displacements by the unknowns, by rows."""
        return self.F_a if self.H_own is None else self.H_own

    def solve(
        self,
        model: Model,
        force: Float[Array, "n_rhs n_dof"],
        gap: Float[Array, "n_rhs n_m"],
        *,
        transpose: bool = False,
    ) -> Bordered:
        """Solve for the steps of unknowns and multipliers.

        Args:
            model: The model.
            force: Right-hand sides, 0 on held unknowns [N].
            gap: Imposed minus current displacement of each active actuator.
            transpose: Solve with the transposed matrix: K^T, with F_a and H_a
                exchanged.
        """
        solve = jax.custom_batching.custom_vmap(partial(_solve, transpose=transpose))

        @solve.def_vmap
        def _rule(axis_size, in_batched, solver, system, force, gap):
            _, of_system, *of_rhs = in_batched
            whole = [
                a if batched else jnp.broadcast_to(a, (axis_size, *a.shape))
                for a, batched in zip((force, gap), of_rhs, strict=True)
            ]
            if any(jax.tree.leaves(of_system)):
                lanes = jax.tree.map(
                    lambda a, batched: (
                        a if batched else jnp.broadcast_to(a, (axis_size, *a.shape))
                    ),
                    system,
                    of_system,
                )
                each = lambda lane: solve(solver, lane[0], *lane[1])
                out = jax.lax.map(each, (lanes, tuple(whole)))
                return out, jax.tree.map(lambda _: True, out)
            # One matrix for all lanes: solve for the actuators' columns only once.
            flat = [a.reshape(a.shape[0] * a.shape[1], a.shape[2]) for a in whole]
            out = solve(solver, system, *flat)
            x, lambda_a = (
                new.reshape(old.shape)
                for new, old in zip((out.x, out.lambda_a), whole, strict=True)
            )
            out = out._replace(x=x, lambda_a=lambda_a)
            none: Any = jax.tree.map(lambda _: False, out)
            return out, none._replace(x=True, lambda_a=True)

        return solve(model.solver, self, force, gap)


def _solve(
    solver: AbstractLinearSolver,
    system: System,
    force: Float[Array, "n_rhs n_dof"],
    gap: Float[Array, "n_rhs n_m"],
    *,
    transpose: bool,
) -> Bordered:
    """Do the work of `System.solve`, eliminating the unknowns first."""
    n_rhs, n_m = gap.shape
    if n_m == 0:
        solved = solver.factor_solve(system.values, force, transpose=transpose)
        none = jnp.zeros((0, 0))
        return Bordered(solved.x, gap, none, solved.n_negative, solved.ok)
    F_a, H_a = system.F_a, system.H_a
    if transpose:
        F_a, H_a = H_a, F_a
    solved = solver.factor_solve(
        system.values, jnp.concatenate([force, F_a]), transpose=transpose
    )
    x, by_a = solved.x[:n_rhs], solved.x[n_rhs:]
    product = lambda A, B: jnp.sum(A[:, None] * B[None], axis=-1)
    W_aa = product(H_a, by_a)
    S = jnp.where(system.active[:, None] & system.active[None], W_aa, 0.0)
    rest = jnp.where(system.active[None], gap - product(x, H_a), 0.0)
    unit = jnp.diag(jnp.where(system.active, 0.0, 1.0))
    lambda_a = jnp.linalg.solve(S + unit, rest.T).T
    x = x + jnp.sum(lambda_a[:, :, None] * by_a[None], axis=1)
    # Inertia: In(bordered) = In(K) + In(-S). Each multiplier contributes one negative
    # eigenvalue; the rest are those of K on steps that keep delta_a.
    positive = jnp.linalg.eigvalsh(0.5 * (S + S.T) - unit) > 0.0
    count = lambda flags: jnp.sum(flags, dtype=solved.n_negative.dtype)
    constrained = solved.n_negative + count(positive) - count(system.active)
    n_negative = jnp.where(solved.n_negative < 0, -1, constrained)
    ok = solved.ok & jnp.all(jnp.isfinite(lambda_a))
    keep = lambda value: jnp.where(ok, value, 0.0)
    return Bordered(
        x=keep(x), lambda_a=keep(lambda_a), W_aa=W_aa, n_negative=n_negative, ok=ok
    )


def estimated_forces(
    F_a: Float[Array, "n_a n_dof"],
    active: Bool[Array, " n_a"],
    unbalanced: Float[Array, " n_dof"],
) -> Float[Array, " n_a"]:
    """Estimate the forces of the active actuators by least squares; 0 for the others.

    This first-order multiplier estimate is exact at equilibrium.

    Args:
        F_a: Forces of the actuators on the unknowns by rows, zero on held ones.
        active: Which actuators have a displacement imposed.
        unbalanced: Internal minus external and imposed forces, zero on held ones [N].
    """
    F = jnp.where(active[:, None], F_a, 0.0)
    normal = jnp.sum(F[:, None] * F[None], axis=-1)
    scale = jnp.maximum(jnp.diag(normal), jnp.finfo(F.dtype).tiny)
    unit = jnp.where(active, 0.0, scale)
    return jnp.linalg.solve(
        normal + jnp.diag(unit), jnp.sum(F * unbalanced[None], axis=1)
    )
