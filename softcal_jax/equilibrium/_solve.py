"""Static equilibrium of a configuration, differentiable and batched."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._lanes import lane_by_lane
from softcal_jax.equilibrium._linearisation import linearise, residual
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings, NewtonState, newton
from softcal_jax.equilibrium._posed import Posed
from softcal_jax.equilibrium._sparsity import product


class EquilibriumSolution(eqx.Module):
    """Equilibrium of one configuration, or of a batch (leading axis on every field).

    Attributes:
        displacement: Displacement u of the nodes of the mesh, then of the four nodes
            of each rigid body's frame [m]; nan where no equilibrium was found.
        multipliers: Forces of the actuators whose displacement is imposed, 0 for the
            others; `actuator_forces` gives those of all.
        result: Outcome; only `RESULTS.converged` is an equilibrium.
        steps: Newton iterations, each on a factor of its own, all load steps together.
        load_steps: Load increments that were taken (1: full load at once).
        load_reached: Share of the load that the body was found to carry [-]; 1 if done.
        residual: Residual relative to the largest of external force, internal force
            and reaction [-].
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Negative eigenvalues of the last tangent, 0 for a stable state;
            -1 where nobody can tell: the linear solver does not count them, or the
            model is not conservative.
    """

    displacement: Float[Array, "*batch n_points 3"]
    multipliers: Float[Array, "*batch n_a"]
    result: RESULTS
    steps: Int[Array, "*batch"]
    load_steps: Int[Array, "*batch"]
    load_reached: Float[Array, "*batch"]
    residual: Float[Array, "*batch"]
    min_det_F: Float[Array, "*batch"]
    n_negative: Int[Array, "*batch"]

    @property
    def converged(self) -> Array:
        """Whether each configuration reached a regular equilibrium."""
        return self.result == RESULTS.converged


def _lane(settings: NewtonSettings):
    @lane_by_lane
    def lane(model, configuration, u0):
        return as_solution(newton(model, configuration, u0, settings))

    return lane


def as_solution(state: NewtonState) -> EquilibriumSolution:
    """What the end of Newton's loop means for a user."""
    carried = state.done & (state.load_ok >= 1.0)
    return EquilibriumSolution(
        # Where there is no equilibrium, no displacement may pass for one.
        displacement=jnp.where(carried, state.at.u, jnp.nan),
        multipliers=jnp.where(carried, state.lambda_a, jnp.nan),
        result=state.result,
        steps=state.step,
        load_steps=state.load_steps,
        load_reached=state.load_ok,
        residual=state.residual,
        min_det_F=state.at.min_det_F,
        n_negative=state.n_negative,
    )


def _held_at(model, configuration, u):
    """Where held nodes are at full load, as a function of what holds them [m]."""
    return Posed.of(model, configuration).held_at(u)


def _on_unknowns(model, configuration, u, forces):
    """Forces on the unknowns at full load [N]."""
    return Posed.of(model, configuration).gather(u, forces)


def _gap(model, configuration, u):
    """How far imposed displacements of actuators are from what they should be."""
    value = jnp.asarray(configuration.actuation.value)
    return value - actuation.displacements(model, u)


@eqx.filter_custom_jvp
def _equilibrium(model, configuration, u0, *, settings):
    return _lane(settings)(model, configuration, u0)


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents, *, settings):
    """Derivative of an equilibrium by the theorem of implicit functions."""
    model, configuration, u0 = primals
    t_model, t_configuration, _ = tangents
    solution = _equilibrium(model, configuration, u0, settings=settings)
    d = implicit_response(model, configuration, solution, t_model, t_configuration)
    none = jax.tree.map(lambda _: None, solution)
    return solution, eqx.tree_at(
        lambda s: (s.displacement, s.multipliers),
        none,
        (d.displacement, d.multipliers),
        is_leaf=lambda leaf: leaf is None,
    )


class ImplicitResponse(NamedTuple):
    """How an equilibrium follows its inputs; nan where there is none.

    Attributes:
        displacement: Derivative of `EquilibriumSolution.displacement` [m].
        multipliers: Derivative of `EquilibriumSolution.multipliers`.
        residual: Derivative of `residual`: how forces of the ground change [N].
    """

    displacement: Float[Array, "n_points 3"]
    multipliers: Float[Array, " n_a"]
    residual: Float[Array, "n_points 3"]


def implicit_response(
    model: Model,
    configuration: ConfigurationArrays,
    solution: EquilibriumSolution,
    t_model: Any,
    t_configuration: Any,
) -> ImplicitResponse:
    """Implicit derivative at an equilibrium that is already known; Eqs. (7) to (9).

    K du - F_a^T dlambda = -dR - K du_held and H_a du = d(imposed) - H_a du_held, with
    dR at a fixed state. Under `vmap` over the tangents alone, one assembly and one
    factorization serve all of them.

    Args:
        model: The model.
        configuration: One configuration.
        solution: Its equilibrium.
        t_model: Tangent of the model: its tree, None where a leaf does not change.
        t_configuration: Tangent of the configuration, likewise.

    Returns:
        Derivatives along the tangents.
    """
    u, lambda_a = solution.displacement, solution.multipliers
    inputs, t_inputs = (model, configuration), (t_model, t_configuration)
    held = lambda model, configuration: _held_at(model, configuration, u)
    _, du_held = eqx.filter_jvp(held, inputs, t_inputs)
    du_held = jnp.zeros_like(u) if du_held is None else du_held
    _, dR = eqx.filter_jvp(
        lambda model, configuration: residual(model, configuration, u, lambda_a),
        inputs,
        t_inputs,
    )
    dR = jnp.zeros_like(u) if dR is None else dR
    _, dgap = eqx.filter_jvp(_gap, (*inputs, u), (*t_inputs, du_held))
    dgap = jnp.zeros_like(lambda_a) if dgap is None else dgap
    lin = linearise(model, configuration, u)
    # The arm of a force changes, too, where the mounting of a tied body does.
    r = residual(model, configuration, u, lambda_a)
    dr = dR + lin.stiffness(du_held)
    _, dr = eqx.filter_jvp(_on_unknowns, (*inputs, u, r), (*t_inputs, du_held, dr))
    force = jnp.where(lin.posed.fixed(), 0.0, -dr)
    dgap = dgap[actuation.with_multiplier(model)]
    dx, d_lambda = _solve_implicitly(model, lin.system, force, dgap)
    d_lambda = actuation.among_all(model, d_lambda)
    du = du_held + lin.posed.scatter(u, dx)
    # Where there is no equilibrium there is no derivative of it.
    du = jnp.where(solution.converged, du, jnp.nan)
    if d_lambda.size > 0:
        d_lambda = jnp.where(solution.converged, d_lambda, jnp.nan)
    by_actuators = d_lambda[:, None, None] * actuation.force_rows(lin.posed.model, u)
    d_residual = dR + lin.stiffness(du) - jnp.sum(by_actuators, axis=0)
    return ImplicitResponse(du, d_lambda, d_residual)


def _solve_implicitly(model: Model, system: actuation.System, force, dgap):
    """Solution of the bordered system, differentiable in its right-hand side.

    Args:
        model: The model.
        system: The matrix.
        force: Right-hand side of the unknowns, 0 on held ones [N].
        dgap: How far each imposed displacement has to go.

    Returns:
        Changes of the unknowns and of the multipliers.
    """
    sparsity, n_dof = model.solver.sparsity, model.n_dof
    values, F_a, H_a, active = system.values, system.F_a, system.H_a, system.active
    # An array without entries would make JAX 0.10.2 lose the solver's call.
    n_m = active.shape[0]
    join = lambda x, lam: jnp.concatenate([x, lam]) if n_m > 0 else x

    def matvec(v):
        x = v[:n_dof]
        force = product(sparsity, values, x)
        if n_m == 0:
            return force
        lam = jnp.where(active, v[n_dof:], 0.0)
        force = force - jnp.sum(lam[:, None] * F_a, axis=0)
        gap = jnp.where(active, -jnp.sum(H_a * x[None], axis=1), v[n_dof:])
        return jnp.concatenate([force, gap])

    def solve(_, b, transpose=False):
        below = b[n_dof:]
        gap = jnp.where(active, -below, 0.0)[None] if n_m > 0 else jnp.zeros((1, 0))
        solved = system.solve(model, b[None, :n_dof], gap, transpose=transpose)
        lam = jnp.where(active, solved.lambda_a[0], below) if n_m > 0 else below
        # A derivative that does not exist must not pass for zero.
        return jnp.where(solved.ok, join(solved.x[0], lam), jnp.nan)

    d = jax.lax.custom_linear_solve(
        matvec,
        join(force, jnp.where(active, -dgap, 0.0)),
        solve,
        transpose_solve=partial(solve, transpose=True),
        symmetric=model.conservative,
    )
    return d[:n_dof], d[n_dof:]


def solve_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    *,
    guess: Float[Array, "n_points 3"] | None = None,
    settings: NewtonSettings | None = None,
) -> EquilibriumSolution:
    """Static equilibrium of one configuration; traceable, differentiable, for `vmap`.

    Derivatives with respect to the model's law and density, and to the loads and the
    imposed displacements, are implicit (forward and reverse): the Newton iterations are
    not differentiated.

    Args:
        model: The body.
        configuration: Supports and loads of one configuration.
        guess: Displacement to start from [m]; at rest by default.
        settings: Settings of Newton's method.

    Returns:
        The solution with its outcome; nothing is raised here, since a batch may hold
        lanes that fail. `check_converged` raises.
    """
    u0 = jnp.zeros((model.n_points, 3)) if guess is None else guess
    return _equilibrium(model, configuration, u0, settings=settings or NewtonSettings())


def check_converged(solution: EquilibriumSolution, names: tuple[str, ...]) -> None:
    """Raise RuntimeError that names every configuration without an equilibrium.

    Args:
        solution: Solutions of a batch.
        names: Names of its configurations.

    Raises:
        RuntimeError: If a lane did not converge; the text says which, and why.
    """
    bad = np.flatnonzero(~np.atleast_1d(np.asarray(solution.converged)))
    if bad.size == 0:
        return
    lines = []
    for lane in bad:
        of = partial(_of_lane, lane)
        result = jax.tree.map(lambda a, of=of: jnp.asarray(of(a)), solution.result)
        lines.append(
            f"configuration {names[lane]!r}: {RESULTS[result]} "
            f"({of(solution.steps)} Newton steps, "
            f"{100 * of(solution.load_reached):.0f} % of the load carried, residual "
            f"{of(solution.residual):.1e}, smallest det F {of(solution.min_det_F):.3g})"
        )
    raise RuntimeError("no equilibrium found.\n" + "\n".join(lines))


def _of_lane(lane, leaf):
    """The value of one lane; a solution without a batch is lane 0."""
    return np.atleast_1d(np.asarray(leaf))[lane]
