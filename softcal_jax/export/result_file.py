"""What is read of a `result.json`, as it stands there; it has more keys."""

from typing import Any

from pydantic import AliasPath, BaseModel, Field


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


class ResultFile(BaseModel):
    """A result; a file needs these keys."""

    converged: bool
    source: SourceEntry | None
    parameters: list[ParameterEntry]
    configurations: list[ConfigurationEntry]
    solver: dict[str, str | int | None]
    covariance: list[list[float | None]] = Field(
        validation_alias=AliasPath("budget", "covariance")
    )
    outcome: str = Field(  # of files from before outcomes were written
        default="take with care", validation_alias=AliasPath("assessment", "outcome")
    )
    reasons: list[str] = Field(validation_alias=AliasPath("assessment", "reasons"))
    versions: dict[str, str]
