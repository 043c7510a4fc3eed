"""Static equilibrium: model, tangent, sparse solver, Newton (paper Eqs. 1 to 3)."""

from softcal_jax._results import RESULTS
from softcal_jax.equilibrium._assembly import (
    TetStates,
    add_weighted,
    energy_and_force,
    field_forces,
    gravity_load,
    internal_force,
    tangent_values,
    tet_states,
)
from softcal_jax.equilibrium._build_model import (
    build_model,
    model_for_law,
    refined_model,
)
from softcal_jax.equilibrium._continuation import continue_equilibrium
from softcal_jax.equilibrium._effectors import (
    actuator_forces,
    effector_values,
    marker_positions,
)
from softcal_jax.equilibrium._element import Formulation
from softcal_jax.equilibrium._linearisation import (
    Linearisation,
    factor_solve,
    linearise,
    residual,
    solved_forces,
)
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings
from softcal_jax.equilibrium._path import EquilibriumPath, LoadPath
from softcal_jax.equilibrium._posed import external_force
from softcal_jax.equilibrium._robot_state import (
    ActuatorState,
    BodyPlace,
    Reaction,
    RobotState,
    actuator_states,
    robot_states,
)
from softcal_jax.equilibrium._sensitivity import (
    InputRows,
    Readings,
    Sensitivity,
    adjoint_rows,
    derivatives,
    input_rows,
    sensitivity,
)
from softcal_jax.equilibrium._solution import (
    EquilibriumSolution,
    check_converged,
    no_equilibrium,
)
from softcal_jax.equilibrium._solve import (
    begin_newton,
    continue_newton,
    solve_equilibrium,
    solve_from_rest,
)
from softcal_jax.equilibrium._workers import Program, Workers, usable_cores

__all__ = [
    "RESULTS",
    "ActuatorState",
    "BodyPlace",
    "EquilibriumPath",
    "EquilibriumSolution",
    "Formulation",
    "InputRows",
    "Linearisation",
    "LoadPath",
    "Model",
    "NewtonSettings",
    "Program",
    "Reaction",
    "Readings",
    "RobotState",
    "Sensitivity",
    "TetStates",
    "Workers",
    "actuator_forces",
    "actuator_states",
    "add_weighted",
    "adjoint_rows",
    "begin_newton",
    "build_model",
    "check_converged",
    "continue_equilibrium",
    "continue_newton",
    "derivatives",
    "effector_values",
    "energy_and_force",
    "external_force",
    "factor_solve",
    "field_forces",
    "gravity_load",
    "input_rows",
    "internal_force",
    "linearise",
    "marker_positions",
    "model_for_law",
    "no_equilibrium",
    "refined_model",
    "residual",
    "robot_states",
    "sensitivity",
    "solve_equilibrium",
    "solve_from_rest",
    "solved_forces",
    "tangent_values",
    "tet_states",
    "usable_cores",
]
