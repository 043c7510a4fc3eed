"""The linear system at a known equilibrium, and derivatives by its inputs; Eqs. 4 to 9.

An input is a parameter, a value imposed on an actuator or a leaf of the model that a
user differentiates.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._assembly import tangent_values
from softcal_jax.equilibrium._balance import (
    Bordered,
    Point,
    System,
    assemble,
    deform,
    estimated_forces,
    taut,
    unbalanced,
    zeros_of,
)
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import product


def residual(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    lambda_a: Float[Array, " n_a"] | None = None,
) -> Nodal:
    """Compute the out-of-balance force f - f_ext - F_a^T lambda_a [N]; Eq. (1).

    At equilibrium it is zero on free coordinates; on held ones it is the reaction, the
    force of the support on the robot. Summed over a rigid body it is zero, or the force
    that holds the body. Unless given, the forces `lambda_a` of actuators whose
    displacement is imposed are estimated from the balance, exactly at equilibrium.
    """
    posed = Posed.of(model, configuration)
    point = deform(posed, u)
    if lambda_a is None:
        lambda_a = estimated_forces(posed, point)
    return unbalanced(posed, point, lambda_a)[0]


def solved_forces(
    model: Model, configuration: ConfigurationArrays, u: Nodal
) -> Float[Array, " n_a"]:
    """Compute the forces of actuators with imposed displacement at an equilibrium."""
    posed = Posed.of(model, configuration)
    return estimated_forces(posed, deform(posed, u))


class Linearisation(Module):
    """The bordered system of a model at an equilibrium under full load.

    Attributes:
        lambda_a: Forces of actuators whose displacement is imposed.
        nodal: Tangent over all nodes, held ones included [N/m].
        regular: False if a factorization is known to have failed.
        near: Whether the solver may still hold the factors of a matrix near this one.
        differentiable: Whether autodiff can transpose `solve`; failure then gives nan.
    """

    posed: Posed
    point: Point
    lambda_a: Float[Array, " n_a"]
    nodal: Float[Array, " nnz"]
    system: System
    regular: Bool[Array, ""]
    near: bool = eqx.field(static=True, default=False)
    differentiable: bool = eqx.field(static=True, default=False)

    @property
    def u(self) -> Nodal:
        """Displacement at the equilibrium [m]."""
        return self.point.u

    def unbalanced(self, u: Nodal, lambda_a: Float[Array, " n_a"]) -> Nodal:
        """Compute `residual` near the equilibrium, to first order in u [N]."""
        g, _ = unbalanced(self.posed, self.point, lambda_a)
        return g + self.stiffness(u - self.u)

    def stiffness(self, du: Nodal) -> Nodal:
        """Compute the change of the forces on all nodes in a small motion [N]."""
        change = product(self.posed.model.pattern, self.nodal, du.ravel())
        return change.reshape(du.shape)

    def free(self, forces: Nodal) -> Float[Array, " n_dof"]:
        """Reduce nodal forces to the free unknowns, 0 on the others [N]."""
        return self.posed.on_free(self.u, forces)

    def scatter(self, x: Float[Array, "n n_dof"]) -> Float[Array, "n n_points 3"]:
        """Expand steps of the unknowns to displacements of all nodes [m]."""
        return jax.vmap(lambda d: self.posed.scatter(self.u, d))(x)

    def solve(
        self,
        force: Float[Array, "n n_dof"],
        gap: Float[Array, "n n_m"],
        *,
        transpose: bool = False,
    ) -> Bordered:
        """Solve for several right-hand sides with at most one factorization.

        `force` is 0 on held unknowns [N], `gap` the imposed minus current displacement
        of active actuators; solutions are zero and not ok if they do not exist.
        """
        solve = partial(self.system.solve, self.posed.model.solver, transpose=transpose)
        if self.differentiable:
            assert not transpose, "autodiff transposes these solutions itself"
            return _solve_linearly(self.posed.model, self.system, force, gap)
        if not self.near:
            return solve(force, gap)
        ok = self.regular & jnp.all(jnp.isfinite(force)) & jnp.all(jnp.isfinite(gap))
        again = lambda: solve(force, gap, near=True)
        return jax.lax.cond(ok, again, lambda: zeros_of(solve, force, gap))


def _solve_linearly(
    model: Model,
    system: System,
    force: Float[Array, "n n_dof"],
    gap: Float[Array, "n n_m"],
) -> Bordered:
    n_dof, n_m = force.shape[1], gap.shape[1]
    values, active = system.values, system.active
    # With an empty array JAX 0.10.2 would drop the call of the solver.
    join = lambda x, lam: jnp.concatenate([x, lam], axis=1) if n_m > 0 else x

    def matvec(v):
        x, lam = v[:, :n_dof], v[:, n_dof:]
        out = jax.vmap(lambda d: product(model.solver.sparsity, values, d))(x)
        if n_m == 0:
            return out
        acting = jnp.where(active[None], lam, 0.0)
        out = out - jnp.sum(acting[:, :, None] * system.F_a[None], axis=1)
        closed = -jnp.sum(system.H_a[None] * x[:, None], axis=2)
        return join(out, jnp.where(active[None], closed, lam))

    def solve(_, b, *, transpose=False):
        below = b[:, n_dof:]
        wanted = jnp.where(active[None], -below, 0.0) if n_m > 0 else below
        # Derivatives of derivatives solve with the same matrix again.
        how = {"transpose": transpose, "near": True, "exact": True}
        solved = system.solve(model.solver, b[:, :n_dof], wanted, **how)
        lam = jnp.where(active[None], solved.lambda_a, below) if n_m > 0 else below
        # A derivative that does not exist must not be mistaken for zero.
        return jnp.where(solved.ok, join(solved.x, lam), jnp.nan)

    x = jax.lax.custom_linear_solve(
        matvec,
        join(force, jnp.where(active[None], -gap, 0.0)),
        solve,
        transpose_solve=partial(solve, transpose=True),
        symmetric=model.conservative,
    )
    unknown, count = jnp.full((n_m, n_m), jnp.nan), jnp.full((), -1, jnp.int32)
    return Bordered(x[:, :n_dof], x[:, n_dof:], unknown, count, jnp.ones((), bool))


def linearise(
    model: Model,
    configuration: ConfigurationArrays,
    u: Nodal,
    lambda_a: Float[Array, " n_a"] | None = None,
    *,
    differentiable: bool = False,
) -> Linearisation:
    """Assemble the tangent and the actuator rows; `lambda_a` as for `residual`."""
    posed = Posed.of(model, configuration)
    point = deform(posed, u)
    if lambda_a is None:
        lambda_a = estimated_forces(posed, point)
    mesh, active = tangent_values(model, u), taut(posed, point)
    tangent = assemble(posed, point, lambda_a, mesh=mesh, active=active)
    return Linearisation(
        posed=posed,
        point=point,
        lambda_a=lambda_a,
        nodal=tangent.nodal,
        system=tangent.system,
        regular=jnp.ones((), bool),
        differentiable=differentiable,
    )


OfInputs = Callable[[Model, ConfigurationArrays], Any]
Readings = Callable[
    [Model, ConfigurationArrays, Nodal, Float[Array, " n_a"], Nodal],
    Float[Array, "..."],
]
"""Function, such as `effector_values`, of a state (u, multipliers) and its `residual`.

Internal forces are read off the residual alone, which needs no pass over the tets.
"""


class InputRows(NamedTuple):
    """Effects of a unit of each input at a fixed state, by rows; see `input_rows`.

    Held nodes and bodies follow the input in all of them.

    Attributes:
        force: -dR/dp, the force on the free unknowns [N].
        held: Motion of held nodes and bodies [m].
        gap: Change of imposed minus current delta_a of `Model.with_multiplier`.
        reading: Direct change of the readings; empty if nothing is read.
    """

    force: Float[Array, "*n n_dof"]
    held: Float[Array, "*n n_points 3"]
    gap: Float[Array, "*n n_m"]
    reading: Float[Array, "*n n_e"]


def derivatives(
    function: Callable[[Float[Array, " n"]], Any], value: Float[Array, " n"]
) -> Any:
    """Differentiate a function by each entry of its argument, stacked.

    One entry after the other: a `vmap` of products with the sparse tangent is slower.
    """
    _, slope = jax.linearize(function, value)
    return jax.lax.map(slope, jnp.eye(value.size))


@jax.custom_jvp
def _known(value: Nodal, function: Nodal) -> Nodal:
    """Return `value`, with the derivatives of `function`, which equals it."""
    return value


_known.defjvp(lambda primals, tangents: (primals[0], tangents[1]))


def input_rows(
    linearisation: Linearisation,
    by_inputs: Callable[[OfInputs], Any],
    readings: Readings | None = None,
) -> InputRows:
    """Differentiate balance, supports and readings by the inputs.

    `by_inputs` maps a function of (model, configuration), whose values are a tree of
    arrays, to its derivatives by all inputs, stacked. The tets are only differentiated
    by inputs that change their law: strains due to a moved support follow from the
    tangent.
    """
    lin = linearisation
    u, lambda_a, which = lin.u, lin.lambda_a, lin.posed.model.with_multiplier

    def at_fixed_unknowns(model, configuration):
        posed = Posed.of(model, configuration)
        placed = posed.held_at(u)
        forces = residual(model, configuration, u, lambda_a) + lin.stiffness(placed - u)
        forces = _known(lin.unbalanced(u, lambda_a), forces)
        wanted = jnp.asarray(configuration.actuation.value)
        reading = jnp.zeros(0)
        if readings is not None:
            reading = readings(model, configuration, placed, lambda_a, forces).ravel()
        return InputRows(
            # The mounting of a tied body changes the arms of forces.
            force=-posed.gather(placed, forces),
            held=placed,
            gap=(wanted - model.displacements(placed))[which],
            reading=reading,
        )

    rows = by_inputs(at_fixed_unknowns)
    fixed = lin.posed.fixed
    return rows._replace(force=jnp.where(fixed[None], 0.0, rows.force))


class Sensitivity(NamedTuple):
    """Derivatives of an equilibrium by its inputs; zero if the tangent is not `ok`.

    W_ep is the change of each reading per unit of each input, in its unit. Changes of
    displacement, free unknowns [m] and multipliers, by rows, are None if adjoint;
    `readings` is None if nothing is read.
    """

    W_ep: Float[Array, "*batch n_e n"]
    ok: Bool[Array, "*batch"]
    displacement: Float[Array, "*batch n n_points 3"] | None = None
    unknowns: Float[Array, "*batch n n_dof"] | None = None
    multipliers: Float[Array, "*batch n n_a"] | None = None
    readings: Float[Array, "*batch n_e"] | None = None


@eqx.filter_jit
def sensitivity(
    linearisation: Linearisation,
    rows: InputRows,
    readings: Readings | None = None,
    *,
    adjoint: bool = False,
) -> Sensitivity:
    """Turn the rows of inputs into derivatives of state and readings; Eq. (9).

    W_ep = H_e K^-1 H_p^T + de/dp, with one factorization; K is bordered by the rows of
    actuators whose displacement is imposed. `adjoint` solves for K^-T H_e^T instead,
    faster if there are fewer readings.
    """
    lin = linearisation
    if adjoint:
        assert readings is not None
        H = adjoint_rows(lin, readings)
        _check_readings(rows, len(H.state))
        W = H.state @ rows.force.T + H.gap @ rows.gap.T + rows.reading.T
        return Sensitivity(W, H.ok, readings=H.readings)
    solved = lin.solve(rows.force, rows.gap)
    moved = lin.scatter(solved.x)
    changed = lin.posed.model.among_all(solved.lambda_a)
    W, value = rows.reading.T, None
    if readings is not None:
        at_inputs = _at_fixed_inputs(lin, readings)
        value, slope = jax.linearize(at_inputs, lin.u, lin.lambda_a)
        _check_readings(rows, value.size)
        # One after the other, like `derivatives`.
        W = W + jax.lax.map(lambda d: slope(*d), (moved, changed)).T
    return Sensitivity(
        W_ep=W,
        ok=solved.ok,
        displacement=rows.held + moved,
        unknowns=solved.x,
        multipliers=changed,
        readings=value,
    )


def _check_readings(rows: InputRows, n_e: int) -> None:
    """Raise ValueError where rows were made for another number of readings."""
    if (n := rows.reading.shape[-1]) != n_e:
        raise ValueError(
            f"the rows of the inputs are for {n} readings, and {n_e} are asked for: "
            "give `parameter_rows` or `input_rows` the same `readings`."
        )


class AdjointRows(NamedTuple):
    """K^-T H_e^T: derivatives of readings by forces on free unknowns, and by gaps."""

    state: Float[Array, "n_e n_dof"]
    gap: Float[Array, "n_e n_m"]
    ok: Bool[Array, ""]
    readings: Float[Array, " n_e"]


@eqx.filter_jit
def adjoint_rows(linearisation: Linearisation, readings: Readings) -> AdjointRows:
    """Solve for the rows of H_e, one right-hand side per reading."""
    lin = linearisation
    value, pull_back = jax.vjp(_at_fixed_inputs(lin, readings), lin.u, lin.lambda_a)
    by_u, by_lambda = jax.lax.map(pull_back, jnp.eye(value.size))
    which = lin.posed.model.with_multiplier
    solved = lin.solve(jax.vmap(lin.free)(by_u), -by_lambda[:, which], transpose=True)
    return AdjointRows(solved.x, -solved.lambda_a, solved.ok, value)


def _at_fixed_inputs(lin: Linearisation, readings: Readings):
    robot = (lin.posed.model, lin.posed.configuration)
    g = lin.unbalanced
    return lambda u, lambda_a: readings(*robot, u, lambda_a, g(u, lambda_a)).ravel()
