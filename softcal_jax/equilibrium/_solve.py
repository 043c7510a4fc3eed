"""Static equilibrium of a configuration, differentiable and batched."""

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._lanes import lane_by_lane
from softcal_jax.equilibrium._linearisation import linearise
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings, NewtonState, newton
from softcal_jax.equilibrium._sensitivity import input_rows, sensitivity
from softcal_jax.equilibrium._solution import EquilibriumSolution


def _lane(settings: NewtonSettings):
    @lane_by_lane
    def lane(model, configuration, u0):
        return as_solution(newton(model, configuration, u0, settings))

    return lane


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
    return _lane(settings)(model, configuration, u0)


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents, *, settings):
    """Differentiate an equilibrium by the implicit function theorem.

    Like all derivatives it comes from `sensitivity`; the single input is a step along
    the tangents.
    """
    model, configuration, u0 = primals
    t_model, t_configuration, _ = tangents
    solution = _equilibrium(model, configuration, u0, settings=settings)
    u, lambda_a = solution.displacement, solution.multipliers

    def along(function):
        inputs, t_inputs = (model, configuration), (t_model, t_configuration)
        value, slope = eqx.filter_jvp(function, inputs, t_inputs)
        return jnp.zeros_like(value) if slope is None else slope

    rows = input_rows(model, configuration, u, lambda_a, along)
    rows = jax.tree.map(lambda row: row[None], rows)
    lin = linearise(model, configuration, u, lambda_a, differentiable=True)
    d = sensitivity(lin, rows)
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
