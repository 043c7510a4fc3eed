"""Effectors as arrays: the rows of all configurations, padded to one shape."""

from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.configurations._arrays import EffectorArrays, RecordingBase
from softcal_jax.configurations._effector import EffectorRow, Quantity

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
"""Rows are stacked in this order."""


class NamedRow(NamedTuple):
    """A row of effector coordinates, and whose it is.

    Attributes:
        name: Name of the marker or effector.
        row: Its coordinates.
    """

    name: str
    row: EffectorRow


def row_numbers(lanes: Sequence[Sequence[NamedRow]]) -> list[list[int]]:
    """Where each row of each configuration stands among the stacked rows.

    Args:
        lanes: The rows of each configuration, in the order of the user.

    Returns:
        For each configuration, one number per row.
    """
    counts = [_count(lanes, quantity) for quantity in QUANTITIES]
    first = dict(zip(QUANTITIES, np.cumsum([0, *counts[:-1]]), strict=True))
    numbers = []
    for lane in lanes:
        used = dict.fromkeys(QUANTITIES, 0)
        found = []
        for _, row in lane:
            found.append(int(first[row.quantity]) + used[row.quantity])
            used[row.quantity] += 1
        numbers.append(found)
    return numbers


def _count(lanes: Sequence[Sequence[NamedRow]], quantity: Quantity) -> int:
    return max(sum(row.quantity == quantity for _, row in lane) for lane in lanes)


def stack_effectors(lanes: Sequence[Sequence[NamedRow]]) -> list[EffectorArrays]:
    """Rows of each configuration as arrays of the same shapes.

    Args:
        lanes: The rows of each configuration.
    """
    numbers = row_numbers(lanes)
    n = {quantity: _count(lanes, quantity) for quantity in QUANTITIES}
    widest = max((row.nodes.size for lane in lanes for _, row in lane), default=0)
    return [
        _stack(lane, at, n, widest) for lane, at in zip(lanes, numbers, strict=True)
    ]


def _stack(
    lane: Sequence[NamedRow], numbers: list[int], n: dict, widest: int
) -> EffectorArrays:
    total = sum(n.values())
    nodes = np.zeros((total, widest), np.int32)
    weights = np.zeros((total, widest))
    index, axis = np.zeros((total, 2), np.int32), np.zeros((total, 3))
    reference = np.tile(np.eye(3), (total, 1, 1))
    measured, inverse_std = np.zeros((total, 3)), np.zeros((total, 3))
    for i, (_, row) in zip(numbers, lane, strict=True):
        nodes[i, : row.nodes.size] = row.nodes
        weights[i, : row.weights.size] = row.weights
        index[i], axis[i], reference[i] = row.about, row.axis, row.reference
        measured[i], inverse_std[i] = np.nan_to_num(row.measured), row.inverse_std
    ends = np.cumsum([n[quantity] for quantity in QUANTITIES])
    points, turns, scalars, forces, reactions = (
        slice(int(end) - n[quantity], int(end))
        for end, quantity in zip(ends, QUANTITIES, strict=True)
    )
    return EffectorArrays(
        nodes=nodes[points],
        weights=weights[points],
        turn_body=index[turns, 0],
        turn_reference=reference[turns],
        scalar_index=index[scalars],
        scalar_axis=axis[scalars],
        force_actuator=index[forces, 0],
        reaction_nodes=nodes[reactions],
        reaction_weights=weights[reactions],
        measured=measured,
        inverse_std=inverse_std,
        base=RecordingBase(np.zeros(3), np.zeros(3)),
    )


def marker_rows(c, carried: list[tuple[HostArray, HostArray]]) -> list[NamedRow]:
    """Markers of a configuration as rows.

    Args:
        c: The configuration.
        carried: Nodes and weights of each of its markers.
    """
    if c.markers is None:
        return []
    inverse_std = c.markers.inverse_std()
    rows = []
    for i, (name, (nodes, weights)) in enumerate(
        zip(c.markers.names, carried, strict=True)
    ):
        known = c.measured is not None
        measured = c.measured[i] if known else np.full(3, np.nan)
        row = EffectorRow(
            "point", "m", measured, inverse_std[i] * known, nodes, weights
        )
        rows.append(NamedRow(name, row))
    return rows
