"""Balance of forces of a posed model, and the bordered system that restores it.

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

from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.equilibrium._assembly import energy_and_force, internal_force
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import Nodal
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import element_entries, mask_supports

T = TypeVar("T")

_TAUT = 1e-6
"""Slack below which a cable still counts as taut, relative to the mesh size [-]."""


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
        exact: bool = False,
    ) -> Bordered:
        """Solve for steps from forces and gaps; `transpose`: K^T, F_a and H_a swapped.

        `near`: the matrix is near the last that was factorized, or may be; then `exact`
        is that of `AbstractLinearSolver.solve_near`.
        """
        how = partial(_solve, transpose=transpose, near=near, exact=exact)
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
    exact: bool,
) -> Bordered:
    n_rhs, n_m = gap.shape
    factor_solve = partial(solver.factor_solve, transpose=transpose)
    # Without a potential, the transposed matrix is another one.
    near = near and not (transpose and not solver.sparsity.symmetric)
    solve = partial(solver.solve_near, exact=exact) if near else factor_solve
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


class Point(NamedTuple):
    """A displacement u, with the internal force and the actuators' displacements at u.

    `contact` are the forces of the nodes on obstacles, beside the internal ones, and
    `friction` those of them that have no potential. The energy of the others, the sum
    of its absolute parts (the scale of its rounding) and the smallest det F are None
    where they are not needed.
    """

    u: Nodal
    force: Nodal
    contact: Nodal
    friction: Nodal | None
    delta_a: Float[Array, " n_a"]
    energy: Any = None
    energy_scale: Any = None
    min_det_F: Any = None

    @property
    def touches(self) -> Bool[Array, ""]:
        """Whether an obstacle is touched."""
        return jnp.any(self.contact != 0.0)

    @property
    def finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.energy) & jnp.all(jnp.isfinite(self.force))


def deform(posed: Posed, u: Nodal) -> Point:
    """Compute forces and actuator displacements, without the energy."""
    model, (_, contact, friction) = posed.model, posed.contact(u)
    force, delta_a = internal_force(model, u), model.displacements(u)
    return Point(u, force, contact, friction, delta_a)


def evaluate(posed: Posed, u: Nodal) -> Point:
    model, (stored, contact, friction) = posed.model, posed.contact(u)
    energy, scale, force, det = energy_and_force(model, u)
    delta_a, scale = model.displacements(u), scale + stored
    energy = energy + stored
    return Point(u, force, contact, friction, delta_a, energy, scale, det)


def at_rest(posed: Posed) -> Point:
    """Return the state before the load, with obstacles where they start."""
    mechanism, none = posed.model.mechanism, jnp.zeros((posed.model.n_points, 3))
    u, delta_a = none, jnp.zeros(mechanism.n_actuators) - mechanism.motor_zero
    if posed.contacts.n_obstacles:
        frames, start = posed.contacts.frames, posed.standing.start
        u = none.at[frames].set(start - jnp.asarray(mechanism.points)[frames])
    energy, contact, friction = posed.contact(u)
    return Point(u, none, contact, friction, delta_a, energy, energy, jnp.ones(()))


def actuator_loads(
    posed: Posed, lambda_a: Float[Array, " n_a"]
) -> Float[Array, " n_a"]:
    imposed = posed.configuration.actuation.forces
    return jnp.where(posed.by_multiplier, lambda_a, posed.load * imposed)


def unbalanced(posed: Posed, point: Point, lambda_a: Float[Array, " n_a"]):
    """Compute the out-of-balance forces g on all nodes [N], and the rows F_a."""
    x = posed.model.positions(point.u)
    rows = posed.model.mechanism.actuators.rows(x)
    forces = actuator_loads(posed, lambda_a)
    g = point.force - posed.load * posed.f_ext + posed.spring_force(point.u)
    g = g + point.contact + posed.anchor_force(point.u)
    if len(forces) > 0:
        g = g - jnp.sum(forces[:, None, None] * rows, axis=0)
    return g, rows


def rows_on_free(
    posed: Posed, u: Nodal, rows: Float[Array, "n n_points 3"]
) -> Float[Array, "n n_dof"]:
    if rows.shape[0] == 0:
        return jnp.zeros((0, posed.model.n_dof), rows.dtype)
    return jax.vmap(lambda row: posed.on_free(u, row))(rows)


def nodal_tangent(
    posed: Posed,
    u: Nodal,
    lambda_a: Float[Array, " n_a"],
    mesh: Float[Array, " nnz"],
    *,
    tamed: int | Int[Array, ""] = 0,
) -> Float[Array, " nnz"]:
    """Add actuators, springs and contact to the tangent of the mesh [N/m]."""
    model, nodal = posed.model, posed.spring_tangent(mesh)
    nodal = posed.contact_tangent(u, nodal, tamed=tamed)
    if posed.anchor is not None:
        of_mesh = model.pattern.diagonal[: 3 * model.mesh.n_nodes]
        nodal = nodal.at[of_mesh].add(posed.anchor[0])
    actuators = model.mechanism.actuators
    loads = actuator_loads(posed, lambda_a)
    # d(F_a^T lambda_a)/dx
    curvature = actuators.curvature(model.positions(u), loads)
    for matrices, places in zip(curvature, model.curvature_at, strict=True):
        p, q = element_entries(matrices.shape[1] // 3, model.pattern.symmetric)
        nodal = nodal.at[places].add(-matrices[:, p, q].T)
    return nodal


class Tangent(NamedTuple):
    """The tangent at a deformed state.

    Attributes:
        nodal: Its entries over all nodes [N/m].
        stiffness: Mean stiffness of an unknown [N/m].
        system: Tangent of the unknowns, bordered by actuators `with_multiplier`.
        H_a: Derivatives of the displacements of these actuators by nodes, by rows.
        g: Out-of-balance forces on all nodes [N].
    """

    nodal: Float[Array, " nnz"]
    stiffness: Float[Array, ""]
    system: System
    H_a: Float[Array, "n_m n_points 3"]
    g: Nodal


def assemble(
    posed: Posed,
    point: Point,
    lambda_a: Float[Array, " n_a"],
    *,
    mesh: Float[Array, " nnz"],
    active: Bool[Array, " n_a"],
    tamed: int | Int[Array, ""] = 0,
) -> Tangent:
    """Add actuators and springs to the tangent of the mesh, reduce it and border it.

    `active` flags the actuators with an imposed displacement that acts; for `tamed` see
    `Posed.contact_tangent`.
    """
    model, u = posed.model, point.u
    actuators, which = model.mechanism.actuators, model.with_multiplier
    g, rows = unbalanced(posed, point, lambda_a)
    nodal = nodal_tangent(posed, u, lambda_a, mesh, tamed=tamed)
    reduced = posed.reduce(u, nodal, g)
    values, stiffness = mask_supports(model.solver.sparsity, reduced, posed.fixed)
    H_a, H_other = rows[which], None
    if any(actuators.has_friction):
        H_a = actuators.displacement_rows(model.positions(u))[which]
        H_other = rows_on_free(posed, u, H_a)
    F_a = rows_on_free(posed, u, rows[which])
    system = System(values, F_a, active[which], H_other)
    return Tangent(nodal, stiffness, system, H_a, g)


def _wanting(posed: Posed, point: Point) -> tuple[Float[Array, " n_a"], Array]:
    wanted = posed.load * jnp.asarray(posed.configuration.actuation.value)
    unilateral = jnp.asarray(posed.model.mechanism.actuators.unilateral)
    return wanted - point.delta_a, unilateral


def gap(posed: Posed, point: Point, lambda_a, stiffness):
    """Return the gaps of imposed displacements, and which of them act.

    A slack cable has no gap; the stiffness [force per gap] tells slack from taut.
    """
    gap, unilateral = _wanting(posed, point)
    taut = lambda_a + stiffness * gap > 0.0
    active = posed.by_multiplier & (taut | ~unilateral)
    return jnp.where(active, gap, 0.0), active


def stiffness_of_gaps(
    posed: Posed, W_aa: Float[Array, "n_m n_m"]
) -> Float[Array, " n_a"]:
    """Return the force per displacement of actuators where it is imposed, 0 elsewhere.

    Slack cables count too, since a step that tightens one leaves a gap to close.
    """
    compliance = jnp.maximum(jnp.abs(jnp.diag(W_aa)), jnp.finfo(W_aa.dtype).tiny)
    stiff = posed.model.among_all(1.0 / compliance)
    return jnp.where(posed.by_multiplier, stiff, 0.0)


def taut(posed: Posed, point: Point) -> Bool[Array, " n_a"]:
    """Flag the imposed displacements that act at an equilibrium: no slack cables."""
    gap, unilateral = _wanting(posed, point)
    short = gap >= -_TAUT * posed.model.mechanism.bodies.length
    return posed.by_multiplier & (short | ~unilateral)


def estimated_forces(posed: Posed, point: Point) -> Float[Array, " n_a"]:
    """Estimate the forces behind imposed displacements by least squares.

    Exact at equilibrium; 0 for slack cables.
    """
    if posed.model.with_multiplier.size == 0:
        return jnp.zeros_like(point.delta_a)
    g, rows = unbalanced(posed, point, jnp.zeros_like(point.delta_a))
    active = taut(posed, point)
    F_a = jnp.where(active[:, None], rows_on_free(posed, point.u, rows), 0.0)
    normal = jnp.sum(F_a[:, None] * F_a[None], axis=-1)
    unit = jnp.diag(jnp.where(active, 0.0, 1.0))
    work = jnp.sum(F_a * posed.on_free(point.u, g)[None], axis=1)
    return jnp.linalg.solve(normal + unit, work)


def merit(posed: Posed, point: Point, lambda_a, gap_stiffness) -> Float[Array, ""]:
    """Compute the norm of out-of-balance forces and of gaps, as forces [N]."""
    g, _ = unbalanced(posed, point, lambda_a)
    g = posed.on_free(point.u, g)
    to_go, _ = gap(posed, point, lambda_a, gap_stiffness)
    return jnp.sqrt(jnp.sum(g**2) + jnp.sum((gap_stiffness * to_go) ** 2))


class Residual(NamedTuple):
    """Out-of-balance forces, and how small rounding lets them become [-].

    Both are relative to the larger of external and internal force, or to the rounding
    of the internal forces if that is larger still.
    """

    size: Float[Array, ""]
    rounding: Float[Array, ""]

    def settled(self, rtol) -> Bool[Array, ""]:
        """Tell whether Newton stops: at `rtol`, or at rounding if that is larger."""
        return self.size <= jnp.maximum(rtol, self.rounding)

    def at_rounding(self, rtol) -> Bool[Array, ""]:
        return self.settled(rtol) & (self.size > rtol)


def relative(posed: Posed, point: Point, merit, stiffness) -> Residual:
    """Divide a merit by the larger of external and internal force.

    The rounding of the internal forces, which is the divisor without load, is the mean
    stiffness [N/m] times that of displacements; a much stiffer region raises it.
    """
    points = jnp.asarray(posed.model.mechanism.points)
    size = jnp.maximum(jnp.max(jnp.ptp(points, axis=0)), jnp.max(jnp.abs(point.u)))
    norm = jnp.linalg.norm
    scale = jnp.maximum(norm(posed.load * posed.f_ext), norm(point.force))
    eps = jnp.finfo(points.dtype).eps
    rounding = eps * stiffness * size * posed.model.n_dof**0.5
    scale = jnp.maximum(scale, rounding)
    return Residual(merit / scale, rounding / scale)
