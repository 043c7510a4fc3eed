"""Robots of bodies and actuators that the tests of this folder share."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from problems import lane_of

from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import (
    RESULTS,
    Model,
    NewtonSettings,
    compiled_effectors,
    solve_equilibrium,
)
from softcal_jax.mesh import TetMesh, beam

LENGTH, SIDE = 0.12, 0.02
NO_GRAVITY = (0.0, 0.0, 0.0)
# The discretised equations solved to rounding, for derivatives by differences.
TIGHT = NewtonSettings(rtol=1e-12)


def strip(cells: int = 6, order: int = 1) -> TetMesh:
    """A beam along x whose cross-sections are groups: "at 0", "at 1", ... cells."""
    mesh = beam(LENGTH, SIDE, SIDE, (cells, 1, 1), order=order)
    x = mesh.points[:, 0] * cells / LENGTH
    at = {f"at {k}": np.flatnonzero(np.isclose(x, k)) for k in range(cells + 1)}
    return TetMesh(
        mesh.points,
        mesh.tets,
        node_groups={**mesh.node_groups, **at},
        surface_groups=mesh.surface_groups,
    )


def arrays(model: Model, configuration: Configuration):
    """One configuration as arrays."""
    stacked = configuration_arrays(model.mesh, [configuration], model.mechanism)
    return lane_of(stacked)


def solve(model, lane, guess, settings):
    """Equilibrium of one configuration, and its effectors' coordinates."""
    solution = solve_equilibrium(model, lane, guess=guess, settings=settings)
    state = solution.displacement, solution.multipliers
    return solution, compiled_effectors(model, lane, *state)


def solved(
    model: Model,
    configuration: Configuration,
    settings: NewtonSettings = NewtonSettings(),  # noqa: B008 (it is immutable)
    guess=None,
):
    """Converged equilibrium, effectors' coordinates, and the arrays of it."""
    lane = arrays(model, configuration)
    guess = jnp.zeros((model.n_points, 3)) if guess is None else guess
    solution, values = solve(model, lane, guess, settings)
    assert bool(solution.converged), RESULTS[solution.result]
    return solution, np.array(values), lane


def values_of(model, lane, guess, where, new):
    """Effectors' coordinates as a function of one part of (model, lane)."""
    model, lane = eqx.tree_at(where, (model, lane), new)
    return solve(model, lane, guess, TIGHT)[1]


def positions(model: Model, solution) -> np.ndarray:
    """Where all nodes are, those of the bodies' frames last [m]."""
    return np.asarray(model.mechanism.points + solution.displacement)
