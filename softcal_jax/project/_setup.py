"""The kinds of [[setup]]: what is calibrated beside the material.

To add a kind, write one table with a key of its own and a `build`, and list it in
`AnySetup`.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

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
from softcal_jax.project._actuators import CableTable
from softcal_jax.project._problems import known_name, shown
from softcal_jax.project._quantities import ANGLE, LENGTH, Dimension, parse_scalar
from softcal_jax.project._table import Angle, ByKeys, Names, Table

if TYPE_CHECKING:
    from softcal_jax.project._schema import ProjectTable


class SetupTable(Table):
    """An error of the setup that is known up to a limit.

    Attributes:
        label: Its key.
        measures: Dimension of `limit` and `prior_std`; None for plain numbers.
    """

    label: ClassVar[str]
    measures: ClassVar[Dimension | None]

    limit: float = Field(description='largest error looked for: "3 deg", "2 mm"')
    prior_std: float | None = None

    @field_validator("limit", "prior_std", mode="before")
    @classmethod
    def _parse(cls, value: Any) -> float:
        if cls.measures is not None:
            number = parse_scalar(value, cls.measures)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"got {shown(value)}; expected a number, like 0.05.")
        else:
            number = float(value)
        if not number > 0.0:
            raise ValueError(f'got "{value}"; expected more than zero.')
        return number

    @abstractmethod
    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build the parameters.

        Args:
            project: The whole file.

        Raises:
            ValueError: If something that they refer to is unknown.
        """


class MotorZeroTable(SetupTable):
    """Zero errors of motors."""

    label = "motor_zero"
    measures = ANGLE

    motor_zero: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build one parameter per motor."""
        motors = [k for k, own in project.actuators.items() if own.type == "motor"]
        for motor in self.motor_zero:
            known_name("motor", motor, motors, "actuators")
        known = {"limit": self.limit, "prior_std": self.prior_std}
        return [motor_zero(motor, **known) for motor in self.motor_zero]


class MountingTable(SetupTable):
    """Translations of rigid bodies from where they should be mounted."""

    label = "mounting"
    measures = LENGTH

    mounting: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build three parameters per body."""
        entries: list[Entry] = []
        for body in self.mounting:
            known_name("rigid body", body, project.bodies, "bodies")
            nominal = project.bodies[body].mounting.translation
            limits = {"limit": self.limit, "prior_std": self.prior_std}
            entries += mounting(body, nominal, **limits)
        return entries


class ScopedTable(SetupTable):
    """An error that all configurations share, or of which each has its own."""

    each: Literal["configuration", "recording"] | tuple[str, ...] | None = None

    def scope(self, project: "ProjectTable") -> dict[str, Any]:
        """Return the scope, as arguments of the functions of `fields`.

        Raises:
            ValueError: If a recording is unknown.
        """
        fitted = [c for c in project.configurations if c.role == "calibration"]
        recordings = list(dict.fromkeys(c.recording or c.name for c in fitted))
        if self.each is None:
            return {}
        if self.each == "configuration":
            return {"each": [c.name for c in fitted], "by": "configuration"}
        if self.each == "recording":
            return {"each": recordings}
        for name in self.each:
            known_name("recording", name, recordings, "configurations")
        return {"each": self.each}


class GravityTiltTable(ScopedTable):
    """Two error angles of the direction of gravity."""

    label = "gravity_tilt"
    measures = ANGLE

    gravity_tilt: Literal[True]

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build two parameters, for all or for each recording."""
        known = {"limit": self.limit, "prior_std": self.prior_std}
        return gravity_tilt(**known, **self.scope(project))


class RecordingOffsetTable(ScopedTable):
    """Offset of the frame of a recording, or of the base of a tracker."""

    label = "recording_offset"
    measures = LENGTH

    recording_offset: Literal[True]
    turn_limit: Angle | None = None
    turn_prior_std: Angle | None = None

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build three parameters, six with turns, for all or for each recording."""
        return recording_offset(
            limit=self.limit,
            prior_std=self.prior_std,
            turn_limit=self.turn_limit,
            turn_prior_std=self.turn_prior_std,
            **self.scope(project),
        )


class FactorTable(ScopedTable):
    """A factor: `limit` is its largest value, `prior_std` is relative."""

    measures = None
    limit: float = 2.0

    def known(self, project: "ProjectTable") -> dict[str, Any]:
        """Return limit, prior and scope, as arguments of the functions of `fields`."""
        own = {"limit": self.limit, "prior_std": self.prior_std}
        return own | self.scope(project)


class LoadFactorTable(FactorTable):
    """A factor on the dead loads."""

    label = "load_factor"

    load_factor: Literal[True]

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build one parameter, for all or for each recording."""
        return [load_factor(**self.known(project))]


class ActuatorFactorTable(FactorTable):
    """A factor on the imposed forces of actuators."""

    label = "actuator_factor"

    actuator_factor: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build one parameter per actuator, for all or for each recording."""
        for name in self.actuator_factor:
            known_name("actuator", name, project.actuators, "actuators")
        known = self.known(project)
        return [actuator_factor(name, **known) for name in self.actuator_factor]


class ClampStiffnessTable(FactorTable):
    """Stiffness of elastic supports; `limit` is a factor, `prior_std` is relative."""

    label = "clamp_stiffness"
    limit: float = 1e3

    clamp_stiffness: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build one parameter per group, for all or for each recording."""
        nominal: dict[str, float] = {}
        for c in project.configurations:
            for own in c.supports:
                if own.stiffness is None:
                    continue
                if nominal.setdefault(own.group, own.stiffness) != own.stiffness:
                    raise ValueError(
                        f"configurations state several stiffnesses for {own.group!r}; "
                        "state one, about which it is calibrated."
                    )
        for group in self.clamp_stiffness:
            known_name("support with a stiffness", group, nominal, "supports")
        known = self.known(project)
        return [clamp_stiffness(g, nominal[g], **known) for g in self.clamp_stiffness]


class FrictionTable(SetupTable):
    """Friction coefficients of cables."""

    label = "friction"
    measures = None

    friction: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Build one parameter per cable."""
        nominal = {
            name: own.friction
            for name, own in project.actuators.items()
            if isinstance(own, CableTable) and own.friction
        }
        for name in self.friction:
            known_name("cable with friction", name, nominal, "actuators")
        known = {"limit": self.limit, "prior_std": self.prior_std}
        return [friction(name, nominal[name], **known) for name in self.friction]


AnySetup = Annotated[
    MotorZeroTable
    | MountingTable
    | GravityTiltTable
    | RecordingOffsetTable
    | LoadFactorTable
    | ActuatorFactorTable
    | ClampStiffnessTable
    | FrictionTable,
    ByKeys(),
]
