"""The schema of a whole project file; its parts are in the other modules.

The description of a key is also the text of the message if the key is missing.
"""

from typing import Any, Generic, Literal, TypeVar

from pydantic import Field, field_validator

from softcal_jax.project._actuators import AnyActuator
from softcal_jax.project._bodies import BodyTable
from softcal_jax.project._configurations import CandidateTable, ConfigurationTable
from softcal_jax.project._effectors import AnyEffector
from softcal_jax.project._laws import Material
from softcal_jax.project._markers import MarkersTable
from softcal_jax.project._mesh import GroupTable, MeshTable
from softcal_jax.project._parameters import (
    ControlPointsTable,
    ParameterSpaceTable,
    ParameterTable,
)
from softcal_jax.project._quantities import shown
from softcal_jax.project._setup import AnySetup
from softcal_jax.project._table import Flag, Integer, Number, Table

M = TypeVar("M", bound=Material)


class SettingsTable(Table):
    """Settings of the calibration; missing ones keep their defaults."""

    noise: Literal["estimated", "stated"] = "estimated"
    tol: Number | None = None
    max_steps: Integer | None = None
    step_bound: Number | None = None
    max_step_bound: Number | None = None
    damping: Number | None = None
    starts: Integer = 1
    seed: Integer = 0
    intervals: Number | None = None
    adapt: Flag | None = None

    @field_validator("starts")
    @classmethod
    def _check_starts(cls, value: int) -> int:
        if value < 1:
            raise ValueError(f"got {value}; expected at least 1.")
        return value

    @field_validator("intervals")
    @classmethod
    def _check_intervals(cls, value: float | None) -> float | None:
        if value is not None and not 0.0 < value < 1.0:
            raise ValueError(f"got {value:g}; expected a level like 0.95.")
        return value


class NewtonTable(Table):
    """Settings of the equilibrium; missing ones keep their defaults.

    Attributes:
        solver: Sparse solver of its linear systems, see `build_model`.
    """

    rtol: Number | None = None
    max_steps: Integer | None = None
    max_steps_per_load: Integer | None = None
    smallest_load_step: Number | None = None
    solver: Literal["pardiso", "klu", "pardiso-host"] | None = None

    @field_validator("solver", mode="before")
    @classmethod
    def _check_solver(cls, name: str | None) -> str | None:
        if name in ("auto", "multigrid"):
            raise ValueError(f"{name!r} was removed: leave solver out.")
        return name


class ProjectTable(Table, Generic[M]):
    """A whole project file, with the schema of its law as parameter."""

    name: str = Field(description="name of the project")
    mesh: MeshTable = Field(description="a table [mesh]")
    groups: dict[str, GroupTable] = Field(default_factory=dict)
    material: M = Field(description="a table [material]")
    bodies: dict[str, BodyTable] = Field(default_factory=dict)
    actuators: dict[str, AnyActuator] = Field(default_factory=dict)
    control_points: dict[str, ControlPointsTable] = Field(default_factory=dict)
    parameters: tuple[ParameterTable, ...] = ()
    setup: tuple[AnySetup, ...] = ()
    parameter_space: ParameterSpaceTable = ParameterSpaceTable()
    markers: MarkersTable | None = None
    effectors: dict[str, AnyEffector] = Field(default_factory=dict)
    configurations: tuple[ConfigurationTable, ...] = ()
    candidates: tuple[CandidateTable, ...] = ()
    settings: SettingsTable = SettingsTable()
    newton: NewtonTable = NewtonTable()

    @field_validator("control_points", mode="before")
    @classmethod
    def _check_named(cls, sets: Any) -> Any:
        if not isinstance(sets, dict):
            return sets
        known = ControlPointsTable.model_fields
        for name, points in sets.items():
            if name not in known and not isinstance(points, dict):
                own = f'"{name}" = {shown(points)}'
                raise ValueError(
                    f"got {own}; expected sets of control points, each with a name: "
                    f"write [control_points.ends] and below positions = {{ {own} }}, "
                    'and control_points = "ends" in [[parameters]].'
                )
        if "positions" in sets and set(sets) <= set(known):
            raise ValueError(
                "a set of control points needs a name: write [control_points.ends], "
                'and control_points = "ends" in [[parameters]].'
            )
        return sets
