"""The axes of a sweep file, and the values that each may have."""

import itertools
import math
import re
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import Field

from softcal_jax._limits import PLANNED, TRIALS
from softcal_jax._names import unknown_name
from softcal_jax.project import Integer, Table, suggestion
from softcal_jax.sweeps._trial import Range, is_number

OWN_AXES = ("layout", "configurations", "start", "noise")
"""Axes that are not keys of the project file."""

REPEATS = ("start", "noise")
"""Axes whose values are mere repetitions."""

_EXPECTED = {
    "start": "{ count = 10 } or a list of numbers: 0 for none, 1, 2, ...",
    "noise": "{ count = 20 } or a list of numbers: 0 for none, 1, 2, ...",
    "configurations": "{ choose = 2 } or a list of lists of configurations that are "
    'fitted together, like [["pose 1"], ["pose 1", "pose 2"]]',
    "layout": 'a list of names, like ["ends"]',
}

_QUANTITY = re.compile(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


class CountTable(Table):
    """Numbers from 1 to `count`."""

    count: Integer = Field(ge=1, description="how many, like 20")


class ChooseTable(Table):
    """All subsets of one size."""

    choose: Integer = Field(description="how many configurations, like 2")


class RangeTable(Table):
    """All values between two ends, for a sample."""

    low: Any = Field(description='the smallest value: "100 kPa", or a number')
    high: Any = Field(description='the largest value: "300 kPa", or a number')
    scale: Literal["linear", "log"] = "linear"


def axis_values(
    axis: str, given: Any, layouts: Sequence[str], poses: Sequence[str]
) -> Sequence[Any] | Range:
    """Return the values of an axis, given what the file has for it.

    `layouts` are the names of the file's layouts, `poses` those of the project's
    configurations with the role calibration.
    """
    if axis not in OWN_AXES and "." not in axis:
        raise ValueError(
            f"unknown axis.{suggestion(axis, OWN_AXES)} Known: {', '.join(OWN_AXES)}, "
            'or a key of the project file, like "material.nu".'
        )
    usual = "a list of values, or { low = 1, high = 2 }"
    wrong = ValueError(f"got {given}; expected {_EXPECTED.get(axis, usual)}.")
    if isinstance(given, dict) and axis != "layout":
        kinds = {"configurations": ChooseTable, **dict.fromkeys(REPEATS, CountTable)}
        try:
            table = kinds.get(axis, RangeTable).model_validate(given)
        except ValueError as error:
            raise wrong from error
        return _values_of_table(table, poses)
    if not isinstance(given, list) or not given:
        raise wrong
    if axis in REPEATS and not all(type(draw) is int and draw >= 0 for draw in given):
        raise wrong
    if axis == "layout":
        _check_known("layout", given, layouts)
    if axis != "configurations":
        return given
    for subset in given:
        if not isinstance(subset, list) or not subset:
            raise wrong
        _check_known("configuration with the role calibration", subset, poses)
    # In the project's order, so that [a, b] and [b, a] are the same trial.
    return [[name for name in poses if name in subset] for subset in given]


def _check_known(kind: str, names: Sequence[Any], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise unknown_name(kind, str(name), known)


def _values_of_table(table: Table, poses: Sequence[str]) -> Sequence[Any] | Range:
    if isinstance(table, CountTable):
        PLANNED.check(f"count = {table.count}", table.count)
        return range(1, table.count + 1)
    if isinstance(table, RangeTable):
        return _range(table)
    assert isinstance(table, ChooseTable)
    if not 1 <= table.choose <= len(poses):
        raise ValueError(
            f"choose = {table.choose}, but the project has {len(poses)} configurations "
            f"with the role calibration: {', '.join(poses)}."
        )
    n = math.comb(len(poses), table.choose)
    TRIALS.check(f"choose = {table.choose} of {len(poses)}", n)
    return [list(subset) for subset in itertools.combinations(poses, table.choose)]


def _range(table: RangeTable) -> Range:
    ends = [table.low, table.high]
    if all(map(is_number, ends)):
        return Range(float(table.low), float(table.high), table.scale)
    parts = [_QUANTITY.fullmatch(str(end)) for end in ends]
    if parts[0] is None or parts[1] is None or parts[0][2] != parts[1][2]:
        raise ValueError(
            f"got {table.low} and {table.high}; expected two numbers, or two "
            'quantities in the same unit, like "100 kPa" and "300 kPa".'
        )
    low, high = (float(part[1]) for part in parts if part is not None)
    return Range(low, high, table.scale, f"{{:.9g}} {parts[0][2]}")
