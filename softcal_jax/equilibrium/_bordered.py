"""The bordered system of unknowns and of forces behind imposed displacements.

The actuators' forces on the nodes are F_a^T lambda_a. Where delta_a is imposed,
lambda_a is an unknown of the bordered system

    [ K  -F_a^T ] [ dx        ]   [ -g                   ]
    [ H_a   0   ] [ dlambda_a ] = [ delta_a imposed - delta_a ]

with H_a = d delta_a / dx. Eliminating dx leaves the compliance W_aa = H_a K^-1 F_a^T,
which needs no second factorization. Where the actuators have a potential,
-sum_a lambda_a delta_a (Eq. 1 of the paper), F_a equals H_a.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver

T = TypeVar("T")


class Bordered(NamedTuple):
    """Steps of unknowns [m] and of actuators' forces, one row per right-hand side.

    `n_negative` is the number of negative eigenvalues of the tangent restricted to
    steps that keep the imposed displacements; -1 if they are not counted.
    """

    x: Float[Array, "n_rhs n_dof"]
    lambda_a: Float[Array, "n_rhs n_m"]
    W_aa: Float[Array, "n_m n_m"]
    n_negative: Array
    ok: Bool[Array, ""]


class System(NamedTuple):
    """The matrix of a bordered system, with the actuators `Model.with_multiplier`.

    `values` is the tangent with supports masked; F_a is zero on held unknowns.
    `H_other` is H_a where that differs from F_a. `active`: imposed displacements act.
    """

    values: Float[Array, " nnz_reduced"]
    F_a: Float[Array, "n_m n_dof"]
    active: Bool[Array, " n_m"]
    H_other: Float[Array, "n_m n_dof"] | None = None

    @property
    def H_a(self) -> Float[Array, "n_m n_dof"]:
        return self.F_a if self.H_other is None else self.H_other

    def solve(
        self,
        solver: AbstractLinearSolver,
        force: Float[Array, "n_rhs n_dof"],
        gap: Float[Array, "n_rhs n_m"],
        *,
        transpose: bool = False,
        near: bool = False,
    ) -> Bordered:
        """Solve for steps from forces and gaps; `transpose`: K^T, F_a and H_a swapped.

        `near`: the matrix is near the last that was factorized, see `solve_near`.
        """
        how = partial(_solve, transpose=transpose, near=near)
        solve = jax.custom_batching.custom_vmap(how)

        @solve.def_vmap
        def _rule(axis_size, in_batched, solver, system, force, gap):
            _, of_system, *of_rhs = in_batched
            if any(jax.tree.leaves(of_system)):
                lanes, shared = eqx.partition(
                    (system, force, gap), tuple(in_batched[1:])
                )
                each = lambda lane: solve(solver, *eqx.combine(lane, shared))
                out = jax.lax.map(each, lanes)
                return out, jax.tree.map(lambda _: True, out)
            # One matrix for all lanes: one factorization, with all right-hand sides.
            whole = [
                a if batched else jnp.broadcast_to(a, (axis_size, *a.shape))
                for a, batched in zip((force, gap), of_rhs, strict=True)
            ]
            out = solve(solver, system, *(jax.lax.collapse(a, 0, 2) for a in whole))
            x, lambda_a = (
                new.reshape(old.shape)
                for new, old in zip((out.x, out.lambda_a), whole, strict=True)
            )
            out = out._replace(x=x, lambda_a=lambda_a)
            none: Any = jax.tree.map(lambda _: False, out)
            return out, none._replace(x=True, lambda_a=True)

        return solve(solver, self, force, gap)


def _solve(
    solver: AbstractLinearSolver,
    system: System,
    force: Float[Array, "n_rhs n_dof"],
    gap: Float[Array, "n_rhs n_m"],
    *,
    transpose: bool,
    near: bool,
) -> Bordered:
    n_rhs, n_m = gap.shape
    factor_solve = partial(solver.factor_solve, transpose=transpose)
    # Without a potential, the transposed matrix is another one.
    near = near and not (transpose and not solver.sparsity.symmetric)
    solve = solver.solve_near if near else factor_solve
    if n_m == 0:
        solved = solve(system.values, force)
        none = jnp.zeros((0, 0))
        return Bordered(solved.x, gap, none, solved.n_negative, solved.ok)
    F_a, H_a = system.F_a, system.H_a
    if transpose:
        F_a, H_a = H_a, F_a
    solved = solve(system.values, jnp.concatenate([force, F_a]))
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


def zeros_of(function: Callable[..., T], *arguments: Any) -> T:
    shapes = jax.eval_shape(function, *arguments)
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
