"""Calibration: stacked errors, bounded QP, outer loop (paper Eqs. 9 to 11)."""

from softcal_jax._files import ProjectSource, SourceFile
from softcal_jax.calibration._calibrate import (
    as_sequence,
    build_problem,
    calibrate,
    profile_intervals,
)
from softcal_jax.calibration._checked_intervals import LEVEL
from softcal_jax.calibration._checkpoint import Clock
from softcal_jax.calibration._checks import (
    levenberg_marquardt,
    simulated_measurements,
    synthetic_measurements,
)
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    SimulationResult,
    simulation_result,
)
from softcal_jax.calibration._evaluation import (
    Evaluation,
    Evaluator,
    at_rest,
    evaluate,
    linearised,
)
from softcal_jax.calibration._noise import (
    CorrelatedNoise,
    check_references,
    correlated_noise,
)
from softcal_jax.calibration._notes import CalibrationWarning, LeftOut, ResidualChecks
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    CalibrationSettings,
    EquilibriumProgress,
    effectors_of,
    equilibria,
    linear_model,
    reports_of,
)
from softcal_jax.calibration._profile import LowerCostFound, profile_ends
from softcal_jax.calibration._qp import QPStep, bounded_step
from softcal_jax.calibration._result import (
    CalibrationResult,
    HistoryEntry,
    MultiStartResult,
    Optimum,
    ParameterEstimate,
    ParameterInterval,
)
from softcal_jax.calibration._runs import Run, best_of, descend, images_of, run_start
from softcal_jax.calibration._starts import (
    FROM_ANYWHERE,
    SearchProgress,
    check_starts,
    default_starts,
    multi_start,
    random_starts,
)
from softcal_jax.calibration._step import (
    FLAT,
    KKT_TOLERANCE,
    SMALLEST_FALL,
    CalibrationState,
    initial_state,
    propose,
)

__all__ = [
    "FLAT",
    "FROM_ANYWHERE",
    "KKT_TOLERANCE",
    "LEVEL",
    "SMALLEST_FALL",
    "CalibrationProblem",
    "CalibrationResult",
    "CalibrationSettings",
    "CalibrationState",
    "CalibrationWarning",
    "Clock",
    "ConfigurationResult",
    "CorrelatedNoise",
    "EquilibriumProgress",
    "Evaluation",
    "Evaluator",
    "HistoryEntry",
    "LeftOut",
    "LowerCostFound",
    "MultiStartResult",
    "Optimum",
    "ParameterEstimate",
    "ParameterInterval",
    "ProjectSource",
    "QPStep",
    "ResidualChecks",
    "Run",
    "SearchProgress",
    "SimulationResult",
    "SourceFile",
    "as_sequence",
    "at_rest",
    "best_of",
    "bounded_step",
    "build_problem",
    "calibrate",
    "check_references",
    "check_starts",
    "correlated_noise",
    "default_starts",
    "descend",
    "effectors_of",
    "equilibria",
    "evaluate",
    "images_of",
    "initial_state",
    "levenberg_marquardt",
    "linear_model",
    "linearised",
    "multi_start",
    "profile_ends",
    "profile_intervals",
    "propose",
    "random_starts",
    "reports_of",
    "run_start",
    "simulated_measurements",
    "simulation_result",
    "synthetic_measurements",
]
