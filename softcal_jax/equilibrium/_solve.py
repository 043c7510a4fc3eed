"""Static equilibrium of a configuration, differentiable and batched."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._lanes import lane_by_lane
from softcal_jax.equilibrium._linearisation import linearise
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings, NewtonState, newton
from softcal_jax.equilibrium._sensitivity import input_rows, sensitivity


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
        load_reached: Share of the load at the last equilibrium [-]; 1 if converged.
        residual: Residual relative to the larger of external and internal force [-].
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Number of negative eigenvalues of the last tangent, 0 for a stable
            state; -1 if unknown, because the linear solver does not count them or the
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


def as_solution(state: NewtonState) -> EquilibriumSolution:
    """Turn the final state of Newton's loop into a solution."""
    carried = state.done & (state.load_ok >= 1.0)
    return EquilibriumSolution(
        # Without an equilibrium, no displacement may be mistaken for one.
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


@eqx.filter_custom_jvp
def _equilibrium(model, configuration, u0, *, settings):
    @lane_by_lane
    def lane(model, configuration, u0):
        return as_solution(newton(model, configuration, u0, settings))

    return lane(model, configuration, u0)


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents, *, settings):
    """Differentiate an equilibrium by the implicit function theorem.

    The single input of `sensitivity` is a step along the tangents.
    """
    model, configuration, u0 = primals
    t_model, t_configuration, _ = tangents
    solution = _equilibrium(model, configuration, u0, settings=settings)
    u, lambda_a = solution.displacement, solution.multipliers

    def along(function):
        inputs, t_inputs = (model, configuration), (t_model, t_configuration)
        value, slope = eqx.filter_jvp(function, inputs, t_inputs)
        return jnp.zeros_like(value) if slope is None else slope

    row = input_rows(model, configuration, u, lambda_a, along)
    lin = linearise(model, configuration, u, lambda_a, differentiable=True)
    d = sensitivity(lin, jax.tree.map(lambda leaf: leaf[None], row))
    # Without an equilibrium there is no derivative either.
    or_nan = lambda a: jnp.where(solution.converged, a[0], jnp.nan)
    none = jax.tree.map(lambda _: None, solution)
    return solution, eqx.tree_at(
        lambda s: (s.displacement, s.multipliers),
        none,
        (or_nan(d.displacement), or_nan(d.multipliers)),
        is_leaf=lambda leaf: leaf is None,
    )


def solve_equilibrium(
    model: Model,
    configuration: ConfigurationArrays,
    *,
    guess: Float[Array, "n_points 3"] | None = None,
    settings: NewtonSettings | None = None,
) -> EquilibriumSolution:
    """Solve for the static equilibrium of one configuration.

    Works under `jit`, `vmap` and autodiff. Derivatives by model and configuration
    (forward and reverse) are implicit: Newton iterations are not differentiated.

    Args:
        model: The model.
        configuration: Supports and loads of one configuration.
        guess: Displacement to start from [m]; rest by default.
        settings: Settings of Newton's method.

    Returns:
        The solution with its outcome. Nothing is raised here, since some lanes of a
        batch may fail; `check_converged` raises.
    """
    u0 = jnp.zeros((model.n_points, 3)) if guess is None else guess
    return _equilibrium(model, configuration, u0, settings=settings or NewtonSettings())


def check_converged(solution: EquilibriumSolution, names: tuple[str, ...]) -> None:
    """Raise an error that names every configuration of a batch without an equilibrium.

    Raises:
        RuntimeError: If a lane did not converge; the message says which and why.
    """
    bad = np.flatnonzero(~np.atleast_1d(np.asarray(solution.converged)))
    if bad.size == 0:
        return

    def why(lane):
        of = lambda leaf: np.atleast_1d(np.asarray(leaf))[lane]
        result = jax.tree.map(lambda a: jnp.asarray(of(a)), solution.result)
        return (
            f"configuration {names[lane]!r}: {RESULTS[result]} "
            f"({of(solution.steps)} Newton steps, "
            f"{100 * of(solution.load_reached):.0f} % of the load carried, residual "
            f"{of(solution.residual):.1e}, smallest det F {of(solution.min_det_F):.3g})"
        )

    raise RuntimeError("no equilibrium found.\n" + "\n".join(map(why, bad)))
