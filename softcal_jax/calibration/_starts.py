"""Random starts of a calibration, and the result of a search from many starts."""

import equinox as eqx
import jax
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.calibration._runs import best_of
from softcal_jax.fields import ParameterSpace, unnamed


class Optimum(eqx.Module):
    """A point at which converged runs end.

    Attributes:
        cost: Half the sum of squared errors in noise units [-].
        values: Parameters, in SI units.
        starts: Indices of the starts that end here.
    """

    cost: float
    values: dict[str, float]
    starts: tuple[int, ...]


class MultiStartResult(eqx.Module):
    """Result of a search from many starts.

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
        """Index of the lowest cost, among the converged runs if any is."""
        return best_of(self.cost, self.converged)

    def __str__(self) -> str:
        """Write one line per optimum, and the runs that found none."""
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


# One start at a time, so that the program does not depend on the number of starts.
_to_scaled = eqx.filter_jit(lambda space, p: space.admissible(space.to_scaled(p)))


def random_starts(
    space: ParameterSpace, n: int, *, seed: int = 0
) -> Float[Array, "n p"]:
    """Draw random parameters within the bounds, uniform in SI units.

    Args:
        space: The parameters.
        n: Number of starts.
        seed: Seed.

    Returns:
        Scaled parameters; pairs that break their order are swapped.

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
    for small, large in pairs * len(pairs):  # repeated, for chains a <= b <= c
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
