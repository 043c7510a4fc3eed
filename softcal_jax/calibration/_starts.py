"""Calibration from many starts, and the distinct optima that they end in."""

import equinox as eqx
import jax
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration._descent import run_start
from softcal_jax.calibration._evaluator import Evaluator, with_solver
from softcal_jax.calibration._problem import CalibrationProblem, without_names
from softcal_jax.calibration._runs import Run, run_starts
from softcal_jax.calibration._state import CalibrationSettings
from softcal_jax.equilibrium import Workers, program_key, usable_cores
from softcal_jax.fields import ParameterSpace, unnamed

SAME_OPTIMUM = 1e-3
"""Largest difference of scaled parameters within one optimum [-]."""


FROM_ANYWHERE = CalibrationSettings(max_steps=12)
"""Settings of runs from many starts: one that leads to the optimum is quick."""


class Optimum(eqx.Module):
    """A point in which converged runs end.

    Attributes:
        cost: Half the sum of squared errors in noise units [-].
        values: Parameters, in SI units.
        starts: Numbers of the starts that end here, from 0.
    """

    cost: float
    values: dict[str, float]
    starts: tuple[int, ...]


class MultiStartResult(eqx.Module):
    """Outcome of a calibration from many starts.

    Attributes:
        names: Names of the parameters.
        starts: Where the runs began, in SI units.
        values: Where they ended, in SI units.
        z: The same, scaled [-].
        cost: Half the sum of squared errors in noise units; infinite where the start
            has no equilibrium [-].
        steps: QP steps of each run.
        converged: Whether lambda_p vanished.
        errors: Size of the stacked error after each step, in noise units [-].
        optima: Distinct ends of the converged runs, the lowest cost first.
    """

    names: tuple[str, ...]
    starts: Float[HostArray, "n_starts n_p"]
    values: Float[HostArray, "n_starts n_p"]
    z: Float[HostArray, "n_starts n_p"]
    cost: Float[HostArray, " n_starts"]
    steps: Int[HostArray, " n_starts"]
    converged: Bool[HostArray, " n_starts"]
    errors: Float[HostArray, "n_starts n_steps"]
    optima: tuple[Optimum, ...]

    @property
    def best(self) -> int:
        """Number of the run with the lowest cost, among the converged if any is."""
        cost = np.where(self.converged, self.cost, np.inf)
        return int(np.argmin(cost if np.any(self.converged) else self.cost))

    def __str__(self) -> str:
        """One line per optimum, and the runs that found none."""
        n = len(self.cost)
        lines = [
            f"{n} starts, {int(self.converged.sum())} converged, "
            f"{len(self.optima)} distinct optima."
        ]
        for optimum in self.optima:
            values = ", ".join(f"{k} {v:.4g}" for k, v in optimum.values.items())
            lines.append(
                f"  cost {optimum.cost:.3g} from {len(optimum.starts)} starts: {values}"
            )
        unfinished = np.flatnonzero(~self.converged & np.isfinite(self.cost))
        if unfinished.size:
            lines.append(
                f"  {unfinished.size} not converged (starts "
                f"{', '.join(map(str, unfinished))}), lowest cost "
                f"{self.cost[unfinished].min():.3g}."
            )
        lost = np.flatnonzero(np.isinf(self.cost))
        if lost.size:
            lines.append(
                f"  {lost.size} without equilibrium at the start (starts "
                f"{', '.join(map(str, lost))})."
            )
        return "\n".join(lines)


_run_starts = eqx.filter_jit(run_starts)
# One start at a time, so that the programs serve any number of them.
_to_scaled = eqx.filter_jit(lambda space, p: space.admissible(space.to_scaled(p)))
_from_scaled = eqx.filter_jit(lambda space, z: space.from_scaled(z))
_distance = eqx.filter_jit(lambda space, a, b: space.distance(a, b))


def multi_start(
    problem: CalibrationProblem,
    starts: int | Float[Array, "n_starts n_p"] = 30,
    *,
    seed: int = 0,
    settings: CalibrationSettings | None = None,
    mirror: bool = True,
) -> MultiStartResult:
    """Calibrate from many starts, side by side, and list the distinct optima.

    Args:
        problem: The calibration, from `build_problem`.
        starts: Scaled parameters to start from, or how many random ones.
        seed: Seed of the random ones.
        settings: Settings of the outer loop; by default no more than 12 steps for each
            image, since one that leads to the optimum is quick.
        mirror: Whether runs go on from their mirror images, see `run_starts`.

    Returns:
        All runs and their optima.

    Raises:
        ValueError: If there are no starts, or they do not fit the parameters.
        RuntimeError: If no start has an equilibrium.
    """
    space, numbered = problem.space, without_names(problem)
    if isinstance(starts, int):
        starts = random_starts(space, starts, seed=seed)
    if starts.ndim != 2 or starts.shape[1] != len(space.names) or not len(starts):
        raise ValueError(
            f"starts must have the shape (number, {len(space.names)}), at least one; "
            f"got {starts.shape}."
        )
    runs = _side_by_side(numbered, settings or FROM_ANYWHERE, starts, mirror)
    if not np.any(np.isfinite(runs.cost)):
        raise RuntimeError(
            f"none of {len(starts)} starts has an equilibrium in every configuration: "
            "check loads, units and bounds, or `softcal simulate`."
        )
    # Rows on the host: their number, too, would belong to a program.
    in_si = lambda rows: np.stack(
        [_from_scaled(numbered.space, row) for row in np.asarray(rows)]
    )
    values, z = in_si(runs.z), np.asarray(runs.z)
    cost, converged = np.asarray(runs.cost), np.asarray(runs.converged)
    return MultiStartResult(
        names=tuple(space.names),
        starts=in_si(starts),
        values=values,
        z=z,
        cost=cost,
        steps=np.asarray(runs.steps),
        converged=converged,
        errors=np.asarray(runs.errors),
        optima=_optima(space, z, values, cost, converged),
    )


def _side_by_side(problem, settings, starts, mirror: bool) -> Run:
    """The runs from all starts.

    Each, a batch of one, goes to the next free core; where there are fewer than cores,
    it is their configurations that do.
    """
    n_c = problem.configurations.gravity.shape[0]
    if len(starts) < min(usable_cores(), n_c):
        with Workers(problem.model, n_c) as workers:
            evaluate = Evaluator(problem, workers)
            ends = [run_start(evaluate, settings, z, mirror=mirror) for z in starts]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *ends)

    def run(solver, start) -> Run:
        found = _run_starts(
            with_solver(problem, solver), settings, start[None], mirror=mirror
        )
        return jax.block_until_ready(found)

    with Workers(problem.model, len(starts)) as workers:
        key = program_key("run_starts", problem, settings, mirror)
        runs = workers.map(run, np.asarray(starts), key)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *runs)


def _optima(space, z, values, cost, converged) -> tuple[Optimum, ...]:
    """Converged runs put together by where they end, the lowest cost first."""
    found: list[tuple[int, list[int]]] = []
    numbered = unnamed(space)
    for i in np.argsort(cost):
        if not converged[i]:
            continue
        for first, members in found:
            # Wrapped: an angle just below 90 degrees is close to one above -90.
            if np.max(_distance(numbered, z[i], z[first])) <= SAME_OPTIMUM:
                members.append(int(i))
                break
        else:
            found.append((int(i), [int(i)]))
    return tuple(
        Optimum(
            float(cost[first]),
            dict(zip(space.names, map(float, values[first]), strict=True)),
            tuple(sorted(members)),
        )
        for first, members in found
    )


def random_starts(
    space: ParameterSpace, n: int, *, seed: int = 0
) -> Float[Array, "n p"]:
    """Random parameters in the whole bounds, uniform in SI units, in the right order.

    Args:
        space: The parameters.
        n: How many.
        seed: Seed.

    Returns:
        Scaled parameters; a pair that breaks the order is swapped.

    Raises:
        ValueError: If n is less than one.
    """
    if n < 1:
        raise ValueError(f"the number of starts must be at least 1, got {n}.")
    random = np.random.default_rng(seed)
    low, high = (
        np.asarray(space.from_scaled(z)) for z in (space.lower(), space.upper())
    )
    p = low + (high - low) * random.random((n, len(low)))
    pairs = _ordered_columns(space)
    for small, large in pairs * len(pairs):  # over and over, for chains a <= b <= c
        p[:, [small, large]] = np.sort(p[:, [small, large]], axis=1)
        p = np.clip(p, low, high)
    numbered = unnamed(space)
    return jax.device_put(np.stack([_to_scaled(numbered, row) for row in p]))


def _ordered_columns(space: ParameterSpace) -> list[tuple[int, int]]:
    names = space.names
    pairs = [
        (names.index(small), names.index(large))
        for small, large in space.order_names()
        if small in names and large in names
    ]
    chart = space.chart
    if chart is not None:
        pairs += list(zip(map(int, chart.small), map(int, chart.large), strict=True))
    return pairs
