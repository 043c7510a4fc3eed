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
        n = 0 if c.markers is None else len(c.markers.names)
        markers, others = records[c.name][:n], records[c.name][n:]
        before = {r.name: r for r in records.get(c.displacement_from or "", ())}
        if c.markers is not None:
            std = np.asarray(c.markers.std)
            values = [std.min(), std.max()] if std.min() < std.max() else [std.max()]
            noise = _stated(
                c.markers.std,
                " to ".join(readable_values([float(v)], "m") for v in values),
            )
            noise += _share(c)
            names = f"{n} marker{'s' if n > 1 else ''}"
            if c.markers.axes != "xyz":
                names += f" along {c.markers.axes}"
            rows.append((c.name, names, _motion(markers, before), noise))
        effectors = {e.name: e for e in c.effectors}
        for record in others:
            effector: Any = effectors[record.name]
            std = effector.std_angle if record.is_turn else effector.std
            size = readable_values(np.atleast_1d(np.asarray(std)).tolist(), record.unit)
            what = f"{record.name}, {_QUANTITIES[record.quantity]}"
            noise = _stated(std, size) if record.seen.any() else ""
            noise += (
                _share(c) if record.seen.any() and record.quantity == "point" else ""
            )
            rows.append((c.name, what, _value(record, before), noise))
        if not records[c.name]:
            rows.append((c.name, "nothing", "", ""))
    # The name stands once, on the first of its lines.
    seen: set[str] = set()
    for i, (name, *rest) in enumerate(rows):
        rows[i] = ("" if name in seen else name, *rest)
        seen.add(name)
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
    low, high = min(moved), max(moved)
    return f"moved {1e3 * low:.3g} to {1e3 * high:.3g} mm" + _since(before)


def _moved(record: EffectorRecord, before: Mapping[str, EffectorRecord]) -> float:
    earlier = before.get(record.name)
    start = record.at_rest if earlier is None else earlier.measured
    return float(np.linalg.norm(np.where(record.seen, record.measured - start, 0.0)))


def _since(before: Mapping[str, EffectorRecord]) -> str:
    return " since the reference" if before else " from rest"


def _value(record: EffectorRecord, before: Mapping[str, EffectorRecord]) -> str:
    if not record.seen.any():
        return "not measured"
    if record.quantity == "point":
        return f"moved {1e3 * _moved(record, before):.3g} mm{_since(before)}"
    if record.is_turn:
        turn = math.acos(np.clip(0.5 * (np.trace(record.reference) - 1.0), -1.0, 1.0))
        return f"turned {math.degrees(turn):.3g} deg from rest"
    return readable_values(list(record.measured), record.unit)
