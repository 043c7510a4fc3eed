"""What is read of a `result.json`, as it stands there; it has more keys."""

from typing import Any

from pydantic import BaseModel


class FileEntry(BaseModel):
    """A file, and its SHA-256."""

    file: str
    sha256: str


class SourceEntry(BaseModel):
    """The files that a calibration was made from, and changes of the project file."""

    project: FileEntry
    files: list[FileEntry]
    changes: dict[str, Any]


class ParameterEntry(BaseModel):
    """A calibrated parameter, in SI units."""

    name: str
    value: float


class ConfigurationEntry(BaseModel):
    """A configuration after the calibration."""

    name: str
    rms_after_mm: float | None


class BudgetEntry(BaseModel):
    """Covariance of the scaled parameters, by all causes."""

    covariance: list[list[float | None]]


class AssessmentEntry(BaseModel):
    """Whether the values may be trusted."""

    outcome: str = "take with care"  # of files from before outcomes were written
    reasons: list[str]


class ResultFile(BaseModel):
    """A result; a file needs these keys."""

    converged: bool
    source: SourceEntry | None
    parameters: list[ParameterEntry]
    configurations: list[ConfigurationEntry]
    solver: dict[str, str | int | None]
    budget: BudgetEntry
    assessment: AssessmentEntry
    versions: dict[str, str]
