from softcal_jax._compilation_cache import (
    use_compilation_cache as use_compilation_cache,
)
from softcal_jax.actuators import Cable as Cable
from softcal_jax.actuators import Chamber as Chamber
from softcal_jax.actuators import Guide as Guide
from softcal_jax.actuators import Motor as Motor
from softcal_jax.bodies import Pose as Pose
from softcal_jax.bodies import RigidBody as RigidBody
from softcal_jax.calibration import calibrate as calibrate
from softcal_jax.calibration import profile_intervals as profile_intervals
from softcal_jax.calibration import simulated_measurements as simulated_measurements
from softcal_jax.calibration import synthetic_measurements as synthetic_measurements
from softcal_jax.configurations import ActuatorDisplacement as ActuatorDisplacement
from softcal_jax.configurations import BodyFrame as BodyFrame
from softcal_jax.configurations import Configuration as Configuration
from softcal_jax.configurations import EdgeForce as EdgeForce
from softcal_jax.configurations import ImposedDisplacement as ImposedDisplacement
from softcal_jax.configurations import ImposedForce as ImposedForce
from softcal_jax.configurations import Markers as Markers
from softcal_jax.configurations import Support as Support
from softcal_jax.configurations import read_markers as read_markers
from softcal_jax.configurations import read_poses as read_poses
from softcal_jax.configurations import register as register
from softcal_jax.control import solve_inverse as solve_inverse
from softcal_jax.equilibrium import build_model as build_model
from softcal_jax.equilibrium import solve_equilibrium as solve_equilibrium
from softcal_jax.exchange.icesl import export_icesl as export_icesl
from softcal_jax.exchange.inp import export_inp as export_inp
from softcal_jax.exchange.sofa import export_sofa as export_sofa
from softcal_jax.fields import ControlPointParameters as ControlPointParameters
from softcal_jax.fields import ControlPoints as ControlPoints
from softcal_jax.fields import Parameter as Parameter
from softcal_jax.fields import ParameterSpace as ParameterSpace
from softcal_jax.identifiability import assess as assess
from softcal_jax.identifiability import identify as identify
from softcal_jax.identifiability import rank_configurations as rank_configurations
from softcal_jax.layouts import compare_laws as compare_laws
from softcal_jax.materials import Corotational as Corotational
from softcal_jax.materials import Fibre as Fibre
from softcal_jax.materials import Isotropic as Isotropic
from softcal_jax.materials import NeoHookean as NeoHookean
from softcal_jax.materials import (
    ReducedTransverseIsotropic as ReducedTransverseIsotropic,
)
from softcal_jax.mesh import beam as beam
from softcal_jax.mesh import read_mesh as read_mesh
from softcal_jax.mesh import select_nodes as select_nodes
from softcal_jax.project import load_project as load_project
from softcal_jax.report import load_result as load_result
from softcal_jax.report import write_results as write_results

__version__: str
__all__: list[str]
