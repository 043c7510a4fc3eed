"""A calibration as arrays: its lanes, their equilibria, and its linear model."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration._noise import CorrelatedNoise, noise_columns
from softcal_jax.configurations import Configuration, ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    Program,
    Workers,
    begin_newton,
    continue_newton,
    effector_values,
)
from softcal_jax.fields import ParameterSpace, unnamed
from softcal_jax.inference import (
    ErrorColumns,
    LinearModel,
    Whitened,
    no_errors,
    span,
    whitened_rows,
)

T = TypeVar("T")

STEPS_BETWEEN = 2
"""Newton iterations of a configuration between two reports."""

Report = Callable[[int, float, int], None]
"""Takes the index of a configuration, the share of its load, and its iterations."""


def lane_of(batch: T, index: int | slice | Int[HostArray, " n"]) -> T:
    """Return one lane of a batch, or a batch of several."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))


def _lanes_of(batch: ConfigurationArrays) -> list[ConfigurationArrays]:
    return [lane_of(batch, c) for c in range(len(batch.gravity))]


def stacked(lanes: Sequence[T]) -> T:
    """Return lanes as a batch, without a program for each number of them."""
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *lanes))


@eqx.filter_jit
def _begin(
    model: Model,
    newton: NewtonSettings,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
):
    return begin_newton(model, configuration, guess, newton)


@eqx.filter_jit
def _go_on(
    model: Model,
    newton: NewtonSettings,
    steps: Int[Array, ""],
    configuration: ConfigurationArrays,
    state: Any,
):
    return continue_newton(model, configuration, state, steps, newton)


def equilibria(
    workers: Workers,
    model: Model,
    configurations: ConfigurationArrays,
    newton: NewtonSettings,
    *,
    guess: Float[Array, "n_c n_points 3"] | None = None,
    report: Report | None = None,
) -> EquilibriumSolution:
    """Solve the equilibria of all configurations on all cores.

    One of three ways to solve a batch. The others are `solve_from_rest`, inside a
    compiled or differentiated program, and `Evaluator`, which adds the errors and
    compliances of a calibration.

    Args:
        workers: Run the configurations, by a program that is compiled once for any
            number of them.
        model: The body, with its parameters set.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
        guess: Displacements to start from [m]; by default rest, and with rigid bodies
            for each configuration the one before, as in `solve_from_rest`.
        report: Called after every few iterations of a configuration.
    """
    lanes, settings = _lanes_of(configurations), newton.as_arrays()
    most = int(newton.max_steps)
    steps = jnp.asarray(most if report is None else STEPS_BETWEEN)
    program = Program(_go_on, model, settings, steps)
    solutions: dict[int, EquilibriumSolution] = {}

    def solve(starts: dict[int, Float[Array, "n_points 3"]]) -> None:
        """Solve the configurations with these indices, from these displacements."""
        states = {
            c: _begin(model, settings, lanes[c], start) for c, start in starts.items()
        }
        while states:
            under_way = list(states)
            ends = workers.map(program, [(lanes[c], states[c]) for c in under_way])
            for c, (state, solution) in zip(under_way, ends, strict=True):
                if report is not None:
                    report(c, float(state.load_ok), int(state.step))
                states[c], solutions[c] = state, solution
                if bool(state.done) or int(state.step) >= most:
                    del states[c]

    rest = jnp.zeros((model.n_points, 3))
    if guess is not None:
        solve(dict(enumerate(guess)))
    elif model.mechanism.bodies.n_bodies > 0:
        start = rest
        for c in range(len(lanes)):
            solve({c: start})
            last = solutions[c]
            start = jnp.where(last.converged, last.displacement, start)
    else:
        solve(dict.fromkeys(range(len(lanes)), rest))
    return stacked([solutions[c] for c in range(len(lanes))])


_effectors_of_lane = eqx.filter_jit(effector_values)


def effectors_on_all_cores(
    workers: Workers,
    model: Model,
    configurations: ConfigurationArrays,
    solution: EquilibriumSolution,
) -> Float[Array, "n_c n_rows 3"]:
    """Compute effector coordinates as `effectors_of` does, on all cores."""
    states = solution.displacement, solution.multipliers
    lanes = zip(_lanes_of(configurations), *map(np.asarray, states), strict=True)
    return stacked(workers.map(Program(_effectors_of_lane, model), lanes))


def effectors_of(
    model: Model, configurations: ConfigurationArrays, solution: EquilibriumSolution
) -> Float[Array, "n_c n_rows 3"]:
    """Compute the effector coordinates of a batch, inside a compiled program too."""
    values = lambda c, u, forces: effector_values(model, c, u, forces)
    states = solution.displacement, solution.multipliers
    return jax.vmap(values)(configurations, *states)


def as_guess(solution: EquilibriumSolution) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from, rest where there was no equilibrium [m]."""
    converged = solution.converged[:, None, None]
    return jnp.where(converged, solution.displacement, 0.0)


class CalibrationProblem(Module):
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

    def noise_columns(self) -> Float[Array, "n_e n_columns"]:
        """Return A of the noise in a program, see `CorrelatedNoise` [-]."""
        effectors = self.configurations.effectors
        if self.noise is None:
            return jnp.zeros((effectors.inverse_std.size, 0))
        return jnp.asarray(self.noise.columns(effectors))

    def rows(
        self,
        z: Float[Array, " n_p"],
        delta_e: Float[Array, "n_c n_rows 3"],
        compliance: Float[Array, "n_e n_p"],
    ) -> Whitened:
        """Return errors and their derivatives in units of the noise, priors behind.

        The QP of Eq. (10) is of these rows.

        Args:
            z: Scaled parameters [-].
            delta_e: Simulated minus measured values.
            compliance: W_ep in the units of the effectors.
        """
        weight = jnp.ravel(jnp.asarray(self.configurations.effectors.inverse_std))
        return whitened_rows(
            self.noise_columns(),
            error=weight * jnp.ravel(delta_e),
            W=weight[:, None] * compliance,
            from_prior=jnp.asarray(self.level) * self.space.from_prior(z),
            prior_weights=jnp.asarray(self.level) * self.space.prior_weights(),
        )

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Factor on the stated standard deviations that an error of one stands for [-].

        Errors count in stated units whatever the noise is found to be, so that what is
        added to their squares must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def of_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the first few configurations."""
        of_lanes = self.with_noise(None).of_lanes(slice(n))
        return of_lanes.with_noise(self.noise and self.noise.of_first(n))

    def without_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the others, without a noise."""
        return self.with_noise(None).of_lanes(slice(n, None))

    def of_lanes(self, which: slice) -> "CalibrationProblem":
        """Return the calibration to some configurations; it must have no noise."""
        some = lane_of(self.configurations, which)
        return eqx.tree_at(lambda p: p.configurations, self, some)

    def with_noise(self, noise: CorrelatedNoise | None) -> "CalibrationProblem":
        """Return the calibration with another noise."""
        where = lambda p: p.noise
        return eqx.tree_at(where, self, noise, is_leaf=lambda leaf: leaf is None)


def without_names(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the calibration without what would compile other programs.

    These are names, and settings that are no arrays.
    """
    own = unnamed(problem.space), problem.newton.as_arrays()
    return eqx.tree_at(lambda p: (p.space, p.newton), problem, own)


def n_measured(problem: CalibrationProblem) -> int:
    """Return the number of measured coordinates, less those that find mountings."""
    effectors, noise = problem.configurations.effectors, problem.noise
    n = int(np.sum(np.asarray(effectors.inverse_std) > 0.0))
    if noise is None:
        return n
    return n - span(noise.on_host(effectors)[:, noise.n_common :]).shape[1]


def linear_model(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    *,
    z: Float[Array, " n_p"],
    W_ep: Float[Array | HostArray, "n_c n_e n_p"],
    ok: Sequence[bool] | Bool[Array, " n_c"],
    delta_e: Float[Array | HostArray, "n_c n_rows 3"],
    rows: Whitened | None = None,
    n_fitted: int | None = None,
    considered: ErrorColumns | None = None,
) -> LinearModel:
    """Make the linear model of measured coordinates, in stated standard deviations.

    Rows of a held-out configuration that has no equilibrium, or no regular tangent, are
    left out.

    Args:
        problem: The calibration, with the noise that weighed its data.
        configurations: Its configurations.
        z: Scaled parameters [-].
        W_ep: Compliances there, in the units of the effectors.
        ok: Which configurations have an equilibrium with a regular tangent.
        delta_e: Simulated minus measured values.
        rows: Rows of the fit, of which the last are the distances from the priors; none
            where nothing was fitted.
        n_fitted: Number of configurations that were fitted, which come first; all by
            default.
        considered: Errors that are considered, of all rows; none by default.
    """
    space, n_c, level = problem.space, len(configurations), float(problem.level)
    from_prior = np.zeros(len(space.names))
    if rows is not None:
        from_prior = np.asarray(rows.error)[-len(from_prior) :] / level
    n_fitted = n_c if n_fitted is None else n_fitted
    effectors = problem.configurations.effectors
    weight = np.asarray(effectors.inverse_std)
    considered = no_errors(weight.size) if considered is None else considered
    n_doubts = considered.values.shape[1]
    doubts = considered.values.reshape(n_c, weight[0].size, n_doubts)
    regular = np.asarray(ok) & np.isfinite(doubts).all(axis=(1, 2))
    used = regular | (np.arange(n_c) < n_fitted)
    measured = ((weight > 0.0) & used[:, None, None]).ravel()
    pose = np.repeat(np.arange(n_c), weight[0].size)
    whole = LinearModel(
        names=tuple(space.names),
        poses=tuple(c.name for c in configurations),
        pose=pose,
        fitted=pose < n_fitted,
        r=np.ravel(weight * np.asarray(delta_e)),
        W=weight.reshape(-1, 1) * np.concatenate(np.asarray(W_ep)),
        correlated=noise_columns(problem.noise, effectors, configurations),
        considered=considered,
        scale=level,
        from_prior=from_prior,
        prior_weights=np.asarray(space.prior_weights()),
        held=space.at_bound(z),
    )
    return whole.only(measured)
