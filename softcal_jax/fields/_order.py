"""Which parameters belong together: order constraints and material axes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._names import suggestion
from softcal_jax._typing import Array, Float, HostArray, Int, is_traced
from softcal_jax.fields._parameters import AbstractEntry, Parameter
from softcal_jax.fields._spread import ControlPointParameters

Entries = tuple[AbstractEntry, ...]


class Term(NamedTuple):
    """One side of an inequality: unit * z[column], or a known constant."""

    name: str
    scale: str
    column: int | None
    unit: Float[Array, ""]
    constant: Float[Array, ""]


def order_terms(
    entries: Entries, order: tuple[tuple[str, ...], ...]
) -> list[tuple[Term, Term]]:
    """Collect both sides of every inequality smaller <= larger.

    One pair per control point of two fields, or per pair of parameters, except for
    pairs of known values.

    Raises:
        ValueError: If a name is unknown, two fields share no control point, a control
            point's name is ambiguous, the scales of both sides differ, or two known
            values contradict the order.
    """
    pairs = []
    for smaller, larger in order:
        left, right = (_sides(entries, name, "order") for name in (smaller, larger))
        shared = [key for key in left if key in right]
        if not shared:
            raise ValueError(
                f"order ({smaller!r}, {larger!r}): the two have no control point in "
                f"common ({', '.join(left)} and {', '.join(right)})."
            )
        for key in shared:
            small, large = left[key], right[key]
            if small.scale != large.scale:
                raise ValueError(
                    f"order ({smaller!r}, {larger!r}): give both the same scale; got "
                    f"{small.scale!r} and {large.scale!r}."
                )
            if small.column is not None or large.column is not None:
                pairs.append((small, large))
            elif is_traced(small.constant) or is_traced(large.constant):
                continue
            elif float(small.constant) > float(large.constant):
                raise ValueError(
                    f"order: {small.name} <= {large.name}, but both are fixed, the "
                    "first above the second."
                )
    return pairs


def _sides(entries: Entries, name: str, key: str) -> dict[str, Term]:
    """Return the terms of a parameter, or of a field by control point.

    `key` is the option that names it, "order" or "axes", for errors.
    """
    parameters = [q for entry in entries for q in entry.parameters]
    columns = {q.name: i for i, q in enumerate(parameters)}

    def unknown(column: int) -> Term:
        q = parameters[column]
        return Term(q.name, q.scale, column, q.unit_step, jnp.zeros(()))

    if name in columns:
        return {"": unknown(columns[name])}
    fields = [entry for entry in entries if isinstance(entry, ControlPointParameters)]
    sides: dict[str, Term] = {}
    for entry in fields:
        if entry.field != name:
            continue
        for point in entry.control_points.names:
            if point in sides:
                raise ValueError(
                    f"{name} has two values at control point {point!r}, in "
                    "different regions: give their control points different names."
                )
            if point in entry.fixed:
                value = entry.fixed[point]
                known = jnp.log(value) if entry.scale == "log" else value
                own = f"{name} of {point}"
                sides[point] = Term(own, entry.scale, None, jnp.ones(()), known)
            else:
                sides[point] = unknown(columns[entry.parameter_name(point)])
    if not sides:
        known = [*(entry.field for entry in fields), *columns]
        raise ValueError(
            f"{key} names {name!r}, which is neither a parameter nor a field with "
            f"control points.{suggestion(name, known)} Parameters are "
            f"{', '.join(columns)}."
        )
    return sides


def axis_columns(
    entries: Entries, axes: tuple[tuple[str, ...], ...]
) -> Int[HostArray, "n_axes 3"]:
    """Find the columns of (smaller modulus, larger modulus, angle) of every axis.

    One row per control point at which all three are unknown.

    Raises:
        ValueError: If a name is unknown, no control point has all three unknown, a
            modulus is not on a log scale, the angle is not a director whose bounds span
            180 degrees, or one of them has a step limit.
    """
    rows: list[list[int]] = []
    parameters = [q for entry in entries for q in entry.parameters]
    for axis in axes:
        sides = [_sides(entries, name, "axes") for name in axis]
        found = []
        for key in sides[0]:
            columns = [s[key].column if key in s else None for s in sides]
            known = [column for column in columns if column is not None]
            # If all three are tied, another control point has given this axis already.
            if len(known) == 3 and known not in found:
                found.append(known)
        if not found:
            raise ValueError(
                f"axes {axis}: no control point has all three unknown; give the three "
                "fields the same control points, or leave this axis out."
            )
        for columns in found:
            _check_axis(axis, [parameters[i] for i in columns])
        rows += found
    used = [column for row in rows for column in row]
    for column in used:
        if used.count(column) > 1:
            raise ValueError(
                f"axes: {parameters[column].name!r} belongs to more than one axis."
            )
    return np.array(rows, dtype=int).reshape(-1, 3)


def _check_axis(axis: tuple[str, ...], members: list[Parameter]) -> None:
    *moduli, angle = members
    for modulus in moduli:
        if modulus.scale != "log":
            raise ValueError(
                f'axes {axis}: {modulus.name!r} must have scale="log", got '
                f"{modulus.scale!r}."
            )
    if not angle.periodic:
        raise ValueError(
            f"axes {axis}: {angle.name!r} must turn freely: give it "
            'interpolation="director" and bounds that span 180 degrees.'
        )
    for member in members:
        if member.max_step is not None:
            raise ValueError(
                f"axes {axis}: {member.name!r} has a max_step, but steps of an axis "
                "are taken as tensors; leave one of the two out."
            )
