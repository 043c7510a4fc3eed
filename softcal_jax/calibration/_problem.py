"""A calibration as arrays: its lanes, their equilibria, and its linear model."""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._module import Module, one_line
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration._noise import CorrelatedNoise, noise_columns
from softcal_jax.calibration._qp import DAMPING
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

MOST_STEPS = 1_000_000
"""Largest `max_steps`: the history of every run has room for so many."""

STEPS_BETWEEN = 2
"""Newton iterations of a configuration between two reports."""

FORESEEN_S = 5.0
"""Time after which the share of the load tells how long an equilibrium takes [s]."""

Report = Callable[[int, float, int], None]
"""Takes the index of a configuration, the share of its load, and its iterations."""


class EquilibriumProgress(NamedTuple):
    """Progress of an equilibrium from rest: Newton iterations and seconds so far.

    `load` is the share of the load that is carried, `stiffer` the factor on the moduli
    of the start [-].
    """

    configuration: str
    load: float
    steps: int
    stiffer: float
    seconds: float

    __repr__ = one_line

    def __str__(self) -> str:
        """Write it in one line."""
        text = (
            f"equilibrium of {self.configuration}: {100.0 * self.load:.0f} % of the "
            f"load, step {self.steps}"
        )
        if self.stiffer > 1.0:
            text += f", moduli {self.stiffer:g} times the start"
        if self.seconds > FORESEEN_S and 0.0 < self.load < 1.0:
            left = self.seconds * (1.0 - self.load) / self.load
            text += f", about {left:.0f} s left"
        return text


def reports_of(
    progress: Callable[[EquilibriumProgress], None] | None,
    names: Sequence[str],
    factor: float = 1.0,
) -> Report | None:
    """Return a report for `equilibria`, which knows configurations by index alone."""
    if progress is None:
        return None
    begun: dict[int, float] = {}

    def report(c: int, load: float, steps: int) -> None:
        now = time.monotonic()
        seconds = now - begun.setdefault(c, now)
        progress(EquilibriumProgress(names[c], load, steps, factor, seconds))

    return report


def _lanes_of(batch: ConfigurationArrays) -> list[ConfigurationArrays]:
    return [lane_of(batch, c) for c in range(len(batch.gravity))]


_begin = eqx.filter_jit(begin_newton)


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

    The program is compiled once for any number of lanes. `solve_from_rest` solves a
    batch inside a compiled or differentiated program, and `Evaluator` adds the errors
    and compliances of a calibration.

    By default each begins at rest, with rigid bodies at the configuration before, as in
    `solve_from_rest`. `report` is called after every few iterations of one of them.
    """
    lanes, settings = _lanes_of(configurations), newton.as_arrays()
    most = int(newton.max_steps)
    steps = jnp.asarray(most if report is None else STEPS_BETWEEN)
    program = Program(_go_on, model, settings, steps)
    solutions: dict[int, EquilibriumSolution] = {}

    def solve(starts: dict[int, Float[Array, "n_points 3"]]) -> None:
        states = {
            c: _begin(model, lanes[c], start, settings) for c, start in starts.items()
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
    states = solution.displacement, solution.multipliers
    return jax.vmap(partial(effector_values, model))(configurations, *states)


def as_guess(solution: EquilibriumSolution) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from, rest where there was no equilibrium [m]."""
    converged = solution.converged[:, None, None]
    return jnp.where(converged, solution.displacement, 0.0)


class CalibrationSettings(Module):
    """Settings of the outer loop.

    Attributes:
        tol: Largest entry of lambda_p at which the loop stops, without that step; with
            `adapt` also where it would lower the cost by less than `SMALLEST_FALL` [-].
        max_steps: Steps after which it gives up.
        step_bound: First bound on every entry of lambda_p; 1 is a factor e on a log
            scale and the whole range on a linear one [-].
        max_step_bound: Largest bound on a step; beyond a factor of two the linear model
            says little, and the guess of the equilibria is poor [-].
        damping: Levenberg damping of the QP, for columns of W of unit length. It holds
            back directions that the data hardly see, without moving the minimum [-].
        adapt: Adapt the bound, refuse steps that do not help over `MEMORY` steps, and
            learn the curvature of the errors. Without it, every step is that of the
            linear model within a fixed bound, as in the paper.
    """

    tol: float = eqx.field(static=True, default=1e-6)
    max_steps: int = eqx.field(static=True, default=50)
    step_bound: float = eqx.field(static=True, default=0.3)
    max_step_bound: float = eqx.field(static=True, default=0.5)
    damping: float = eqx.field(static=True, default=DAMPING)
    adapt: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not 0.0 < self.tol < 1.0:
            raise ValueError(f"tol must lie in (0, 1), got {self.tol}.")
        if not 1 <= self.max_steps <= MOST_STEPS:
            raise ValueError(
                f"max_steps must lie between 1 and {MOST_STEPS}, got {self.max_steps}."
            )
        if not 0.0 < self.damping <= 1.0:
            # More, and every step would be too short to tell from none.
            raise ValueError(f"damping must lie in (0, 1], got {self.damping}.")
        for name in ("step_bound", "max_step_bound"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}.")


class CalibrationProblem(Module):
    """Model, parameters and a batch of configurations that share them.

    Without a `noise` the errors are independent, with the standard deviations of the
    effectors.
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

    def rows(
        self,
        z: Float[Array, " n_p"],
        delta_e: Float[Array, "n_c n_rows 3"],
        compliance: Float[Array, "n_e n_p"],
    ) -> Whitened:
        """Return errors and their derivatives in units of the noise, priors behind.

        The QP of Eq. (10) is of these rows; the compliance is W_ep.
        """
        effectors = self.configurations.effectors
        weight = jnp.ravel(jnp.asarray(effectors.inverse_std))
        columns = jnp.zeros((weight.size, 0))
        if self.noise is not None:
            columns = jnp.asarray(self.noise.columns(effectors))
        return whitened_rows(
            columns,
            error=weight * jnp.ravel(delta_e),
            W=weight[:, None] * compliance,
            from_prior=jnp.asarray(self.level) * self.space.from_prior(z),
            prior_weights=jnp.asarray(self.level) * self.space.prior_weights(),
        )

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Factor on the stated standard deviations that an error of one stands for [-].

        What is added to the squares of errors must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def of_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the first few configurations."""
        return self._of(slice(n)).with_noise(self.noise and self.noise.of_first(n))

    def without_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the others, without a noise."""
        return self._of(slice(n, None))

    def _of(self, lanes: slice) -> "CalibrationProblem":
        some = lane_of(self.configurations, lanes)
        return eqx.tree_at(lambda p: p.configurations, self.with_noise(None), some)

    def with_noise(self, noise: CorrelatedNoise | None) -> "CalibrationProblem":
        """Return the calibration with another noise."""
        where = lambda p: p.noise
        return eqx.tree_at(where, self, noise, is_leaf=lambda leaf: leaf is None)


def without_names(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the calibration without names and settings that compile other programs."""
    without = unnamed(problem.space), problem.newton.as_arrays()
    return eqx.tree_at(lambda p: (p.space, p.newton), problem, without)


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

    The problem has the noise that weighed its data. Rows of a held-out configuration
    that is not `ok`, without an equilibrium or a regular tangent, are left out. The
    last `rows` of a fit are the distances from the priors; there are none where nothing
    was fitted. The first `n_fitted` configurations were fitted, by default all.
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
