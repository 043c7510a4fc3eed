"""Configurations as lanes of one program, and their equilibria."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
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
    solve_equilibrium,
    solve_from_rest,
)

T = TypeVar("T")

STEPS_BETWEEN = 2
"""Newton iterations of a configuration between two reports."""

OfLane = Callable[[int, float, int], None]
"""Told the index of a configuration, the share of its load, and its iterations."""


def lane_of(batch: T, index: int | slice | Int[HostArray, " n"]) -> T:
    """Return one lane of a batch, or a batch of several."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))


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
    workers: Workers,
    model: Model,
    configurations: ConfigurationArrays,
    newton: NewtonSettings,
    guess: Float[Array, "n_c n_points 3"] | None = None,
    told: OfLane = lambda *_: None,
) -> tuple[EquilibriumSolution, Float[Array, "n_c n_rows 3"]]:
    """Simulate as `simulate` does, with configurations as lanes of one program.

    It is compiled once for any number of them, and the lanes share the cores. `told` is
    called at the end of each.
    """

    def ended(first: int, index: int, found) -> None:
        own = found[0]
        told(first + index, float(own.load_reached), int(own.steps))

    lanes = [lane_of(configurations, c) for c in range(len(configurations.gravity))]
    program = Program(_simulate_lane, model, newton.as_arrays())
    start = jax.device_put(np.zeros((model.n_points, 3)))
    if guess is None and model.mechanism.bodies.n_bodies > 0:
        found = []
        for c, lane in enumerate(lanes):
            found += workers.map(program, [(lane, start)], partial(ended, c))
            (last, _) = found[-1]
            start = jnp.where(last.converged, last.displacement, start)
    else:
        starts = [start] * len(lanes) if guess is None else guess
        every = zip(lanes, starts, strict=True)
        found = workers.map(program, every, partial(ended, 0))
    return jax.device_put(jax.tree.map(lambda *own: np.stack(own), *found))


def step_by_step(
    model: Model,
    lanes: Sequence[ConfigurationArrays],
    begin: Callable[[ConfigurationArrays, Float[Array, "n_points 3"]], Any],
    go_on: Callable[[Iterable[tuple[ConfigurationArrays, Any]]], list[Any]],
    *,
    max_steps: int | Int[Array | HostArray, ""],
    told: OfLane,
) -> EquilibriumSolution:
    """Solve equilibria a few iterations at a time, and report in between.

    With rigid bodies each starts from the one before, as in `solve_from_rest`.

    Args:
        model: The body.
        lanes: One per configuration.
        begin: Returns the state of Newton's method at a guess [m].
        go_on: Takes some iterations more, from configurations and their states to
            states and solutions.
        max_steps: Iterations after which a configuration is given up.
        told: Called after these iterations.
    """
    guess, n_c = jnp.zeros((model.n_points, 3)), len(lanes)
    each = [[c] for c in range(n_c)]
    groups = each if model.mechanism.bodies.n_bodies > 0 else [range(n_c)]
    found: dict[int, EquilibriumSolution] = {}
    for group in groups:
        states = {c: begin(lanes[c], guess) for c in group}
        while states:
            under_way = tuple(states)
            ends = go_on([(lanes[c], states[c]) for c in under_way])
            for c, (state, solution) in zip(under_way, ends, strict=True):
                told(c, float(state.load_ok), int(state.step))
                states[c], found[c] = state, solution
                if bool(state.done) or int(state.step) >= max_steps:
                    del states[c]
        last = found[group[-1]]
        guess = jnp.where(last.converged, last.displacement, guess)
    solutions = [found[c] for c in range(n_c)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *solutions)


@eqx.filter_jit
def _begin_lane(
    model: Model,
    newton: NewtonSettings,
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
):
    return begin_newton(model, configuration, guess, newton)


@eqx.filter_jit
def _go_on_lane(
    model: Model,
    newton: NewtonSettings,
    steps: Int[Array, ""],
    configuration: ConfigurationArrays,
    state: Any,
):
    return continue_newton(model, configuration, state, steps, newton)


def equilibria(
    model: Model,
    configurations: ConfigurationArrays,
    newton: NewtonSettings,
    told: OfLane = lambda *_: None,
) -> EquilibriumSolution:
    """Solve the equilibria of all configurations from rest, on all cores.

    Args:
        model: The body, with its parameters set.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
        told: Called after every few iterations.
    """
    lanes = [lane_of(configurations, c) for c in range(len(configurations.gravity))]
    shared = model, newton.as_arrays()
    program = Program(_go_on_lane, *shared, jnp.asarray(STEPS_BETWEEN))
    with Workers(model, len(lanes)) as workers:
        return step_by_step(
            model,
            lanes,
            partial(_begin_lane, *shared),
            partial(workers.map, program),
            max_steps=newton.max_steps,
            told=told,
        )


def as_guess(solution: EquilibriumSolution) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from, rest where there was no equilibrium [m]."""
    there = solution.converged[:, None, None]
    return jnp.where(there, solution.displacement, 0.0)
