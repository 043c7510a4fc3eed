"""Effectors other than markers, and their rows for the solver (paper Sec. II).

Each is a sensor where it has a measured value; control brings the others to goals.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh

Quantity = Literal["point", "turn", "scalar", "force", "reaction"]
"""What a row of three effector coordinates is computed from."""

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
"""Rows are stacked in this order."""


class Unstated(float):
    """A default standard deviation, which weighs data but states nothing of them."""


class EffectorRow(NamedTuple):
    """Up to three coordinates of an effector, as the solver sees them.

    Nodes carry a point, with weights [-], or hold a reaction; `about` are indices of
    bodies or of the actuator. An angle has an axis [-] in the frame of the mesh, and
    turns are counted from a reference. Measured values are NaN where there is none,
    and `inverse_std` is 0 for a coordinate that does not count.
    """

    name: str
    quantity: Quantity
    unit: str
    measured: Float[HostArray, "3"] = np.full(3, np.nan)
    inverse_std: Float[HostArray, "3"] = np.zeros(3)
    nodes: Int[HostArray, " n"] = np.zeros(0, np.int32)
    weights: Float[HostArray, " n"] = np.zeros(0)
    about: tuple[int, int] = (0, 0)
    axis: Float[HostArray, "3"] = np.zeros(3)
    reference: Float[HostArray, "3 3"] = np.eye(3)

    @property
    def width(self) -> int:
        """Number of coordinates; the others of a scalar or a force are padding."""
        return 1 if self.quantity in ("scalar", "force") else 3

    def with_value(
        self,
        value: float | Float[ArrayLike, "..."] | None,
        std: float | Float[ArrayLike, "3"],
    ) -> tuple["EffectorRow"]:
        weight = inverse_std(self.name, "std", std, self.unit)
        if value is None:
            return (self,)
        n, shape = self.width, () if self.width == 1 else (3,)
        if np.shape(value) != shape or not np.all(np.isfinite(value)):
            count = "a finite number" if n == 1 else "three finite numbers"
            raise ValueError(
                f"effector {self.name!r} has the value {value}, expected {count} "
                f"[{self.unit}]; leave out what was not measured."
            )
        measured, weights = np.full(3, np.nan), np.zeros(3)
        measured[:n], weights[:n] = value, weight
        return (self._replace(measured=measured, inverse_std=weights),)


class AbstractEffector(Module):
    """Something that is measured on the robot, or brought to a goal."""

    name: eqx.AbstractVar[str]

    @abstractmethod
    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Return its coordinates on a mesh at rest.

        Raises:
            ValueError: If it does not fit the model, or its value is not finite.
        """

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "AbstractEffector":
        """Return it with other measured values: a row for each of `rows`, from rest."""
        del mechanism
        return replace(self, measured=values[0])  # pyright: ignore


class AbstractScalar(AbstractEffector):
    """An effector of one coordinate: a length, a volume, an angle, a force."""

    def measured_as(
        self, values: Float[HostArray, "k 3"], mechanism: Mechanism
    ) -> "AbstractScalar":
        del mechanism
        return replace(self, measured=float(values[0, 0]))  # pyright: ignore


def inverse_std(
    name: str, what: str, std: float | Float[ArrayLike, "3"], unit: str
) -> Float[HostArray, "..."]:
    values = np.asarray(std, float)
    bad = values[~(np.isfinite(values) & (values > 0.0))]
    if bad.size:
        raise ValueError(
            f"{what} of effector {name!r} must be positive and finite [{unit}], got "
            f"{bad[0]:g}."
        )
    return np.asarray(1.0 / values)
