"""Tables of a project file that make rigid bodies and their states."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from softcal_jax.bodies import BodyState, Pose, RigidBody, hinge_axes
from softcal_jax.configurations import Mechanism
from softcal_jax.project._problems import known_name, under
from softcal_jax.project._table import (
    Direction,
    Mass,
    Names,
    Position,
    RotationVector,
    Table,
    TableOr,
)


class MotionTable(Table):
    """A rigid motion of a frame: its translation and rotation vector."""

    translation: Position = (0.0, 0.0, 0.0)
    rotation_vector: RotationVector = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        return Pose(self.translation, self.rotation_vector)


class BodyTable(Table):
    """Nodes that move as one."""

    group: Names = Field(description='a group of the mesh: "x_max", or several')
    origin: Position | None = None
    hinge: Direction | None = None
    axes: tuple[Direction, Direction, Direction] | None = None
    mounting: MotionTable = MotionTable()
    tied_to: str | None = None
    mass: Mass = 0.0
    centre_of_mass: Position | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyTable":
        if self.hinge is not None and self.axes is not None:
            raise ValueError(
                "got hinge and axes; the hinge is the third of the axes, so give one "
                "of them."
            )
        return self

    def build(self, name: str) -> RigidBody:
        axes = None if self.axes is None else np.array(self.axes)
        return RigidBody(
            name=name,
            where=self.group,
            origin=self.origin,
            axes=axes if self.hinge is None else hinge_axes(self.hinge),
            mounting=self.mounting.pose,
            **self.model_dump(include={"tied_to", "mass", "centre_of_mass"}),
        )


class BodyStateTable(MotionTable):
    """State of a rigid body in one configuration."""

    state: Literal["held", "hinged", "free"] = "held"


State = TableOr[BodyStateTable, Literal["held", "hinged", "free"]]


def build_states(
    table: Mapping[str, Any], mechanism: Mechanism
) -> dict[str, BodyState | Pose | str]:
    """Build the states of rigid bodies, by their names."""
    states: dict[str, BodyState | Pose | str] = {}
    for body, own in table.items():
        with under(body):
            known_name("rigid body", body, mechanism.bodies.names, "[bodies]")
            word = isinstance(own, str)
            states[body] = own if word else BodyState(own.state, own.pose)
    return states
