"""The kinds of [[setup]]: what is calibrated beside the material.

A new kind is one table here, with the key that tells it from the others and what it
makes, and one line in `AnySetup`.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Field, field_validator

from softcal_jax.fields import Entry, motor_zero, mounting
from softcal_jax.project._problems import known_name
from softcal_jax.project._quantities import ANGLE, LENGTH, Dimension, parse_scalar
from softcal_jax.project._table import ByKeys, Names, Table

if TYPE_CHECKING:
    from softcal_jax.project._schema import ProjectTable


class SetupTable(Table):
    """Something of the setup that is known up to a limit.

    Attributes:
        label: Its key.
        measures: What `limit` and `prior_std` measure.
    """

    label: ClassVar[str]
    measures: ClassVar[Dimension]

    limit: float = Field(description='largest error looked for: "3 deg", "2 mm"')
    prior_std: float | None = None

    @field_validator("limit", "prior_std", mode="before")
    @classmethod
    def _parse(cls, value: Any) -> float:
        number = parse_scalar(value, cls.measures)
        if not number > 0.0:
            raise ValueError(f'got "{value}"; expected more than zero.')
        return number

    @abstractmethod
    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """The parameters.

        Args:
            project: The whole file, which has what they are about.

        Raises:
            ValueError: If what they are about is unknown.
        """


class MotorZeroTable(SetupTable):
    """What motors add to their angles."""

    label = "motor_zero"
    measures = ANGLE

    motor_zero: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """One parameter per motor."""
        motors = [k for k, own in project.actuators.items() if own.type == "motor"]
        for motor in self.motor_zero:
            known_name("motor", motor, motors, "actuators")
        known = {"limit": self.limit, "prior_std": self.prior_std}
        return [motor_zero(motor, **known) for motor in self.motor_zero]


class MountingTable(SetupTable):
    """How far rigid bodies are mounted from where they should be."""

    label = "mounting"
    measures = LENGTH

    mounting: Names

    def build(self, project: "ProjectTable") -> Sequence[Entry]:
        """Three parameters per body."""
        entries: list[Entry] = []
        for body in self.mounting:
            known_name("rigid body", body, project.bodies, "bodies")
            nominal = project.bodies[body].mounting.translation
            limits = {"limit": self.limit, "prior_std": self.prior_std}
            entries += mounting(body, nominal, **limits)
        return entries


AnySetup = Annotated[MotorZeroTable | MountingTable, ByKeys()]
