"""Robots of bodies and actuators that the tests of this folder share."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import (
    RESULTS,
    Model,
    NewtonSettings,
    _solve,
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
    solution, values = solve(model, lane, guess, settings)
    assert bool(solution.converged), RESULTS[solution.result]
    return solution, np.array(values), lane


def values_of(model, lane, guess, where, new):
    """Effectors' coordinates as a function of one part of (model, lane)."""
    model, lane = eqx.tree_at(where, (model, lane), jax.tree.map(jnp.asarray, new))
    return solve(model, lane, guess, TIGHT)[1]


def both_ways_at(function):
    """Make one program of a function's derivatives, forward and reverse.

    Its equilibrium is known: half of such a program would be Newton's loop, which is
    not differentiated.

    Args:
        function: Takes `x` and any other arrays, which are held.

    Returns:
        A compiled function of (solution, x, tangent, cotangent, *others): slope along
        the tangent, and pull-back.
    """

    @jax.jit
    def of(solution, x, tangent, cotangent, *others):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_solve, "_solved", lambda *_: solution)
            # What is traced here must not be kept for others.
            patch.setattr(_solve, "_compiled_equilibrium", _solve._equilibrium)
            _, along = jax.linearize(lambda x: function(x, *others), x)
        (reverse,) = jax.linear_transpose(along, x)(cotangent)
        return along(tangent), reverse

    return of


def positions(model: Model, solution) -> np.ndarray:
    """Where all nodes are, those of the bodies' frames last [m]."""
    return np.asarray(model.mechanism.points + solution.displacement)
