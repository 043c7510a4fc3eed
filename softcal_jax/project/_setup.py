"""Tables of a project file that make unknowns: parameters, [[setup]], [uncertain].

The last two are made from `softcal_jax.fields.KINDS`; to add a kind, write a row there.
"""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    StrictFloat,
    create_model,
    field_validator,
    model_validator,
)

from softcal_jax import fields
from softcal_jax._text import check_unique
from softcal_jax.mesh import surface_motion
from softcal_jax.project import _quantities as typed
from softcal_jax.project._table import (
    Choice,
    Maker,
    Table,
    TableOr,
    WholeFile,
    by_keys,
    known_name,
    one_of,
    only,
    under,
)

PerPoint = float | dict[str, float]
"""One value for all control points, or one for each by name."""


AnyControlPoints = Annotated[
    Maker,
    only(
        fields.ControlPoints,
        positions=TableOr[dict[str, typed.Position], tuple[typed.Position, ...]],
    ),
]


class ParameterTable(Table):
    """One unknown constant of the material, or one per control point.

    The schema of the material, in the `Context`, lists its constants.
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
    max_step: StrictFloat | None = None
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
        material = info.context.material
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
            0.0 if constant is None else typed.parse_in_si(quantity, constant["unit"])
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
        if (info.data.get("scale") or constant["scale"]) == "linear":
            return typed.parse_in_si(value, constant["unit"])
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

    def build(self, project: WholeFile) -> fields.Entry:
        constant = type(project.material).constants[self.field]
        common = self.model_dump(include={"S", "region", "max_step", "prior_std"})
        unit = constant["unit"]
        common |= {"scale": self.scale or constant["scale"], "unit": unit}
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
            span["periodic"] = unit == "rad" and bool(half_turn)
            return fields.Parameter(self.label, self.field, **span, **common)
        known_name("set", self.control_points, sets, "[control_points]")
        points = sets[self.control_points].build()
        free = [n for n in points.names if n not in {*self.fixed, *self.tied}]
        for key, value in span.items():
            span[key] = _each(key, value, points.names, free, nominal)
        # +90 and -90 degrees are the same axis, so their mean is not 0.
        usual = "director" if unit == "rad" else "linear"
        return fields.ControlPointParameters(
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


def build_space(table: WholeFile) -> fields.ParameterSpace | None:
    """Build the parameter space; None if nothing is to be calibrated."""
    for name, points in table.control_points.items():
        with under(f"control_points.{name}"):
            points.build()
    entries: list[fields.Entry] = []
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
        fields.check_names(tuple(entries))
    with under("parameter_space"):
        between = table.parameter_space.model_dump()
        return fields.ParameterSpace(tuple(entries), **between)


def _constant(info: Any) -> Mapping[str, Any] | None:
    """Return the metadata of a constant; None if its field or the law is wrong."""
    material = info.context.material
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


def _deviation(field: dataclasses.Field) -> Any:
    kind, unit = field.type, field.metadata["unit"]
    if not unit:
        return Annotated[StrictFloat, Field(ge=0, allow_inf_nan=False)]
    words = () if kind is float else ("estimated",)
    return Annotated[kind, typed.deviation(unit, *words)]


_STDS = {f.name: _deviation(f) for f in dataclasses.fields(fields.Uncertain)}


AnyUncertain = Annotated[Maker, only(fields.Uncertain, **_STDS)]
AnyShape = Annotated[Maker, only(surface_motion)]


class SetupTable(Table):
    """An error of the setup that is known up to a limit: a kind of `fields.KINDS`.

    Its keys are that of the kind, which says what it belongs to, and the arguments of
    the function of `fields` that makes its parameters.
    """

    kind: ClassVar[fields.Kind]

    @property
    def label(self) -> str:
        return self.kind.name

    def build(self, project: WholeFile) -> list[fields.Entry]:
        kind = self.kind
        arguments = self.model_dump(exclude={kind.name, "each"})
        if kind.each:
            arguments |= _scope(project, vars(self)["each"])
        of: list[tuple[Any, ...]] = [()]
        if kind.noun:
            of = [(name,) for name in getattr(self, kind.name)]
        if kind.subjects is not None:
            subjects = {subject[0]: subject for subject in kind.subjects(project)}
            for (name,) in of:
                known_name(kind.noun, name, subjects, kind.section)
            of = [subjects[name] for (name,) in of]
        made = [fields.FUNCTIONS[kind.name](*subject, **arguments) for subject in of]
        several = ([m] if isinstance(m, fields.Entry) else m for m in made)
        return [entry for entries in several for entry in entries]


Each = Annotated[
    Literal["configuration", "recording"] | tuple[str, ...],
    Choice(lambda value, kinds: kinds[1 if isinstance(value, list) else 0]),
]


def _scope(project: WholeFile, each: Each | None) -> dict[str, Any]:
    """Return the scope of an error that all share, or of which each has its own."""
    fitted = [c for c in project.configurations if c.role == "calibration"]
    if each == "configuration":
        return {"each": [c.name for c in fitted], "by": "configuration"}
    recordings = list(dict.fromkeys(c.recording or c.name for c in fitted))
    names = recordings if each == "recording" else each or ()
    for name in names:
        known_name("recording", name, recordings, "[[configurations]]")
    return {"each": names}


def _table(kind: fields.Kind) -> type[SetupTable]:
    unnamed = lambda names: kind.unnamed if kind.unnamed and names is True else names
    names = Annotated[typed.Names, BeforeValidator(unnamed)]
    keys: dict[str, Any] = {kind.name: (names if kind.noun else Literal[True], ...)}
    for part in kind.parts:
        unit = "" if part.relative else part.unit
        size = Annotated[float | None, typed.scalar(unit, "positive")]
        usual = None if len(kind.parts) > 1 else kind.limit if kind.relative else ...
        example = 'largest error looked for: "3 deg", "2 mm"'
        keys[f"{part.prefix}limit"] = (size, Field(usual, description=example))
        keys[f"{part.prefix}prior_std"] = (size, None)
    if kind.each:
        keys["each"] = (Each, None)
    table = create_model("Setup", __base__=SetupTable, **keys)
    table.kind = kind
    return table


_TABLES = [_table(fields.KINDS[name]) for name in fields.FUNCTIONS]

AnySetup = Annotated[SetupTable, Choice(lambda value, _: by_keys(value, _TABLES))]
