"""The kinds of [[setup]]: what is calibrated beside the material.

To add a kind, write one table with a key of its own, named like the function of
`softcal_jax.fields` that makes it, and list it in `AnySetup`.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, field_validator

from softcal_jax._names import UNNAMED_LOADS
from softcal_jax.fields import (
    Entry,
    actuator_factor,
    clamp_stiffness,
    friction,
    gravity_tilt,
    load_factor,
    motor_zero,
    mounting,
    recording_offset,
)
from softcal_jax.project._mechanism import CableTable, MotorTable
from softcal_jax.project._problems import known_name
from softcal_jax.project._quantities import (
    ANGLE,
    LENGTH,
    Dimension,
    parse_number,
    parse_scalar,
)
from softcal_jax.project._table import Angle, Choice, Names, Table, WholeFile, by_keys

Subjects = dict[str, tuple[Any, ...]]
"""What an error can belong to, with its nominal value, if any."""


class SetupTable(Table):
    """An error of the setup that is known up to a limit.

    The function that `makes` its parameters, from limit, prior, and the name and
    nominal value of what it belongs to, has the key of the table as name. `limit` and
    `prior_std` are of the dimension that it `measures`, or plain numbers. What it
    belongs to is called `noun`, unless that is the robot, and stands in a `section`.
    """

    makes: ClassVar[Callable[..., Entry | Sequence[Entry]]]
    measures: ClassVar[Dimension | None] = None
    noun: ClassVar[str | None] = None
    section: ClassVar[str] = "[actuators]"

    limit: float | None = Field(description='largest error looked for: "3 deg", "2 mm"')
    prior_std: float | None = None

    @field_validator("limit", "prior_std", mode="before")
    @classmethod
    def _parse(cls, value: Any) -> float:
        kind = cls.measures
        number = parse_number(value) if kind is None else parse_scalar(value, kind)
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
        del project
        return self.model_dump(exclude={self.label, "each"})

    def build(self, project: WholeFile) -> list[Entry]:
        known, of = self.known(project), [()]
        if self.noun is not None:
            subjects, names = self.subjects(project), getattr(self, self.label)
            for name in names:
                known_name(self.noun, name, subjects, self.section)
            of = [(name, *subjects[name]) for name in names]
        made = [type(self).makes(*own, **known) for own in of]
        several = ([m] if isinstance(m, Entry) else m for m in made)
        return [entry for entries in several for entry in entries]


class MotorZeroTable(SetupTable):
    makes = motor_zero
    measures = ANGLE
    noun = "motor"
    motor_zero: Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.actuators.items()
        return {name: () for name, own in tables if isinstance(own, MotorTable)}


class MountingTable(SetupTable):
    makes = mounting
    measures = LENGTH
    noun = "rigid body"
    section = "[bodies]"
    mounting: Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.bodies.items()
        return {name: (own.mounting.translation,) for name, own in tables}


class FrictionTable(SetupTable):
    makes = friction
    noun = "cable with friction"
    friction: Names

    def subjects(self, project: WholeFile) -> Subjects:
        tables = project.actuators.items()
        cables = {name: own for name, own in tables if isinstance(own, CableTable)}
        return {k: (own.friction,) for k, own in cables.items() if own.friction}


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
    makes = gravity_tilt
    measures = ANGLE
    gravity_tilt: Literal[True]


class RecordingOffsetTable(ScopedTable):
    """Offset of the frame of a recording, or of the base of a tracker.

    Three parameters with `limit`, and three of its turn with `turn_limit`.
    """

    makes = recording_offset
    measures = LENGTH
    limit: float | None = None
    recording_offset: Literal[True]
    turn_limit: Angle | None = None
    turn_prior_std: Angle | None = None


class FactorTable(ScopedTable):
    """A factor: `limit` is its largest value, `prior_std` is relative."""

    limit: float | None = 2.0


class LoadFactorTable(FactorTable):
    """Factors on dead loads, one parameter each; true for those without a name."""

    makes = load_factor
    noun = "load"
    section = "`loads` of a configuration"
    load_factor: Annotated[
        Names, BeforeValidator(lambda names: UNNAMED_LOADS if names is True else names)
    ]

    def subjects(self, project: WholeFile) -> Subjects:
        loads = [own for c in project.configurations for own in c.loads]
        return {own.name: () for own in loads}


class ActuatorFactorTable(FactorTable):
    makes = actuator_factor
    noun = "actuator"
    actuator_factor: Names

    def subjects(self, project: WholeFile) -> Subjects:
        return dict.fromkeys(project.actuators, ())


class ClampStiffnessTable(FactorTable):
    makes = clamp_stiffness
    noun = "support with a stiffness"
    section = "`supports` of a configuration"
    limit: float | None = 1e3
    clamp_stiffness: Names

    def subjects(self, project: WholeFile) -> Subjects:
        """List the groups of elastic supports, with their nominal stiffness."""
        nominal: dict[str, tuple[float]] = {}
        supports = [own for c in project.configurations for own in c.supports]
        for own in supports:
            if own.stiffness is None:
                continue
            if nominal.setdefault(own.group, (own.stiffness,)) != (own.stiffness,):
                raise ValueError(
                    f"configurations state several stiffnesses for {own.group!r}; "
                    "state one, about which it is calibrated."
                )
        return dict(nominal)


AnySetup = Annotated[
    MotorZeroTable
    | MountingTable
    | GravityTiltTable
    | RecordingOffsetTable
    | LoadFactorTable
    | ActuatorFactorTable
    | ClampStiffnessTable
    | FrictionTable,
    Choice(by_keys),
]
