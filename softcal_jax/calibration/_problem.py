"""A calibration as arrays, and its evaluation at one value of the parameters."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._noise import CorrelatedNoise, whitened
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Batch,
    EquilibriumSolution,
    Job,
    Model,
    NewtonSettings,
    Workers,
    effector_values,
    program_key,
    solve_equilibrium,
    solve_from_rest,
)
from softcal_jax.fields import ParameterSpace, unnamed
from softcal_jax.sensitivity import Response, equilibrium_response

T = TypeVar("T")


class CalibrationProblem(eqx.Module):
    """Model, parameters and a batch of configurations that share them.

    Attributes:
        model: The body.
        space: The parameters.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
        noise: Covariance of the errors; None where they are independent, with the
            standard deviations of the effectors.
    """

    model: Model
    space: ParameterSpace
    configurations: ConfigurationArrays
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)
    noise: CorrelatedNoise | None = None

    def at(self, z: Float[Array, " n_p"]) -> tuple[Model, ConfigurationArrays]:
        """Return model and configurations with scaled parameters set [-]."""
        model, configurations = self.space.model_at(self.model, z), self.configurations
        if not all(self.space.sets_fields):
            apply = lambda c: self.space.apply(self.model, c, z)[1]
            configurations = jax.vmap(apply)(configurations)
        return model, configurations

    def in_noise_units(self, x: Float[Array, "n_e ..."]) -> Float[Array, "n_e ..."]:
        """Convert stacked values from the units of the effectors to those of the noise.

        They are divided by the standard deviations and made independent, see
        `CorrelatedNoise` [-].
        """
        effectors = self.configurations.effectors
        weight = jnp.asarray(effectors.inverse_std)
        x = weight.reshape(-1, *(1,) * (x.ndim - 1)) * x
        if self.noise is None:
            return x
        return whitened(jnp.asarray(self.noise.columns(effectors)), x)

    def on_host_in_noise_units(
        self, x: Float[HostArray, "n_e ..."]
    ) -> Float[HostArray, "n_e ..."]:
        """Convert as `in_noise_units`, without a compiled program for each shape."""
        weight = np.asarray(self.configurations.effectors.inverse_std)
        return whitened(
            self.noise_columns(), weight.reshape(-1, *(1,) * (x.ndim - 1)) * x
        )

    def noise_columns(self) -> Float[HostArray, "n_e n_columns"]:
        """Return A of the noise on the host, see `CorrelatedNoise` [-]."""
        effectors = jax.tree.map(np.asarray, self.configurations.effectors)
        if self.noise is None:
            return np.zeros((effectors.inverse_std.size, 0))
        return np.asarray(jax.tree.map(np.asarray, self.noise).columns(effectors))

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Factor on the stated standard deviations that an error of one stands for [-].

        Errors count in stated units whatever the noise is found to be, so that what is
        added to their squares must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def prior_weights(self) -> Float[Array, " n_p"]:
        """Return 1 / standard deviations of the prior, in units of the errors [-]."""
        return jnp.asarray(self.level) * self.space.prior_weights()

    def from_prior(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Return distances from the prior, in units of the errors [-]."""
        return jnp.asarray(self.level) * self.space.from_prior(z)

    def with_noise(self, noise: CorrelatedNoise | None) -> "CalibrationProblem":
        """Return the calibration with another noise."""
        where = lambda p: p.noise
        return eqx.tree_at(where, self, noise, is_leaf=lambda leaf: leaf is None)


def without_names(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the calibration without names, which would compile other programs."""
    return eqx.tree_at(lambda p: p.space, problem, unnamed(problem.space))


def n_measured(problem: CalibrationProblem) -> int:
    """Return the number of measured coordinates, less those that find offsets."""
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    spent = 0 if problem.noise is None else problem.noise.n_attachment_offsets(weight)
    return int(np.sum(weight > 0.0)) - spent


class Evaluation(eqx.Module):
    """Equilibria, errors and compliances of all configurations at one z.

    Attributes:
        equilibrium: Solutions, one lane per configuration.
        effectors: Simulated effector coordinates: positions [m], turns [rad], ...
        delta_e: Simulated minus measured values; 0 where nothing is measured.
        compliance: Stacked W_ep in the units of the effectors, per unit of lambda_p.
        error: Stacked delta_e in units of the noise, see `in_noise_units` [-].
        W_ep: The same in units of the noise, per unit of lambda_p [-].
        prior: Distance of the parameters from the middle of their priors, in standard
            deviations of these [-].
        tangents: du/dz of each lane, or None where W_ep came from the adjoint side [m].
        ok: Whether every lane has an equilibrium and a regular tangent.
    """

    equilibrium: EquilibriumSolution
    effectors: Float[Array, "n_c n_rows 3"]
    delta_e: Float[Array, "n_c n_rows 3"]
    compliance: Float[Array, "n_e n_p"]
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
        return _cost(self.ok, self.error, self.prior)


@jax.jit
def _cost(ok, error, prior) -> Float[Array, ""]:
    squares = jnp.sum(error**2) + jnp.sum(prior**2)
    return jnp.where(ok, 0.5 * squares, jnp.inf)


def simulate(
    model: Model,
    configurations: ConfigurationArrays,
    newton: NewtonSettings,
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> tuple[EquilibriumSolution, Float[Array, "n_c n_rows 3"]]:
    """Compute equilibria and effector coordinates of all configurations.

    Args:
        model: The body, with its parameters set.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
        guess: Displacements to start from; by default see `solve_from_rest` [m].
    """
    if guess is None:
        found = solve_from_rest(model, configurations, newton)
    else:
        solve = lambda c, u: solve_equilibrium(model, c, guess=u, settings=newton)
        found = jax.vmap(solve)(configurations, guess)
    values = lambda c, u, forces: effector_values(model, c, u, forces)
    e = jax.vmap(values)(configurations, found.displacement, found.multipliers)
    return found, e


@eqx.filter_jit
def _simulate_lane(
    model: Model,
    newton: NewtonSettings,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
) -> tuple[EquilibriumSolution, Float[Array, "n_rows 3"]]:
    found = solve_equilibrium(model, configuration, guess=guess, settings=newton)
    u, forces = found.displacement, found.multipliers
    return found, effector_values(model, configuration, u, forces)


def simulate_lanes(
    model: Model,
    configurations: ConfigurationArrays,
    newton: NewtonSettings,
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> Job[tuple[EquilibriumSolution, Float[Array, "n_c n_rows 3"]]]:
    """Simulate as `simulate` does, with configurations as lanes of one program.

    It is compiled once for any number of them, and the lanes share the cores.
    """
    lanes = [lane_of(configurations, c) for c in range(len(configurations.gravity))]

    def call(solver, lane):
        own = eqx.tree_at(lambda m: m.solver, model, solver)
        return jax.block_until_ready(_simulate_lane(own, newton, *lane))

    key = program_key("simulate_lane", model, lanes[0])
    start = jax.device_put(np.zeros((model.n_points, 3)))
    if guess is None and model.mechanism.bodies.n_bodies > 0:
        found = []
        for lane in lanes:
            found += yield Batch(call, [(lane, start)], key)
            (last, _) = found[-1]
            start = jnp.where(last.converged, last.displacement, start)
    else:
        starts = [start] * len(lanes) if guess is None else guess
        found = yield Batch(call, list(zip(lanes, starts, strict=True)), key)
    return jax.device_put(jax.tree.map(lambda *own: np.stack(own), *found))


def as_guess(solution: EquilibriumSolution) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from, rest where there was no equilibrium [m]."""
    there = solution.converged[:, None, None]
    return jnp.where(there, solution.displacement, 0.0)


def effector_errors(
    problem: CalibrationProblem, e: Float[Array, "n_c n_rows 3"]
) -> Float[Array, "n_c n_rows 3"]:
    """Return Delta_e, simulated minus measured values; 0 where nothing is measured."""
    effectors = problem.configurations.effectors
    return jnp.where(effectors.inverse_std > 0.0, e - effectors.measured, 0.0)


def evaluate_lane(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    before: Float[Array, "n_points 3"],
    precise: bool | Bool[Array, ""] = False,
) -> Response:
    """Compute equilibrium, effectors and compliances of one configuration.

    Unless `precise`, which takes one more Newton step, the compliances belong to the
    state before the last step.
    """
    return equilibrium_response(
        problem.model,
        configuration,
        guess,
        problem.space,
        z,
        newton=problem.newton,
        before=before,
        precise=precise,
    )


def stacked(
    problem: CalibrationProblem, z: Float[Array, " n_p"], lanes: Response
) -> Evaluation:
    """Stack the errors and compliances of all lanes."""
    delta_e = effector_errors(problem, lanes.effectors)
    compliance = lanes.W_ep.reshape(-1, z.shape[0])
    error = problem.in_noise_units(jnp.ravel(delta_e))
    W = problem.in_noise_units(compliance)
    ok = jnp.all(lanes.equilibrium.converged) & jnp.all(lanes.ok)
    return Evaluation(
        equilibrium=lanes.equilibrium,
        effectors=lanes.effectors,
        delta_e=delta_e,
        compliance=compliance,
        error=error,
        W_ep=W,
        prior=problem.from_prior(z),
        tangents=lanes.displacement,
        ok=ok & jnp.all(jnp.isfinite(error)) & jnp.all(jnp.isfinite(W)),
    )


def in_other_units(
    problem: CalibrationProblem, old: Evaluation, before: CalibrationProblem
) -> Evaluation:
    """Return an evaluation in the units of another noise.

    Args:
        problem: The calibration with that noise.
        old: The evaluation.
        before: The calibration with the noise that it was made with.
    """
    where = lambda e: (e.error, e.W_ep, e.prior)
    both = np.ravel(old.delta_e), np.asarray(old.compliance)
    units = [problem.on_host_in_noise_units(x) for x in both]
    prior = np.asarray(problem.level) / np.asarray(before.level) * np.asarray(old.prior)
    return eqx.tree_at(where, old, tuple(jax.device_put([*units, prior])))


def at_rest(problem: CalibrationProblem) -> Float[Array, "n_c n_points 3"]:
    """Return displacements of zero, as a guess [m]."""
    n_c = problem.configurations.gravity.shape[0]
    return jnp.zeros((n_c, problem.model.n_points, 3))


_evaluate_lane = eqx.filter_jit(evaluate_lane)


@eqx.filter_jit
def _posed(problem: CalibrationProblem, z) -> tuple[Model, ConfigurationArrays]:
    return problem.at(z)


class Evaluator:
    """Evaluates a calibration, its configurations as lanes of one program.

    The program does not depend on the number of configurations, on the data, or on how
    the parameters are stepped, so it is compiled once for all of these.

    Attributes:
        problem: The calibration.
        numbered: The same without names, for compiled programs.
        shared: What all lanes share, without configurations.
        lanes: The configurations.
    """

    def __init__(self, problem: CalibrationProblem):
        """Split the calibration into what all lanes share, and the lanes."""
        self.problem, self.numbered = problem, without_names(problem)
        # The number of lanes and what concerns steps alone would each give another
        # program, so both are left out.
        space = replace(self.numbered.space, order=(), tensor_steps=True, pin=None)
        where = lambda p: (p.configurations, p.space)
        alone = self.numbered.with_noise(None)
        self.shared = eqx.tree_at(where, alone, (None, space))
        n_c = problem.configurations.gravity.shape[0]
        self.lanes = [lane_of(problem.configurations, c) for c in range(n_c)]
        self._program = program_key("evaluate_lane", self.shared, self.lanes[0])
        self._on: dict[int, tuple[Any, CalibrationProblem]] = {}

    def with_space(self, space: ParameterSpace) -> "Evaluator":
        """Return an evaluator of the same lanes with another order, chart or pin."""
        other = copy(self)
        other.numbered = eqx.tree_at(lambda p: p.space, self.numbered, space)
        return other

    def with_noise(self, noise: CorrelatedNoise | None) -> "Evaluator":
        """Return an evaluator of the same lanes with another noise."""
        other = copy(self)
        other.problem = self.problem.with_noise(noise)
        other.numbered = self.numbered.with_noise(noise)
        return other

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Job[Evaluation]:
        """Compute equilibria, stacked errors and compliances W_ep (paper Eqs. 9, 10).

        Args:
            z: Scaled parameters [-].
            guess: Displacements to start from [m].
            before: Displacements of the equilibria that the guess extrapolates to first
                order, if it does [m].
            precise: Whether the compliances are exact, see `evaluate_lane`.
        """
        before = guess if before is None else before
        lanes = zip(self.lanes, guess, before, strict=True)
        jobs = [(z, *lane, jnp.asarray(precise)) for lane in lanes]
        found = yield Batch(self._evaluate, jobs, self._program)
        return _stacked(self.numbered, z, found)

    def from_rest(self, z: Float[Array, " n_p"]) -> Job[Evaluation]:
        """Evaluate without a guess from another evaluation, see `solve_from_rest`."""
        guess = at_rest(self.problem)
        if self.problem.model.mechanism.bodies.n_bodies > 0:
            posed = _posed(self.numbered.with_noise(None), z)
            found, _ = yield from simulate_lanes(*posed, self.problem.newton)
            guess = as_guess(found)
        return (yield from self(z, guess))

    def _evaluate(self, solver, lane) -> Response:
        # The solver is kept beside, so that its id is not given to another one.
        if id(solver) not in self._on:
            self._on[id(solver)] = solver, with_solver(self.shared, solver)
        shared = self._on[id(solver)][1]
        return jax.block_until_ready(_evaluate_lane(shared, *lane))


def evaluate(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> Evaluation:
    """Compute equilibria, stacked errors and W_ep (paper Eqs. 9, 10), on all cores.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        guess: Displacements to start from; by default as at the start of a fit [m].
    """
    evaluator = Evaluator(problem)
    job = evaluator.from_rest(z) if guess is None else evaluator(z, guess)
    with Workers(problem.model, problem.configurations.gravity.shape[0]) as workers:
        return workers.end_of(job)


@eqx.filter_jit
def _stacked(problem, z, lanes: list[Response]) -> Evaluation:
    return stacked(problem, z, jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes))


def with_solver(problem: CalibrationProblem, solver) -> CalibrationProblem:
    """Return the calibration with another sparse solver of its pattern."""
    return eqx.tree_at(lambda p: p.model.solver, problem, solver)


def lane_of(batch: T, index: int) -> T:
    """Return one lane of a batch."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))


def each_lane(
    problem: CalibrationProblem, function: Callable[..., T], lanes: Sequence[Any]
) -> Job[list[T]]:
    """Call a compiled function of model, parameters and a lane, for all lanes.

    Args:
        problem: The calibration, without names.
        function: Takes the model, the space and the values of a lane.
        lanes: Of one shape each.
    """
    where = lambda p: p.configurations
    shared = eqx.tree_at(where, problem.with_noise(None), None)

    def call(solver, lane):
        on = with_solver(shared, solver)
        return jax.block_until_ready(function(on.model, on.space, *lane))

    key = program_key(function.__name__, shared, lanes[0])
    return (yield Batch(call, lanes, key))
