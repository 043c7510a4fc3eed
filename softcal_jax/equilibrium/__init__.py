"""Static equilibrium: model, tangent, sparse solver, Newton (paper Eqs. 1 to 3)."""

from softcal_jax._results import RESULTS as RESULTS
from softcal_jax.equilibrium._assembly import (
    add_weighted as add_weighted,
    energy_and_force as energy_and_force,
    field_forces as field_forces,
    force_of_gradients as force_of_gradients,
    gravity_load as gravity_load,
    internal_force as internal_force,
    tangent_values as tangent_values,
    tet_states as tet_states,
    tet_stresses as tet_stresses,
    traced_tet_states as traced_tet_states,
)
from softcal_jax.equilibrium._batch import (
    EquilibriumProgress as EquilibriumProgress,
    Report as Report,
    compiled_effectors as compiled_effectors,
    effectors_on_all_cores as effectors_on_all_cores,
    equilibria as equilibria,
    reports_of as reports_of,
)
from softcal_jax.equilibrium._build_model import (
    build_model as build_model,
    model_for_law as model_for_law,
    with_offset as with_offset,
    with_points as with_points,
)
from softcal_jax.equilibrium._continuation import (
    Known as Known,
    continue_equilibrium as continue_equilibrium,
)
from softcal_jax.equilibrium._element import (
    Formulation as Formulation,
    TetStates as TetStates,
)
from softcal_jax.equilibrium._linearisation import (
    InputRows as InputRows,
    Linearisation as Linearisation,
    Readings as Readings,
    Sensitivity as Sensitivity,
    adjoint_rows as adjoint_rows,
    derivatives as derivatives,
    input_rows as input_rows,
    linearise as linearise,
    residual as residual,
    sensitivity as sensitivity,
    solved_forces as solved_forces,
)
from softcal_jax.equilibrium._model import (
    Model as Model,
    Omission as Omission,
    omission_sentences as omission_sentences,
    omissions as omissions,
)
from softcal_jax.equilibrium._newton import NewtonSettings as NewtonSettings
from softcal_jax.equilibrium._path import (
    EquilibriumPath as EquilibriumPath,
    LoadPath as LoadPath,
    trace_equilibria as trace_equilibria,
)
from softcal_jax.equilibrium._posed import one_lane as one_lane
from softcal_jax.equilibrium._robot_state import (
    ActuatorState as ActuatorState,
    BodyPlace as BodyPlace,
    Reaction as Reaction,
    RobotState as RobotState,
    actuator_forces as actuator_forces,
    actuator_states as actuator_states,
    effector_values as effector_values,
    marker_positions as marker_positions,
    robot_states as robot_states,
)
from softcal_jax.equilibrium._solve import (
    EquilibriumSolution as EquilibriumSolution,
    check_converged as check_converged,
    lanes as lanes,
    no_equilibrium as no_equilibrium,
    other_ways as other_ways,
    outcome_words as outcome_words,
    solve_equilibrium as solve_equilibrium,
)
from softcal_jax.equilibrium._workers import (
    Program as Program,
    Workers as Workers,
    map_lanes as map_lanes,
    usable_cores as usable_cores,
    use_cores as use_cores,
)
