"""The content of `result.json`: what is written, what is read, and its table.

One class per kind of entry, whose fields are the keys. Written, they are taken from the
attributes of results, in SI units, and those in mm or percent are converted; read, they
are taken as they stand. Only keys without a default are needed to load a result.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from softcal_jax.calibration import (
    HistoryEntry,
    LackOfFit,
    Optimum,
    ParameterInterval,
    RecordingEstimate,
)
from softcal_jax.equilibrium import ActuatorState, Reaction
from softcal_jax.export._plain import plain
from softcal_jax.identifiability import Conditioning, Direction, ParameterOutlook


class Attributes(NamedTuple):
    """Mark of a key whose entries have the attributes of a class as their keys."""

    of: type


def _converted(factor: float) -> BeforeValidator:
    """Multiply values that are taken from results, not those of a file."""

    def convert(value: Any, info: Any) -> Any:
        if value is None or info.mode == "json":
            return value
        return plain(factor * np.asarray(value, float))

    return BeforeValidator(convert)


Plain = Annotated[Any, BeforeValidator(plain)]
Millimetres = Annotated[Any, _converted(1e3)]
Percent = Annotated[Any, _converted(100.0)]


def _of(attribute: str) -> Any:
    """Return a key that is not needed to load a result, of an attribute."""
    return Field(default=None, validation_alias=attribute)


class Entry(BaseModel):
    """What all entries have in common; missing numbers are null."""

    model_config = ConfigDict(
        from_attributes=True,
        populate_by_name=True,
        use_attribute_docstrings=True,
        arbitrary_types_allowed=True,
    )


class FileEntry(Entry):
    """A file that a result was made from."""

    file: str
    """Its path: of the project file, relative to the results; of others, to that."""
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

    name: str
    value: float
    standard_error: Plain = None
    """By all causes, see `budget`; null on a bound, or if not determined."""
    start: Plain = None
    lower: Plain = None
    upper: Plain = None
    unit: Plain = None
    at_bound: Plain = None
    interval: Plain = None
    """As in `intervals`; null if none was asked for."""
    given: Plain = None
    """Parameters on a bound: the standard error holds with these kept there."""


class MarkerEntry(Entry):
    """A marker, or another point that was measured."""

    name: Plain = None
    measured_mm: Millimetres = _of("measured")
    simulated_before_mm: Millimetres = _of("simulated_before")
    """With the start values."""
    simulated_mm: Millimetres = _of("simulated")
    residual_mm: Millimetres = _of("residual")
    """Simulated minus measured."""


class EffectorEntry(Entry):
    """An effector that is not a point, in SI units."""

    name: Plain = None
    unit: Plain = None
    is_turn: Plain = None
    """Whether it is an orientation: rotation vectors from the measured one."""
    measured: Plain = None
    simulated_before: Plain = None
    simulated: Plain = None
    residual: Plain = None


class BodyEntry(Entry):
    """A rigid body at an equilibrium."""

    name: Plain = None
    state: Plain = None
    position_mm: Millimetres = _of("position")
    translation_mm: Millimetres = _of("translation")
    rotation_vector: Plain = None


class RobotEntry(Entry):
    """Rigid bodies, actuators and reactions at an equilibrium."""

    rigid_bodies: list[BodyEntry] = Field(default=[], validation_alias="bodies")
    actuators: Annotated[Plain, Attributes(ActuatorState)] = None
    reactions: Annotated[Plain, Attributes(Reaction)] = None


class ConfigurationEntry(Entry):
    """A configuration, before and after the calibration."""

    name: str
    role: Plain = None
    """`calibration`, or `validation` if it was held out."""
    rms_before_mm: Millimetres = _of("rms_before")
    """Root mean square distance of the markers, with the start values."""
    rms_after_mm: Annotated[float | None, _converted(1e3)] = Field(
        validation_alias="rms_after"
    )
    motion_mm: Millimetres = _of("motion")
    """Root mean square of how far the markers moved."""
    rms_after_percent_of_motion: Percent = _of("rms_share")
    markers: list[MarkerEntry] = Field(default=[], validation_alias="points")
    """Markers and other points."""
    effectors: list[EffectorEntry] = Field(default=[], validation_alias="others")
    """Effectors that are not points."""
    robot: RobotEntry | None = None
    """Null if there is nothing in it."""
    newton_steps: Plain = None
    residual: Plain = None
    """Of the equilibrium, relative to its forces."""
    rounding: Plain = None
    """What rounding leaves of the residual."""
    at_rounding: Plain = None
    """Whether Newton's method stopped there."""
    min_det_F: Plain = None


class BudgetParameterEntry(Entry):
    """What the standard error of a parameter comes from, in SI units."""

    name: Plain = None
    unit: Plain = None
    standard_error: Plain = None
    """By all causes."""
    by_cause: Plain = None
    """By each cause alone, `noise` first."""
    sentence: Plain = None


class BudgetErrorEntry(Entry):
    """Something that is uncertain."""

    cause: Plain = None
    name: Plain = None
    deviations: Plain = None
    """Change of each parameter per standard deviation of it."""


class BudgetEntry(Entry):
    """The standard errors by cause."""

    parameters: list[BudgetParameterEntry] = []
    errors: list[BudgetErrorEntry] = []
    unknown: Plain = None
    """Causes whose size could not be estimated."""
    covariance: list[list[float | None]]
    """Of the scaled parameters by all causes."""


class NoiseEntry(Entry):
    """The noise that weighed the data, as standard deviations."""

    jitter: Plain = None
    """Factor on the stated standard deviations of coordinates."""
    share: Plain = None
    """Of each configuration: share of its motion."""
    offset_mm: Millimetres = _of("offset")
    """Of the recording of each configuration, along each axis."""


class LeftOutEntry(Entry):
    """A configuration as the others predict it."""

    name: Plain = None
    rms_mm: Millimetres = _of("rms")
    expected_mm: Millimetres = _of("expected")
    """By noise, parameters and what is held fixed."""
    motion_mm: Millimetres = _of("motion")
    probability: Plain = None
    by_scatter: Plain = None


class ChecksEntry(Entry):
    """What the residuals say about the model."""

    reasons: Plain = None
    """Why the model cannot be right."""
    agreement: Plain = None
    """Whether the recordings agree, in words."""
    lack_of_fit: Annotated[Plain, Attributes(LackOfFit)] = None
    """Null where the noise is stated."""
    recordings: Annotated[Plain, Attributes(RecordingEstimate)] = None
    """Parameters from each recording alone."""
    level: Plain = None
    """Residuals over the stated standard deviation; null unless it was stated."""
    probability: Plain = None
    left_out: list[LeftOutEntry] = []


class PredictionEntry(Entry):
    """What the uncertainty of the parameters does to a configuration."""

    name: Plain = None
    role: Plain = None
    std_mm: Millimetres = _of("std")
    """Of its markers; null if that is unknown."""


class AssessmentEntry(Entry):
    """Whether the values may be trusted."""

    identified: Plain = None
    reasons: list[str]
    """Why not."""
    misfit_probability: Plain = None
    """Of residuals this large by chance; null where the noise was estimated."""
    predictions: list[PredictionEntry] = []


class IdentifiabilityEntry(Entry):
    """What the data tell of the parameters; null stands for infinite, too."""

    verdict: Plain = None
    n_data: Plain = None
    precision: Plain = None
    """Relative standard error that is asked for."""
    parameters: Annotated[Plain, Attributes(ParameterOutlook)] = None
    informed: Plain = None
    """Number of directions along which the data tell more than the prior."""
    directions: Annotated[Plain, Attributes(Direction)] = None
    """The best seen first."""
    covariance: Plain = None
    """Of the scaled parameters."""
    correlation: Plain = None
    conditioning: Annotated[Plain, Attributes(Conditioning)] = None
    unknown: Plain = None
    """Causes of errors that are left out since their size is not known."""


class StartsEntry(Entry):
    """Runs from several starts, one row per run."""

    names: Plain = None
    """Of the parameters."""
    starts: Plain = None
    values: Plain = None
    cost: Plain = None
    steps: Plain = None
    converged: Plain = None
    optima: Annotated[Plain, Attributes(Optimum)] = None
    """Distinct ends, the lowest cost first."""
    second_best: Annotated[Plain, Attributes(Optimum)] = None


class UncertaintyEntry(Entry):
    """Uncertainty by the noise alone, of the scaled parameters."""

    noise: Plain = None
    """`stated` or `estimated`."""
    noise_scale: Plain = None
    degrees_of_freedom: Plain = None
    chi_squared: Plain = None
    covariance: Plain = None
    correlation: Plain = None


class ResultFile(Entry):
    """The content of `result.json`."""

    format: str
    name: Plain = None
    converged: bool
    """If not, do not use the values."""
    source: SourceEntry | None
    """Null for a calibration without a project file."""
    parameters: list[ParameterEntry]
    intervals: Annotated[Plain, Attributes(ParameterInterval)] = None
    configurations: list[ConfigurationEntry]
    history: Annotated[Plain, Attributes(HistoryEntry)] = None
    """One entry per step, 0 is the start; `rms_mm` in place of `rms`."""
    solver: dict[str, str | int | None]
    """The sparse solver, law, formulation and size of the mesh."""
    settings: Plain = None
    """Of calibration, Newton's method and noise."""
    uncertainty: UncertaintyEntry | None = None
    budget: BudgetEntry
    noise: NoiseEntry | None = None
    checks: ChecksEntry | None = None
    assessment: AssessmentEntry
    identifiability: IdentifiabilityEntry | None = None
    starts: StartsEntry | None = None
    """Null for a single one."""
    notes: Plain = None
    versions: dict[str, str]
    """Of Python and its packages, and the machine."""
    timing_s: Plain = None
    """Wall time per part."""
