from softcal_jax._compilation_cache import (
    use_compilation_cache as use_compilation_cache,
)
from softcal_jax.actuators import (
    Cable as Cable,
    Chamber as Chamber,
    Guide as Guide,
    Motor as Motor,
)
from softcal_jax.bodies import Pose as Pose, RigidBody as RigidBody
from softcal_jax.calibration import (
    bounded_step as bounded_step,
    calibrate as calibrate,
    profile_intervals as profile_intervals,
)
from softcal_jax.configurations import (
    ActuatorDisplacement as ActuatorDisplacement,
    BodyFrame as BodyFrame,
    Configuration as Configuration,
    EdgeForce as EdgeForce,
    ImposedDisplacement as ImposedDisplacement,
    ImposedForce as ImposedForce,
    Markers as Markers,
    Observation as Observation,
    Support as Support,
)
from softcal_jax.control import solve_inverse as solve_inverse
from softcal_jax.designs import design as design
from softcal_jax.equilibrium import (
    build_model as build_model,
    lanes as lanes,
    map_lanes as map_lanes,
    marker_positions as marker_positions,
    solve_equilibrium as solve_equilibrium,
    use_cores as use_cores,
    with_points as with_points,
)
from softcal_jax.exchange.icesl import export_icesl as export_icesl
from softcal_jax.exchange.inp import export_inp as export_inp
from softcal_jax.exchange.sofa import export_sofa as export_sofa
from softcal_jax.fields import (
    ControlPointParameters as ControlPointParameters,
    ControlPoints as ControlPoints,
    Parameter as Parameter,
    ParameterSpace as ParameterSpace,
    exactly_known as exactly_known,
    set_field as set_field,
)
from softcal_jax.identifiability import (
    assess as assess,
    identify as identify,
    rank_configurations as rank_configurations,
)
from softcal_jax.layouts import compare_laws as compare_laws
from softcal_jax.materials import (
    Corotational as Corotational,
    Fibre as Fibre,
    Isotropic as Isotropic,
    NeoHookean as NeoHookean,
    ReducedTransverseIsotropic as ReducedTransverseIsotropic,
)
from softcal_jax.mesh import (
    TetMesh as TetMesh,
    beam as beam,
    read_mesh as read_mesh,
    select_nodes as select_nodes,
)
from softcal_jax.project import load_project as load_project
from softcal_jax.readings import (
    read_markers as read_markers,
    read_poses as read_poses,
    register as register,
)
from softcal_jax.results import (
    load_result as load_result,
    write_results as write_results,
)
from softcal_jax.robots import (
    simulated_measurements as simulated_measurements,
    synthetic_measurements as synthetic_measurements,
)
from softcal_jax.sensitivity import parameter_compliance as parameter_compliance

__version__: str
__all__: list[str]
