"""Effectors as arrays: the rows of all configurations, padded to one shape."""

from collections.abc import Mapping, Sequence

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.configurations._arrays import EffectorArrays, RecordingBase
from softcal_jax.configurations._effector import QUANTITIES, EffectorRow, Quantity

Rows = Sequence[EffectorRow]
"""The rows of one configuration, in the order of the user."""


def row_indices(lanes: Sequence[Rows]) -> list[list[int]]:
    """Find the index of each row of each configuration among the stacked rows.

    Args:
        lanes: The rows of each configuration.

    Returns:
        For each configuration, one index per row.
    """
    counts = [_count(lanes, quantity) for quantity in QUANTITIES]
    first = dict(zip(QUANTITIES, np.cumsum([0, *counts[:-1]]), strict=True))
    indices = []
    for lane in lanes:
        used = dict.fromkeys(QUANTITIES, 0)
        found = []
        for row in lane:
            found.append(int(first[row.quantity]) + used[row.quantity])
            used[row.quantity] += 1
        indices.append(found)
    return indices


def _count(lanes: Sequence[Rows], quantity: Quantity) -> int:
    return max(sum(row.quantity == quantity for row in lane) for lane in lanes)


def stack_effectors(
    lanes: Sequence[Rows], indices: Sequence[Sequence[int]]
) -> list[EffectorArrays]:
    """Put the rows of each configuration into arrays of the same shapes.

    Args:
        lanes: The rows of each configuration.
        indices: Their indices, see `row_indices`.
    """
    n = {q: _count(lanes, q) for q in QUANTITIES}
    widest = max((row.nodes.size for lane in lanes for row in lane), default=0)
    return [
        _stack(lane, at, n, widest) for lane, at in zip(lanes, indices, strict=True)
    ]


def _stack(
    lane: Rows, indices: Sequence[int], n: Mapping[str, int], widest: int
) -> EffectorArrays:
    total = sum(n.values())
    nodes = np.zeros((total, widest), np.int32)
    weights = np.zeros((total, widest))
    about, axis = np.zeros((total, 2), np.int32), np.zeros((total, 3))
    reference = np.tile(np.eye(3), (total, 1, 1))
    measured, inverse_std = np.zeros((total, 3)), np.zeros((total, 3))
    for i, row in zip(indices, lane, strict=True):
        nodes[i, : row.nodes.size] = row.nodes
        weights[i, : row.weights.size] = row.weights
        about[i], axis[i], reference[i] = row.about, row.axis, row.reference
        measured[i], inverse_std[i] = np.nan_to_num(row.measured), row.inverse_std
    ends = np.cumsum([n[quantity] for quantity in QUANTITIES])
    points, turns, scalars, forces, reactions = (
        slice(int(end) - n[quantity], int(end))
        for end, quantity in zip(ends, QUANTITIES, strict=True)
    )
    return EffectorArrays(
        nodes=nodes[points],
        weights=weights[points],
        turn_body=about[turns, 0],
        turn_reference=reference[turns],
        scalar_index=about[scalars],
        scalar_axis=axis[scalars],
        force_actuator=about[forces, 0],
        reaction_nodes=nodes[reactions],
        reaction_weights=weights[reactions],
        measured=measured,
        inverse_std=inverse_std,
        base=RecordingBase(np.zeros(3), np.zeros(3)),
    )


def marker_rows(c, carried: list[tuple[HostArray, HostArray]]) -> list[EffectorRow]:
    """Return the markers of a configuration as rows.

    Args:
        c: The configuration.
        carried: Nodes and weights of each of its markers.
    """
    if c.markers is None:
        return []
    inverse_std, known = c.markers.inverse_std(), c.measured is not None
    return [
        EffectorRow(
            name=name,
            quantity="point",
            unit="m",
            measured=c.measured[i] if known else np.full(3, np.nan),
            inverse_std=inverse_std[i] * known,
            nodes=nodes,
            weights=weights,
        )
        for i, (name, (nodes, weights)) in enumerate(
            zip(c.markers.names, carried, strict=True)
        )
    ]
