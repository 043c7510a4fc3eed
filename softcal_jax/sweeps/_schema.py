"""The keys of a sweep file; a message on a missing key quotes its description."""

from collections.abc import Sequence
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from softcal_jax.project import Integer, Table, suggestion

OWN_AXES = ("layout", "configurations", "start", "noise")
"""Axes that are not keys of the project file."""

REPEATS = ("start", "noise")
"""Axes whose values are mere repetitions."""


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


_TABLE_OF: dict[str, type[Table]] = {
    "start": CountTable,
    "noise": CountTable,
    "configurations": ChooseTable,
}
_EXPECTED = {
    "start": "{ count = 10 } or a list of numbers",
    "noise": "{ count = 20 } or a list of numbers",
    "configurations": '{ choose = 2 } or a list of lists, like [["pose 1"]]',
    "layout": 'a list of names, like ["ends"]',
}


class SweepTable(Table):
    """A whole sweep file."""

    project: str = Field(description='the project file: "project.toml"')
    axes: dict[str, Any] = Field(description="a table [axes]")
    name: str | None = None
    seed: Integer = 0
    sample: Integer | None = None
    layouts: dict[str, dict[str, Any]] = Field(default_factory=dict)
    replaces: str | None = None
    truth: dict[str, Any] = Field(default_factory=dict)

    @field_validator("axes", mode="before")
    @classmethod
    def _check_axes(cls, axes: Any) -> Any:
        if not isinstance(axes, dict):
            return axes
        if not axes:
            raise ValueError(
                "there are none. Expected at least one of "
                f"{', '.join(OWN_AXES)}, or a key of the project file."
            )
        return {axis: _axis(axis, values) for axis, values in axes.items()}

    @model_validator(mode="after")
    def _check(self) -> "SweepTable":
        if self.sample is not None and self.sample < 1:
            raise ValueError(f"sample is {self.sample}; expected at least 1.")
        ranges = [a for a, v in self.axes.items() if isinstance(v, RangeTable)]
        if ranges and self.sample is None:
            raise ValueError(
                f"axis {ranges[0]} is a range, which has no end of values: say how "
                "many trials to draw, like sample = 100, or list the values."
            )
        if bool(self.layouts) != ("layout" in self.axes):
            raise ValueError(
                "[layouts] and the axis `layout` go together: the axis lists names of "
                "layouts, which [layouts.NAME] describes."
            )
        return self


def _axis(axis: str, values: Any) -> Sequence[Any] | Table:
    """Check the values of an axis as far as possible without the project."""
    if axis not in OWN_AXES and "." not in axis:
        raise ValueError(
            f"unknown axis {axis}.{suggestion(axis, OWN_AXES)} Known: "
            f'{", ".join(OWN_AXES)}, or a key of the project file, like "material.nu".'
        )
    usual = "a list of values, or { low = 1, high = 2 }"
    expected = f"expected {_EXPECTED.get(axis, usual)}."
    if isinstance(values, dict) and axis != "layout":
        try:
            return _TABLE_OF.get(axis, RangeTable).model_validate(values)
        except ValueError as error:
            raise ValueError(f"axis {axis}: {expected}") from error
    if not isinstance(values, list) or not values:
        raise ValueError(f"axis {axis}: got {values}; {expected}")
    if axis in REPEATS:
        for value in values:
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise ValueError(
                    f"axis {axis}: got {value}; expected numbers of draws: 0 for none, "
                    "1, 2, ..."
                )
    return values
