"""The cantilever that the benchmarks share: a beam of tets under its own weight."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax import (
    Configuration,
    NeoHookean,
    Support,
    beam,
    build_model,
    solve_equilibrium,
)
from softcal_jax.configurations import ConfigurationArrays, configuration_arrays
from softcal_jax.equilibrium import EquilibriumSolution, Formulation, Model

GRAVITY = 9.81
"""Acceleration [m/s2], along -z, across the beam."""

DENSITY = 1070.0
"""Mass density of silicone [kg/m3]."""

solve = eqx.filter_jit(solve_equilibrium)
"""Equilibrium of one configuration, compiled."""


class Beam(NamedTuple):
    """A box with its long axis along x, clamped at x = 0.

    Attributes:
        size: Length, width and height [m].
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
    """

    size: tuple[float, float, float]
    E: float
    nu: float

    def lame(self) -> tuple[float, float]:
        """Lame's constants lambda and mu [Pa]."""
        E, nu = self.E, self.nu
        return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))

    def model(
        self,
        cells: tuple[int, int, int],
        *,
        order: int = 1,
        formulation: Formulation = "displacement",
        solver: str | None = None,
    ) -> Model:
        """The neo-Hookean body on a mesh of tets."""
        return build_model(
            beam(*self.size, cells, order=order),
            NeoHookean(self.E, self.nu),
            density=DENSITY,
            formulation=formulation,
            solver=solver,
        )


def own_weight(model: Model, lanes: int = 1) -> ConfigurationArrays:
    """Lanes of the same load: the beam under its own weight."""
    return configuration_arrays(
        model.mesh,
        [
            Configuration(f"weight {i}", [Support("x_min")], (0.0, 0.0, -GRAVITY))
            for i in range(lanes)
        ],
    )


def first_lane(lanes: ConfigurationArrays) -> ConfigurationArrays:
    """The first lane of a batch, without the leading axis."""
    return jax.tree.map(lambda leaf: leaf[0], lanes)


def equilibrium(model: Model, lane: ConfigurationArrays) -> EquilibriumSolution:
    """The converged equilibrium, ready.

    Raises:
        RuntimeError: If there is none.
    """
    solution = jax.block_until_ready(solve(model, lane))
    if not bool(solution.converged):
        raise RuntimeError(f"no equilibrium: {solution.result}")
    return solution


def nearest(points: np.ndarray, point: tuple[float, float, float]) -> int:
    """Index of the node that stands at a point.

    Raises:
        ValueError: If none does.
    """
    distance = np.linalg.norm(points - np.array(point), axis=1)
    if distance.min() > 1e-9:
        raise ValueError(f"no node at {point}; one is {distance.min():g} m off.")
    return int(np.argmin(distance))


def tip(size: tuple[float, float, float]) -> tuple[float, float, float]:
    """Centre of the free face [m]."""
    return size[0], size[1] / 2.0, size[2] / 2.0
