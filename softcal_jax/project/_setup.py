"""What else is known only roughly: the kinds of [[setup]], and [uncertain].

To add a kind of [[setup]], which is calibrated beside the material, write one table
with a key of its own, named like the function of `softcal_jax.fields` that makes it.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, create_model, field_validator

from softcal_jax import fields
from softcal_jax._names import UNNAMED_LOADS
from softcal_jax.project import _quantities as typed
from softcal_jax.project._effectors import BodyFrameTable
from softcal_jax.project._mechanism import CableTable, MotorTable
from softcal_jax.project._problems import known_name
from softcal_jax.project._quantities import (
    dimension_of,
    is_number,
    parse_in_si,
    scalar,
    shown,
)
from softcal_jax.project._table import Choice, Table, WholeFile, by_keys

_PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")


def _parser(unit: str, *, estimated: bool) -> Callable[[Any], float | str]:
    """Return a parser of values in an SI unit or in "%"; zero needs neither."""
    parse = parse_share if unit == "%" else scalar(dimension_of(unit), "not negative")

    def parsed(value: Any) -> float | str:
        if is_number(value) and value == 0:
            return 0.0
        return value if estimated and value == "estimated" else parse(value)

    return parsed


def parse_share(value: Any) -> float:
    """Parse a share of a value, "3 %"; raise ValueError if it is none."""
    match = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if not match:
        raise ValueError(f'got {shown(value)}; expected a share, like "3 %".')
    return 0.01 * float(match[1])


ShareOrEstimated = Annotated[
    float | Literal["estimated"], BeforeValidator(_parser("%", estimated=True))
]


Share = Annotated[float, BeforeValidator(_parser("%", estimated=False))]


def _type_of(kind: Any, unit: str) -> Any:
    if not unit:
        return Annotated[typed.Number, Field(ge=0, allow_inf_nan=False)]
    return Annotated[kind, BeforeValidator(_parser(unit, estimated=kind is not float))]


_KEYS: dict[str, Any] = {
    field.name: (_type_of(field.type, field.metadata["unit"]), field.default)
    for field in dataclasses.fields(fields.Uncertain)
}


class UncertainTable(create_model("UncertainTable", __base__=Table, **_KEYS)):
    """Its keys are the fields of `Uncertain`, whose docstring explains them."""


Subjects = dict[str, tuple[Any, ...]]
"""What an error can belong to, with its nominal value, if any."""


class SetupTable(Table):
    """An error of the setup that is known up to a limit.

    `makes` is the function that makes its parameters, named like the key of the table,
    from limit, prior, and the name and nominal value of what the error belongs to, in
    the `section`. `limit` and `prior_std` have the dimension of the quantity, or are
    plain numbers.
    """

    makes: ClassVar[Callable[..., fields.Entry | Sequence[fields.Entry]]]
    section: ClassVar[str] = "[actuators]"

    limit: float | None = Field(description='largest error looked for: "3 deg", "2 mm"')
    prior_std: float | None = None

    @field_validator("limit", "prior_std", mode="before")
    @classmethod
    def _parse(cls, value: Any) -> float:
        quantity = fields.QUANTITIES[cls.makes.__name__]
        number = parse_in_si(value, "" if quantity.relative else quantity.unit)
        if not number > 0.0:
            raise ValueError(f'got "{value}"; expected more than zero.')
        return number

    @property
    def label(self) -> str:
        return type(self).makes.__name__

    def subjects(self, project: WholeFile) -> Subjects:
        """List what such an error can belong to."""
        raise NotImplementedError

    def known(self, project: WholeFile) -> dict[str, Any]:
        """Return limit, prior and scope, as arguments of `makes`."""
        return self.model_dump(exclude={self.label, "each"})

    def build(self, project: WholeFile) -> list[fields.Entry]:
        known, of = self.known(project), [()]
        noun, names = fields.QUANTITIES[self.label].noun, getattr(self, self.label)
        if noun:
            subjects = self.subjects(project)
            for name in names:
                known_name(noun, name, subjects, self.section)
            of = [(name, *subjects[name]) for name in names]
        made = [type(self).makes(*subject, **known) for subject in of]
        several = ([m] if isinstance(m, fields.Entry) else m for m in made)
        return [entry for entries in several for entry in entries]


class MotorZeroTable(SetupTable):
    makes = fields.motor_zero
    motor_zero: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.actuators.items()
        return {name: () for name, table in tables if isinstance(table, MotorTable)}


class MountingTable(SetupTable):
    makes = fields.mounting
    section = "[bodies]"
    mounting: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.bodies.items()
        return {name: (body.mounting.translation,) for name, body in tables}


class FrictionTable(SetupTable):
    makes = fields.friction
    friction: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.actuators.items()
        cables = {k: table for k, table in tables if isinstance(table, CableTable)}
        return {k: (cable.friction,) for k, cable in cables.items() if cable.friction}


class MarkerOffsetTable(SetupTable):
    makes = fields.marker_offset
    section = "[markers.positions] or [effectors]"
    marker_offset: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.effectors.items()
        frames = [name for name, table in tables if isinstance(table, BodyFrameTable)]
        markers = project.markers.positions if project.markers else ()
        return dict.fromkeys([*markers, *frames], ())


Each = Annotated[
    Literal["configuration", "recording"] | tuple[str, ...],
    Choice(lambda value, kinds: kinds[1 if isinstance(value, list) else 0]),
]


class ScopedTable(SetupTable):
    """An error that all configurations share, or of which each has its own."""

    each: Each | None = None

    def known(self, project: WholeFile) -> dict[str, Any]:
        known = super().known(project)
        fitted = [c for c in project.configurations if c.role == "calibration"]
        recordings = list(dict.fromkeys(c.recording or c.name for c in fitted))
        if self.each is None:
            return known
        if self.each == "configuration":
            return known | {"each": [c.name for c in fitted], "by": "configuration"}
        names = recordings if self.each == "recording" else self.each
        for name in names:
            known_name("recording", name, recordings, "[[configurations]]")
        return known | {"each": names}


class GravityTiltTable(ScopedTable):
    makes = fields.gravity_tilt
    gravity_tilt: Literal[True]


class RecordingOffsetTable(ScopedTable):
    """Offset of the frame of a recording, or of the base of a tracker.

    `limit` gives it three parameters of offset, `turn_limit` three of rotation.
    """

    makes = fields.recording_offset
    limit: float | None = None
    recording_offset: Literal[True]
    turn_limit: typed.Angle | None = None
    turn_prior_std: typed.Angle | None = None


class FactorTable(ScopedTable):
    """A factor: `limit` is its largest value, `prior_std` is relative."""

    limit: float | None = 2.0


class LoadFactorTable(FactorTable):
    """Factors on dead loads, one parameter each; true for loads without a name."""

    makes = fields.load_factor
    section = "`loads` of a configuration"
    load_factor: Annotated[
        typed.Names,
        BeforeValidator(lambda names: UNNAMED_LOADS if names is True else names),
    ]

    def subjects(self, project: WholeFile) -> Subjects:
        loads = [load for c in project.configurations for load in c.loads]
        return {load.name: () for load in loads}


class ActuatorFactorTable(FactorTable):
    makes = fields.actuator_factor
    actuator_factor: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        return dict.fromkeys(project.actuators, ())


class ClampStiffnessTable(FactorTable):
    makes = fields.clamp_stiffness
    section = "`supports` of a configuration"
    limit: float | None = 1e3
    clamp_stiffness: typed.Names

    def subjects(self, project: WholeFile) -> Subjects:
        """List the groups of elastic supports, with their nominal stiffness."""
        nominal: dict[str, tuple[float]] = {}
        supports = [support for c in project.configurations for support in c.supports]
        for support in supports:
            group, stiffness = support.group, support.stiffness
            if stiffness and nominal.setdefault(group, (stiffness,)) != (stiffness,):
                raise ValueError(
                    f"configurations state several stiffnesses for {group!r}; give one."
                )
        return dict(nominal)


AnySetup = Annotated[SetupTable, Choice(by_keys)]
