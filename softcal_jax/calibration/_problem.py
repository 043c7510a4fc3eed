"""A calibration as arrays, and its evaluation at one value of the parameters."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    effector_values,
    solve_equilibrium,
)
from softcal_jax.fields import ParameterSpace, unnamed
from softcal_jax.sensitivity import Response, equilibrium_response


class CalibrationProblem(eqx.Module):
    """Model, parameters and a batch of configurations that share them.

    Attributes:
        model: The body.
        space: The parameters.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
    """

    model: Model
    space: ParameterSpace
    configurations: ConfigurationArrays
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)


def without_names(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the calibration without names, which would compile other programs.

    Args:
        problem: The calibration.
    """
    return eqx.tree_at(lambda p: p.space, problem, unnamed(problem.space))


class Evaluation(eqx.Module):
    """Equilibria, errors and compliances of all configurations at one z.

    Attributes:
        equilibrium: Solutions, one lane per configuration.
        effectors: Simulated effector coordinates: positions [m], turns [rad], ...
        delta_e: Simulated minus measured values; 0 where nothing is measured.
        error: The same in units of the noise, stacked over configurations [-].
        W_ep: Stacked compliances in units of the noise, per unit of lambda_p [-].
        prior: Distance of the parameters from the middle of their priors, in standard
            deviations of these [-].
        tangents: du/dz of each lane, or None where W_ep came from the adjoint side [m].
        ok: Whether every lane has an equilibrium and a regular tangent.
    """

    equilibrium: EquilibriumSolution
    effectors: Float[Array, "n_c n_rows 3"]
    delta_e: Float[Array, "n_c n_rows 3"]
    error: Float[Array, " n_e"]
    W_ep: Float[Array, "n_e n_p"]
    prior: Float[Array, " n_p"]
    tangents: Float[Array, "n_c n_p n_points 3"] | None
    ok: Bool[Array, ""]

    @property
    def cost(self) -> Float[Array, ""]:
        """Half the sum of squared errors in noise units; infinite if not ok [-].

        Distances from the prior count like errors.
        """
        squares = jnp.sum(self.error**2) + jnp.sum(self.prior**2)
        return jnp.where(self.ok, 0.5 * squares, jnp.inf)


def simulate(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"],
) -> tuple[EquilibriumSolution, Float[Array, "n_c n_rows 3"]]:
    """Compute equilibria and effector coordinates of all configurations.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        guess: Displacements to start from [m].

    Returns:
        Solutions and effectors, one lane per configuration.
    """
    model = problem.space.model_at(problem.model, z)
    return simulate_model(model, configurations_at(problem, z), guess, problem.newton)


def configurations_at(
    problem: CalibrationProblem, z: Float[Array, " n_p"]
) -> ConfigurationArrays:
    """Set the parameters that belong to configurations, lane by lane.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
    """
    if all(problem.space.sets_fields):
        return problem.configurations
    apply = lambda c: problem.space.apply(problem.model, c, z)[1]
    return jax.vmap(apply)(problem.configurations)


def simulate_model(
    model: Model,
    configurations: ConfigurationArrays,
    guess: Float[Array, "n_c n_points 3"],
    newton: NewtonSettings,
) -> tuple[EquilibriumSolution, Float[Array, "n_c n_rows 3"]]:
    """Compute equilibria and effector coordinates of a model with given parameters.

    Args:
        model: The body.
        configurations: One lane per configuration.
        guess: Displacements to start from [m].
        newton: Settings of the equilibrium.
    """

    def lane(configuration, u0):
        solution = solve_equilibrium(model, configuration, guess=u0, settings=newton)
        return solution, _effectors(model, configuration, solution)

    return jax.vmap(lane)(configurations, guess)


def _effectors(model: Model, configuration: ConfigurationArrays, solution):
    return effector_values(
        model, configuration, solution.displacement, solution.multipliers
    )


def effector_errors(
    problem: CalibrationProblem, e: Float[Array, "n_c n_rows 3"]
) -> Float[Array, "n_c n_rows 3"]:
    """Return Delta_e, simulated minus measured values; 0 where nothing is measured."""
    effectors = problem.configurations.effectors
    seen = effectors.inverse_std > 0.0
    return jnp.where(seen, e - effectors.measured, 0.0)


class Lane(NamedTuple):
    """Evaluation of one configuration; of a batch, with a leading axis."""

    response: Response
    effectors: Float[Array, "*n_c n_rows 3"]


def evaluate_lane(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    before: Float[Array, "n_points 3"],
    precise: bool | Bool[Array, ""] = False,
) -> Lane:
    """Compute equilibrium, effectors and compliances of one configuration.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        configuration: One of its configurations.
        guess: Displacements to start from [m].
        before: Displacements of the equilibrium that the guess extrapolates [m].
        precise: Whether to linearise at the converged state, for one more Newton step;
            otherwise the compliances belong to the state before the last step.
    """
    response = equilibrium_response(
        problem.model,
        configuration,
        guess,
        problem.space,
        z,
        newton=problem.newton,
        before=before,
        precise=precise,
    )
    return Lane(response, response.effectors)


def stacked(
    problem: CalibrationProblem, z: Float[Array, " n_p"], lanes: Lane
) -> Evaluation:
    """Stack the errors and compliances of all lanes.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        lanes: Evaluations of all configurations.
    """
    response, effectors = lanes
    delta_e = effector_errors(problem, effectors)
    weight = jnp.asarray(problem.configurations.effectors.inverse_std)
    error = jnp.ravel(weight * delta_e)
    W = response.W_ep.reshape(-1, z.shape[0]) * weight.reshape(-1, 1)
    solution = response.equilibrium
    ok = jnp.all(solution.converged) & jnp.all(response.ok)
    ok = ok & jnp.all(jnp.isfinite(error)) & jnp.all(jnp.isfinite(W))
    tangents = response.displacement
    prior = problem.space.from_prior(z)
    return Evaluation(solution, effectors, delta_e, error, W, prior, tangents, ok)


def evaluate(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"],
    before: Float[Array, "n_c n_points 3"] | None = None,
    precise: bool | Bool[Array, ""] = False,
) -> Evaluation:
    """Compute equilibria, stacked errors and compliances W_ep (paper Eqs. 9, 10).

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        guess: Displacements to start from [m].
        before: Displacements of the equilibria that the guess extrapolates to first
            order, if it does [m].
        precise: Whether the compliances are exact, see `evaluate_lane`.

    Returns:
        Everything that one step of the outer loop needs.
    """
    before = guess if before is None else before
    lane = lambda c, u, u0: evaluate_lane(problem, z, c, u, u0, precise)
    lanes = jax.vmap(lane)(problem.configurations, guess, before)
    return stacked(problem, z, lanes)


def at_rest(problem: CalibrationProblem) -> Float[Array, "n_c n_points 3"]:
    """Return displacements of zero, as a guess [m]."""
    n_c = problem.configurations.gravity.shape[0]
    return jnp.zeros((n_c, problem.model.n_points, 3))


def first_guess(
    problem: CalibrationProblem, z: Float[Array, " n_p"]
) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from without an earlier equilibrium [m].

    They are zero; with rigid bodies, those of the preceding configuration: its poses
    lie near each other, and far from the unmounted parts.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
    """
    model = problem.space.model_at(problem.model, z)
    return chained_guess(model, configurations_at(problem, z), problem.newton)


def chained_guess(
    model: Model, configurations: ConfigurationArrays, newton: NewtonSettings
) -> Float[Array, "n_c n_points 3"]:
    """Return the guess of `first_guess` for a model with given parameters.

    Args:
        model: The body.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
    """
    n_c = configurations.gravity.shape[0]
    rest = jnp.zeros((n_c, model.n_points, 3))
    if model.mechanism.bodies.n_bodies == 0:
        return rest

    def follow(u, configuration):
        solution = solve_equilibrium(model, configuration, guess=u, settings=newton)
        found = jnp.where(solution.converged, solution.displacement, u)
        return found, found

    return jax.lax.scan(follow, rest[0], configurations)[1]
