"""Measured and simulated values of effectors, for results and all that reads them."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.configurations._effector import EffectorRow, Quantity


def _width(quantity: Quantity) -> int:
    """Return how many of the three coordinates of a row count; others are padding."""
    return 1 if quantity in ("scalar", "force") else 3


class EffectorRecord(eqx.Module):
    """Up to three coordinates of an effector: their names, units and values.

    Made together with the arrays that the solver sees, and filled in by results; files,
    tables and pictures read it. A frame has two, one of its point and one of its turn.

    Attributes:
        name: Name of the marker or effector.
        quantity: What the coordinates are.
        unit: Their unit.
        index: Index of their row in `EffectorArrays`.
        measured: Measured values, or goals; NaN for a coordinate that was not measured.
            A turn is counted from the measured one.
        std: Their standard deviation; infinite for a coordinate that was not measured.
        reference: Of a turn, the orientation that it is counted from, as a matrix [-].
        at_rest: Of a point, its position on the undeformed robot [m]; of others NaN.
        simulated_before: Simulated values with the start parameters; NaN without
            an equilibrium, and where nothing was calibrated.
        simulated: Simulated values of the result; NaN without an equilibrium.
    """

    name: str
    quantity: Quantity
    unit: str
    index: int
    measured: Float[HostArray, " k"]
    std: Float[HostArray, " k"]
    reference: Float[HostArray, "3 3"]
    at_rest: Float[HostArray, " k"]
    simulated_before: Float[HostArray, " k"]
    simulated: Float[HostArray, " k"]

    @property
    def is_turn(self) -> bool:
        """Whether it is the orientation of a rigid body."""
        return self.quantity == "turn"

    @property
    def seen(self) -> Bool[HostArray, " k"]:
        """Which coordinates were measured."""
        return np.isfinite(self.std)

    @property
    def residual(self) -> Float[HostArray, " k"]:
        """Simulated minus measured values; NaN where not measured."""
        return self.simulated - self.measured

    def error(self, values: Float[HostArray, " k"]) -> Float[HostArray, " k"]:
        """Subtract the measured values from others; 0 where not measured."""
        return np.where(self.seen, values - self.measured, 0.0)

    def among(self, rows: Float[ArrayLike, "n_rows 3"]) -> Float[HostArray, " k"]:
        """Pick its coordinates among those of all rows of a configuration."""
        return np.asarray(rows)[self.index, : _width(self.quantity)].copy()


def effector_records(
    rows: Sequence[EffectorRow],
    indices: Sequence[int],
    points: Float[HostArray, "n_points 3"],
) -> tuple[EffectorRecord, ...]:
    """Describe the rows of one configuration.

    Args:
        rows: The rows.
        indices: Their indices in the arrays.
        points: All nodes at rest [m].
    """
    records = []
    for row, index in zip(rows, indices, strict=True):
        width, is_point = _width(row.quantity), row.quantity == "point"
        weight, nothing = row.inverse_std[:width], np.full(width, np.nan)
        seen = weight > 0.0
        records.append(
            EffectorRecord(
                name=row.name,
                quantity=row.quantity,
                unit=row.unit,
                index=index,
                measured=np.where(seen, row.measured[:width], np.nan),
                std=np.where(seen, 1.0 / np.where(seen, weight, 1.0), np.inf),
                reference=row.reference,
                at_rest=row.weights @ points[row.nodes] if is_point else nothing,
                simulated_before=nothing,
                simulated=nothing,
            )
        )
    return tuple(records)
