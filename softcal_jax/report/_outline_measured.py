"""What is measured in each configuration, in words, before anything is solved."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    EffectorRecord,
    Unstated,
)
from softcal_jax.export import readable_values


def measured_rows(
    posed: Sequence[Configuration], lanes: ConfigurationLanes
) -> list[tuple[str, ...]]:
    """List what is measured in each configuration: markers together, others alone."""
    records = {c.name: seen for c, seen in zip(posed, lanes.effectors, strict=True)}
    rows: list[tuple[str, ...]] = []
    for c in posed:
        before = {r.name: r for r in records.get(c.displacement_from or "", ())}
        effectors = {e.name: e for e in c.effectors}
        n = 0 if c.markers is None else len(c.markers.names)
        own = []
        if c.markers is not None:
            std = np.asarray(c.markers.std)
            ends = dict.fromkeys([float(std.min()), float(std.max())])
            size = " to ".join(readable_values([value], "m") for value in ends)
            noise = _stated(c.markers.std, size) + _share(c)
            what = f"{n} marker{'s' if n > 1 else ''}"
            if c.markers.axes != "xyz":
                what += f" along {c.markers.axes}"
            own.append((what, _motion(records[c.name][:n], before), noise))
        for record in records[c.name][n:]:
            effector: Any = effectors[record.name]
            std = effector.std_angle if record.is_turn else effector.std
            size = readable_values(np.atleast_1d(np.asarray(std)).tolist(), record.unit)
            noise = _stated(std, size) if record.seen.any() else ""
            if noise and record.quantity == "point":
                noise += _share(c)
            what = f"{record.name}, {_QUANTITIES[record.quantity]}"
            own.append((what, _value(record, before), noise))
        own = own or [("nothing", "", "")]
        # The name stands once, on the first of its lines.
        rows += [("" if i else c.name, *row) for i, row in enumerate(own)]
    return rows


_QUANTITIES = {
    "point": "position",
    "turn": "orientation",
    "scalar": "value",
    "force": "force",
    "reaction": "reaction",
}
"""What coordinates are, in words."""


def _stated(std: Any, shown: str) -> str:
    return f"not stated: {shown} as a weight" if isinstance(std, Unstated) else shown


def _share(c: Configuration) -> str:
    """Say what belongs to the noise beside a standard deviation."""
    if c.relative_std == "estimated":
        return " and an estimated share of the motion"
    return f" and {100 * c.relative_std:.3g} % of the motion" if c.relative_std else ""


def _motion(
    markers: Sequence[EffectorRecord], before: Mapping[str, EffectorRecord]
) -> str:
    """Say how far markers were measured from where they are at rest, or were before."""
    moved = [_moved(m, before) for m in markers if m.seen.any()]
    if not moved:
        return "not measured"
    since = "since the reference" if before else "from rest"
    ends = dict.fromkeys(f"{1e3 * end:.3g}" for end in (min(moved), max(moved)))
    return f"moved {' to '.join(ends)} mm {since}"


def _moved(record: EffectorRecord, before: Mapping[str, EffectorRecord]) -> float:
    earlier = before.get(record.name)
    start = record.at_rest if earlier is None else earlier.measured
    return float(np.linalg.norm(np.where(record.seen, record.measured - start, 0.0)))


def _value(record: EffectorRecord, before: Mapping[str, EffectorRecord]) -> str:
    if record.quantity == "point" or not record.seen.any():
        return _motion([record], before)
    if record.is_turn:
        turn = math.acos(np.clip(0.5 * (np.trace(record.reference) - 1.0), -1.0, 1.0))
        return f"turned {math.degrees(turn):.3g} deg from rest"
    return readable_values(list(record.measured), record.unit)
