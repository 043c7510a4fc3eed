"""Configurations as lanes of one program, and their equilibria."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Batch,
    EquilibriumSolution,
    Job,
    Model,
    NewtonSettings,
    effector_values,
    program_key,
    solve_equilibrium,
    solve_from_rest,
)

T = TypeVar("T")


def lane_of(batch: T, index: int | Int[HostArray, " n"]) -> T:
    """Return one lane of a batch, or a batch of several."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))


def each_lane(
    function: Callable[..., T], shared: tuple[Any, ...], lanes: Sequence[Any]
) -> Job[list[T]]:
    """Call a compiled function for all lanes, which share the cores.

    Args:
        function: Takes what is shared and the values of a lane.
        shared: What all lanes share, without names, the model first.
        lanes: Of one shape each.
    """
    model, *others = shared

    def call(solver, lane):
        own = eqx.tree_at(lambda m: m.solver, model, solver)
        return jax.block_until_ready(function(own, *others, *lane))

    key = program_key(function.__name__, shared, lanes[0])
    return (yield Batch(call, lanes, key))


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
    each = partial(each_lane, _simulate_lane, (model, newton.as_arrays()))
    start = jax.device_put(np.zeros((model.n_points, 3)))
    if guess is None and model.mechanism.bodies.n_bodies > 0:
        found = []
        for lane in lanes:
            found += yield from each([(lane, start)])
            (last, _) = found[-1]
            start = jnp.where(last.converged, last.displacement, start)
    else:
        starts = [start] * len(lanes) if guess is None else guess
        found = yield from each(list(zip(lanes, starts, strict=True)))
    return jax.device_put(jax.tree.map(lambda *own: np.stack(own), *found))


def as_guess(solution: EquilibriumSolution) -> Float[Array, "n_c n_points 3"]:
    """Return displacements to start from, rest where there was no equilibrium [m]."""
    there = solution.converged[:, None, None]
    return jnp.where(there, solution.displacement, 0.0)
