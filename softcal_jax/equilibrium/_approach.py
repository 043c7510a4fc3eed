"""The way to an equilibrium from one that is known, through configurations between.

At the share s of the way from a configuration a to b, loads, imposed motions and
actuation are a + s (b - a). Each state begins where a parabola through the last three
leads: what turns far moves on a curve, and the tangent alone would stretch it. Steps
grow where few iterations are needed, and are halved where Newton's method fails. What
stops the straight way may lie beside a detour.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from scipy.spatial.distance import cdist

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._model import Nodal
from softcal_jax.equilibrium._path import WANTED_ITERATIONS
from softcal_jax.equilibrium._solve import EquilibriumSolution

_SMALLEST = 1.0 / 64.0  # step below which the way counts as ended [-]
_PARABOLA = 3  # states that the next one is extrapolated from


class Known(NamedTuple):
    """A configuration without effectors, and its equilibrium [m]."""

    configuration: ConfigurationArrays
    displacement: Nodal


class Approach(NamedTuple):
    """How far a way led [-], the equilibrium at its end, and Newton iterations."""

    share: float
    solution: EquilibriumSolution | None
    steps: int


def unloaded(configuration: ConfigurationArrays) -> Known:
    """Return the state at rest: nothing acts, and nothing that is held is moved."""
    loads = lambda c: (
        c.imposed,
        c.springs.rest,
        c.loads.force,
        c.gravity,
        c.actuation.value,
    )
    zeros = tuple(np.zeros(np.shape(leaf)) for leaf in loads(configuration))
    rest = eqx.tree_at(loads, configuration, zeros)
    return Known(rest, jax.device_put(np.zeros(np.shape(configuration.imposed))))


def distances(configurations: Sequence[ConfigurationArrays]) -> Float[HostArray, "n n"]:
    """Compute by how much what acts and is imposed differs [-].

    A number counts per the largest of its kind, an array by its root mean square. It is
    infinite where other coordinates are held, or actuators are imposed otherwise.
    """
    squares = np.zeros((len(configurations),) * 2)
    without_key = lambda c: jax.tree.leaves(eqx.tree_at(lambda c: c.key, c, None))
    for leaf in zip(*map(without_key, configurations), strict=True):
        rows = np.stack([np.ravel(values) for values in leaf])
        rows = rows[:, np.any(rows != rows[0], axis=0)]
        if rows.size == 0:
            continue
        if np.issubdtype(rows.dtype, np.floating):
            rows /= np.max(np.abs(rows), axis=0)
            squares += cdist(rows, rows, "sqeuclidean") / rows.shape[1]
        else:
            squares[cdist(rows, rows, "hamming") > 0.0] = np.inf
    return np.sqrt(squares)


def approach(
    at_once: Callable[[ConfigurationArrays, Nodal], EquilibriumSolution],
    known: Known,
    stops: Sequence[ConfigurationArrays],
    *,
    first: float,
    most: int,
    report: Callable[[float, int], None],
) -> Approach:
    """Follow the way from a known equilibrium to a configuration.

    Args:
        at_once: Solves a configuration from a guess, without load steps.
        known: Where the way begins.
        stops: Where it turns, and at last where it leads.
        first: First step towards each of them [-].
        most: Newton iterations after which it is given up.
        report: Called before each step with the share of the way, and the iterations.
    """
    from scipy.interpolate import KroghInterpolator  # slow to import

    begun, u, solution, taken = known.configuration, known.displacement, None, 0
    for k, stop in enumerate(stops):
        shares, states, step = [0.0], [np.asarray(u)], first
        while shares[-1] < 1.0:
            way = (k + shares[-1]) / len(stops)
            if step < _SMALLEST or taken >= most:
                return Approach(way, None, taken)
            report(way, taken)
            share = shares[-1] + step
            if 1.0 - share < 0.5 * step:  # a short rest costs as much as a step
                share = 1.0
            lane = stop if share == 1.0 else _between(begun, stop, share)
            last = KroghInterpolator(shares[-_PARABOLA:], states[-_PARABOLA:])
            solution = at_once(lane, jax.device_put(last(share)))
            iterations = int(solution.steps)
            taken += iterations
            if not solution.converged:
                step *= 0.5
                continue
            shares.append(share)
            states.append(np.asarray(solution.displacement))
            step *= float(np.clip(WANTED_ITERATIONS / iterations, 0.5, 2.0))
        begun, u = stop, states[-1]
    return Approach(1.0, solution, taken)


def detours(
    a: ConfigurationArrays, b: ConfigurationArrays
) -> list[tuple[ConfigurationArrays, ...]]:
    """List other ways from a to b, by where they turn, and their end.

    Of several actuators that differ, one changes after the other. If loads and
    something else differ, the loads change first, or last.
    """
    loads = lambda c: (c.loads.force, c.loads.factor, c.gravity, c.tilt)
    start, end = (np.asarray(c.actuation.value) for c in (a, b))
    order = np.cumsum(start != end)
    inputs = [np.where(order <= k, end, start) for k in range(1, order.max(initial=0))]
    turns = [
        [eqx.tree_at(lambda c: c.actuation.value, b, value) for value in inputs],
        [eqx.tree_at(lambda c: (c.key, *loads(c)), a, (b.key, *loads(b)))],
        [eqx.tree_at(loads, b, loads(a))],
    ]
    differ = lambda turn: np.all(distances([a, b, turn])[2, :2] > 0.0)
    return [(*jax.device_put(way), b) for way in turns if way and all(map(differ, way))]


def _between(
    a: ConfigurationArrays, b: ConfigurationArrays, share: float
) -> ConfigurationArrays:
    """Return a configuration between two that hold and impose the same."""

    def blend(a: Array | HostArray, b: Array | HostArray) -> HostArray:
        a, b = np.asarray(a), np.asarray(b)  # on the device, each shape is compiled
        return a + share * (b - a) if np.issubdtype(b.dtype, np.floating) else b

    return jax.device_put(jax.tree.map(blend, a, b))
