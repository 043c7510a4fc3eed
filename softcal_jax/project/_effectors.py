"""Tables of a project file that make effectors and their measured values."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from softcal_jax import configurations
from softcal_jax.configurations import AbstractEffector, BodyFrame, Mechanism, Unstated
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import under
from softcal_jax.project._quantities import (
    dimension_of,
    parse_scalar,
    parse_vector,
    scalar,
    shown,
)
from softcal_jax.project._sensors import (
    FrameTable,
    MotionSource,
    OrientationTable,
    PhotosTable,
    PolhemusFileTable,
    PoseFileTable,
    WrittenPoseTable,
)
from softcal_jax.project._table import Choice, Maker, of_type, table_of

Effectors = dict[str, AbstractEffector]


def _measured(value: Any, kinds: Sequence[Any]) -> Any:
    if not isinstance(value, dict):
        return Any
    if "photos" in value:
        return PhotosTable
    if "file" not in value:
        return WrittenPoseTable
    return PolhemusFileTable if value.get("format") == "polhemus" else PoseFileTable


Measured = Annotated[Any, Choice(_measured)]
"""A pose, or a quantity as text, whose dimension the effector knows."""


class EffectorTable(Maker):
    """Something measured beside markers, with `std` in the unit that it has there."""

    def build(self, name: str, mesh: TetMesh, mechanism: Mechanism) -> AbstractEffector:
        """Build the effector without a measured value, and check that it fits."""
        given = self.arguments()
        std = given.pop("std")
        effector: Any = self.makes(name, **given)
        unit = effector.rows(mesh, mechanism)[0].unit
        if not isinstance(std, str):
            return effector
        with under("std"):
            return replace(effector, std=scalar(dimension_of(unit), "positive")(std))

    def measured(
        self, effector: Any, value: Any, folder: Path, model: Model
    ) -> AbstractEffector:
        """Return the effector with its measured value; paths start from `folder`."""
        row = effector.rows(model.mesh, model.mechanism)[0]
        dimension = dimension_of(row.unit)
        if isinstance(value, MotionSource):
            raise ValueError(f'expected {dimension.name}, like "{dimension.example}".')
        if row.n_values == 1:
            return replace(effector, measured=parse_scalar(value, dimension))
        return replace(effector, measured=np.array(parse_vector(value, dimension)))


class BodyFrameTable(EffectorTable):
    """A frame with the mounting of its sensor, and the frame of the tracker's base."""

    orientation: OrientationTable = OrientationTable()
    base: FrameTable = FrameTable()

    def measured(
        self, effector: BodyFrame, value: Any, folder: Path, model: Model
    ) -> BodyFrame:
        """Return the frame with the motion of its body.

        Where the measurement has a covariance, it adds to the stated deviations.
        """
        if not isinstance(value, MotionSource):
            raise ValueError(
                f"got {shown(value)}; expected a pose, like "
                '{ position = "(0, 0, 100) mm", azimuth = "10 deg" }, '
                '{ file = "tracker.csv" } or { photos = "pose1/*.jpg", ... }.'
            )
        bodies = model.mechanism.bodies
        rest = effector.point
        if rest is None:
            rest = bodies.origin[bodies.names.index(effector.body)]
        pose, covariance = value.motion(folder, self.base.pose, self.orientation, rest)
        if covariance is None:
            return replace(effector, measured=pose)
        std, std_angle = np.sqrt(np.diag(covariance)).reshape(2, 3)
        if not isinstance(effector.std, Unstated):
            std = np.hypot(effector.std, std)
        if not isinstance(effector.std_angle, Unstated):
            std_angle = np.hypot(effector.std_angle, std_angle)
        return replace(effector, measured=pose, std=std, std_angle=std_angle)


def _table(kind: type[AbstractEffector]) -> type[Maker]:
    base = BodyFrameTable if kind is BodyFrame else EffectorTable
    return table_of(kind, "name", "measured", base=base, type=str, std=str)


AnyEffector = Annotated[EffectorTable, of_type(configurations.EFFECTORS, _table)]


def build_effectors(
    tables: Mapping[str, EffectorTable], mesh: TetMesh, mechanism: Mechanism
) -> Effectors:
    """Build all effectors of a project by name, without measured values."""
    effectors: Effectors = {}
    for name, table in tables.items():
        with under(name):
            effectors[name] = table.build(name, mesh, mechanism)
    return effectors
