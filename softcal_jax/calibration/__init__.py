"""Calibration: stacked errors, bounded QP, outer loop (paper Eqs. 9 to 11)."""

from softcal_jax._files import ProjectSource as ProjectSource, SourceFile as SourceFile
from softcal_jax.calibration._calibrate import (
    as_sequence as as_sequence,
    build_problem as build_problem,
    calibrate as calibrate,
    checked_problem as checked_problem,
    number_of_starts as number_of_starts,
    profile_intervals as profile_intervals,
)
from softcal_jax.calibration._checked_intervals import (
    LEVEL as LEVEL,
    check_level as check_level,
)
from softcal_jax.calibration._checkpoint import HistoryEntry as HistoryEntry
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult as ConfigurationResult,
    SimulationResult as SimulationResult,
    simulation_result as simulation_result,
)
from softcal_jax.calibration._density import (
    LogDensity as LogDensity,
    errors as errors,
    log_density as log_density,
)
from softcal_jax.calibration._evaluation import (
    Evaluation as Evaluation,
    Evaluator as Evaluator,
    evaluate as evaluate,
)
from softcal_jax.calibration._fit import Event as Event, Watch as Watch, fit as fit
from softcal_jax.calibration._notes import (
    CalibrationWarning as CalibrationWarning,
    LeftOut as LeftOut,
    ResidualChecks as ResidualChecks,
)
from softcal_jax.calibration._problem import (
    CalibrationSettings as CalibrationSettings,
    FitOptions as FitOptions,
    linear_model as linear_model,
)
from softcal_jax.calibration._profile import (
    LowerCostFound as LowerCostFound,
    profile_ends as profile_ends,
)
from softcal_jax.calibration._qp import QPStep as QPStep, bounded_step as bounded_step
from softcal_jax.calibration._result import (
    MISSED as MISSED,
    CalibrationResult as CalibrationResult,
    MultiStartResult as MultiStartResult,
    Optimum as Optimum,
    ParameterEstimate as ParameterEstimate,
    ParameterInterval as ParameterInterval,
)
from softcal_jax.calibration._runs import (
    Begun as Begun,
    Run as Run,
    best_of as best_of,
    descend as descend,
    images_of as images_of,
    known_optima as known_optima,
    run_start as run_start,
)
from softcal_jax.calibration._starts import (
    FROM_ANYWHERE as FROM_ANYWHERE,
    SearchProgress as SearchProgress,
    multi_start as multi_start,
)
from softcal_jax.calibration._step import (
    FLAT as FLAT,
    OUTSIDE as OUTSIDE,
    CalibrationState as CalibrationState,
    decide as decide,
    initial_state as initial_state,
    propose as propose,
)
from softcal_jax.calibration._weighing import NOT_TAKEN as NOT_TAKEN
