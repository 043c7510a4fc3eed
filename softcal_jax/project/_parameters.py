"""Tables of a project file that make parameters and control points."""

from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from softcal_jax._names import check_unique
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Entry,
    Parameter,
    ParameterSpace,
    check_names,
)
from softcal_jax.project import _quantities as typed
from softcal_jax.project._laws import Constant
from softcal_jax.project._problems import known_name, one_of, under
from softcal_jax.project._table import Table, TableOr, WholeFile

PerPoint = float | dict[str, float]
"""One value for all control points, or one for each by name."""


class ControlPointsTable(Table):
    """Control points, where fields of the law have values of their own."""

    positions: TableOr[dict[str, typed.Position], tuple[typed.Position, ...]] = Field(
        description='names and positions, { "CP 1" = "(0, 7.5, 7.5) mm" }, or a list '
        "of positions"
    )
    names: tuple[str, ...] | None = None
    power: typed.Number = 2.0
    nearest: typed.Integer | None = None
    axes: str = "xyz"
    max_distance: typed.Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "ControlPointsTable":
        if self.names is not None and isinstance(self.positions, dict):
            raise ValueError("`positions` names its points: leave `names` out.")
        return self

    def build(self) -> ControlPoints:
        positions = self.positions
        if not isinstance(positions, dict):
            positions = np.array(positions, float).reshape(-1, 3)
        return ControlPoints(positions, **self.model_dump(exclude={"positions"}))


class ParameterTable(Table):
    """One unknown constant of the material, or one per control point.

    The validation context is the schema of the material, which lists its constants, or
    None if the law is unknown.
    """

    field: str = Field(description='a constant of the material, like "E" or "density"')
    name: str | None = None
    region: str | None = None
    control_points: str | None = None
    lower: PerPoint = Field(description='smallest value allowed: "50 kPa"')
    upper: PerPoint = Field(description='largest value allowed: "1 MPa"')
    start: PerPoint | None = None
    scale: Literal["log", "linear"] | None = None
    S: float | None = None
    max_step: typed.Number | None = None
    interpolation: Literal["linear", "log", "director"] | None = None
    sampling: Literal["centroids"] | None = Field(
        default=None, description="only in older files; it does nothing"
    )
    fixed: dict[str, float] = Field(default_factory=dict)
    tied: dict[str, str] = Field(default_factory=dict)
    prior_std: float | None = None
    core: float = 0.0

    @property
    def label(self) -> str:
        default = self.field if self.region is None else f"{self.field}_{self.region}"
        return self.name or default

    @field_validator("field")
    @classmethod
    def _check_field(cls, value: str, info: Any) -> str:
        material = info.context
        if material is not None and value not in material.constants:
            known = one_of(value, material.constants)
            elsewhere = material.foreign(value)
            raise ValueError(f"got {typed.shown(value)}; expected {known}{elsewhere}")
        return value

    @field_validator("lower", "upper", "start", "S", "fixed", mode="before")
    @classmethod
    def _parse(cls, value: Any, info: Any) -> Any:
        # `field` is validated first, so it is known here unless it is wrong itself.
        constant = _constant(info)
        parsed = lambda quantity: (
            0.0 if constant is None else typed.parse_in_si(quantity, constant.unit)
        )
        if not isinstance(value, dict):
            return value if info.field_name == "fixed" else parsed(value)
        values = {}
        for name, quantity in value.items():
            with under(name):
                values[name] = parsed(quantity)
        return values

    @field_validator("prior_std", mode="before")
    @classmethod
    def _parse_prior(cls, value: Any, info: Any) -> Any:
        constant = _constant(info)
        if constant is None:
            return None
        if (info.data.get("scale") or constant.scale) == "linear":
            return typed.parse_in_si(value, constant.unit)
        if not typed.is_number(value):
            raise ValueError(f"got {typed.shown(value)}; it is relative, like 0.3.")
        return float(value)

    @model_validator(mode="after")
    def _check(self) -> "ParameterTable":
        if self.control_points is not None:
            if self.name is not None:
                raise ValueError(
                    "`name` is for a single parameter; at control points the names are "
                    f'made, like "{self.field} of CP 1". Leave it out.'
                )
            return self
        options = {"interpolation", "sampling", "fixed", "tied", "core"}
        for key, value in self:
            if value if key in options else isinstance(value, dict):
                raise ValueError(
                    f"{key} = {typed.shown(value)} is for control points: name a set "
                    'of them, like control_points = "ends".'
                )
        return self

    def build(self, project: WholeFile) -> Entry:
        constant = type(project.material).constants[self.field]
        common = self.model_dump(include={"S", "region", "max_step", "prior_std"})
        common |= {"scale": self.scale or constant.scale, "unit": constant.unit}
        nominal = project.material.constant(self.field, self.region)
        sets = project.control_points
        span: dict[str, Any] = {
            "start": nominal if self.start is None else self.start,
            "lower": self.lower,
            "upper": self.upper,
        }
        if self.control_points is None:
            # An axis at -90 degrees is the same as at +90.
            half_turn = np.isclose(span["upper"] - span["lower"], np.pi)
            span["periodic"] = constant.unit == "rad" and bool(half_turn)
            return Parameter(self.label, self.field, **span, **common)
        known_name("set", self.control_points, sets, "[control_points]")
        points = sets[self.control_points].build()
        free = [n for n in points.names if n not in {*self.fixed, *self.tied}]
        for key, value in span.items():
            span[key] = _each(key, value, points.names, free, nominal)
        # +90 and -90 degrees are the same axis, so their mean is not 0.
        usual = "director" if constant.unit == "rad" else "linear"
        return ControlPointParameters(
            self.field,
            points,
            **span,
            **common,
            interpolation=self.interpolation or usual,
            **self.model_dump(include={"fixed", "tied", "core"}),
        )


class ParameterSpaceTable(Table):
    order: tuple[tuple[str, str], ...] = ()
    axes: tuple[tuple[str, str, str], ...] = ()


def build_space(table: WholeFile) -> ParameterSpace | None:
    """Build the parameter space; None if nothing is to be calibrated."""
    for name, points in table.control_points.items():
        with under(f"control_points.{name}"):
            points.build()
    entries: list[Entry] = []
    for parameter in table.parameters:
        with under(f"parameters.{parameter.label}"):
            entries.append(parameter.build(table))
            check_unique("parameter", [q.name for q in entries[-1].parameters])
    for i, error in enumerate(table.setup, start=1):
        with under(f"setup[{i}].{error.label}"):
            entries += error.build(table)
    if not entries:
        return None
    with under("parameters"):
        check_names(tuple(entries))
    between = table.parameter_space
    with under("parameter_space"):
        return ParameterSpace(tuple(entries), order=between.order, axes=between.axes)


def _constant(info: Any) -> Constant | None:
    """Return the constant of a parameter; None if its field or the law is wrong."""
    material = info.context
    return None if material is None else material.constants.get(info.data.get("field"))


def _each(
    key: str, value: PerPoint, names: tuple[str, ...], free: list[str], nominal: float
) -> list[float]:
    """Return one value per control point; fixed and tied ones get a placeholder."""
    if not isinstance(value, dict):
        return [value] * len(names)
    with under(key):
        for name in value:
            known_name("control point", name, names, "[control_points]")
    missing = [name for name in free if name not in value]
    if missing and key != "start":
        raise ValueError(f"{key} has no value for {', '.join(missing)}.")
    spare = nominal if key == "start" else next(iter(value.values()), 0.0)
    return [value.get(name, spare) for name in names]
