"""Which parameters belong together: order constraints and material axes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._names import suggestion
from softcal_jax._typing import Array, Float, HostArray, Int, is_traced
from softcal_jax.fields._entry import AbstractEntry
from softcal_jax.fields._parameters import Parameter
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
    entries: Entries, order: tuple[tuple[str, str], ...]
) -> list[tuple[Term, Term]]:
    """Collect both sides of every inequality smaller <= larger.

    Args:
        entries: Entries of a parameter space.
        order: Pairs of parameter names, or of fields with control points.

    Returns:
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
            pair = (left[key], right[key])
            if pair[0].scale != pair[1].scale:
                raise ValueError(
                    f"order ({smaller!r}, {larger!r}): give both the same scale; got "
                    f"{pair[0].scale!r} and {pair[1].scale!r}."
                )
            if pair[0].column is not None or pair[1].column is not None:
                pairs.append(pair)
            else:
                _check_known(*pair)
    return pairs


def _check_known(small: Term, large: Term) -> None:
    """Raise ValueError if two known values contradict the order."""
    if is_traced(small.constant) or is_traced(large.constant):
        return
    if float(small.constant) > float(large.constant):
        raise ValueError(
            f"order: {small.name} <= {large.name}, but both are fixed, the first "
            "above the second."
        )


def _sides(entries: Entries, name: str, key: str) -> dict[str, Term]:
    """Return the terms of a parameter, or of a field by control point.

    Args:
        entries: Entries of a parameter space.
        name: The parameter or the field.
        key: Option that names it, "order" or "axes", for errors.
    """
    parameters = [q for entry in entries for q in entry.parameters]
    columns = {q.name: i for i, q in enumerate(parameters)}
    if name in columns:
        return {"": _unknown(parameters, columns[name])}
    sides = {}
    for entry in entries:
        if isinstance(entry, ControlPointParameters) and entry.field == name:
            for point in entry.control_points.names:
                if point in entry.fixed:
                    side = _known(entry, point)
                else:
                    column = columns[entry.parameter_name(point)]
                    side = _unknown(parameters, column)
                if point in sides:
                    raise ValueError(
                        f"{name} has two values at control point {point!r}, in "
                        "different regions: give their control points different names."
                    )
                sides[point] = side
    if not sides:
        fields = [e.field for e in entries if isinstance(e, ControlPointParameters)]
        raise ValueError(
            f"{key} names {name!r}, which is neither a parameter nor a field with "
            f"control points.{suggestion(name, [*fields, *columns])} Parameters are "
            f"{', '.join(columns)}."
        )
    return sides


def _unknown(parameters: list[Parameter], column: int) -> Term:
    q = parameters[column]
    unit = jnp.ones(()) if q.scale == "log" else q.unit_step
    return Term(q.name, q.scale, column, unit, jnp.zeros(()))


def _known(entry: ControlPointParameters, point: str) -> Term:
    value = entry.fixed[point]
    constant = jnp.log(value) if entry.scale == "log" else value
    name = f"{entry.field} of {point}"
    return Term(name, entry.scale, None, jnp.ones(()), constant)


def axis_columns(
    entries: Entries, axes: tuple[tuple[str, str, str], ...]
) -> Int[HostArray, "n_axes 3"]:
    """Find the columns of (smaller modulus, larger modulus, angle) of every axis.

    Args:
        entries: Entries of a parameter space.
        axes: Triples of fields with the same control points.

    Returns:
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


def _check_axis(axis: tuple[str, str, str], members: list[Parameter]) -> None:
    small, large, angle = members
    for modulus in (small, large):
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
