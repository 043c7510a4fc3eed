"""Configurations as lanes of one program, and their equilibria."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.configurations import ConfigurationArrays
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
