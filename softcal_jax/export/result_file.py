"""The content of `result.json`: what is written, in SI, mm or %, and what is read.

Values that are read are not converted; a file needs the keys without a default.
"""

import dataclasses
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from softcal_jax import calibration
from softcal_jax.calibration import CorrelatedNoise, LeftOut
from softcal_jax.configurations import EffectorRecord
from softcal_jax.contact import ContactState
from softcal_jax.equilibrium import ActuatorState, BodyPlace, Reaction, RobotState
from softcal_jax.export._made import pick, plain
from softcal_jax.identifiability import Assessment, Identifiability, Prediction
from softcal_jax.inference import LackOfFit, RecordingEstimate, Uncertainty


class Keys:
    """Annotation of a key whose entries are attributes of a class, see `pick`."""

    def __init__(self, of: type, names: str = ""):
        """Take all attributes of a dataclass, or those with these names."""
        self.of = of
        self.names = names.split() or [field.name for field in dataclasses.fields(of)]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Take the keys before anything else is checked."""
        return BeforeValidator(self._taken).__get_pydantic_core_schema__(
            source, handler
        )

    def _taken(self, value: Any, info: Any) -> Any:
        if value is None or info.mode == "json":
            return value
        if isinstance(value, tuple):
            return [self.entry(item) for item in value]
        return self.entry(value)

    def entry(self, value: object) -> dict[str, Any]:
        """Take the keys of one entry."""
        return plain(pick(value, " ".join(self.names)))


def _converted(factor: float) -> BeforeValidator:
    """Multiply values that are taken from results, but not those read from a file."""
    return BeforeValidator(
        lambda value, info: value if info.mode == "json" else plain(factor * value)
    )


IDENTIFIABILITY = Keys(
    Identifiability,
    "verdict n_data precision parameters informed directions covariance correlation "
    "conditioning",
)
"""Keys of what the data tell; null stands for infinite values, too."""

_MARKERS = Keys(
    EffectorRecord, "name measured_mm simulated_before_mm simulated_mm residual_mm"
)
_EFFECTORS = Keys(
    EffectorRecord, "name unit is_turn measured simulated_before simulated residual"
)
_HISTORY = Keys(
    calibration.HistoryEntry,
    "step cost lambda_p step_bound accepted kkt_residual newton_steps values "
    "noise_level seconds rms_mm",
)
_UNCERTAINTY = Keys(
    Uncertainty,
    "noise noise_scale degrees_of_freedom chi_squared covariance correlation",
)
_STARTS = Keys(
    calibration.MultiStartResult,
    "names starts values cost steps converged optima second_best missed",
)

Number = Annotated[float | None, BeforeValidator(plain)]
Plain = Annotated[Any, BeforeValidator(plain)]
Millimetres = Annotated[float | None, _converted(1e3)]
Percent = Annotated[float | None, _converted(100.0)]


class Entry(BaseModel):
    """What all entries have in common; missing numbers are null.

    Attributes:
        of: Class that has an attribute for each key, or for most of them.
    """

    model_config = ConfigDict(
        from_attributes=True, populate_by_name=True, use_attribute_docstrings=True
    )
    of: ClassVar[type] = object


class FileEntry(Entry):
    """A file, and its SHA-256."""

    file: str
    """Path of the project file from the results, of another from the project file."""
    sha256: str


class SourceEntry(Entry):
    """The files that a calibration was made from."""

    project: FileEntry
    files: list[FileEntry]
    """Mesh and measurements."""
    changes: dict[str, Any]
    """Changes of the project file, by key."""


class ParameterEntry(Entry):
    """A calibrated parameter, in SI units."""

    of = calibration.ParameterEstimate
    name: str
    value: float
    standard_error: Plain = None
    start: Plain = None
    lower: Number = None
    upper: Number = None
    unit: Plain = None
    at_bound: Plain = None
    interval: Plain = None
    given: Plain = None


class RobotEntry(Entry):
    """Rigid bodies, actuators, reactions and contacts at an equilibrium."""

    of = RobotState
    rigid_bodies: Annotated[
        Any, Keys(BodyPlace, "name state position_mm translation_mm rotation_vector")
    ] = Field(default=None, validation_alias="bodies")
    actuators: Annotated[Any, Keys(ActuatorState)] = None
    reactions: Annotated[Any, Keys(Reaction)] = None
    contacts: Annotated[Any, Keys(ContactState)] = None
    """What obstacles feel: `area` and `depth` of the contact, in SI, and the share of
    the area that is `sliding`."""


class ConfigurationEntry(Entry):
    """A configuration, before and after the calibration."""

    of = calibration.ConfigurationResult
    name: str
    role: Plain = None
    rms_before_mm: Millimetres = Field(default=None, validation_alias="rms_before")
    rms_after_mm: Millimetres = Field(validation_alias="rms_after")
    motion_mm: Millimetres = Field(default=None, validation_alias="motion")
    rms_after_percent_of_motion: Percent = Field(
        default=None, validation_alias="rms_share"
    )
    markers: Annotated[Any, _MARKERS] = Field(default=None, validation_alias="points")
    """Markers and other points."""
    effectors: Annotated[Any, _EFFECTORS] = Field(
        default=None, validation_alias="others"
    )
    """Effectors that are not points, in SI units."""
    robot: RobotEntry | None = None
    newton_steps: Plain = None
    residual: Plain = None
    rounding: Plain = None
    at_rounding: Plain = None
    min_det_F: Plain = None


class BudgetEntry(Entry):
    """The standard errors by cause, in SI units."""

    parameters: Plain = None
    """`name`, `unit`, `standard_error` by all causes, `by_cause`, and a `sentence`."""
    errors: Plain = None
    """What is uncertain: `cause`, `name` and `deviations`, changes of parameters."""
    covariance: list[list[float | None]]
    """Covariance of the scaled parameters, by all causes."""


class ChecksEntry(Entry):
    """What the residuals say about the model."""

    of = calibration.ResidualChecks
    reasons: Plain = None
    agreement: Plain = None
    lack_of_fit: Annotated[Any, Keys(LackOfFit)] = None
    recordings: Annotated[Any, Keys(RecordingEstimate)] = None
    level: Plain = None
    probability: Plain = None
    left_out: Annotated[
        Any, Keys(LeftOut, "name rms_mm expected_mm motion_mm probability by_scatter")
    ] = None


class AssessmentEntry(Entry):
    """Whether the values may be trusted."""

    of = Assessment
    outcome: str = "take with care"  # of files from before outcomes were written
    contradicted: bool = False  # of files from before it was written
    reasons: list[str]
    misfit_probability: Plain = None
    predictions: Annotated[Any, Keys(Prediction, "name role std_mm")] = None
    held: Plain = None


class ResultFile(Entry):
    """The content of `result.json`."""

    of = calibration.CalibrationResult
    format: str
    name: Plain = None
    converged: bool
    source: SourceEntry | None
    parameters: list[ParameterEntry]
    intervals: Annotated[Any, Keys(calibration.ParameterInterval)] = None
    configurations: list[ConfigurationEntry]
    history: Annotated[Any, _HISTORY] = None
    solver: dict[str, str | int | None]
    """The sparse solver, law, formulation and size of the mesh."""
    settings: Plain = None
    """Settings of the calibration, of Newton's method and of the noise."""
    uncertainty: Annotated[Any, _UNCERTAINTY] = None
    budget: BudgetEntry
    noise: Annotated[Any, Keys(CorrelatedNoise, "jitter share offset_mm")] = None
    checks: ChecksEntry | None = None
    assessment: AssessmentEntry
    identifiability: Annotated[Any, IDENTIFIABILITY] = None
    starts: Annotated[Any, _STARTS] = None
    mistakes: Plain = None
    notes: Plain = None
    versions: dict[str, str]
    """Versions of Python and its packages, and the machine."""
    timing_s: Plain = None
    """Wall time per part."""
