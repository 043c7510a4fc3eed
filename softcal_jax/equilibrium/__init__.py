"""Static equilibrium: model, tangent, sparse solver, Newton (paper Eqs. 1 to 3)."""

from softcal_jax._results import RESULTS
from softcal_jax.equilibrium._assembly import (
    add_weighted,
    energy_and_force,
    field_forces,
    gravity_load,
    internal_force,
    strain_energy,
    tangent_values,
)
from softcal_jax.equilibrium._continuation import Continuation, continue_equilibrium
from softcal_jax.equilibrium._lanes import lane_by_lane
from softcal_jax.equilibrium._linear_solver import LinearSolution
from softcal_jax.equilibrium._model import Model, build_model
from softcal_jax.equilibrium._newton import NewtonSettings
from softcal_jax.equilibrium._problem import external_force
from softcal_jax.equilibrium._solve import (
    EquilibriumSolution,
    check_converged,
    factor_solve,
    marker_positions,
    residual,
    solve_equilibrium,
)

__all__ = [
    "RESULTS",
    "Continuation",
    "EquilibriumSolution",
    "LinearSolution",
    "Model",
    "NewtonSettings",
    "add_weighted",
    "build_model",
    "check_converged",
    "continue_equilibrium",
    "energy_and_force",
    "external_force",
    "factor_solve",
    "field_forces",
    "gravity_load",
    "internal_force",
    "lane_by_lane",
    "marker_positions",
    "residual",
    "solve_equilibrium",
    "strain_energy",
    "tangent_values",
]
