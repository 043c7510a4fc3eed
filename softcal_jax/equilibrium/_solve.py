"""Static equilibrium of a configuration, differentiable and batched."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._assembly import internal_force, tangent_values
from softcal_jax.equilibrium._lanes import lane_by_lane
from softcal_jax.equilibrium._linear_solver import LinearSolution
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import (
    NewtonSettings,
    NewtonState,
    external_force,
    mask_supports,
    newton,
    product,
)


class EquilibriumSolution(eqx.Module):
    """Equilibrium of one configuration, or of a batch (leading axis on every field).

    Attributes:
        displacement: Nodal displacement u [m]; nan where no equilibrium was found.
        result: Outcome; only `RESULTS.converged` is an equilibrium.
        steps: Newton iterations, all load steps together.
        load_steps: Load increments that were taken (1: full load at once).
        load_reached: Share of the load that the body was found to carry [-]; 1 if done.
        residual: Residual relative to the largest of external force, internal force
            and reaction [-].
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Negative eigenvalues of the last tangent, 0 for a stable state;
            -1 where nobody can tell: the linear solver does not count them, or the
            model is not conservative.
    """

    displacement: Float[Array, "*batch n_nodes 3"]
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


def residual(
    model: Model, configuration: ConfigurationArrays, u: Float[Array, "n_nodes 3"]
) -> Float[Array, "n_nodes 3"]:
    """Out-of-balance force f_int(x; p) - f_ext(p), all nodes [N]; paper Eq. (1).

    Zero on free coordinates at equilibrium; on held ones it is the reaction, the force
    of the support on the body.
    """
    return internal_force(model, u) - external_force(model, configuration)


def factor_solve(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_nodes 3"],
    rhs: Float[Array, "n_rhs n_nodes 3"],
    *,
    transpose: bool = False,
) -> LinearSolution:
    """Solve K(u) dx = rhs on the free nodes, one factorization for all rows.

    Args:
        model: The body.
        configuration: Its supports decide which rows are held.
        u: Displacement where K is taken [m].
        rhs: Right-hand sides; entries on held nodes are ignored [N].
        transpose: Solve with K^T, which is K only for a conservative model.

    Returns:
        The solutions, zero on held nodes [m].
    """
    sparsity = model.solver.sparsity
    fixed = configuration.fixed.ravel()
    values = tangent_values(model, u)
    masked, _ = mask_supports(sparsity, values, fixed)
    flat = jnp.where(fixed, 0.0, rhs.reshape(rhs.shape[0], -1))
    solved = model.solver.factor_solve(masked, flat, transpose=transpose)
    return solved._replace(x=solved.x.reshape(rhs.shape))


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
        jnp.where(carried, state.u, jnp.nan),
        state.result,
        state.step,
        state.load_steps,
        state.load_ok,
        state.residual,
        state.min_det_F,
        state.n_negative,
    )


@eqx.filter_custom_jvp
def _equilibrium(model, configuration, u0, *, settings):
    return _lane(settings)(model, configuration, u0)


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents, *, settings):
    """Implicit derivative K du = -(dR/dp) dp - K_held du_held; Eqs. (7) to (9)."""
    model, configuration, u0 = primals
    t_model, t_configuration, _ = tangents
    solution = _equilibrium(model, configuration, u0, settings=settings)
    u = solution.displacement
    fixed = configuration.fixed
    t_imposed = t_configuration.imposed
    du_held = (
        jnp.zeros_like(u) if t_imposed is None else jnp.where(fixed, t_imposed, 0.0)
    )
    _, dR = eqx.filter_jvp(
        residual, (model, configuration, u), (t_model, t_configuration, du_held)
    )
    sparsity = model.solver.sparsity
    values = tangent_values(model, u)
    masked, _ = mask_supports(sparsity, values, fixed.ravel())

    def solve(_, b, transpose=False):
        solved = model.solver.factor_solve(masked, b[None], transpose=transpose)
        # A derivative that does not exist must not pass for zero.
        return jnp.where(solved.ok, solved.x[0], jnp.nan)

    du = jax.lax.custom_linear_solve(
        lambda v: product(sparsity, masked, v),
        jnp.where(fixed, 0.0, -dR).ravel(),
        solve,
        transpose_solve=partial(solve, transpose=True),
        symmetric=model.conservative,
    )
    none = jax.tree.map(lambda _: None, solution)
    du = jnp.where(fixed, du_held, du.reshape(u.shape))
    # Where there is no equilibrium there is no derivative of it.
    du = jnp.where(solution.converged, du, jnp.nan)
    return solution, eqx.tree_at(
        lambda s: s.displacement, none, du, is_leaf=lambda leaf: leaf is None
    )


def solve_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    *,
    guess: Float[Array, "n_nodes 3"] | None = None,
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
    u0 = jnp.zeros(model.mesh.points.shape) if guess is None else guess
    return _equilibrium(model, configuration, u0, settings=settings or NewtonSettings())


def marker_positions(
    model: Model, configuration: ConfigurationArrays, solution: EquilibriumSolution
) -> Float[Array, "n_markers 3"]:
    """Simulated positions of the markers of one configuration [m].

    Args:
        model: The body.
        configuration: One configuration, with markers.
        solution: Its equilibrium.

    Returns:
        Positions in the frame of the mesh; nan where there is no equilibrium.
    """
    x = jnp.asarray(model.mesh.points) + solution.displacement
    return configuration.effectors.positions(x)


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
        one = jax.tree.map(lambda leaf, lane=lane: jnp.atleast_1d(leaf)[lane], solution)
        lines.append(
            f"configuration {names[lane]!r}: {RESULTS[one.result]} "
            f"({int(one.steps)} Newton steps, {100 * float(one.load_reached):.0f} % of "
            f"the load carried, residual {float(one.residual):.1e}, smallest det F "
            f"{float(one.min_det_F):.3g})"
        )
    raise RuntimeError("no equilibrium found.\n" + "\n".join(lines))
